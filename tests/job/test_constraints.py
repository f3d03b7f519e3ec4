"""What keeps vertices near their place: limits, pins and trust, by identities."""

import numpy as np
import pytest

from msal_cli import codecs, methods
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.codecs.conversion import convert
from msal_cli.errors import UsageError
from msal_cli.job import constraints
from msal_cli.job.constraints import select_vertices
from msal_cli.job.settings import Lock, Settings, parse_length, parse_lock
from msal_cli.kernels.geometry import distances
from msal_cli.mesh import Mesh, prepare_mesh
from tests.files import denoise_bytes
from tests.job.test_pipeline import settings
from tests.ply_files import to_ply
from tests.shapes import grid, torus

ALL = methods.names()


def random():
    """The same numbers for every test, whatever ran before it."""
    return np.random.default_rng(7)


def noisy(maker=torus):
    vertices, faces = maker()
    edge = prepare_mesh(vertices, faces).mesh.mean_edge_length
    return vertices + 0.2 * edge * random().standard_normal(vertices.shape), faces


def denoised(data, **asked):
    output, record = denoise_bytes(data, "a.ply", settings(**asked))
    assert record.error is None, record.error
    return codecs.open_mesh(bytes(output), "a.ply").vertices, record


@pytest.mark.parametrize(
    ("text", "unit", "value", "in_edges"),
    [("0.3e", None, 0.3, True), (" 1e-3 ", None, 1e-3, False), ("2e3e", "m", 2e3, True)]
    + [("0.05", "m", 0.05, False), ("0.01mm", "m", 0.01e-3, False)]
    + [("50 um", "mm", 0.05, False), ("50µm", "mm", 0.05, False), ("1in", "mm", 25.4, False)]
    + [("2mil", "mm", 0.0508, False), ("1ft", "in", 12.0, False), ("1yd", "ft", 3.0, False)]
    + [("1m", "ft", 3.2808398950131235, False), ("1e-3km", "cm", 100.0, False)]
    + [("3nm", "um", 0.003, False)],
)
def test_lengths(text, unit, value, in_edges):
    found = parse_length(text, unit=unit)
    assert (found.value, found.in_edges) == (value, in_edges)
    assert parse_length(str(found)) == found


def test_a_unit_means_nothing_where_that_of_the_file_is_not_known():
    with pytest.raises(UsageError, match=r"--max-move 0\.01mm: mesh files have no unit") as caught:
        parse_length("0.01mm")
    assert "--unit mm" in caught.value.hint


@pytest.mark.parametrize(
    "text",
    ["", "0", "-1", "0e", "nan", "inf", "1e999", "3mmm", "0.3 e e", "%", "0mm", "-1mm"]
    + ["1e-999999999mm", "1e-323nm", "1e308km"],
)
def test_what_is_no_length_is_refused(text):
    with pytest.raises(UsageError, match=r"no length|too large"):
        parse_length(text, unit="m")


@pytest.mark.parametrize("text", ["", "a <", "< 3", "a < b", "a < 1e999", "a=1", "a < 1mm"])
def test_what_is_no_lock_is_refused(text):
    with pytest.raises(UsageError, match="neither"):
        parse_lock(text)


@pytest.mark.parametrize(
    ("comparison", "expected"),
    [("<", "100"), ("<=", "110"), (">", "001"), (">=", "011"), ("==", "010"), ("!=", "101")],
)
def test_comparisons(comparison, expected):
    lock = parse_lock(f"q {comparison} 2")
    selected = select_vertices(lock, np.array([1.0, 2.0, 3.0]))
    assert "".join(str(int(flag)) for flag in selected) == expected
    assert parse_lock(str(lock)) == lock
    assert parse_lock(f"z {comparison} -.2cm", unit="mm") == Lock("z", comparison, -2.0)


def test_a_single_precision_property_is_compared_in_single_precision():
    stored = np.array([0.2, 0.3], dtype=np.float32).astype(float)
    assert stored[0] > 0.2
    assert select_vertices(parse_lock("q <= 0.2"), stored).tolist() == [True, False]
    assert select_vertices(parse_lock("q == 0.2"), np.array([0.2, 0.3])).tolist() == [True, False]


@pytest.mark.parametrize("method", ALL)
def test_no_vertex_of_any_method_goes_further_than_the_limit(method):
    vertices, faces = noisy()
    mesh = prepare_mesh(vertices, faces).mesh
    data = to_ply(vertices, faces)
    limit = 0.05 * mesh.mean_edge_length
    free, _ = denoised(data, method=method)
    kept, record = denoised(data, method=method, max_move="0.05e")
    ways, free_ways = kept - vertices, free - vertices
    lengths, free_lengths = (np.linalg.norm(moves, axis=1) for moves in (ways, free_ways))
    assert lengths.max() <= limit * (1 + 1e-12)
    # The record is what gates look at.
    assert record.displacement.max <= 0.05 * record.mean_edge_length
    beyond = free_lengths > limit
    assert record.clamped_vertices == beyond.sum() > 0
    assert np.array_equal(kept[~beyond], free[~beyond])
    assert np.allclose(lengths[beyond], limit, rtol=1e-9)
    cosine = (ways * free_ways).sum(axis=1)[beyond] / (lengths * free_lengths)[beyond]
    assert cosine.min() > 1 - 1e-9


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_clamping_never_exceeds_the_limit_not_even_by_rounding(scale):
    before = scale * (random().standard_normal((2000, 3)) + 50.0)
    after = before + scale * np.random.default_rng(8).standard_normal((2000, 3))
    limit = 0.1 * scale
    mesh = Mesh(before, np.array([[0, 1, 2]], dtype=np.int32))
    kept, n_clamped = constraints.Constraints(mesh, None, limit).apply(after)
    assert n_clamped == (distances(before, after) > limit).sum() > 1000
    assert distances(before, kept).max() <= limit
    assert not np.shares_memory(kept, after)


def test_outliers_that_a_limit_keeps_off_are_no_damage_by_the_choice():
    vertices, faces = torus(96, 48)
    mesh = prepare_mesh(vertices, faces).mesh
    scan = add_noise(mesh, AddedNoise("outliers", 0.1, 1, fraction=0.02))
    chosen = Settings("adaptive", {}, max_move="0.1e")
    _, record = denoise_bytes(to_ply(scan, faces), "a.ply", chosen)
    assert record.despiked and record.displacement.moved_vertices and not record.warnings


def test_vertices_at_one_place_stay_together():
    vertices, faces = noisy()
    soup = vertices[faces].reshape(-1, 3)
    alone = np.arange(len(soup)).reshape(-1, 3)
    lock = np.zeros(len(soup))
    lock[0] = 1.0
    kept, record = denoised(to_ply(soup, alone, q=lock), max_move="0.05e", lock=("q == 1",))
    assert record.seam_gap == 0.0
    assert record.locked_vertices == 1
    # All corners at the place of the pinned one.
    there = (soup == soup[0]).all(axis=1)
    assert there.sum() > 1
    assert np.array_equal(kept[there], soup[there])


@pytest.mark.parametrize(("method", "encoding"), [("taubin", "same"), ("msal", "ascii")])
def test_locked_vertices_keep_their_very_bytes(method, encoding):
    vertices, faces = noisy()
    quality = random().random(len(vertices))
    file = codecs.open_mesh(to_ply(vertices, faces, quality=quality), "a.ply")
    data = bytes(file.encoded(file.vertices, encoding, "same"))
    before = codecs.open_mesh(data, "a.ply").vertices
    after, record = denoised(data, method=method, lock=("quality < 0.3",))
    is_locked = quality < 0.3
    assert record.locked_vertices == is_locked.sum()
    assert np.array_equal(after[is_locked], before[is_locked])
    assert (after[~is_locked] != before[~is_locked]).any(axis=1).mean() > 0.9


def test_the_boundary_is_locked_as_boundary_fixed_does():
    data = to_ply(*noisy(grid))
    locked, record = denoised(data, lock=("boundary",))
    fixed, _ = denoised(data, boundary="fixed")
    assert np.array_equal(locked, fixed)
    assert record.locked_vertices == record.boundary_edges > 0
    vertices, faces = noisy(grid)
    glb, _ = convert(codecs.open_mesh(to_ply(vertices, faces), "a.ply"), vertices, "glb")
    _, both = denoise_bytes(bytes(glb), "a.glb", settings(lock=("boundary", "x < 1e5")))
    assert both.locked_vertices == len(vertices) > record.locked_vertices


def test_trust_is_the_property_over_its_largest_value():
    vertices, faces = noisy()
    quality = random().random(len(vertices)) * 255.0
    data = to_ply(vertices, faces, quality=quality)
    half = to_ply(vertices, faces, quality=0.5 * quality)
    whole, _ = denoised(data, weights="quality")
    halved, _ = denoised(half, weights="quality")
    plain, _ = denoised(data)
    assert np.array_equal(whole, halved)
    assert not np.array_equal(whole, plain)
    record = denoise_bytes(data, "a.ply", settings(weights="x"))[1]
    assert "'x' is a coordinate" in record.error.message
    is_fifth = np.arange(len(vertices)) == 5
    negative, zero = (np.where(is_fifth, value, quality) for value in (-3.0, 0.0))
    of_negative, of_zero = (
        denoised(to_ply(vertices, faces, q=trust), weights="q")[0] for trust in (negative, zero)
    )
    assert np.array_equal(of_negative, of_zero)


def test_pinned_vertices_go_back_whatever_a_method_gives():
    mesh = prepare_mesh(*grid(5)).mesh
    held = np.arange(len(mesh.vertices)) % 3 == 0
    moved, n_cut = constraints.Constraints(mesh, held, None).apply(mesh.vertices + 1.0)
    assert n_cut == 0
    assert (moved[held] == mesh.vertices[held]).all()
    assert (moved[~held] == mesh.vertices[~held] + 1.0).all()
