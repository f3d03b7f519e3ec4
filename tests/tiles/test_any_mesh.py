"""A run by tiles writes the bytes that a run in memory writes, whatever the mesh and the method."""

from __future__ import annotations

import dataclasses
import gzip
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as campaign
from hypothesis import strategies as st

from msal_cli import methods
from msal_cli.errors import MsalError
from msal_cli.job.pipeline import denoise_file
from msal_cli.job.records import MeshRecord
from msal_cli.job.settings import Settings, Task
from msal_cli.tiles import join, measures, opening, stages
from msal_cli.tiles.scratch import Scratch
from tests.cli.scans import msal
from tests.tiles import mesh_files

CASES = mesh_files.cases()


@pytest.fixture(autouse=True, scope="module")
def quick_writes():
    """Nothing is flushed to the disk, which takes most of the time of so small runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        yield


def settings(method: str = "msal", trust: str | None = None, **given) -> Settings:
    """``trust`` is the property of --weights, since methods have a parameter of that name."""
    own = {
        key: given.pop(key)
        for key in list(given)
        if key in Settings.__dataclass_fields__ and key != "weights"
    }
    return Settings(method, methods.find(method).validate(given), weights=trust, **own)


def in_memory(source: Path, wanted: Settings) -> MeshRecord:
    """The record of a run in memory, which writes ``whole`` beside the file."""
    target = source.with_name("whole" + source.suffix)
    record = denoise_file(Task(str(source), str(target), source.name), wanted)
    assert target.exists() == (record.error is None)
    return record


def by_tiles(source: Path, wanted: Settings, tile: int, chunk: int) -> dict[str, Any] | MsalError:
    """The figures of a run with tiles of about ``tile`` vertices, read by ``chunk`` of them, which
    writes ``tiles``; or its error."""
    target = source.with_name("tiles" + source.suffix)
    scratch = Scratch(source.with_name("scratch"))
    scratch.path.mkdir()
    task = Task(str(source), str(target), source.name)
    try:
        opening.open_run(task, wanted, scratch, tile_vertices=tile, chunk_vertices=chunk)
        stages.run_here(scratch)
        assert not target.exists()
        join.finish_output(scratch)
        changed = measures.changes_of(scratch)
        defects = measures.defects_of(scratch)
    except MsalError as error:
        assert not target.exists()
        return error
    finally:
        scratch.remove()
    assert target.exists()
    codes = tuple(code for code, _ in changed.warnings)
    return dataclasses.asdict(defects) | changed.fields | {"warning_codes": codes}


def check(
    folder: Path, file: tuple[str, bytes], wanted: Settings, tile: int = 100, chunk: int = 151
) -> bytes | str:
    """The output of both runs, or the code of their error, after they were compared."""
    suffix, data = file
    source = folder / f"scan{suffix}"
    source.write_bytes(data)
    record, found = in_memory(source, wanted), by_tiles(source, wanted, tile, chunk)
    if record.error is not None or isinstance(found, MsalError):
        assert record.error is not None and isinstance(found, MsalError), (record.error, found)
        assert (record.error.code, record.error.message) == (found.code, found.message)
        return record.error.code
    whole, tiled = (source.with_name(name + suffix).read_bytes() for name in ("whole", "tiles"))
    if whole != tiled:
        pytest.fail(where_different(file, whole, tiled))
    for name, value in found.items():
        # Tiles judge volume and flips, and no other harm.
        if hasattr(record, name) and name != "warning_codes":
            assert_close(name, getattr(record, name), value)
    return whole


def assert_close(name: str, one: Any, other: Any) -> None:
    """Figures of two records: counts are the same, sums but for their last digits."""
    if dataclasses.is_dataclass(one) and dataclasses.is_dataclass(other):
        for field in dataclasses.fields(one):
            assert_close(field.name, getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, float) and isinstance(other, float):
        # Lengths are counted in classes that are 0.1 % wide.
        limit = 1e-3 if name.startswith("p95") else 1e-7
        assert other == pytest.approx(one, rel=limit, abs=1e-9), name
    else:
        assert one == other, name


def where_different(file: tuple[str, bytes], whole: bytes, tiled: bytes) -> str:
    """In what vertices two outputs differ, and by how much."""
    from msal_cli import codecs

    if len(whole) != len(tiled):
        return f"{len(whole)} bytes in memory, {len(tiled)} by tiles"
    name = f"scan{file[0]}"
    before, one, other = (codecs.open_mesh(data, name).vertices for data in (file[1], whole, tiled))
    gap = np.abs(one - other).max(axis=1)
    rows = np.flatnonzero(one.view(np.uint64) != other.view(np.uint64)) // 3
    rows = np.unique(rows)
    if not len(rows):
        at = np.flatnonzero(np.frombuffer(whole, np.uint8) != np.frombuffer(tiled, np.uint8))
        return f"positions are the same, but {len(at)} bytes from byte {at[0]} on are not"
    return (
        f"{len(rows)} of {len(one)} vertices differ, the first {rows[:8].tolist()}, by up to "
        f"{gap.max():.3g}, where vertices moved by up to {np.abs(one - before).max():.3g}"
    )


QUICK = {
    "open", "everything", "half turned", "normals and seams", "polygons, float64",
    "stl, everything", "lines and points among the faces", "big endian, float64", "fans",
    "wiener", "robust", "all constraints", "by mass", "self-intersections",
    "umbrella", "bilateral_normal", "learned", "normal_diffusion",
}  # fmt: skip
"""Of the cases below those of every run; the others take a minute."""


def each(names):
    """The names as parameters of a test, most of them slow."""
    marks = {False: [pytest.mark.slow], True: []}
    return [pytest.param(name, marks=marks[name in QUICK]) for name in names]


@pytest.mark.parametrize("name", each(CASES))
def test_any_mesh(name, tmp_path):
    check(tmp_path, CASES[name], settings("msal"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["closed", "open", "seams", "everything", "components", "wound at random", "stl"]
)
def test_any_mesh_by_another_method(name, tmp_path):
    check(tmp_path, CASES[name], settings("bilateral_normal", iterations=4, vertex_iterations=3))


SHORT = {
    "anisotropic_diffusion": {"iterations": 4},
    "bilateral_normal": {"iterations": 3, "vertex_iterations": 4},
    "guided_normal": {"iterations": 2, "vertex_iterations": 3},
    "learned": {"iterations": 2, "vertex_iterations": 3},
    "mean_curvature_flow": {"variant": "explicit"},
    "normal_diffusion": {"iterations": 2, "normal_iterations": 2, "vertex_iterations": 2},
    "normal_threshold": {"iterations": 3, "vertex_iterations": 4},
    "static_dynamic": {"iterations": 2, "vertex_iterations": 3},
    "taubin": {"iterations": 4},
    "windowed_sinc": {"iterations": 6},
    "hc": {"iterations": 4},
    "wiener": {"iterations": 3},
    "blend": {"members": "0.5*guided_normal(similarity=0.45,iterations=1,vertex_iterations=2)"
              "+0.5*al(iterations=2,mollify=2)"},
}  # fmt: skip
"""Parameters with which the reach is small against the mesh."""


@pytest.mark.parametrize("name", each(methods.names()))
def test_any_method(name, tmp_path):
    """A method with a reach gives the same bytes, one without is refused before any work."""
    wanted = settings(name, **SHORT.get(name, {}))
    if methods.find(name).reach(wanted.parameters) is None:
        source = tmp_path / "scan.ply"
        source.write_bytes(CASES["closed"][1])
        error = by_tiles(source, wanted, 100, 151)
        assert isinstance(error, MsalError) and error.code == "E_USAGE"
        return
    outcome = check(tmp_path, CASES["open"], wanted)
    assert isinstance(outcome, bytes) and outcome != CASES["open"][1]


SETTINGS = {
    "no sweep": settings("msal", iterations=0),
    "many sweeps": settings("msal", iterations=9, mollify=0),
    "mollified": settings("al", mollify=3, iterations=2),
    "robust": settings("msal", schedule="robust", quantile=0.7),
    "wiener": settings("al", schedule="wiener", noise=0.2),
    "wiener, unknown noise": settings("msal", schedule="wiener"),
    "constant": settings("al", schedule="constant", fidelity=0.3, time_step=0.5),
    "al, multiscale": settings("al", schedule="multiscale"),
    "area": settings("msal", normals="area", weights="tukey", deviation="median"),
    "huber": settings("al", weights="huber"),
    "no weights": settings("al", weights="none"),
    "by mass": settings("al", scaling="mass"),
    "by edges": settings("al", scaling="edge"),
    "fixed boundary": settings("msal", boundary="fixed"),
    "curve": settings("taubin", iterations=3, boundary="curve"),
    "free": settings("umbrella", boundary="free"),
    "umbrella, multiscale": settings("umbrella", schedule="multiscale"),
    "bilateral, robust": settings("bilateral", schedule="robust", iterations=3),
    "explicit flow": settings("mean_curvature_flow", variant="explicit", schedule="multiscale"),
    "edges": settings("bilateral_normal", neighbours="edge", iterations=3, vertex_iterations=3),
    "undone": settings("bilateral_normal", sliding="undone", iterations=2, vertex_iterations=2),
    "auto sliding": settings("bilateral_normal", sliding="auto", iterations=2, vertex_iterations=2),
    "max move": settings("msal", max_move="0.05"),
    "max move in edges": settings("al", max_move="0.04e"),
    "lock": settings("msal", lock=("boundary",)),
    "lock a property": settings("msal", lock=("quality < 0",)),
    "trust": settings("msal", trust="quality"),
    "all constraints": settings(
        "al", schedule="multiscale", max_move="0.1e", lock=("boundary", "quality < 0"),
        trust="quality",
    ),
    "self-intersections": settings("msal", checks=("self-intersections",)),
}  # fmt: skip


@pytest.mark.parametrize("name", each(SETTINGS))
def test_any_setting(name, tmp_path):
    vertices, faces = mesh_files.relief()
    quality = np.random.default_rng(2).normal(size=len(vertices))
    file = (".ply", mesh_files.ply(vertices, faces, values={"quality": quality}))
    assert isinstance(check(tmp_path, file, SETTINGS[name]), bytes)


@pytest.mark.parametrize(("tile", "chunk"), [(1, 10**6), (5, 7), (25, 1), (10**6, 3)])
def test_any_size_of_tile_and_chunk(tile, chunk, tmp_path):
    vertices, faces = mesh_files.shuffled(*mesh_files.relief(5, 4))
    data = mesh_files.ply(*mesh_files.split_along_seams(vertices, faces))
    check(tmp_path, (".ply", data), settings("msal", iterations=2), tile, chunk)


NUMBERS = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 3.0]),
    st.floats(-4.0, 4.0, width=32, allow_subnormal=False),
)
METHODS = (
    settings("msal"),
    settings("al", schedule="constant"),
    settings("msal", schedule="robust", quantile=0.5, boundary="fixed"),
    settings("taubin", iterations=2),
    settings("bilateral_normal", iterations=2, vertex_iterations=2),
    settings("al", max_move="0.1e", lock=("boundary",)),
)


@st.composite
def soups(draw):
    """Any vertices and polygons at all, as a file."""
    vertices = draw(st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), min_size=3, max_size=40))
    corner = st.integers(0, len(vertices) - 1)
    faces = draw(st.lists(st.lists(corner, min_size=3, max_size=5), min_size=1, max_size=60))
    kind, endian = draw(st.sampled_from(["f4", "f8"])), draw(st.sampled_from("<>"))
    if draw(st.booleans()):
        triangles = np.array([face[:3] for face in faces])
        return ".stl", mesh_files.stl(np.array(vertices), triangles)
    return ".ply", mesh_files.ply(np.array(vertices), faces, kind=kind, endian=endian)


@st.composite
def damaged_scans(draw):
    """A small surface, some of whose faces and vertices are mixed up, in a random order."""
    seed = draw(st.integers(0, 2**20))
    dice = np.random.default_rng(seed)
    vertices, faces = draw(st.sampled_from([mesh_files.scan, mesh_files.relief]))(9, 8, seed)
    changes = (
        mesh_files.split_along_seams,
        mesh_files.with_strays,
        mesh_files.with_useless_faces,
        mesh_files.with_fins,
        mesh_files.wound_at_random,
        mesh_files.soup,
    )
    for change in changes:
        if draw(st.booleans()):
            vertices, faces = change(vertices, faces)
    left = dice.random(len(faces)) >= draw(st.sampled_from([0.0, 0.1, 0.6]))
    left[0] = True
    if draw(st.booleans()):
        vertices, faces = mesh_files.shuffled(vertices, faces[left], seed)
    if draw(st.booleans()):
        return ".stl", mesh_files.stl(vertices, faces)
    kind = draw(st.sampled_from(["f4", "f8"]))
    return ".ply", mesh_files.ply(vertices, faces, kind=kind)


ANY = {
    "file": st.one_of(soups(), damaged_scans()),
    "wanted": st.sampled_from(METHODS),
    "tile": st.integers(1, 60),
    "chunk": st.integers(1, 200),
}
_UNHURRIED = campaign(
    deadline=None, database=None, suppress_health_check=list(HealthCheck), derandomize=True
)


@campaign(_UNHURRIED, max_examples=4)
@given(**ANY | {"tile": st.integers(20, 60), "chunk": st.integers(40, 200)})
def test_anything_at_all(tmp_path_factory, file, wanted, tile, chunk):
    check(tmp_path_factory.mktemp("any"), file, wanted, tile, chunk)


@pytest.mark.slow
@campaign(_UNHURRIED, max_examples=1500)
@given(**ANY)
def test_anything_at_all_for_long(tmp_path_factory, file, wanted, tile, chunk):
    check(tmp_path_factory.mktemp("any"), file, wanted, tile, chunk)


@pytest.mark.slow
@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("name", CASES)
def test_any_mesh_by_any_setting(name, setting, tmp_path):
    wanted = SETTINGS[setting]
    if wanted.weights or any("quality" in lock for lock in wanted.lock):
        wanted = dataclasses.replace(wanted, weights=None, lock=("boundary",))
    check(tmp_path, CASES[name], wanted, tile=40)


@pytest.mark.slow
@pytest.mark.parametrize("wanted", METHODS)
@pytest.mark.parametrize("name", ["scans/face000.ply", "scans/dragon_vrip_res2.ply.gz"])
def test_real_scans(name, wanted, tmp_path, real_data):
    data = (real_data / name).read_bytes()
    if name.endswith(".gz"):
        data = gzip.decompress(data)
    check(tmp_path, (".ply", data), wanted, tile=4000, chunk=30_000)


@pytest.mark.parametrize("name", each(["everything", "shuffled seams"]))
def test_tasks_may_be_lost_at_their_end_and_come_in_any_order(name, tmp_path, monkeypatch):
    """Of a worker that is killed, all that it wrote may be there but for the result."""
    plain, lost, dice = Scratch.finish, set(), np.random.default_rng(4)

    def finish(self, stage, index, result):
        if (stage, index) in lost:
            plain(self, stage, index, result)
        lost.add((stage, index))

    def run_here(scratch):
        while (stage := stages.next_stage(scratch)) is not None:
            for index in dice.permutation(stage.todo).tolist():
                stages.run_task((str(scratch.path), stage.name, index))
            if not stages.next_stage(scratch).todo:
                stages.reduce_stage(scratch, stage.name)
                stages.reduce_stage(scratch, stage.name)

    monkeypatch.setattr(Scratch, "finish", finish)
    monkeypatch.setattr(stages, "run_here", run_here)
    wanted = settings("al", schedule="multiscale", max_move="0.1e", lock=("boundary",))
    assert isinstance(check(tmp_path, CASES[name], wanted), bytes)
    assert len(lost) > 40


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("normals and seams", ["--method", "al"]),
        ("properties", ["--max-move", "0.1e", "--lock", "boundary", "--lock", "quality < 0"]),
        ("properties", ["--method", "msal", "--weights", "quality"]),
    ],
)
def test_the_command_writes_the_same(name, words, tmp_path):
    suffix, data = CASES[name]
    source = tmp_path / f"scan{suffix}"
    source.write_bytes(data)
    records = []
    for folder, more in (("whole", []), ("tiles", ["--tiled"])):
        made = msal("denoise", source, "-o", tmp_path / folder / "out.ply", "--json", *more, *words)
        assert made.exit_code == 0, made.stderr
        records += json.loads(made.stdout)["records"]
    whole, tiled = records
    assert tiled["tiles"] is not None and whole["tiles"] is None
    assert tiled["output_sha256"] == whole["output_sha256"]
    for field in ("locked_vertices", "clamped_vertices", "welded_vertices", "seam_gap", "method"):
        assert tiled[field] == whole[field], field
