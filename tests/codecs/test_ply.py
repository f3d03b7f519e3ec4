"""PLY by hand-worked cases, range grids, other readers, and with fields at its vertices."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from msal_cli import codecs
from msal_cli.codecs import open_mesh, ply
from msal_cli.codecs.ply_write import with_fields
from msal_cli.errors import ContentError, InternalError, MsalError
from tests.cli.scans import closed_scan, ply_text
from tests.codecs import plain_ply
from tests.codecs.plain_ply import ENCODINGS, Element, Ply
from tests.shapes import cube, grid

LE = "binary_little_endian"
XYZ = [("x", "float", ""), ("y", "float", ""), ("z", "float", "")]
NORMALS = [("nx", "float", ""), ("ny", "float", ""), ("nz", "float", "")]
LIST = [("vertex_indices", "int", "uchar")]


def read(file: Ply) -> ply.PlyFile:
    return ply.read(plain_ply.written(file))


def mesh_file(encoding: str, vertices, faces, normals=None, face_normals=None) -> Ply:
    rows = [list(map(float, row)) for row in vertices]
    if normals is not None:
        rows = [row + list(map(float, normal)) for row, normal in zip(rows, normals, strict=True)]
    cells = [[list(map(int, face))] for face in faces]
    if face_normals is not None:
        cells = [
            cell + list(map(float, normal))
            for cell, normal in zip(cells, face_normals, strict=True)
        ]
    return Ply(
        encoding,
        [
            Element("vertex", XYZ + (NORMALS if normals is not None else []), rows),
            Element("face", LIST + (NORMALS if face_normals is not None else []), cells),
        ],
    )


def test_minus_zero_and_equal_values_keep_their_bytes():
    file = mesh_file(LE, [[-0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    mesh = read(file)
    vertices = mesh.vertices + 0.0
    assert not np.signbit(vertices).any()
    assert bytes(mesh.replaced(vertices)) == plain_ply.written(file)
    vertices[1, 2] = 0.5
    assert bytes(mesh.replaced(vertices)) == plain_ply.written(
        file.with_columns("vertex", {"z": [0.0, 0.5, 0.0]})
    )


def test_a_body_that_begins_with_the_byte_of_a_line_end():
    file = plain_ply.cube(LE)
    file.elements[0].rows[0][0] = struct.unpack("<f", b"\n\r\n?")[0]
    for newline in ("\n", "\r\n", "\r"):
        assert np.array_equal(read(replace(file, newline=newline)).vertices, read(file).vertices)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_whole_number_coordinates_are_rounded_with_a_warning(encoding):
    kinds = [("x", "short", ""), ("y", "int", ""), ("z", "uchar", "")]
    file = Ply(
        encoding,
        [
            Element("vertex", kinds, [[0, 0, 0], [10, 0, 1], [0, 10, 2]]),
            Element("face", LIST, [[[0, 1, 2]]]),
        ],
    )
    mesh = read(file)
    assert mesh.precision == ("text" if encoding == "ascii" else "integer")
    assert "rounded" in mesh.warnings[0]
    vertices = mesh.vertices + [[0.4, 0.5, 1.5], [-0.6, 0.3, 0.2], [0, 0, 0]]
    output = mesh.replaced(vertices)
    mesh.check(output, vertices)
    assert bytes(output) == plain_ply.written(
        file.with_columns("vertex", {"x": [0, 9, 0], "y": [0, 0, 10], "z": [2, 1, 2]})
    )
    for far in (-1.0, 256.0):
        vertices[2, 2] = far
        with pytest.raises(ContentError, match="new z of vertex 2"):
            mesh.replaced(vertices)
    wide = plain_ply.read(bytes(mesh.encoded(vertices, "same", "float64")))
    assert wide.element("vertex").properties[2] == ("z", "double", "")
    assert [row[2] for row in wide.element("vertex").rows] == [1.5, 1.2, 256.0]


# Faces


def test_an_unsigned_strip_restarts_at_all_ones():
    file = Ply(
        LE,
        [
            Element("vertex", XYZ, [[k, k * k, 0] for k in range(6)]),
            Element(
                "tristrips", [("vertex_indices", "uint", "uint")], [[[0, 1, 2, 2**32 - 1, 3, 4, 5]]]
            ),
        ],
    )
    assert read(file).faces.tolist() == [[0, 1, 2], [3, 4, 5]]


# Normals


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_vertex_normals_follow_the_surface_and_keep_their_sense(encoding):
    vertices, faces = grid(6, 5)
    inward = np.tile([0.0, 0.0, -1.0], (len(vertices), 1))
    file = mesh_file(encoding, vertices, faces, normals=inward)
    mesh = read(file)
    # The plane z = x / 2 instead of z = 0 for the columns from 2 on.
    tilted = vertices.copy()
    tilted[:, 2] = np.maximum(vertices[:, 0] - 2.0, 0.0) / 2.0
    output = mesh.replaced(tilted)
    mesh.check(output, tilted)
    rows = plain_ply.read(bytes(output)).element("vertex").rows
    steep = np.array([0.5, 0.0, -1.0]) / np.sqrt(1.25)
    for x, _, _, *normal in rows:
        if x < 2:
            assert normal == [0.0, 0.0, -1.0]
        elif x > 2:
            assert np.allclose(normal, steep, atol=2e-6)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_face_normals_of_polygons_are_recomputed(encoding):
    corners = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [9, 9, 9], [8, 9, 9], [9, 8, 9]]
    faces = [[0, 1, 2, 3], [2, 1, 0], [4, 5, 6], [0, 1], [0, 1, 2]]
    stored = [[0, 0, 1], [0, 0, 1], [0.5, 0.25, 0], [1, 0, 0], [0, 0, 0]]
    mesh = read(mesh_file(encoding, corners, faces, face_normals=stored))
    vertices = mesh.vertices.copy()
    vertices[[1, 2], 2] = 2.0
    output = mesh.replaced(vertices)
    mesh.check(output, vertices)
    normals = [row[1:] for row in plain_ply.read(bytes(output)).element("face").rows]
    half = 0.5**0.5
    # The second face was wound against its normal: it stays so.  No corner of the third moved,
    # the fourth has no area, the fifth had no normal.
    assert np.allclose(normals[0], [-half, 0, half], atol=1e-6)
    assert np.allclose(normals[1], [-half, 0, half], atol=1e-6)
    assert normals[2:] == [[0.5, 0.25, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_normals_that_are_not_three_floats_are_kept_with_a_warning(encoding):
    file = plain_ply.cube(encoding)
    vertex = file.element("vertex")
    vertex.properties += [("nx", "char", ""), ("ny", "char", ""), ("nz", "char", "")]
    vertex.rows = [[*row, 0, 0, 127] for row in vertex.rows]
    mesh = read(file)
    assert "kept, not recomputed" in mesh.warnings[0]
    output = plain_ply.read(bytes(mesh.replaced(mesh.vertices + np.arange(24.0).reshape(8, 3))))
    assert [row[4:] for row in output.element("vertex").rows] == [[0, 0, 127]] * 8


def test_normals_belong_to_the_positions_given_last():
    vertices, faces = grid(4, 4)
    file = mesh_file(LE, vertices, faces, normals=np.tile([0.0, 0.0, 1.0], (len(vertices), 1)))
    mesh = read(file)
    first, second = vertices + np.sin(vertices), vertices + np.cos(3 * vertices)
    before = bytes(mesh.replaced(first))
    assert bytes(mesh.replaced(second)) == bytes(read(file).replaced(second)) != before
    with pytest.raises(InternalError):
        mesh.check(before, second)


def test_a_nan_among_the_normals_stays_and_passes_the_check():
    vertices, faces = grid(3, 3)
    normals = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    normals[0] = np.nan
    mesh = read(mesh_file(LE, vertices, faces, normals=normals))
    moved = vertices + np.sin(vertices)
    output = mesh.replaced(moved)
    mesh.check(output, moved)
    rows = plain_ply.read(bytes(output)).element("vertex").rows
    assert np.isnan(rows[0][3:]).all() and np.isfinite(rows[1][3:]).all()


# Conversion


def test_long_integers_are_exact_there_and_back():
    file = plain_ply.cube()
    camera = file.element("camera")
    camera.properties = [("id", "uint64", ""), ("sums", "int64", "uchar")]
    camera.rows = [[2**64 - 1, [2**53 + 1, -(2**63), 2**63 - 1, 0]]]
    mesh = read(file)
    output = bytes(mesh.encoded(mesh.vertices, "ascii", "same"))
    assert b"\n18446744073709551615 4 9007199254740993 -9223372036854775808 " in output
    again = ply.read(output)
    assert bytes(again.encoded(again.vertices, "binary", "same")) == plain_ply.written(file)


@pytest.mark.parametrize(
    ("kind", "token"),
    [
        ("uchar", "300"), ("char", "-129"), ("uint", "-1"), ("int", "1.5"), ("uint64", "-1"),
        ("int64", "9" * 30), ("float", "1e40"),
    ],
)  # fmt: skip
def test_ascii_values_that_their_type_cannot_hold_do_not_become_binary(kind, token):
    file = plain_ply.cube("ascii")
    vertex = file.element("vertex")
    vertex.properties[3] = ("red", kind, "")
    vertex.rows[6][3] = token
    mesh = read(file)
    with pytest.raises(ContentError) as caught:
        mesh.encoded(mesh.vertices, "binary", "same")
    assert caught.value.code == "E_RANGE" and "vertex 6, line " in caught.value.where
    assert np.array_equal(
        ply.read(mesh.encoded(mesh.vertices, "same", "float64")).vertices, mesh.vertices
    )


@pytest.mark.parametrize("extra", ["", "q"])
@pytest.mark.parametrize("code", ["<f4", ">f8", "<i2"])
def test_records_of_positions_alone_are_as_any_others(code, extra):
    # More records than are worked on at a time.
    n = 40_000
    rng = np.random.default_rng(5)
    kind = np.dtype([(name, code) for name in ("x", "y", "z", *extra)])
    records = np.zeros(n, dtype=kind)
    for name in kind.names:
        records[name] = rng.integers(-3000, 3000, n)
    word = {"f4": "float", "f8": "double", "i2": "short"}[code[1:]]
    order = "little" if code[0] == "<" else "big"
    head = f"ply\nformat binary_{order}_endian 1.0\nelement vertex {n}\n"
    head += "".join(f"property {word} {name}\n" for name in kind.names)
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    face = np.array([3], np.uint8).tobytes() + np.array([0, 1, 2], code[0] + "i4").tobytes()
    data = head.encode() + records.tobytes() + face
    file = ply.read(data)
    assert (file.vertices == np.stack([records[k] for k in "xyz"], axis=1)).all()
    moved = file.vertices.copy()
    moved[20_000:, 1] += 7.0
    output = bytes(file.replaced(moved))
    file.check(output, moved)
    records["y"][20_000:] += 7
    assert output == head.encode() + records.tobytes() + face
    for at in (len(head) + 3, len(head) + 30_000 * kind.itemsize, len(output) - 1):
        wrong = bytearray(output)
        wrong[at] ^= 1
        with pytest.raises(InternalError):
            file.check(bytes(wrong), moved)


SAMPLES = [[0, 1, 2, None], [3, 4, 5, 6], [None, 7, None, 8]]
PLACES = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (1.75, 0.875), (3, 1), (1, 2), (3, 2)]
"""A vertex for each sample, on whole numbers but for the sixth, which is nearer to the second."""

TRIANGLES = [
    # Both diagonals are as long; in the next cell the first one is shorter.
    *([0, 1, 3], [1, 4, 3]),
    *([1, 2, 5], [1, 5, 4]),
    # Cells of three samples.
    [6, 5, 2],
    [3, 4, 7],
    [7, 4, 5],
    [5, 6, 8],
]
INFOS = ["obj_info is_mesh 0", "obj_info num_cols 4", "obj_info num_rows 3", "comment a scan"]


def scan(encoding: str = "ascii", infos=INFOS, samples=SAMPLES, heights=None) -> Ply:
    heights = heights or {}
    rows = [[float(x), float(y), heights.get(k, 0.0), 0.5] for k, (x, y) in enumerate(PLACES)]
    cells = [[[] if k is None else [k]] for row in samples for k in row]
    return Ply(
        encoding,
        [
            Element(
                "vertex", [(name, "float", "") for name in ("x", "y", "z", "confidence")], rows
            ),
            Element("range_grid", [("vertex_indices", "int", "uchar")], cells),
        ],
        list(infos),
    )


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_neighbouring_samples_are_joined_and_only_positions_change(encoding):
    plain = scan(encoding)
    data = plain_ply.written(plain)
    file = open_mesh(data, "a.ply")
    assert file.faces.tolist() == TRIANGLES
    assert file.n_polygons == len(TRIANGLES)
    assert file.properties == ("vertex.confidence float", "range grid of 3 rows and 4 columns")
    assert file.warnings == ()
    assert file.replaced(file.vertices.copy()) is data
    vertices = file.vertices.copy()
    vertices[4] = [1.25, 1.5, -0.5]
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    columns = {name: vertices[:, k].tolist() for k, name in enumerate("xyz")}
    assert plain_ply.read(output) == replace(plain.with_columns("vertex", columns), newline="\n")
    assert plain_ply.header(plain) == output[: output.index(b"end_header\n") + 11]


def test_a_step_in_depth_is_not_joined():
    # The median edge is 1, so that the limit is 4: the last vertex is 5 behind its neighbours.
    file = ply.read(plain_ply.written(scan(heights={8: 5.0})))
    assert file.faces.tolist() == TRIANGLES[:-1]
    file = ply.read(plain_ply.written(scan(heights={8: 3.5})))
    assert file.faces.tolist() == TRIANGLES


def test_faces_go_before_the_grid():
    plain = scan(infos=[])
    plain.elements.append(Element("face", [("vertex_indices", "int", "uchar")], [[[0, 1, 4]]]))
    file = ply.read(plain_ply.written(plain))
    assert file.faces.tolist() == [[0, 1, 4]]
    assert "element range_grid (12)" in file.properties


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"infos": []}, "E_FORMAT", "no 'obj_info num_rows' and no 'obj_info num_cols'"),
        ({"infos": ["obj_info num_cols 4"]}, "E_FORMAT", "no 'obj_info num_rows'"),
        ({"infos": ["obj_info num_cols 4", "obj_info num_rows 4"]}, "E_FORMAT", "12 samples"),
        ({"infos": ["obj_info num_cols -4", "obj_info num_rows -3"]}, "E_FORMAT", "-3 by -4"),
        ({"samples": [[0, 1, 2, None], [9, 4, 5, 6], [None] * 4]}, "E_INDEX", "vertex 9"),
        ({"samples": [[0, 1, 2, None], [None] * 4, [3, 4, 5, 6]]}, "E_NO_FACES",
            "no three samples"),
        ({"two": 5}, "E_FORMAT", "more than one vertex"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_what_is_wrong_with_a_grid(change, code, words, encoding):
    place = change.get("two")
    plain = scan(encoding, **({} if place else change))
    if place:
        plain.element("range_grid").rows[place] = [[4, 5]]
    with pytest.raises(MsalError, match=words) as caught:
        open_mesh(plain_ply.written(plain), "a.ply")
    assert caught.value.code == code
    assert caught.value.hint and caught.value.where
    assert not place or caught.value.where.startswith(f"range_grid {place}")


def opened(data, name="a.ply"):
    return codecs.open_mesh(bytes(data), name)


def test_positions_faces_numbers_and_colours_are_there():
    source = opened(closed_scan())
    n = len(source.vertices)
    colours = np.arange(3 * n, dtype=np.uint8).reshape(n, 3)
    values = np.linspace(-1.0, 1.0, n)
    data = with_fields(source, source.vertices, {"deviation": values}, colours, ["of a test"])
    again = opened(data)
    assert np.array_equal(again.vertices, source.vertices)
    assert np.array_equal(again.faces, source.faces)
    assert "vertex.deviation float" in again.properties
    assert b"comment of a test\n" in data
    judge = trimesh.load(trimesh.util.wrap_as_stream(bytes(data)), "ply", process=False)
    assert np.array_equal(judge.visual.vertex_colors[:, :3], colours)
    stored = judge.metadata["_ply_raw"]["vertex"]["data"]["deviation"].reshape(-1)
    assert np.array_equal(stored, values.astype(np.float32))


def test_a_comment_cannot_end_the_header():
    source = opened(ply_text(*cube()))
    data = with_fields(source, source.vertices, {}, None, ["a\nend_header\r\x1b[31m\u202e.ply"])
    assert data.count(b"\nend_header\n") == 1
    assert np.array_equal(opened(data).vertices, source.vertices)


@pytest.mark.parametrize("name", ["x", "red", "two words", "a\nb", ""])
def test_a_field_that_cannot_be(name):
    source = opened(ply_text(*cube()))
    with pytest.raises(InternalError):
        with_fields(source, source.vertices, {name: np.zeros(8)})


def test_a_list_longer_than_its_count_type_does_not_become_binary():
    file = mesh_file("ascii", *grid(3, 3))
    file.elements[1].properties = [("vertex_indices", "int", "char")]
    file.elements[1].rows[2][0] = [0, 1, 4] * 43
    mesh = read(file)
    with pytest.raises(ContentError, match="face 2"):
        mesh.encoded(mesh.vertices, "binary", "same")
