"""Binary PLY in pieces: the same mesh, the same bytes and the same errors as the whole file."""

from __future__ import annotations

import pickle
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.codecs.streamed import byte_ranges, open_streamed, ply, ply_walk
from msal_cli.errors import MsalError, UnsupportedError
from tests.codecs import plain_ply
from tests.codecs.plain_ply import Element, Ply
from tests.codecs.streamed import pieces

WHOLE_TYPES = ["char", "uchar", "short", "ushort", "int", "uint", "int64", "uint64"]
BINARY = plain_ply.ENCODINGS[1:]


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Blocks of a few records, so that every border is met."""
    monkeypatch.setattr(ply_walk, "BLOCK_BYTES", 40)
    monkeypatch.setattr(ply, "BLOCK_BYTES", 40)
    monkeypatch.setattr(ply, "_AT_ONCE", 2)


def scalar(draw, kind: str):
    if kind in plain_ply.FLOATS:
        width = 64 if kind in ("double", "float64") else 32
        return draw(st.floats(-1e6, 1e6, width=width))
    low, high = (0, 200) if kind.startswith("u") else (-100, 100)
    return draw(st.integers(low, high))


@st.composite
def files(draw):
    """A PLY of a few vertices and polygons, with other properties and elements around."""
    n = draw(st.integers(3, 9))
    coordinate = draw(st.sampled_from([*plain_ply.FLOATS, "short", "int", "uchar", "int64"]))
    names = ["x", "y", "z"]
    if draw(st.booleans()):
        names += ["nx", "ny", "nz"]
    names += [f"p{k}" for k in range(draw(st.integers(0, 2)))]
    names = draw(st.permutations(names))
    types = dict.fromkeys("xyz", coordinate)
    types |= {name: draw(st.sampled_from(["float", "double"])) for name in ("nx", "ny", "nz")}
    kinds = [types.get(name) or draw(st.sampled_from(list(plain_ply.PACK))) for name in names]
    vertex = Element(
        "vertex",
        [(name, kind, "") for name, kind in zip(names, kinds, strict=True)],
        [[scalar(draw, kind) for kind in kinds] for _ in range(n)],
    )
    smallest, largest = draw(st.sampled_from([(3, 3), (4, 4), (1, 6), (3, 5)]))
    corners = st.lists(st.integers(0, n - 1), min_size=smallest, max_size=largest)
    polygons = draw(st.lists(corners, min_size=1, max_size=12))
    if max(map(len, polygons)) < 3:
        polygons.append([0, 1, 2])
    listed = (
        draw(st.sampled_from(["vertex_indices", "vertex_index"])),
        draw(st.sampled_from([*WHOLE_TYPES, "float"])),
        draw(st.sampled_from(WHOLE_TYPES)),
    )
    face = Element("face", [listed], [[one] for one in polygons])
    if draw(st.booleans()):
        face.properties.insert(0, ("flag", "uchar", ""))
        face.rows = [[7, *row] for row in face.rows]
    if draw(st.booleans()):
        face.properties.append(("texcoord", "float", "uchar"))
        face.rows = [[*row, [0.5] * (len(row) % 2)] for row in face.rows]
    other = Element("extra", [("a", "short", ""), ("b", "float", "uint")], [[3, [1.5]], [4, []]])
    camera = Element("camera", [("a", "double", "")], [[2.5]])
    chosen = draw(st.sampled_from([[], [other], [camera], [other, camera]]))
    elements = draw(st.permutations([vertex, face, *chosen]))
    encoding = draw(st.sampled_from(BINARY))
    newline = draw(st.sampled_from(["\n", "\r\n"]))
    trailing = draw(st.sampled_from([b"", b"\0rest"]))
    return plain_ply.written(Ply(encoding, list(elements), [], newline, trailing))


def in_folder(data: bytes):
    """The opened file, in a folder of its own for every example."""
    folder = tempfile.TemporaryDirectory()
    return folder, pieces.stored(Path(folder.name), data, "ply")


@settings(max_examples=50, deadline=None)
@given(files(), st.integers(1, 7), st.integers(1, 200), st.randoms(use_true_random=False))
def test_pieces_are_the_whole_file(data, step, size, random):
    whole = pieces.whole(data, "ply")
    folder, mesh = in_folder(data)
    with folder:
        assert mesh.n_vertices == len(whole.vertices)
        for name in ("encoding", "precision", "properties", "references", "n_polygons", "warnings"):
            assert getattr(mesh, name) == getattr(whole, name), name
        vertices = pieces.read_vertices(mesh, step)
        assert vertices.dtype == mesh.vertex_type
        assert np.array_equal(vertices.astype(np.float64), whole.vertices)
        assert np.array_equal(pieces.read_triangles(mesh, step), whole.faces)
        new = whole.vertices.copy()
        for i in range(len(new)):
            for k in range(3):
                if random.random() < 0.4:
                    new[i, k] = random.uniform(0, 120)
        normals = None
        if mesh.has_normals:
            names = ("nx", "ny", "nz")
            stored = np.stack([whole.vertex_property(one) for one in names], axis=1)
            assert np.array_equal(mesh.read_normals(0, len(new)), stored)
            normals = pieces.new_normals(whole, new)
        expected = bytes(whole.replaced(new))
        assert pieces.replace(mesh, new, normals, size) == expected
        assert pieces.replace(mesh, whole.vertices, step=size) == data


def tetrahedron(encoding: str = BINARY[0], kind: str = "float", n_faces: int = 9) -> Ply:
    vertex = Element(
        "vertex",
        [(name, kind, "") for name in "xyz"],
        [[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]],
    )
    faces = [[[0, 2, 1]], [[0, 1, 3]], [[0, 3, 2]], [[1, 2, 3]]]
    face = Element(
        "face", [("vertex_indices", "int", "uchar")], [faces[k % 4] for k in range(n_faces)]
    )
    return Ply(encoding, [vertex, face])


def failure(read) -> tuple[str, str, str]:
    with pytest.raises(MsalError) as caught:
        read()
    return caught.value.code, caught.value.where, caught.value.message


def read_all(tmp_path, data: bytes) -> None:
    mesh = pieces.stored(tmp_path, data, "ply")
    mesh.face_chunks(2)
    pieces.read_vertices(mesh, 2)
    pieces.read_triangles(mesh, 2)


@pytest.mark.parametrize("sizes", ["triangles", "mixed"])
def test_every_prefix_is_refused_as_the_whole_file_is(tmp_path, sizes):
    mesh = tetrahedron()
    if sizes == "mixed":
        mesh.element("face").rows[3] = [[0, 1, 2, 3]]
    mesh.elements.append(Element("extra", [("a", "double", "")], [[1.0], [2.0]]))
    data = plain_ply.written(mesh)
    for size in range(len(data)):
        part = data[:size]
        expected = failure(lambda part=part: pieces.whole(part, "ply"))
        assert failure(lambda part=part: read_all(tmp_path, part)) == expected


@pytest.mark.parametrize("corner", [4, -1, 2**31 - 1, -(2**31)])
@pytest.mark.parametrize("encoding", BINARY)
def test_a_wrong_index_is_named_with_its_face(tmp_path, encoding, corner):
    mesh = tetrahedron(encoding)
    mesh.element("face").rows[5] = [[0, corner, 1]]
    data = plain_ply.written(mesh)
    expected = failure(lambda: pieces.whole(data, "ply"))
    assert expected[1] == "face 5"
    assert failure(lambda: read_all(tmp_path, data)) == expected


@pytest.mark.parametrize("kind", ["float", "double", "int64", "short", "uint64"])
def test_wrong_indices_of_other_types_are_named_too(tmp_path, kind):
    mesh = tetrahedron()
    mesh.element("face").properties = [("vertex_indices", kind, "uchar")]
    wrong = {"float": 1.5, "double": -3.0, "int64": -(2**40), "short": -2, "uint64": 2**63}[kind]
    mesh.element("face").rows[6] = [[0, wrong, 1]]
    data = plain_ply.written(mesh)
    expected = failure(lambda: pieces.whole(data, "ply"))
    assert failure(lambda: read_all(tmp_path, data)) == expected


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_position_that_is_not_finite_is_named(tmp_path, value):
    mesh = tetrahedron()
    mesh.element("vertex").rows[3] = [0, value, 0]
    data = plain_ply.written(mesh)
    expected = failure(lambda: pieces.whole(data, "ply"))
    assert failure(lambda: read_all(tmp_path, data)) == expected


def test_a_negative_count_is_named(tmp_path):
    mesh = tetrahedron()
    mesh.element("face").properties = [("vertex_indices", "int", "char")]
    data = bytearray(plain_ply.written(mesh))
    data[-13] = 0xFF
    expected = failure(lambda: pieces.whole(bytes(data), "ply"))
    assert failure(lambda: read_all(tmp_path, bytes(data))) == expected


@pytest.mark.parametrize(
    "change",
    [
        {"elements": [tetrahedron().elements[0]]},
        {"elements": [tetrahedron().elements[1]]},
        {"elements": [tetrahedron().elements[0], Element("face", [("a", "int", "")], [[1]])]},
        {
            "elements": [
                tetrahedron().elements[0],
                Element("face", [("vertex_index", "int", "int")], [[[1, 2]]]),
            ]
        },
    ],
)
def test_what_is_no_surface_is_refused_with_the_same_words(tmp_path, change):
    mesh = tetrahedron()
    mesh.elements = change["elements"]
    data = plain_ply.written(mesh)
    expected = failure(lambda: pieces.whole(data, "ply"))
    assert failure(lambda: read_all(tmp_path, data)) == expected


def test_a_position_beyond_the_type_is_refused_with_its_number(tmp_path):
    data = plain_ply.written(tetrahedron())
    whole = pieces.whole(data, "ply")
    new = whole.vertices.copy()
    new[2, 1] = 1e39
    expected = failure(lambda: whole.replaced(new))
    mesh = pieces.stored(tmp_path, data, "ply")
    assert failure(lambda: pieces.replace(mesh, new, step=12)) == expected


def with_list(mesh: Ply) -> None:
    mesh.element("vertex").properties.append(("l", "int", "uchar"))
    for row in mesh.element("vertex").rows:
        row.append([])


def with_strips(mesh: Ply) -> None:
    mesh.elements.append(Element("tristrips", [("vertex_indices", "int", "int")], [[[0, 1, 2]]]))


def with_face_normals(mesh: Ply) -> None:
    mesh.element("face").properties += [(name, "float", "") for name in ("nx", "ny", "nz")]
    for k, row in enumerate(mesh.element("face").rows):
        mesh.element("face").rows[k] = [*row, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("change", [with_list, with_strips, with_face_normals])
def test_what_cannot_be_read_in_pieces_is_refused_with_a_hint(tmp_path, change):
    mesh = tetrahedron()
    change(mesh)
    with pytest.raises(UnsupportedError) as caught:
        pieces.stored(tmp_path, plain_ply.written(mesh), "ply")
    assert caught.value.hint and caught.value.where


def test_properties_of_vertices_are_read(tmp_path):
    data = plain_ply.written(tetrahedron())
    mesh = pieces.stored(tmp_path, data, "ply")
    assert mesh.read_property("y", 1, 4).tolist() == [0.0, 9.0, 0.0]
    whole = pieces.whole(data, "ply")
    expected = failure(lambda: whole.vertex_property("q"))
    assert failure(lambda: mesh.read_property("q", 0, 1)) == expected


def test_reading_a_range_reads_little_more(tmp_path, monkeypatch):
    data = plain_ply.written(tetrahedron(n_faces=3000))
    mesh = pieces.stored(tmp_path, data, "ply")
    mesh.face_chunks(100)
    read = []
    original = byte_ranges.read_range

    def counted(path, start, stop):
        read.append(stop - start)
        return original(path, start, stop)

    monkeypatch.setattr(ply, "read_range", counted)
    mesh.read_triangles(mesh.face_chunks(100)[7])
    mesh.read_vertices(1, 3)
    mesh.replace(mesh.output_pieces(64)[-1], lambda _start, _stop: None, None)
    assert sum(read) < 2000
    assert len(pickle.dumps(mesh)) < 4000


def test_opening_reads_only_the_header(tmp_path):
    """A file with a hole of many gigabytes opens at once, since its faces are not looked at."""
    mesh = tetrahedron()
    data = plain_ply.written(mesh).replace(b"element face 9", b"element face 2000000000")
    path = tmp_path / "large.ply"
    path.write_bytes(data)
    with path.open("r+b") as file:
        file.truncate(30_000_000_000)
    opened = open_streamed(path)
    assert opened.n_polygons == 2_000_000_000
    assert opened.read_vertices(1, 2).tolist() == [[9.0, 0.0, 0.0]]
