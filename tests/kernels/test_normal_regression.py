"""Descriptors of face normals and the network, against plain twins and by identities."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from msal_cli.kernels import parallel
from msal_cli.kernels.faces import face_centroids, face_rings
from msal_cli.kernels.geometry import face_normals_and_areas
from msal_cli.kernels.normal_regression import (
    EARLIER,
    GLOBALS,
    NUMBERS,
    OTHERS,
    STATISTICS,
    VECTORS,
    Evidence,
    Network,
    NormalDescriber,
    count_vectors,
    find_neighbourhoods,
    measure_ripples,
)
from msal_cli.mesh import prepare_mesh
from tests.kernels import plain_descriptors
from tests.shapes import grid, noisy, torus


def rows_of(start, entries):
    return [entries[a:b].tolist() for a, b in itertools.pairwise(start)]


def evidence_of(mesh):
    """Some normals and numbers, as other filters and the surroundings give them."""
    draw = np.random.default_rng(2)
    own = face_normals_and_areas(mesh.vertices, mesh.faces)[0]
    normals = []
    for spread in (0.1, 0.2, 0.3, 0.4):
        turned = own + spread * draw.normal(size=own.shape)
        turned /= np.linalg.norm(turned, axis=1)[:, None]
        normals.append(turned.astype(np.float32))
    assert len(normals) == OTHERS
    statistics = draw.random((len(own), STATISTICS)).astype(np.float32)
    return Evidence(0.1, True, tuple(normals), statistics)


def same_evidence(mesh):
    """Evidence that says nothing beyond the normals of the mesh."""
    own = face_normals_and_areas(mesh.vertices, mesh.faces)[0].astype(np.float32)
    return Evidence(0.1, True, (own,) * OTHERS, np.zeros((len(own), STATISTICS), np.float32))


def described(mesh, earlier=None, make_evidence=same_evidence):
    normals, areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    centroids = face_centroids(mesh.vertices, mesh.faces)
    rings = face_rings(mesh.faces, mesh.topology, "edge")
    describer = NormalDescriber(mesh.faces, centroids, *rings, make_evidence(mesh))
    heights = measure_ripples(mesh.vertices, mesh.vertex_normals(), mesh.topology)
    return describer.describe(normals, areas, centroids, heights, earlier), describer.around


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


@pytest.fixture(scope="module")
def plain(scan):
    normals, areas = face_normals_and_areas(scan.vertices, scan.faces)
    centroids = face_centroids(scan.vertices, scan.faces)
    edges = face_rings(scan.faces, scan.topology, "edge")
    across = rows_of(*edges)
    near = find_neighbourhoods(centroids, *edges)
    units = plain_descriptors.local_units(centroids, across)
    return plain_descriptors.Plain(
        normals, areas, centroids, rows_of(near.near_start, near.near), units
    )


def test_vectors_are_those_of_the_twin(scan, plain):
    got = described(scan)[0].vectors
    assert got.shape == (len(scan.faces), count_vectors(0), 3)
    assert np.abs(got[:, :VECTORS] - plain.vectors).max() < 2e-4


def test_evidence_stands_behind_the_own_vectors_and_numbers(scan, plain):
    given = evidence_of(scan)
    got = described(scan, make_evidence=evidence_of)[0]
    for k, normals in enumerate(given.normals):
        assert (got.vectors[:, VECTORS + k] == normals).all()
    assert (got.numbers[:, NUMBERS:] == given.statistics).all()
    own = plain.normals
    for k, s in enumerate((0.3, 0.6)):
        expected = [plain.filtered(f, given.normals[0], own, s) for f in range(len(own))]
        assert np.abs(got.vectors[:, VECTORS + OTHERS + k] - expected).max() < 2e-4


def test_numbers_are_those_of_the_twin(scan, plain):
    got = described(scan)[0].numbers
    assert np.abs(got[:, :13] - plain.numbers).max() < 2e-4


def test_ripples_are_umbrellas_of_umbrellas(scan):
    rings = rows_of(*scan.topology.one_ring)
    left, normals = scan.vertices, scan.vertex_normals()
    got = measure_ripples(scan.vertices, normals, scan.topology)
    for k in range(3):
        left = np.array([left[row].mean(axis=0) for row in rings]) - left
        along = np.einsum("ij,ij->i", left, normals)
        assert got[:, k] == pytest.approx(np.abs(along), abs=1e-12)
        if k == 1:
            sideways = np.linalg.norm(left - along[:, None] * normals, axis=1)
            assert got[:, 3] == pytest.approx(sideways, abs=1e-9)


def test_normals_are_those_of_the_plain_network(scan):
    descriptors, _ = described(scan)
    network = random_network(count_vectors(0))
    plain = plain_descriptors.predict(
        [(bias.astype(float), matrix.astype(float)) for bias, matrix in network.layers],
        descriptors.inputs().astype(float),
        descriptors.vectors.astype(float),
    )
    assert np.abs(descriptors.predict(network) - plain).max() < 1e-3


def test_a_later_stage_filters_the_scanned_normals_by_the_last(scan, plain):
    normals = face_normals_and_areas(scan.vertices, scan.faces)[0]
    last = plain.vectors[:, 3]
    vectors = described(scan, (normals, last))[0].vectors
    first = count_vectors(1) - EARLIER
    assert np.abs(vectors[:, first] - normals).max() < 1e-6
    assert np.abs(vectors[:, first + 1] - last).max() < 1e-6
    for k, s in enumerate((0.3, 0.6)):
        expected = [plain.filtered(f, last, normals, s) for f in range(len(normals))]
        assert np.abs(vectors[:, first + 2 + k] - expected).max() < 2e-4


def test_where_all_normals_are_one_so_is_the_outcome():
    mesh = prepare_mesh(*grid(9, 9)).mesh
    normals = described(mesh)[0].predict(random_network(count_vectors(0), 5))
    up = face_normals_and_areas(mesh.vertices, mesh.faces)[0][0]
    assert (np.abs(normals) == np.abs(up)).all()


def test_threads_and_blocks_do_not_change_a_bit(scan, monkeypatch):
    network = random_network(count_vectors(0))
    results = []
    for count in ("1", "3"):
        monkeypatch.setenv("MSAL_THREADS", count)
        monkeypatch.setattr(parallel, "MIN_RANGE", 37 if count == "3" else 10**6)
        descriptors = described(scan)[0]
        results.append((descriptors.inputs(), descriptors.predict(network)))
    assert (results[0][0] == results[1][0]).all()
    assert (results[0][1] == results[1][1]).all()


def test_a_turned_mesh_has_the_same_inputs(scan):
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    there = described(scan.with_vertices(scan.vertices @ turn.T))[0]
    here = described(scan)[0]
    assert np.abs(there.vectors - here.vectors @ turn.T.astype(np.float32)).max() < 1e-3
    assert np.abs(there.numbers - here.numbers).max() < 1e-3


def test_a_face_without_area_takes_the_normal_of_those_around():
    vertices, faces = grid(6, 6)
    vertices = vertices.astype(float)
    vertices[faces[20, 1]] = (vertices[faces[20, 0]] + vertices[faces[20, 2]]) / 2
    mesh = prepare_mesh(vertices, faces).mesh
    assert mesh.flat_faces
    descriptors, _ = described(mesh)
    assert np.isfinite(descriptors.inputs()).all()
    assert (np.abs(descriptors.vectors[:, :, 2]) > 0.999).all()
