"""A mesh denoised by tiles, as far as its new positions, and the same in memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from msal_cli import methods
from msal_cli.auto import NONE
from msal_cli.job import changes
from msal_cli.mesh import prepare_mesh
from msal_cli.tiles import measures, stages
from msal_cli.tiles.plan import write_globals
from msal_cli.tiles.scratch import Scratch
from tests.tiles.fakes import FakeMesh, open_fake


def denoise_by_tiles(
    monkeypatch: Any,
    folder: Path,
    mesh: FakeMesh,
    method: str,
    given: dict[str, Any],
    *,
    is_repeated: bool = False,
    **sizes: int,
) -> tuple[np.ndarray, Scratch]:
    """New positions (n, 3) in the order of the file, and the scratch folder they came from; with
    ``is_repeated`` every task runs twice."""
    folder.mkdir(exist_ok=True)
    _, scratch = open_fake(monkeypatch, folder, mesh, **sizes)
    while (stage := stages.next_stage(scratch)) is not None and stage.name != "join":
        if stage.name == "choose":
            choose(scratch, method, given)
        else:
            for index in stage.todo:
                stages.run_task((str(folder), stage.name, index))
                if is_repeated:
                    # As after a kill between the last write and the result.
                    (folder / "done" / stage.name / f"{index}.json").unlink()
                    stages.run_task((str(folder), stage.name, index))
        if stage.name == "choose":
            scratch.finish_stage("choose", {"again": False})
        else:
            stages.reduce_stage(scratch, stage.name)
    moved = scratch.array("moved.f8", np.float64, 3)
    return np.array(moved[scratch.array("numbers.u4", np.uint32)]), scratch


def choose(scratch: Scratch, method: str, given: dict[str, Any]) -> None:
    """What the stage ``choose`` would: a method by name, or none."""
    one = None if method == NONE else methods.find(method)
    parameters = {} if one is None else one.validate(given)
    choice = {
        "method": method,
        "parameters": parameters,
        "is_whole": True,
        "mean_edge_length": 1.0,
        "known": {},
        "noise_estimate": {},
    }
    scratch.finish("choose", 0, choice)
    write_globals(scratch, choice=choice, rings=0 if one is None else one.reach(parameters))


def denoise_in_memory(
    mesh: FakeMesh, method: str, given: dict[str, Any]
) -> tuple[np.ndarray, Any, changes.Measured]:
    """New positions (n, 3), the prepared mesh, and what changed."""
    vertices = mesh.vertices.astype(np.float64)
    ready = prepare_mesh(vertices, mesh.faces.astype(np.int32))
    moved = ready.mesh.vertices
    if method != NONE:
        one = methods.find(method)
        moved = one.denoise(ready.mesh, one.validate(given)).vertices
    return ready.to_file_vertices(moved, vertices), ready, changes.measure(ready, moved, None)


def check_same(
    monkeypatch: Any,
    folder: Path,
    mesh: FakeMesh,
    method: str = "al",
    given: Any = None,
    **more: Any,
) -> Scratch:
    """Denoise both ways and compare everything but the estimate of the noise."""
    monkeypatch.setattr(changes, "noise_field", lambda mesh, known=None: None)
    expected, ready, measured = denoise_in_memory(mesh, method, given or {})
    found, scratch = denoise_by_tiles(monkeypatch, folder, mesh, method, given or {}, **more)
    assert found.tobytes() == expected.tobytes()
    assert measures.defects_of(scratch) == ready.defects
    compare(measures.changes_of(scratch), measured)
    return scratch


def compare(found: changes.Measured, expected: changes.Measured) -> None:
    """Figures of a run by tiles against those of a run in memory."""
    assert found.warnings == expected.warnings
    assert found.harm == expected.harm
    for name, value in found.fields.items():
        if name == "seam_gap":
            assert value == 0.0
            continue
        other = expected.fields[name]
        if not hasattr(value, "__dataclass_fields__"):
            assert value == other, name
            continue
        for field in value.__dataclass_fields__:
            one, two = getattr(value, field), getattr(other, field)
            label = f"{name}.{field}"
            if isinstance(one, float) and isinstance(two, float):
                near = 2e-3 if field.startswith("p95") else 1e-9
                assert abs(one - two) <= near * abs(two) + 1e-15, label
            else:
                assert one == two, label
