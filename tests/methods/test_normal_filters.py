"""Filters of face normals: hand-worked cases, plain twins from the papers, and sharp edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli import methods
from msal_cli.errors import UsageError
from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.faces import face_centroids, face_rings
from msal_cli.kernels.geometry import face_normals, face_normals_and_areas
from msal_cli.kernels.normal_filters import (
    bilateral_averages,
    difference_width,
    normal_system,
    threshold_averages,
)
from msal_cli.mesh import prepare_mesh
from tests.methods import plain_normals as plain
from tests.methods.runs import denoise, error_deg, free_vertices, run, scan, small_scan
from tests.shapes import cube, fan, grid, noisy, roof, torus

OPEN_AND_CLOSED = pytest.mark.parametrize(
    ("shape", "boundary"), [("torus", "fixed"), ("grid", "fixed"), ("grid", "free")]
)
ANY_ROUGH_MESH = {
    "seed": st.integers(0, 999),
    "sharing": st.sampled_from(["vertex", "edge"]),
    "boundary": st.sampled_from(["fixed", "free"]),
    "is_closed": st.booleans(),
}
WIDTHS = st.tuples(st.sampled_from([0.5, 1.0, 3.0]), st.sampled_from([0.2, 0.35, 2.0]))


def rough(is_closed, seed):
    if is_closed:
        return scan(0.2, seed, torus, around=7, across=5)
    return scan(0.2, seed, grid, rows=6, columns=5)


def assert_twin(mesh, out, expected, tolerance=1e-12):
    assert np.abs(out - expected).max() <= tolerance * np.ptp(mesh.vertices)
    assert np.abs(out - mesh.vertices).max() > 1e-3


@pytest.mark.parametrize("name", ["guided_normal", "static_dynamic"])
def test_a_sharp_edge_stays(name):
    # Across the ridge a pair weighs exp(-|n_i - n_j|^2 / (2 sigma^2)) = exp(-100).
    mesh, out = run(name, *roof(12, 13), similarity=0.1)
    assert np.abs(out - mesh.vertices).max() < 1e-13


@pytest.mark.parametrize(
    ("name", "most_deg"),
    [("guided_normal", 2.0), ("static_dynamic", 1.0), ("normal_threshold", 3.0)],
)
def test_a_sharp_edge_comes_back_under_noise(name, most_deg):
    vertices, faces = roof(24, 25)
    clean = prepare_mesh(vertices, faces).mesh
    mesh = clean.with_vertices(noisy(clean.vertices, 4, 0.2))
    assert error_deg(clean, mesh.vertices) > 11.0
    assert error_deg(clean, denoise(name, mesh)) < most_deg
    assert error_deg(clean, denoise("al", mesh)) > 4.0


# Bilateral


def averaged(normals, areas, exponents, similarity):
    """One pass over faces all of which neighbour the first; the exponents of their distances."""
    others = len(normals) - 1
    centroids = np.zeros((others + 1, 3))
    centroids[1:, 0] = np.sqrt(2.0 * np.asarray(exponents))  # sigma_c = 1
    return bilateral_averages(
        np.array(normals, dtype=float),
        np.array(areas, dtype=float),
        centroids,
        np.array([0, others] + [others] * others, dtype=np.int32),
        np.arange(1, others + 1, dtype=np.int32),
        1.0,
        similarity,
        1,
        lambda: None,
    )[0]


def test_one_bilateral_sum_worked_by_hand():
    # Two neighbours at right angles to one another, both at 45 degrees to the face: their
    # differences are alike.  Areas 1 and 3, exponents of the distances 0 and 1: 1 to 3 / e.
    half = np.sqrt(0.5)
    out = averaged([[0, half, half], [0, 0, 1], [0, 1, 0]], [9, 1, 3], [0, 1], 0.35)
    assert out == pytest.approx(plain.unit(np.array([0, 3 / np.e, 1])), abs=1e-14)


def test_far_neighbours_do_not_underflow():
    # exp(-5000) is zero; the nearer of the two must count all the same, e times as much.
    out = averaged([[0, 0.6, 0.8], [0, 0.8, 0.6], [0.8, 0, 0.6]], [1, 1, 1], [5000, 5000.68], 9.0)
    assert np.isfinite(out).all()
    assert out[1] > out[0] > 0.1


def test_faces_without_area_do_not_count():
    out = averaged([[0, 0, 1], [0, 0, 0], [0, 0.6, 0.8]], [1, 0, 1e-9], [0, 50], 0.35)
    assert out == pytest.approx([0, 0.6, 0.8], abs=1e-15)
    assert (averaged([[0, 0, 1], [0, 0, 0]], [1, 0], [0], 0.35) == [0, 0, 1]).all()
    assert (averaged([[0, 0, 0], [0, 0, 1]], [0, 1], [0], 0.35) == 0).all()


def test_two_faces_swap_their_normals():
    # The own normal is left out: after two passes each face has its own again.
    vertices = np.array([[0, 0, 0], [0, 1, 0], [1, 0.5, 0], [-1, 0.5, 0.4]])
    faces = np.array([[0, 2, 1], [0, 1, 3]], dtype=np.int32)
    for passes in (1, 2):
        mesh, out = run("bilateral_normal", vertices, faces, n=passes, boundary="free")
        away = np.abs(out - mesh.vertices).max()
        assert away > 0.05 if passes == 1 else away < 1e-14


@given(**ANY_ROUGH_MESH, widths=WIDTHS, passes=st.integers(1, 5))
def test_local_bilateral_is_the_formula(seed, widths, sharing, boundary, is_closed, passes):
    mesh = rough(is_closed, seed)
    chosen = {"closeness": widths[0], "similarity": widths[1], "neighbours": sharing}
    chosen |= {"boundary": boundary, "n": passes, "vertex_iterations": 4}
    is_fixed = boundary == "fixed"
    expected = plain.local_filter(mesh.vertices, mesh.faces, widths, passes, 4, sharing, is_fixed)
    out = denoise("bilateral_normal", mesh, **chosen)
    assert np.abs(out - expected).max() <= 1e-12 * np.ptp(mesh.vertices)


@given(**ANY_ROUGH_MESH, widths=WIDTHS, fidelity=st.sampled_from([1e-3, 0.01, 0.3, 1.0]))
def test_global_bilateral_is_the_formula(seed, widths, sharing, boundary, is_closed, fidelity):
    mesh = rough(is_closed, seed)
    chosen = {"closeness": widths[0], "similarity": widths[1], "neighbours": sharing}
    chosen |= {"variant": "global", "fidelity": fidelity, "vertex_iterations": 4}
    out = denoise("bilateral_normal", mesh, **chosen, boundary=boundary)
    expected, least = plain.global_filter(
        mesh.vertices, mesh.faces, widths, fidelity, 4, sharing, boundary == "fixed"
    )
    # Conjugate gradients stop at 1e-4; what they leave counts more where normals nearly cancel.
    assert np.abs(out - expected).max() <= 1e-4 / least * np.ptp(mesh.vertices)


def test_the_defaults_are_the_authors():
    mesh = scan(0.1, 1, around=7, across=5)
    expected = plain.local_filter(mesh.vertices, mesh.faces)
    assert_twin(mesh, denoise("bilateral_normal", mesh), expected)
    expected, least = plain.global_filter(mesh.vertices, mesh.faces)
    assert_twin(mesh, denoise("bilateral_normal", mesh, variant="global"), expected, 1e-4 / least)
    expected = plain.threshold_filter(mesh.vertices, mesh.faces)
    assert_twin(mesh, denoise("normal_threshold", mesh), expected)


def system(vertices, faces, sharing="vertex"):
    rows = face_rings(faces, connectivity(len(vertices), faces), sharing)
    normals, areas = face_normals_and_areas(vertices, faces)
    centroids = face_centroids(vertices, faces)
    return normals, areas, normal_system(normals, areas, centroids, *rows, 0.7, 0.35, 0.01)


def dense(matrix, m):
    """A (m, m), three columns at a time."""
    result = np.empty((m, m))
    for first in range(0, m, 3):
        x = np.zeros((m, 3))
        for axis in range(min(3, m - first)):
            x[first + axis, axis] = 1.0
        product = np.empty_like(x)
        matrix.times(x, product)
        result[:, first : first + 3] = product[:, : m - first]
    return result


@pytest.mark.parametrize("sharing", ["vertex", "edge"])
def test_the_matrix_is_the_formula(sharing):
    vertices, faces = grid(5, 4)
    # Two faces more that touch nothing, and at their other sides one another's corner only.
    vertices = np.concatenate([noisy(vertices, 3, 0.2), 9 + np.eye(3), 10 + np.eye(3)[:2]])
    faces = np.concatenate([faces, [[20, 21, 22], [22, 23, 24]]]).astype(np.int32)
    normals, areas, matrix = system(vertices, faces, sharing)
    rows = plain.neighbours(faces, sharing)
    centroids = vertices[faces].mean(axis=1)
    expected = plain.global_matrix(normals, areas, centroids, rows, (0.7, 0.35), 0.01)
    assert np.abs(dense(matrix, len(faces)) - expected).max() < 1e-13
    assert np.abs(matrix.diagonal - expected.diagonal()).max() < 1e-13


@pytest.mark.parametrize("height", [0.0, 1e-14])
def test_a_face_without_a_normal_stays_out_of_the_system(height):
    vertices, faces = grid(4, 4)
    vertices = np.concatenate([vertices, [[0.5, height, 0.0]]])
    faces = np.concatenate([faces, [[0, 16, 1]]]).astype(np.int32)
    matrix = dense(system(vertices, faces)[2], len(faces))
    assert matrix[-1, -1] == pytest.approx(0.01)
    assert (matrix[-1, :-1] == 0).all() and (matrix[:-1, -1] == 0).all()


# Threshold


def threshold_averaged(normals, threshold, passes=1):
    """Two faces that neighbour one another."""
    start, ring = np.array([0, 1, 2], dtype=np.int32), np.array([1, 0], dtype=np.int32)
    return threshold_averages(np.array(normals), start, ring, threshold, passes, lambda: None)


def test_two_normals_worked_by_hand():
    # At 60 degrees n . m = 1/2; with T = 1/4 the own normal weighs 9/16 and the other 1/16.
    n, m = np.array([0.0, 0.0, 1.0]), np.array([np.sqrt(0.75), 0.0, 0.5])
    assert threshold_averaged([n, m], 0.25)[0] == pytest.approx(plain.unit(9 * n + m), abs=1e-15)
    # Beyond the threshold nothing counts.
    assert (threshold_averaged([n, m], 0.500001, 9) == [n, m]).all()
    assert (threshold_averaged([n, m], 0.499999, 9) != [n, m]).any()
    # Faces without a normal stay so and do not count.
    out = threshold_averaged([m, np.zeros(3)], 0.0, 3)
    assert out[0] == pytest.approx(m, abs=1e-15)
    assert (out[1] == 0.0).all()


@given(**ANY_ROUGH_MESH, T=st.sampled_from([0.0, 0.3, 0.5, 0.9]), passes=st.integers(1, 6))
def test_threshold_is_the_formula(seed, T, passes, sharing, boundary, is_closed):
    mesh = rough(is_closed, seed)
    chosen = {"T": T, "n": passes, "neighbours": sharing, "boundary": boundary}
    out = denoise("normal_threshold", mesh, vertex_iterations=4, **chosen)
    expected = plain.threshold_filter(
        mesh.vertices, mesh.faces, T, passes, 4, sharing, boundary == "fixed"
    )
    assert np.abs(out - expected).max() <= 1e-12 * np.ptp(mesh.vertices)


@pytest.mark.parametrize("T", ["1", "-0.1", "nan"])
def test_thresholds_that_leave_nothing_are_refused(T):
    with pytest.raises(UsageError, match="threshold"):
        methods.find("normal_threshold").validate({"T": T})


# Guided


def test_one_patch_has_one_guide():
    # All faces of a fan touch, so that each is guided by the mean, upright by symmetry; with a
    # wide reach and one pass the rim stays and the hub goes to the mean height of the centroids.
    wide = {"iterations": 1, "vertex_iterations": 1, "closeness": 10, "radius": 10}
    mesh, out = run("guided_normal", *fan([0.2, -0.2] * 3), **wide, boundary="fixed")
    assert out == pytest.approx(mesh.vertices, abs=1e-15)
    mesh, out = run("guided_normal", *fan([0.3] * 6), **wide, boundary="fixed")
    # The filtered normals are upright but for the Gaussian of distances; centroids are 0.2 up.
    assert out[0, 2] - mesh.vertices[0, 2] == pytest.approx(0.2, abs=2e-3)
    assert out[1:] == pytest.approx(mesh.vertices[1:], abs=0)


def guided_twin(mesh, free, iterations, vertex_iterations, similarity, closeness, radius):
    x, faces = mesh.vertices, mesh.faces
    touching, across = plain.sharing(faces, 1), plain.sharing(faces, 2)
    centroids = x[faces].mean(axis=1)
    near = plain.near(centroids, touching, radius * plain.mean_distance(centroids, across))
    for _ in range(iterations):
        n, areas = plain.normals_and_areas(x, faces)
        g = plain.guides(n, areas, touching, across)
        c = x[faces].mean(axis=1)
        sigma = closeness * plain.mean_distance(c, across)
        wanted = plain.joint(n, g, areas, c, near, sigma, similarity)
        x = plain.moved(x, wanted, faces, free, vertex_iterations)
    return x


@OPEN_AND_CLOSED
@pytest.mark.parametrize(("similarity", "closeness", "radius"), [(0.35, 1.0, 2.0), (0.5, 1.5, 3.0)])
def test_guided_agrees_with_the_plain_twin(shape, boundary, similarity, closeness, radius):
    mesh = small_scan(shape, 0.15, 2)
    chosen = {"similarity": similarity, "closeness": closeness, "radius": radius}
    chosen |= {"iterations": 2, "vertex_iterations": 4}
    out = denoise("guided_normal", mesh, boundary=boundary, **chosen)
    assert_twin(mesh, out, guided_twin(mesh, free_vertices(mesh, boundary), **chosen))


# Static and dynamic guidance


def static_dynamic_twin(
    mesh,
    free,
    iterations,
    vertex_iterations,
    strength=2.0,
    closeness=1.5,
    guidance=1.5,
    similarity=0.3,
    tolerance_deg=0.2,
):
    """As the paper writes it: with dense matrices of weights, and a sum over unordered pairs."""
    x, faces = mesh.vertices, mesh.faces
    touching, across = plain.sharing(faces, 1), plain.sharing(faces, 2)

    def squares(field):
        return ((field[:, None] - field[None, :]) ** 2).sum(axis=2)

    for _ in range(iterations):
        n0, areas = plain.normals_and_areas(x, faces)
        g = plain.guides(n0, areas, touching, across)
        c = x[faces].mean(axis=1)
        eta = closeness * plain.mean_distance(c, across)
        is_near = np.zeros((len(faces), len(faces)))
        for i, others in enumerate(plain.near(c, touching, 3 * eta)):
            is_near[i, list(others)] = 1
        spatial = (areas[:, None] + areas) * is_near * np.exp(-squares(c) / (2 * eta**2))
        weights = spatial * np.exp(-squares(g) / (2 * guidance**2))
        scaled = strength * areas.sum() / np.triu(spatial).sum()
        n = n0
        for _ in range(100):
            sums = (2 * similarity**2 / scaled * areas)[:, None] * n0
            sums = sums + (weights * np.exp(-squares(n) / (2 * similarity**2))) @ n
            new = plain.unit(sums)
            change = np.sqrt((areas * ((new - n) ** 2).sum(axis=1)).sum() / areas.sum())
            n = new
            if change <= 2 * np.sin(np.radians(tolerance_deg) / 2):
                break
        x = plain.moved(x, n, faces, free, vertex_iterations)
    return x


@pytest.mark.parametrize(
    ("shape", "boundary", "chosen"),
    [
        ("grid", "free", {}),
        *(
            (shape, boundary, {"strength": 0.7, "closeness": 0.8, "guidance": 0.4}
             | {"similarity": 0.5, "tolerance_deg": 0.05})
            for shape, boundary in (("torus", "free"), ("grid", "fixed"))
        ),
    ],
)  # fmt: skip
def test_static_dynamic_agrees_with_the_plain_twin(shape, boundary, chosen):
    mesh = small_scan(shape, 0.1, 2)
    chosen = {"iterations": 2, "vertex_iterations": 4} | chosen
    out = denoise("static_dynamic", mesh, boundary=boundary, **chosen)
    assert_twin(mesh, out, static_dynamic_twin(mesh, free_vertices(mesh, boundary), **chosen))


# Diffusion


def diffusion_twin(mesh, rounds, steps, passes, similarity, time_step, free):
    """Face by face and vertex by vertex, from the formulas."""
    x, faces = mesh.vertices.copy(), mesh.faces
    tau = time_step * mesh.mean_edge_length**2
    beside = [
        [
            (g, sorted(set(face) & set(other)))
            for g, other in enumerate(faces.tolist())
            if len(set(face) & set(other)) == 2
        ]
        for face in faces.tolist()
    ]
    for _ in range(rounds):
        n, areas = plain.normals_and_areas(x, faces)
        middle = x[faces].mean(axis=1)
        for _ in range(steps):
            new = n.copy()
            for i, row in enumerate(beside):
                share = [
                    np.linalg.norm(x[a] - x[b]) / np.linalg.norm(middle[i] - middle[j])
                    for j, (a, b) in row
                ]
                step = min(tau / areas[i], 0.75 / sum(share))
                for s, (j, _) in zip(share, row, strict=True):
                    jump = n[j] - n[i]
                    new[i] += step * s * np.exp(-(jump @ jump) / (2 * similarity**2)) * jump
            n = plain.unit(new)
        x = plain.moved(x, n, faces, free, passes)
    return x


@OPEN_AND_CLOSED
@pytest.mark.parametrize(("similarity", "time_step"), [(0.4, 0.1), (0.8, 0.02)])
def test_diffusion_agrees_with_the_literal_twin(shape, boundary, similarity, time_step):
    mesh = small_scan(shape)
    chosen = {"iterations": 2, "normal_iterations": 3, "vertex_iterations": 2}
    chosen |= {"similarity": similarity, "time_step": time_step, "boundary": boundary}
    free = free_vertices(mesh, boundary)
    expected = diffusion_twin(mesh, 2, 3, 2, similarity, time_step, free)
    assert_twin(mesh, denoise("normal_diffusion", mesh, **chosen), expected)


def test_the_automatic_width_of_diffusion_is_that_by_hand():
    mesh = scan()
    rings = face_rings(mesh.faces, mesh.topology, "edge")
    width = difference_width(face_normals(mesh.vertices, mesh.faces), *rings)
    out, same, other = (
        denoise("normal_diffusion", mesh, **values)
        for values in ({}, {"similarity": width}, {"similarity": width / 2})
    )
    assert (out == same).all()
    assert np.abs(out - other).max() > 0.01
    mesh, out = run("normal_diffusion", *cube())
    assert np.abs(out - mesh.vertices).max() < 1e-15


# The Wiener filter with the normals that follow it


def follow(mesh, guide, sigma_s, closeness, share, passes, vertex_passes):
    """Step 3, face by face, from its definition."""
    faces = mesh.faces
    like, areas = plain.normals_and_areas(guide, faces)
    c = guide[faces].mean(axis=1)
    width = closeness * plain.mean_distance(c, plain.sharing(faces, 2))
    scan_normals, _ = plain.normals_and_areas(mesh.vertices, faces)
    n = plain.unit(share * scan_normals + (1 - share) * like)
    for _ in range(passes):
        n = plain.joint(n, like, areas, c, plain.sharing(faces, 1), width, sigma_s)
    return plain.moved(guide, n, faces, np.ones(len(guide), bool), vertex_passes)


def test_wiener_without_the_normals_is_the_schedule_of_al():
    mesh = scan(0.05, 1)
    for values in ({}, {"noise": 0.1}, {"mollify": 1, "n": 3, "boundary": "fixed"}):
        chosen = {"n": 6, "mollify": 2, "caution": 0.75} | values
        expected = denoise("al", mesh, schedule="wiener", **chosen)
        assert (denoise("wiener", mesh, normal_iterations=0, **values) == expected).all()


@pytest.mark.parametrize("share", [1.0, 0.3])
@pytest.mark.parametrize("shape", [torus(9, 7), grid(6, 6), cube()])
def test_the_normals_follow_as_the_definition_says(shape, share):
    vertices, faces = shape
    mesh = prepare_mesh(noisy(vertices, 2, 0.1), faces).mesh
    guide = denoise("wiener", mesh, normal_iterations=0, noise=0.2)
    expected = follow(mesh, guide, 2.0 * 0.2, 1.5, share, 2, 3)
    chosen = {"noise": 0.2, "similarity": 2.0, "closeness": 1.5, "scan_share": share}
    actual = denoise("wiener", mesh, **chosen, normal_iterations=2, vertex_iterations=3)
    assert_twin(mesh, actual, expected)
    assert np.abs(actual - guide).max() > 1e-3


def test_wiener_comes_closer_than_its_parts_in_positions_and_in_normals():
    vertices, faces = torus(96, 48)
    normals = prepare_mesh(vertices, faces).mesh.vertex_normals()
    waves = 0.06 * np.sin(4 * vertices[:, 0]) * np.sin(4 * vertices[:, 1])
    heights = 0.02 * np.random.default_rng(0).normal(size=len(vertices))
    ready = prepare_mesh(vertices + (waves + heights)[:, None] * normals, faces)
    true = ready.mesh.with_vertices(vertices + waves[:, None] * normals - ready.origin)

    def errors(name, **given):
        out = denoise(name, ready.mesh, **given)
        return np.array([np.linalg.norm(out - true.vertices, axis=1).mean(), error_deg(true, out)])

    whole = errors("wiener")
    assert (whole < 0.6 * errors("wiener", n=0)).all()
    assert (whole < errors("msal")).all()
    assert (whole < errors("al", n=2)).all()
    assert (whole < errors("msal", schedule="wiener")).all()
