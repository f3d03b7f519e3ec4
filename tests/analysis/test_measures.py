"""Figures of a surface and of its change, what it encloses, and what counts as damage."""

import numpy as np
import pytest

from benchmarks import ground_truth
from msal_cli.analysis import measures
from msal_cli.mesh import prepare_mesh
from tests.shapes import ball, cube, fan, grid, torus


def test_displacement_by_hand():
    statistics = measures.distance_statistics(np.arange(20.0))
    assert statistics.mean == pytest.approx(9.5)
    assert statistics.rms == pytest.approx(np.sqrt((np.arange(20) ** 2).mean()))
    assert statistics.p95 == 18.0  # the 19th of 20: 95 % of the vertices moved no farther
    assert statistics.max == 19.0
    assert statistics.n_moved == 19


def test_normals_by_hand():
    # Flatten a pyramid: every face turns by the same angle.
    vertices, faces = fan([0.0] * 4)
    vertices[0, 2] = 1.0
    tip, flat = prepare_mesh(vertices, faces).mesh, prepare_mesh(vertices * [1, 1, 0], faces).mesh
    turned = measures.measure_surface_change(tip, flat)
    angle = np.degrees(np.arccos(1 / np.sqrt(3)))
    assert turned.mean_angular_error_deg == pytest.approx(angle)
    assert turned.max_angular_error_deg == pytest.approx(angle)
    assert turned.flipped_faces == 0


def test_a_volume_that_is_rounding_is_none():
    flat = 8.0 * 1e-9  # the area is 4, and 4 ** 1.5 is 8
    above = np.nextafter(flat, 1.0)
    assert measures.is_negative(-above, 4.0) and not measures.is_negative(-flat, 4.0)
    assert measures.relative_volume_change(flat, 1.0, 4.0) is None
    assert measures.relative_volume_change(above, 0.0, 4.0) == -1.0
    assert measures.relative_volume_change(-2.0, -3.0, 4.0) == 0.5


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_curvature_of_a_torus(scale):
    vertices, faces = torus(160, 80)
    mesh = prepare_mesh(scale * vertices, faces).mesh
    beta = np.arctan2(vertices[:, 2], np.hypot(vertices[:, 0], vertices[:, 1]) - 3.0)
    expected = (3.0 + 2.0 * np.cos(beta)) / (2.0 * (3.0 + np.cos(beta)))
    assert scale * measures.mean_curvature(mesh) == pytest.approx(expected, rel=0.01, abs=0.005)


def test_the_sign_follows_the_winding():
    vertices, faces = torus(40, 20)
    outward = measures.mean_curvature(prepare_mesh(vertices, faces).mesh)
    inward = measures.mean_curvature(prepare_mesh(vertices, faces[:, ::-1]).mesh)
    assert outward == pytest.approx(-inward, rel=1e-9)
    assert (outward > 0.0).mean() > 0.9


def test_sigma_by_hand():
    # Heights 1, -1, ... above the plane z = 0: mean 0, mean deviation 1, sigma 2.
    mesh = prepare_mesh(*fan([1.0, -1.0, 1.0, -1.0])).mesh
    normals = np.tile([0.0, 0.0, 1.0], (5, 1))
    assert measures.local_scale(mesh, normals)[0] == pytest.approx(2.0)
    assert (
        measures.local_scale(prepare_mesh(*grid()).mesh, np.tile([0.0, 0.0, 1.0], (30, 1))).max()
        < 1e-6
    )


def test_what_is_created_is_neither_the_difference_nor_all():
    vertices, faces = torus(10, 6)
    # A vertex on the other side of the tube, or of the whole.
    before, after = vertices.copy(), vertices.copy()
    before[0] *= -0.9
    after[30] *= -0.9
    ready = prepare_mesh(before, faces)
    moved = ready.mesh.with_vertices(after - ready.origin)
    n_before, n_after, n_created = measures.self_intersection_change(ready.mesh, moved)
    assert n_before == measures.count_self_intersections(ready.mesh) > 0
    assert n_after == measures.count_self_intersections(moved) > 0
    assert n_after - n_before < n_created <= n_after
    still = ready.mesh.with_vertices(ready.mesh.vertices.copy())
    assert measures.self_intersection_change(ready.mesh, still) == (n_before, n_before, 0)


def test_faces_without_area_are_left_out():
    # The third face closes a gap that has no width, and touches the first all along an edge.
    vertices = np.array([(0, 0, 0), (2, 0, 0), (1, 2, 0), (1, 0, 0), (1, -2, 0)], dtype=float)
    faces = np.array([(0, 1, 2), (3, 0, 4), (0, 3, 1)], dtype=np.int32)
    ready = prepare_mesh(vertices, faces)
    assert ready.defects.degenerate_faces == 1
    # Those with an area touch along half an edge, and share a vertex only.
    assert measures.count_self_intersections(ready.mesh) == 1


def harm_of(before, after, has_volume=True):
    return measures.harmful_change(
        before, after, measures.measure_surface_change(before, after), has_volume=has_volume
    )


@pytest.mark.parametrize(
    ("scale", "is_harm"), [(0.8, False), (0.79, True), (1.14, False), (1.15, True), (-1.0, True)]
)
@pytest.mark.parametrize("order", [1, -1])
def test_half_of_the_volume_is_harm_whichever_side_is_out(scale, is_harm, order):
    vertices, faces = torus()
    mesh = prepare_mesh(vertices, faces[:, ::order]).mesh
    found = harm_of(mesh, mesh.with_vertices(mesh.vertices * scale))
    assert (found is not None) == is_harm
    assert found is None or found.code == measures.VOLUME
    if scale == 0.79:
        assert found.reason == "the volume changed by -50.7 %"


def excess_of(before, after, noise, has_volume=True, leeway=1.0):
    change = measures.measure_surface_change(before, after)
    ways = np.linalg.norm(after.vertices - before.vertices, axis=1)
    p95 = float(np.quantile(ways, 0.95)) / before.mean_edge_length
    more = {"has_volume": has_volume, "leeway": leeway}
    return measures.excessive_change(before, after, change, noise, p95, **more)


def test_what_noise_does_not_explain_is_harm():
    mesh = prepare_mesh(*ball()).mesh
    smaller = mesh.with_vertices(0.99 * mesh.vertices)
    assert excess_of(mesh, smaller, 0.01).code == measures.VOLUME
    assert excess_of(mesh, smaller, 0.01).reason.startswith("the volume changed by -3.0 %")
    shifted = mesh.with_vertices(mesh.vertices + [0.2 * mesh.mean_edge_length, 0.0, 0.0])
    assert excess_of(mesh, shifted, 0.01).code == measures.MOVES
    turned = mesh.vertices + 0.03 * np.cross(mesh.vertices, [0.0, 0.0, 1.0])
    assert measures.displacement(mesh, mesh.with_vertices(turned)).p95 > 0.1 * mesh.mean_edge_length
    assert excess_of(mesh, mesh.with_vertices(turned), 0.01) is None, "within the surface"
    assert excess_of(mesh, smaller, 0.01, leeway=measures.NAMED_LEEWAY) is None
    stretched = mesh.with_vertices(mesh.vertices * [1.05, 1.0, 1.0])
    assert excess_of(mesh, stretched, 0.01, has_volume=False).code == measures.AREA
    assert excess_of(mesh, mesh, 0.0) is None


@pytest.mark.parametrize("level", [0.05, 0.1, 0.3, 0.5, 0.7])
@pytest.mark.parametrize("kind", ["gaussian-normal", "gaussian"])
@pytest.mark.parametrize("shape", [ball, lambda: torus(96, 48), lambda: torus(400, 12)])
def test_the_true_surface_is_no_harm(shape, kind, level):
    clean = prepare_mesh(*shape()).mesh
    noisy = clean.with_vertices(ground_truth.add_plain_noise(clean, kind, level, seed=3))
    read = level * clean.mean_edge_length / noisy.mean_edge_length
    assert excess_of(noisy, clean, read) is None


def test_flips_on_a_smooth_mesh_are_harm():
    mesh = prepare_mesh(*grid(20, 20)).mesh
    vertices = mesh.vertices.copy()
    inner = np.flatnonzero(~mesh.topology.boundary)
    for vertex in inner[::25]:
        vertices[vertex, :2] += [5.0, 5.0]
    after = mesh.with_vertices(vertices)
    n_flipped = measures.measure_surface_change(mesh, after).flipped_faces
    assert n_flipped > 0.02 * len(mesh.faces)
    found = harm_of(mesh, after, has_volume=False)
    assert found is not None
    assert found.code == measures.FLIPPED
    assert found.reason.startswith(f"{n_flipped} of {len(mesh.faces)} faces flipped (")
    # Half of the faces are needles: they flip by next to nothing, and have next to no area.
    squeezed = mesh.vertices.copy()
    squeezed[:, 1] -= 0.999 * (np.arange(400) // 20 % 2)
    beyond = squeezed - np.outer(np.arange(400) // 20 % 2, [0.0, 0.002, 0.0])
    needles = mesh.with_vertices(squeezed)
    assert harm_of(needles, mesh.with_vertices(beyond), has_volume=False) is None
    change = measures.measure_surface_change(needles, mesh.with_vertices(beyond))
    assert change.flipped_faces > 0.4 * len(mesh.faces)


@pytest.mark.parametrize("level", [0.2, 0.4, 0.6])
def test_unfolding_what_noise_folded_is_no_harm(level):
    clean = prepare_mesh(*ball()).mesh
    noisy = clean.with_vertices(ground_truth.add_plain_noise(clean, "gaussian", level, seed=3))
    assert measures.measure_surface_change(noisy, clean).flipped_faces > 0.02 * len(clean.faces)
    assert measures.folded_faces(noisy) > 0
    assert harm_of(noisy, clean) is None


@pytest.mark.parametrize("shape", [cube, ball, torus, grid])
def test_clean_shapes_have_no_folds_and_open_ones_no_volume_to_lose(shape):
    mesh = prepare_mesh(*shape()).mesh
    assert measures.folded_faces(mesh) == 0
    assert measures.explained_area(mesh, 0.0) == 0.0
    assert harm_of(mesh, mesh.with_vertices(mesh.vertices * 0.1), has_volume=False) is None


def together(*parts):
    """Several (vertices, faces) as one, far from the origin, with a vertex that no face uses."""
    vertices = [np.zeros((1, 3))] + [part for part, _ in parts]
    firsts = np.cumsum([len(part) for part in vertices])
    faces = [own + first for (_, own), first in zip(parts, firsts, strict=False)]
    ready = prepare_mesh(np.concatenate(vertices) + 1e4, np.concatenate(faces))
    return ready, [len(own) for _, own in parts]


def box(size, at=0.0, turned=False):
    vertices, faces = cube()
    return size * (vertices - 0.5) + [at, 0.0, 0.0], faces[:, ::-1] if turned else faces


@pytest.mark.parametrize(
    ("parts", "volume", "turned"),
    [
        ([box(1.0)], 1.0, [0]),
        ([box(1.0, turned=True)], 1.0, [1]),
        ([box(1.0), box(2.0, 5.0)], 9.0, [0, 0]),
        # A part that is mirrored, and is inside out by that.
        ([box(2.0), box(2.0, 5.0, turned=True)], 16.0, [0, 1]),
        ([box(1.0), box(2.0, 5.0, turned=True)], 9.0, [0, 1]),
        ([box(1.0, turned=True), box(2.0, 5.0, turned=True)], 9.0, [1, 1]),
        # Cavities, one of them in a part that is inside out as a whole.
        ([box(2.0), box(1.0, turned=True)], 7.0, [0, 0]),
        ([box(2.0, turned=True), box(1.0)], 7.0, [1, 1]),
        ([box(2.0, turned=True), box(1.0), box(1.0, 5.0)], 8.0, [1, 1, 0]),
        # A part within a part, which overlap.
        ([box(2.0), box(1.0)], 9.0, [0, 0]),
    ],
)
def test_boxes_by_hand(parts, volume, turned):
    ready, counts = together(*parts)
    found = measures.measure_enclosure(ready)
    enclosed = found.volume(ready.mesh, measures.area_and_volume(ready.mesh)[1])
    assert enclosed == pytest.approx(volume)
    assert found.is_inside_out == any(turned)
    inward = np.zeros(sum(counts), bool) if found.inward is None else found.inward
    assert (inward == np.repeat(np.array(turned, dtype=bool), counts)).all()
    assert (found.n_turned, found.n_parts) == (sum(turned), len(turned))
    signs = found.outward_signs(ready.mesh)
    of_vertices = np.repeat(
        [1.0, *(-1.0 if is_turned else 1.0 for is_turned in turned)], [1] + [8] * len(turned)
    )
    used = ready.mesh.topology.has_ring
    assert (signs[used] == of_vertices[used]).all()


def test_surfaces_that_are_open_or_look_both_ways_have_no_inside():
    vertices, faces = torus()
    ready = prepare_mesh(vertices, np.concatenate([faces[:, ::-1], faces]))
    assert not measures.measure_enclosure(ready).is_inside_out
    vertices, faces = grid()
    ready = together(box(1.0, turned=True), (vertices + 9.0, faces))[0]
    assert not measures.measure_enclosure(ready).is_inside_out


def test_parts_that_cancel_out_are_not_harmed_by_a_small_change():
    vertices, faces = torus()
    ready = together((vertices, faces), (vertices + 9.0, faces[:, ::-1]))[0]
    mesh = ready.mesh
    after = mesh.with_vertices(mesh.vertices * [1.0, 1.0, 0.9])
    raw = measures.measure_surface_change(mesh, after)
    change = measures.measure_enclosure(ready).change(mesh, after, raw)
    assert change.volumes[1] / change.volumes[0] == pytest.approx(0.9)
    assert measures.harmful_change(mesh, after, change, has_volume=True) is None
    assert change.mean_angular_error_deg == raw.mean_angular_error_deg
