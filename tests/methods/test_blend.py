"""The weighted mean of methods: how it is written, and that it is that mean."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli import auto as selection
from msal_cli import methods
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.auto.candidates import CANDIDATES
from msal_cli.errors import UsageError
from msal_cli.job.room import method_bytes_per_face
from msal_cli.job.settings import Settings
from msal_cli.mesh import prepare_mesh
from msal_cli.methods._sliding import even_out
from msal_cli.methods.blend import (
    KEPT_PER_FACE,
    MAX_MEMBERS,
    format_members,
    parse_levels,
    parse_members,
)
from tests.methods.runs import denoise, error_deg, scan
from tests.shapes import grid, torus

BLEND = methods.find("blend")


@pytest.fixture
def mesh():
    return scan(0.05, 0)


def blended(mesh, text, **more):
    return denoise("blend", mesh, members=text, **more)


def test_it_is_the_weighted_mean_of_its_members(mesh):
    made = blended(mesh, "0.5*al(iterations=3)+0.25*taubin+0.125*msal(K=0.7,mollify=2)")
    by_hand = (
        0.5 * denoise("al", mesh, iterations=3)
        + 0.25 * denoise("taubin", mesh)
        + 0.125 * denoise("msal", mesh, K=0.7, mollify=2)
        + 0.125 * mesh.vertices
    )
    assert np.abs(made - by_hand).max() < 1e-14
    assert np.abs(made - mesh.vertices).max() > 0.01


@pytest.mark.parametrize(
    "text",
    [
        " 0.6 * al ( iterations = 3 ,mollify=2 ) + 0.4*msal ",
        "0.6*al(iterations=3,mollify=2)\n+\t0.4*msal()",
        "6e-1*al(mollify=2,iterations=3)+.4*msal",
        "0.60*al(iterations=3,iterations=3,mollify=2)+0.4*msal",
    ],
)
def test_spaces_and_the_way_numbers_are_written_do_not_matter(text):
    members, expected = (
        [
            (member.weights[0], member.method.name, member.parameters)
            for member in parse_members(each)
        ]
        for each in (text, "0.6*al(iterations=3,mollify=2)+0.4*msal")
    )
    assert members == expected
    (member,) = parse_members("1*msal(K=0.7)")
    assert member.parameters == methods.find("msal").validate({"K": 0.7})


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "there are no members"),
        ("smooth it", "not understood from 'smoothit' on"),
        ("0.5", "not understood from '0.5' on"),
        ("0.5*al+", r"not understood from '\+' on"),
        ("0.5*al-0.5*msal", r"not understood from '-0.5\*msal' on"),
        ("0.5*al(iterations=3", r"not understood from '\(iterations=3' on"),
        ("0.5*AL", r"not understood from '0.5\*AL' on"),
        ("-0.5*al", r"not understood from '-0.5\*al' on"),
        ("nan*al", r"not understood from 'nan\*al' on"),
        ("0*al", "0 is not the weight of a member"),
        ("1.5*al", "1.5 is not the weight of a member"),
        ("0.1.2*al", "0.1.2 is not the weight of a member"),
        ("0.6*al+0.6*msal", "add up to 1.2"),
        ("0.5*best", "no method 'best'"),
        ("0.5*blend(members=1)", "a blend cannot be a member of a blend"),
        ("0.5*al(sweeps=3)", "al has no parameter 'sweeps'"),
        ("0.5*al(iterations=-1)", "iterations = -1 is not allowed"),
        ("0.5*al(iterations=many)", "iterations = many is not allowed"),
        ("0.5*al(iterations)", "'iterations' of member al is not NAME=VALUE"),
        ("0.5*al(iterations=3,)", "'' of member al is not NAME=VALUE"),
        ("0.5*al(iterations=3,iterations=4)", "two different values of iterations"),
        ("+".join(["0.01*al"] * (MAX_MEMBERS + 1)), "more than 16 members"),
        ("0.5*al; 0.1:0.2", "0.5 is not 2 weights, as there are levels"),
        ("0.5:0.5*al; ", "0.5:0.5 is not one weight"),
        ("0.5:0.5*al; 0.2:0.1", "levels = 0.2:0.1 is not allowed"),
        ("0.5:0.5*al; 0.1:", "levels = 0.1: is not allowed"),
        ("0.5*al; inf", "levels = inf is not allowed"),
        ("0.2:0.6*al+0.2:0.6*msal; 0.1:0.2", "add up to 1.2"),
        ("0:0*al; 0.1:0.2", "0:0 is not the weight of a member"),
    ],
)
def test_what_means_nothing_is_refused(text, what):
    members, _, levels = text.partition("; ")
    with pytest.raises(UsageError, match=what) as refused:
        BLEND.validate({"members": members} | ({"levels": levels} if ";" in text else {}))
    assert refused.value.hint
    for line in ("0:0:0", "1:2", "0:0:up", "0:0:inf"):
        with pytest.raises(UsageError, match=f"line = {line} is not allowed"):
            BLEND.validate({"line": line})
    assert parse_levels("0.1:0.2") == (0.1, 0.2)


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 1.0, exclude_min=True), st.sampled_from(CANDIDATES), st.floats(0.0, 0.9)
        ),
        min_size=1,
        max_size=MAX_MEMBERS,
    )
)
def test_what_is_written_is_read_again(members):
    total = sum(weight for weight, _, _ in members)
    scale = 1.0 if total <= 1.0 else 0.999 / total
    given_members = [
        ([weight * scale], candidate.method, candidate.settings(noise))
        for weight, candidate, noise in members
        if weight * scale > 0.0
    ]
    if not given_members:
        return
    found = parse_members(format_members(given_members))
    assert [list(member.weights) for member in found] == [
        weights for weights, _, _ in given_members
    ]
    for member, (_, name, values) in zip(found, given_members, strict=True):
        assert member.method.name == name
        assert member.parameters == methods.find(name).validate(values)


def test_memory_follows_the_members_that_are_given():
    of = {name: methods.find(name).bytes_per_face for name in ("al", "wiener", "static_dynamic")}
    for name, least in of.items():
        given = {"members": f"0.4*al+0.6*{name}"}
        assert BLEND.bytes_per_face_of(given) == least + KEPT_PER_FACE
    light = Settings("blend", {"members": "0.4*al+0.6*al(iterations=5)"})
    heavy = Settings("blend", {"members": "0.4*al+0.6*static_dynamic"})
    between = method_bytes_per_face(heavy) - method_bytes_per_face(light)
    assert between == of["static_dynamic"] - of["al"]
    # A method with a schedule needs its own memory, too.
    flow = Settings("mean_curvature_flow", {"schedule": "wiener"})
    assert method_bytes_per_face(flow) == 180 + method_bytes_per_face(
        Settings("al", {"schedule": "wiener"})
    )


def test_weights_follow_the_local_noise():
    # Noise on the upper half.
    true = prepare_mesh(*torus(120, 60)).mesh
    noise = AddedNoise("half", 0.25, direction=(0.0, 1.0, 0.0))
    mesh = true.with_vertices(add_noise(true, noise))
    made = blended(mesh, "0:1*al(iterations=3)", levels="0.05:0.15")
    quiet, loud = true.vertices[:, 1] < -1.5, true.vertices[:, 1] > 1.5
    assert (made[quiet] == mesh.vertices[quiet]).all()
    assert np.abs(made - denoise("al", mesh, iterations=3))[loud].max() < 1e-12


def test_jagged_triangles_are_evened_out_and_the_surface_stays():
    true = prepare_mesh(*torus(90, 45)).mesh
    mesh = true.with_vertices(add_noise(true, AddedNoise("gaussian", 0.2)))

    def angle(**more):
        made = blended(mesh, "1*bilateral_normal(similarity=0.45,iterations=10)", **more)
        return error_deg(true, made)

    assert angle(relax=2) < 0.5 * angle()
    even = even_out(mesh, 2)
    normals = mesh.vertex_normals("uniform", 3)
    heights = np.einsum("ij,ij->i", even.vertices - mesh.vertices, normals)
    assert np.abs(heights).max() < 1e-12
    start, ring = mesh.topology.ring_start, mesh.topology.ring
    first = np.repeat(np.arange(len(mesh.vertices)), np.diff(start))
    lengths = [np.linalg.norm(x.vertices[first] - x.vertices[ring], axis=1) for x in (even, mesh)]
    # The edges come nearer to one length.
    spread = [x.std() / x.mean() for x in lengths]
    assert spread[0] < 0.9 * spread[1]


def test_vertices_that_are_held_at_open_edges_or_far_off_are_not_evened_out():
    mesh = prepare_mesh(*grid(9, 8)).mesh
    vertices = mesh.vertices + 0.2 * np.random.default_rng(0).standard_normal((72, 3))
    vertices[38, 0] += 3.0
    held = np.arange(len(vertices)) % 5 == 0
    rough = mesh.with_vertices(vertices).with_constraints(held, None)
    even = even_out(rough, 3)
    still = held | mesh.topology.boundary | (np.arange(len(vertices)) == 38)
    assert (even.vertices[still] == vertices[still]).all()
    assert (even.vertices[~still] != vertices[~still]).any(axis=1).all()
    assert even_out(rough, 0) is rough


@pytest.mark.parametrize("line", ["0:0:2", "0:0:-1", "1:2:-3"])
def test_vertices_stay_on_lines_where_their_planes_face_them(line):
    truth, faces = grid(30, 30)
    truth[:, 2] = 2.0 * np.sin(truth[:, 0] / 3.0)
    view = np.array([float(number) for number in line.split(":")])
    view /= np.linalg.norm(view)
    clean = prepare_mesh(truth, faces).mesh
    noise = np.random.default_rng(3).normal(0.0, 0.2, len(truth))
    noisy = clean.with_vertices(clean.vertices + noise[:, None] * view)
    moves = blended(noisy, "1*taubin", line=line) - noisy.vertices
    faced = np.abs(clean.vertex_normals() @ view) > 0.7
    assert faced.any()
    assert np.allclose(np.cross(moves[faced], view), 0.0, atol=1e-12)
    usual, away = blended(noisy, "1*taubin") - noisy.vertices, np.abs(clean.vertex_normals() @ view)
    assert np.array_equal(moves[away < 0.1], usual[away < 0.1])


@pytest.mark.parametrize("relax", [0, 2])
def test_a_share_goes_part_of_the_way(relax):
    mesh = scan(0.05, 0, around=20, across=12)

    def made(share):
        return blended(mesh, "0.8*al(iterations=2)", relax=relax, share=share)

    assert made(0.3) == pytest.approx(0.7 * mesh.vertices + 0.3 * made(1.0), abs=1e-12)
    assert (made(0.0) == mesh.vertices).all()


def test_memory_is_that_of_the_hungriest_member_that_is_ever_chosen():
    most = max(methods.find(x.method).bytes_per_face for x in CANDIDATES)
    assert BLEND.bytes_per_face >= most + KEPT_PER_FACE
    of_plain = {"blend", "hc", "msal", "taubin"}
    assert {candidate.method for candidate in CANDIDATES} | of_plain == set(selection.METHODS)
