"""Descriptors of face normals and the network: what goes in, threads and machine code."""

import dataclasses
import functools
import itertools

import numpy as np
import pytest

from msal_cli.kernels import normal_descriptors, normal_regression
from msal_cli.kernels import vectors as small_vectors
from msal_cli.kernels.faces import face_rings
from msal_cli.kernels.geometry import face_normals_and_areas
from msal_cli.kernels.library import Kernel
from msal_cli.kernels.normal_descriptors import NUMBERS
from msal_cli.kernels.normal_regression import (
    GLOBALS,
    OTHERS,
    STATISTICS,
    VECTORS,
    Evidence,
    Network,
    NormalDescriber,
    count_vectors,
    measure_ripples,
)
from msal_cli.mesh import prepare_mesh
from tests.shapes import grid, noisy, torus
from training.inputs import collect_inputs


def evidence_of(mesh):
    """Some normals and numbers, as other filters and the surroundings give them."""
    draw = np.random.default_rng(2)
    own = face_normals_and_areas(mesh.vertices, mesh.faces)[0]
    normals = np.empty((len(own), 3 * OTHERS), dtype=np.float32)
    for place, spread in enumerate((0.1, 0.2, 0.3, 0.4)):
        turned = own + spread * draw.normal(size=own.shape)
        turned /= np.linalg.norm(turned, axis=1)[:, None]
        normals[:, 3 * place : 3 * place + 3] = turned
    statistics = draw.random((len(own), STATISTICS)).astype(np.float32)
    return Evidence(0.1, True, False, normals, statistics)


def same_evidence(mesh):
    """Evidence that says nothing beyond the normals of the mesh."""
    own = face_normals_and_areas(mesh.vertices, mesh.faces)[0].astype(np.float32)
    zeros = np.zeros((len(own), STATISTICS), dtype=np.float32)
    return Evidence(0.1, True, False, np.tile(own, OTHERS), zeros)


def described(mesh, earlier=None, make_evidence=same_evidence):
    rings = face_rings(mesh.faces, mesh.topology, "edge")
    describer = NormalDescriber(mesh.faces, mesh.vertices, *rings, make_evidence(mesh))
    ripples = measure_ripples(mesh.vertices, mesh.vertex_normals(), mesh.topology)
    return describer.describe(mesh.vertices, ripples, earlier)


def all_kernels():
    """The kernels that the descriptors and the network are made of."""
    for module in (normal_descriptors, normal_regression, small_vectors):
        for value in vars(module).values():
            if isinstance(value, Kernel):
                yield value


def random_network(width, seed=0, hidden=16):
    draw = np.random.default_rng(seed)
    sizes = (3 * width + NUMBERS + STATISTICS + GLOBALS, hidden, hidden, width)
    layers = [
        (
            draw.normal(size=b).astype(np.float32),
            (draw.normal(size=(b, a)) / a**0.5).astype(np.float32),
        )
        for a, b in itertools.pairwise(sizes)
    ]
    return Network(tuple(layers))


@pytest.fixture(scope="module")
def scan():
    vertices, faces = torus(22, 12)
    return prepare_mesh(noisy(vertices, 3, 0.1), faces).mesh


@pytest.mark.ci
def test_evidence_stands_behind_the_own_vectors_and_numbers(scan):
    given = evidence_of(scan)
    descriptors = described(scan, make_evidence=evidence_of)
    others = given.normals.reshape(-1, OTHERS, 3)
    assert (collect_inputs(descriptors)[1][:, VECTORS : VECTORS + OTHERS] == others).all()
    numbers = collect_inputs(descriptors)[0][:, 3 * descriptors.n_vectors : -GLOBALS]
    assert (numbers[:, NUMBERS:] == given.statistics).all()


def test_faces_without_noise_do_not_count_where_it_is_uneven(scan):
    vertices, faces = torus(40, 20)
    far = np.concatenate([scan.vertices, vertices + 10.0])
    both = prepare_mesh(far, np.concatenate([scan.faces, faces + len(scan.vertices)])).mesh

    def with_power(mesh, is_uneven):
        statistics = np.zeros((len(mesh.faces), STATISTICS), dtype=np.float32)
        statistics[: len(scan.faces), 2] = 0.5
        return dataclasses.replace(same_evidence(mesh), is_uneven=is_uneven, statistics=statistics)

    def globals_of(mesh, is_uneven):
        make = functools.partial(with_power, is_uneven=is_uneven)
        return described(mesh, make_evidence=make).globals

    alone = globals_of(scan, False)
    assert np.allclose(globals_of(both, True), alone, atol=1e-5)
    assert np.abs(globals_of(both, False) - alone).max() > 0.05


@pytest.mark.ci
def test_a_face_without_area_takes_the_normal_of_those_around():
    vertices, faces = grid(6, 6)
    vertices = vertices.astype(float)
    vertices[faces[20, 1]] = (vertices[faces[20, 0]] + vertices[faces[20, 2]]) / 2
    mesh = prepare_mesh(vertices, faces).mesh
    assert mesh.flat_faces
    descriptors = described(mesh)
    inputs, vectors = collect_inputs(descriptors)
    assert np.isfinite(inputs).all()
    assert (np.abs(vectors[:, :, 2]) > 0.999).all()


@pytest.mark.ci
def test_normals_that_others_do_not_give_are_the_own(scan):
    def without_first(mesh):
        given = same_evidence(mesh)
        given.normals[7, 3:6] = 0.0
        return given

    own = face_normals_and_areas(scan.vertices, scan.faces)[0]
    vectors = collect_inputs(described(scan, make_evidence=without_first))[1]
    assert np.abs(vectors[:, VECTORS + 1] - own).max() < 1e-6


def test_lanes_of_machine_code_are_those_of_numpy(scan, monkeypatch):
    network = random_network(count_vectors(1), hidden=8)
    earlier = -face_normals_and_areas(scan.vertices, scan.faces)[0]
    descriptors = described(scan, earlier)
    expected = [*descriptors.sources[5:7], descriptors.predict(network).reshape(-1)]
    monkeypatch.setenv("MSAL_INTERPRET_KERNELS", "1")
    for kernel in all_kernels():
        monkeypatch.setattr(kernel, "_native", {})
    # Blocks that begin in the middle, and a last one that is not full.
    start, stop = 501, 520

    def over_part(kernel, count, *arguments):
        is_long = kernel in (normal_regression.describe, normal_regression.predict_normals)
        part = (start, stop) if is_long else (0, count)
        return [kernel(*part, *arguments)]

    monkeypatch.setattr(normal_regression, "over_ranges", over_part)
    # What is not made is anything.
    with np.errstate(all="ignore"):
        known, records = described(scan, earlier).sources[5:7]
    made = known, records, descriptors.predict(network).reshape(-1)
    for interpreted, array in zip(made, expected, strict=True):
        rows = [part.reshape(len(earlier), -1)[start:stop] for part in (interpreted, array)]
        # One number of what is known is room.
        rows = [np.delete(part, 34, axis=1) if part.shape[1] == 36 else part for part in rows]
        assert (rows[0] == rows[1]).all()
