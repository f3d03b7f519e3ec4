"""Two files that are read in pieces against each other, as in memory."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.job import streamed_distances
from msal_cli.job.comparison import compare_files
from msal_cli.job.plain_data import as_data
from tests.job.large_files import in_pieces, write_ply, write_stl
from tests.shapes import grid, torus

__all__ = ["in_pieces"]

NOT_MEASURED = {
    "hausdorff",
    "hausdorff_edges",
    "distance_to_before",
    "distance_to_after",
    "seam_gap",
    "warnings",
    "read_in_pieces",
}
NOT_COUNTED = {"vertices_before", "vertices_after"}


def moved(vertices, *, by=0.03, share=1.0):
    """Vertices of which a share moved, by distances that differ much."""
    rng = np.random.default_rng(3)
    step = rng.normal(0.0, by, vertices.shape) * rng.random((len(vertices), 1)) ** 4
    return vertices + step * (rng.random((len(vertices), 1)) < share)


def check_same(before, after, monkeypatch, *, but=()):
    in_pieces_now = as_data(compare_files(str(before), str(after)))
    monkeypatch.undo()
    known = as_data(compare_files(str(before), str(after)))
    assert in_pieces_now["error"] is None
    assert in_pieces_now["read_in_pieces"]
    check_alike(
        {name: told for name, told in in_pieces_now.items() if told is not None},
        {name: value for name, value in known.items() if name not in NOT_MEASURED | set(but)},
    )


def check_alike(told, known):
    for name, value in known.items():
        if isinstance(value, dict):
            check_alike(told[name], value)
        elif isinstance(value, float):
            assert told[name] == pytest.approx(value, rel=1e-9, abs=1e-15), name
        elif value is not None:
            assert told[name] == value, name


@pytest.mark.parametrize("shape", [torus, grid])
@pytest.mark.parametrize("share", [0.0, 0.02, 1.0])
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_plys(tmp_path, in_pieces, monkeypatch, shape, share, kind):
    vertices, faces = shape(30, 20)
    vertices = np.append(vertices, [[0.5, 0.25, 0.125]], axis=0)
    faces = np.append(np.random.default_rng(1).permutation(faces), [[5, 7, 7]], axis=0)
    before = write_ply(tmp_path / "a.ply", vertices, faces, kind)
    after = write_ply(tmp_path / "b.ply", moved(vertices, share=share), faces, kind)
    check_same(before, after, monkeypatch)


def test_inside_out_and_flipped(tmp_path, in_pieces, monkeypatch):
    vertices, faces = torus(30, 20)
    before = write_ply(tmp_path / "a.ply", vertices, faces[:, ::-1])
    after = write_ply(tmp_path / "b.ply", moved(vertices, by=0.8), faces[:, ::-1])
    check_same(before, after, monkeypatch)
    assert compare_files(str(before), str(after)).flipped_faces > 0


def test_stls(tmp_path, in_pieces, monkeypatch):
    vertices, faces = torus(30, 20)
    before = write_stl(tmp_path / "a.stl", vertices, faces)
    after = write_stl(tmp_path / "b.stl", moved(vertices), faces)
    # Corners at one place count one by one, so that only what faces tell is the same.
    check_same(
        before, after, monkeypatch, but=(*NOT_COUNTED, "displacement", "vertex_error_percent")
    )


def test_facets_that_come_apart_are_other_faces(tmp_path, in_pieces):
    vertices, faces = torus(30, 20)
    before = write_stl(tmp_path / "a.stl", vertices, faces)
    after = write_stl(tmp_path / "b.stl", vertices, np.random.default_rng(0).permutation(faces))
    error = compare_files(str(before), str(after)).error
    assert error.code == "E_UNSUPPORTED"
    assert "apart after" in error.message


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda v, f: (v, f[:-1]), "other numbers of vertices or faces"),
        (lambda v, f: (v[:-1], np.minimum(f, len(v) - 2)), "other numbers of vertices or faces"),
        (lambda v, f: (v, np.concatenate([f[:700], f[701:], f[:1]])), "triangle 700 is another"),
    ],
)
def test_other_faces_are_refused(tmp_path, in_pieces, spoil, why):
    vertices, faces = torus(30, 20)
    before = write_ply(tmp_path / "a.ply", vertices, faces)
    after = write_ply(tmp_path / "b.ply", *spoil(vertices, faces))
    record = compare_files(str(before), str(after))
    assert record.error.code == "E_UNSUPPORTED"
    assert why in record.error.message
    assert record.error.where == str(after)


def test_bad_input_is_named_with_its_file_and_place(tmp_path, in_pieces):
    vertices, faces = torus(30, 20)
    before = write_ply(tmp_path / "a.ply", vertices, faces)
    vertices[301, 1] = np.inf
    after = write_ply(tmp_path / "b.ply", vertices, faces)
    error = compare_files(str(before), str(after)).error
    assert (error.code, error.where) == ("E_NONFINITE", f"{after}: vertex 301")


@pytest.mark.parametrize("n_kept", [1, 100, 10**6])
@pytest.mark.parametrize(
    "numbers",
    [
        np.random.default_rng(2).random(3000) ** 9,
        np.full(500, 0.1),
        np.zeros(500),
        np.append(np.zeros(900), np.full(100, 1e300)),
        1.0 + np.arange(1000) * 2.0**-52,
    ],
)
def test_numbers_of_a_rank(numbers, n_kept, monkeypatch):
    monkeypatch.setattr(streamed_distances, "MOST_KEPT", n_kept)
    for rank in (0, 17, len(numbers) // 2, len(numbers) - 1):
        found = streamed_distances.number_of_rank(lambda: iter(np.array_split(numbers, 7)), rank)
        assert found == pytest.approx(np.sort(numbers)[rank], rel=1e-14)
