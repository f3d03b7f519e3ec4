"""Filters of face normals: hand-worked cases, plain twins from the papers, and sharp edges."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli import methods
from msal_cli.errors import UsageError
from msal_cli.kernels.faces import face_rings
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.normal_filters import bilateral_averages, difference_width
from msal_cli.mesh import prepare_mesh
from msal_cli.methods._sliding import SIDEWAYS, sideways_share, undo_sliding
from tests.methods import plain_normals as plain
from tests.methods.runs import assert_twin, denoise, error_deg, free_vertices, run, scan, small_scan
from tests.shapes import cube, grid, noisy, roof, torus

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


@pytest.mark.parametrize(
    ("name", "most_deg"),
    [("guided_normal", 2.0), ("static_dynamic", 1.0), ("normal_threshold", 3.0), ("l0", 1.0)],
)
def test_a_sharp_edge_comes_back_under_noise(name, most_deg):
    vertices, faces = roof(24, 25)
    clean = prepare_mesh(vertices, faces).mesh
    mesh = clean.with_vertices(noisy(clean.vertices, 4, 0.2))
    assert error_deg(clean, mesh.vertices) > 11.0
    assert error_deg(clean, denoise(name, mesh)) < most_deg
    assert error_deg(clean, denoise("al", mesh)) > 4.0


# Bilateral


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


# Threshold


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
    beside = [[] for _ in faces]
    for edge, own in plain.edge_faces(faces).items():
        for f, g in itertools.permutations(own, 2):
            beside[f].append((g, edge))
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


SLIDING = [
    name
    for name in methods.names()
    if any(spec.name == "sliding" for spec in methods.find(name).parameters)
]


def along_normals():
    """A torus of uneven triangles under noise along its normals, and the torus."""
    vertices, faces = torus(48, 24)
    normals = prepare_mesh(vertices, faces).mesh.vertex_normals()
    heights, *ways = 0.08 * np.random.default_rng(0).normal(size=(4, len(vertices)))
    vertices = vertices + 0.3 * np.cross(np.transpose(ways), normals)
    ready = prepare_mesh(vertices + heights[:, None] * normals, faces)
    return ready.mesh, ready.mesh.with_vertices(vertices - ready.origin)


def test_what_slid_within_a_plane_comes_back_exactly_and_heights_over_it_stay():
    mesh = prepare_mesh(*grid(7, 6)).mesh
    slid = mesh.vertices.copy()
    slid[:, :2] += np.random.default_rng(0).uniform(-0.2, 0.2, (len(slid), 2))
    assert undo_sliding(mesh, slid, "kept", "free") is slid
    assert np.abs(undo_sliding(mesh, slid, "undone", "free") - mesh.vertices).max() < 1e-15
    back = undo_sliding(mesh, mesh.vertices + [0.1, -0.05, 0.3], "undone", "free")
    assert np.abs(back - mesh.vertices - [0.0, 0.0, 0.3]).max() < 1e-15


@pytest.mark.parametrize("name", SLIDING)
def test_it_comes_closer_where_the_noise_was_along_the_normals(name):
    mesh, true = along_normals()
    few = {"iterations": 20 if name in ("l0", "windowed_sinc") else 3}
    found = {sliding: denoise(name, mesh, sliding=sliding, **few) for sliding in ("kept", "undone")}
    by_itself = "undone" if name == "learned" else "kept"
    assert (found[by_itself] == denoise(name, mesh, **few)).all()
    kept, undone = (
        np.linalg.norm(found[way] - true.vertices, axis=1).mean() for way in ("kept", "undone")
    )
    assert undone < 0.97 * kept
    angles = {way: error_deg(true, positions) for way, positions in found.items()}
    assert angles["undone"] < 1.03 * angles["kept"]


@pytest.mark.parametrize("name", SLIDING)
def test_no_iterations_change_no_bit_and_what_is_held_stays(name):
    mesh, _ = along_normals()
    assert (denoise(name, mesh, iterations=0, sliding="undone") == mesh.vertices).all()
    held = np.arange(len(mesh.vertices)) % 3 == 0
    found = denoise(name, mesh.with_constraints(held, None), iterations=2, sliding="undone")
    assert np.abs(found[held] - mesh.vertices[held]).max() < 1e-14


def test_the_share_of_noise_within_the_surface():
    vertices, faces = torus(96, 48)
    normals = prepare_mesh(vertices, faces).mesh.vertex_normals()
    random = np.random.default_rng(0)
    heights = 0.04 * random.normal(size=len(vertices))[:, None] * normals
    ways = random.normal(size=vertices.shape)
    ways -= (ways * normals).sum(axis=1)[:, None] * normals
    for share in (0.0, 0.5, 1.0):
        mesh = prepare_mesh(vertices + heights + 0.04 * share * ways, faces).mesh
        # A torus has some of its own: its rings are uneven.
        assert sideways_share(mesh) == pytest.approx(share, rel=0.15, abs=0.15)
    assert 0.2 < SIDEWAYS < 0.8
    assert sideways_share(prepare_mesh(*grid(6, 6)).mesh) == np.inf
