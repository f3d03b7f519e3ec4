"""What the record says of a mesh that was denoised by tiles, and whether its result is kept."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from msal_cli import methods
from msal_cli.auto import NONE
from msal_cli.job import changes
from msal_cli.job.choice import reject_choice
from msal_cli.job.plain_data import as_data, from_data
from msal_cli.job.records import ChoiceMade, MethodUsed, NoiseEstimate
from msal_cli.job.settings import CHOOSING
from msal_cli.tiles import measures
from msal_cli.tiles.plan import load_plan, read_globals, write_globals
from msal_cli.tiles.representative import read_settings, to_whole_units
from msal_cli.tiles.sweep import MEAN_EDGE_LENGTH

if TYPE_CHECKING:
    from msal_cli.codecs.streamed_mesh import StreamedMesh
    from msal_cli.tiles.scratch import Scratch


@dataclass
class Outcome:
    """Fields of a ``MeshRecord``, and its warnings with their codes."""

    fields: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    warning_codes: list[str] = field(default_factory=list)


def describe_source(mesh: StreamedMesh) -> dict[str, Any]:
    """Fields of the record that the header shows."""
    return {
        "format": mesh.format,
        "encoding": mesh.encoding,
        "precision": mesh.precision,
        "vertices": None if mesh.are_corners else mesh.n_vertices,
        "corners": mesh.n_vertices if mesh.are_corners else None,
        "faces": mesh.n_polygons,
    }


def reject_harmful(scratch: Scratch) -> bool:
    """Whether a method that was chosen would damage the mesh: then it stays as it is, and the
    stages from the first ``denoise`` on are to be run again."""
    choice = read_globals(scratch)["choice"]
    made = choice["known"].get("choice")
    if choice["method"] == NONE or made is None:
        return False
    harm = measures.changes_of(scratch).harm
    if harm is None:
        return False
    known = choice["known"]
    rejected = reject_choice(from_data(ChoiceMade, made), known.get("despiked"), harm)
    stays = {"method": NONE, "parameters": {}, "known": known | as_data(rejected)}
    write_globals(scratch, choice=choice | stays)
    number = 0
    while scratch.stage_result(f"denoise-{number}") is not None:
        number += 1
    # The last round first: where this is interrupted, what is left is a run up to some round.
    for one in reversed(range(number)):
        scratch.forget_stage(f"denoise-{one}")
    return True


def describe_result(scratch: Scratch, mesh: StreamedMesh) -> Outcome:
    """What is known once all tiles are denoised."""
    known = read_globals(scratch)
    edge = known["known"][MEAN_EDGE_LENGTH]
    settings = read_settings(load_plan(scratch))
    defects, measured = measures.defects_of(scratch), measures.changes_of(scratch)
    choice = to_whole_units(known["choice"], edge)
    noise = from_data(NoiseEstimate, choice["noise_estimate"])
    fields = {
        name: getattr(defects, name)
        for name in (
            "components",
            "boundary_edges",
            "non_manifold_edges",
            "inconsistent_edges",
            "degenerate_faces",
            "duplicate_faces",
            "unreferenced_vertices",
            "welded_vertices",
        )
    }
    fields |= {
        "triangles": known["n_triangles"],
        "mean_edge_length": edge,
        "noise_estimate": noise,
        **_read_known(choice["known"]),
        **measured.fields,
    }
    if mesh.are_corners:
        fields["vertices"] = mesh.n_vertices - known["n_welded"]
    if settings.method not in CHOOSING and choice["method"] != NONE:
        # A noise that was estimated is among the parameters.
        fields["method"] = MethodUsed(choice["method"], choice["parameters"])
    warnings = [*mesh.warnings, *changes.defect_warnings(defects), *choice["warnings"]]
    warnings += [f"{text} ({code})" for code, text in measured.warnings]
    if settings.method not in CHOOSING and choice["method"] != NONE:
        method = methods.find(choice["method"])
        moved = measured.fields["displacement"]
        warnings += changes.method_warnings(method, choice["parameters"], noise, moved, False)
    return Outcome(fields, warnings, [code for code, _ in measured.warnings])


def _read_known(known: dict[str, Any]) -> dict[str, Any]:
    """Fields of the record, of their own types, from plain data."""
    kinds = {"choice": ChoiceMade, "method": MethodUsed}
    return {
        name: from_data(kinds[name], value) if name in kinds and value is not None else value
        for name, value in known.items()
    }
