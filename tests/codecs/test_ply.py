"""PLY: hand-worked cases, range grids, other readers, fields at vertices, and wrong files."""

import struct
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from msal_cli.codecs import open_mesh, ply
from msal_cli.codecs.ply_write import write_ply
from msal_cli.errors import ContentError, InternalError, MsalError
from tests.cli.scans import closed_scan
from tests.codecs import plain_ply
from tests.codecs.patching import rewritten
from tests.codecs.plain_ply import ENCODINGS, Element, Ply
from tests.shapes import grid

LE, BE = "binary_little_endian", "binary_big_endian"
XYZ = [("x", "float", ""), ("y", "float", ""), ("z", "float", "")]
NORMALS = [("nx", "float", ""), ("ny", "float", ""), ("nz", "float", "")]
LIST = [("vertex_indices", "int", "uchar")]


def read(file: Ply) -> ply.PlyFile:
    return ply.read(plain_ply.written(file))


def mesh_file(encoding: str, vertices, faces, normals=None, face_normals=None) -> Ply:
    def element(name, properties, rows, more):
        more, has_more = [[]] * len(rows) if more is None else more, more is not None
        rows = [row + list(map(float, own)) for row, own in zip(rows, more, strict=True)]
        return Element(name, properties + NORMALS * has_more, rows)

    rows = [list(map(float, row)) for row in vertices]
    cells = [[list(map(int, face))] for face in faces]
    vertex = element("vertex", XYZ, rows, normals)
    return Ply(encoding, [vertex, element("face", LIST, cells, face_normals)])


def test_a_body_that_begins_with_the_byte_of_a_line_end():
    file = plain_ply.cube(LE)
    file.elements[0].rows[0][0] = struct.unpack("<f", b"\n\r\n?")[0]
    for newline in ("\n", "\r\n", "\r"):
        assert np.array_equal(read(replace(file, newline=newline)).vertices, read(file).vertices)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_whole_number_coordinates_are_rounded_with_a_warning(encoding):
    kinds = [("x", "short", ""), ("y", "int", ""), ("z", "uchar", "")]
    vertex = Element("vertex", kinds, [[0, 0, 0], [10, 0, 1], [0, 10, 2]])
    file = Ply(encoding, [vertex, Element("face", LIST, [[[0, 1, 2]]])])
    mesh = read(file)
    assert mesh.precision == ("text" if encoding == "ascii" else "integer")
    assert "rounded" in mesh.warnings[0]
    vertices = mesh.vertices + [[0.4, 0.5, 1.5], [-0.6, 0.3, 0.2], [0, 0, 0]]
    output = rewritten(mesh, vertices)
    assert output == plain_ply.written(
        file.with_columns("vertex", {"x": [0, 9, 0], "y": [0, 0, 10], "z": [2, 1, 2]})
    )
    for far in (-0.6, 255.6, 256.0):
        vertices[2, 2] = far
        with pytest.raises(ContentError, match="new z of vertex 2") as caught:
            mesh.replaced(vertices)
        assert (caught.value.where[:8], caught.value.code) == ("vertex 2", "E_RANGE")
    for near, stored in ((-0.4, 0), (255.4, 255)):
        vertices[2, 2] = near
        assert plain_ply.read(bytes(mesh.replaced(vertices))).element("vertex").rows[2][2] == stored
    vertices[2, 2] = 256.0
    wide = plain_ply.read(bytes(mesh.encoded(vertices, "same", "float64")))
    assert wide.element("vertex").properties[2] == ("z", "double", "")
    assert [row[2] for row in wide.element("vertex").rows] == [1.5, 1.2, 256.0]


def test_an_unsigned_strip_restarts_at_all_ones():
    vertex = Element("vertex", XYZ, [[k, k * k, 0] for k in range(6)])
    strips = [("vertex_indices", "uint", "uint")]
    strip = Element("tristrips", strips, [[[0, 1, 2, 2**32 - 1, 3, 4, 5]]])
    assert read(Ply(LE, [vertex, strip])).faces.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_vertex_normals_follow_the_surface_and_keep_their_sense(encoding):
    vertices, faces = grid(6, 5)
    inward = np.tile([0.0, 0.0, -1.0], (len(vertices), 1))
    file = mesh_file(encoding, vertices, faces, normals=inward)
    mesh = read(file)
    # The plane z = x / 2 instead of z = 0 for the columns from 2 on.
    tilted = vertices.copy()
    tilted[:, 2] = np.maximum(vertices[:, 0] - 2.0, 0.0) / 2.0
    output = rewritten(mesh, tilted)
    rows = plain_ply.read(output).element("vertex").rows
    steep = np.array([0.5, 0.0, -1.0]) / np.sqrt(1.25)
    for x, _, _, *normal in rows:
        if x < 2:
            assert normal == [0.0, 0.0, -1.0]
        elif x > 2:
            assert np.allclose(normal, steep, atol=2e-6)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_normals_of_faces_are_kept_with_a_warning(encoding):
    corners, stored = [[0, 0, 0], [2, 0, 0], [2, 2, 0]], [[0.5, 0.25, 0]]
    mesh = read(mesh_file(encoding, corners, [[0, 1, 2]], face_normals=stored))
    assert mesh.warnings == ("normals of faces are kept as they are",)
    output = rewritten(mesh, mesh.vertices[:, ::-1].copy())
    assert [row[1:] for row in plain_ply.read(output).element("face").rows] == stored


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


def test_a_nan_and_a_zero_among_the_normals_stay_and_pass_the_check():
    vertices, faces = grid(3, 3)
    normals = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    normals[0], normals[2] = np.nan, 0.0
    mesh = read(mesh_file(LE, vertices, faces, normals=normals))
    moved = vertices + np.sin(vertices)
    output = rewritten(mesh, moved)
    rows = plain_ply.read(output).element("vertex").rows
    assert np.isnan(rows[0][3:]).all() and np.isfinite(rows[1][3:]).all()
    assert rows[2][3:] == [0.0, 0.0, 0.0]


def test_long_integers_are_exact_in_text_and_stay_there():
    file = plain_ply.cube()
    camera = file.element("camera")
    camera.properties = [("id", "uint64", ""), ("sums", "int64", "uchar")]
    camera.rows = [[2**64 - 1, [2**53 + 1, -(2**63), 2**63 - 1, 0]]]
    mesh = read(file)
    output = bytes(mesh.encoded(mesh.vertices, "ascii", "same"))
    assert b"\n18446744073709551615 4 9007199254740993 -9223372036854775808 " in output
    with pytest.raises(ContentError, match="'id' of camera 0"):
        ply.read(output).encoded(mesh.vertices, "binary", "same")


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


SAMPLES = [[0, 1, 2, None], [3, 4, 5, 6], [None, 7, None, 8]]
PLACES = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (1.75, 0.875), (3, 1), (1, 2), (3, 2)]
"""A vertex for each sample, on whole numbers but for the sixth, which is nearer to the second."""

# Both diagonals are as long; in the next cell the first one is shorter; cells of three samples.
TRIANGLES = [[0, 1, 3], [1, 4, 3], [1, 2, 5], [1, 5, 4], [6, 5, 2], [3, 4, 7], [7, 4, 5], [5, 6, 8]]
INFOS = ["obj_info is_mesh 0", "obj_info num_cols 4", "obj_info num_rows 3", "Created by Blender"]


def scan(encoding: str = "ascii", infos=INFOS, samples=SAMPLES, heights=None) -> Ply:
    heights = heights or {}
    rows = [[float(x), float(y), heights.get(k, 0.0), 0.5] for k, (x, y) in enumerate(PLACES)]
    cells = [[[] if k is None else [k]] for row in samples for k in row]
    vertex = Element("vertex", [*XYZ, ("confidence", "float", "")], rows)
    return Ply(encoding, [vertex, Element("range_grid", LIST, cells)], list(infos))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_neighbouring_samples_are_joined_and_only_positions_change(encoding):
    plain = scan(encoding)
    data = plain_ply.written(plain)
    file = open_mesh(data, "a.ply")
    assert file.faces.tolist() == TRIANGLES
    assert file.n_polygons == len(TRIANGLES)
    assert file.properties[:2] == ("vertex.confidence float", "range grid of 3 rows and 4 columns")
    assert file.warnings == ()
    assert file.replaced(file.vertices.copy()) is data
    vertices = file.vertices.copy()
    vertices[4] = [1.25, 1.5, -0.5]
    output = rewritten(file, vertices)
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
    plain.elements.append(Element("face", LIST, [[[0, 1, 4]]]))
    file = ply.read(plain_ply.written(plain))
    assert file.faces.tolist() == [[0, 1, 4]]
    assert "element range_grid (12)" in file.properties


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"infos": []}, "E_FORMAT", "of 12 samples are missing and missing"),
        ({"infos": ["obj_info num_cols 4", "obj_info num_rows 4"]}, "E_FORMAT", "are 4 and 4"),
        ({"infos": ["obj_info num_cols -4", "obj_info num_rows -3"]}, "E_FORMAT", "are -3 and -4"),
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


def test_positions_faces_numbers_and_colours_are_there():
    source = ply.read(closed_scan())
    n = len(source.vertices)
    colours = np.arange(3 * n, dtype=np.uint8).reshape(n, 3)
    values = np.linspace(-1.0, 1.0, n)
    fields = {"deviation": values}
    comments = ["of a test", "cannot end the header\nend_header\r\x1b[31m\u202e.ply"]
    surface = source.vertices, *source.polygons()
    data = write_ply(*surface, single=False, colours=colours, fields=fields, comments=comments)
    again = ply.read(bytes(data))
    assert np.array_equal(again.vertices, source.vertices)
    assert np.array_equal(again.faces, source.faces)
    assert "vertex.deviation float" in again.properties
    assert b"comment of a test\n" in data
    assert data.count(b"\nend_header\n") == 1
    judge = trimesh.load(trimesh.util.wrap_as_stream(bytes(data)), "ply", process=False)
    assert np.array_equal(judge.visual.vertex_colors[:, :3], colours)
    stored = judge.metadata["_ply_raw"]["vertex"]["data"]["deviation"].reshape(-1)
    assert np.array_equal(stored, values.astype(np.float32))


def test_a_list_longer_than_its_count_type_does_not_become_binary():
    file = mesh_file("ascii", *grid(3, 3))
    file.elements[1].properties = [("vertex_indices", "int", "char")]
    file.elements[1].rows[2][0] = [0, 1, 4] * 43
    mesh = read(file)
    with pytest.raises(ContentError, match="face 2"):
        mesh.encoded(mesh.vertices, "binary", "same")


CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def text(head: str, body: str) -> bytes:
    """An ascii file; ``head`` are the header lines between format and end_header."""
    return f"ply\nformat ascii 1.0\n{head}end_header\n{body}".encode()


def binary(head: str, body: bytes, order: str = "little") -> bytes:
    return f"ply\nformat binary_{order}_endian 1.0\n{head}end_header\n".encode() + body


def tetra(encoding: str = "ascii", faces=((0, 1, 2),), **changes) -> bytes:
    elements = [
        Element("vertex", XYZ, [list(row) for row in changes.get("corners", CORNERS)]),
        Element("face", changes.get("list", LIST), [[list(face)] for face in faces]),
    ]
    return plain_ply.written(Ply(encoding, elements))


def cells(second: str = "1 0 0", face: str = "3 0 1 2") -> bytes:
    """An ascii file of four vertices, the second of which may be another, and a face."""
    return text(V4 + F1, V4_TEXT.replace("1 0 0", second) + face + "\n")


V4 = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
F1 = "element face 1\nproperty list uchar int vertex_indices\n"
V4_TEXT = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
V4_BYTES = struct.pack("<12f", *(x for row in CORNERS for x in row))
GOOD = tetra()

DAMAGED = {
    "another format": (b"solid cube\nfacet normal 0 0 1\n", "E_FORMAT", "byte 0"),
    "byte-order mark": (b"\xef\xbb\xbf" + GOOD, "E_FORMAT", "line 1"),
    "only the magic line": (b"ply\n", "E_TRUNCATED", "line 2"),
    "no end_header": (GOOD[: GOOD.index(b"end_header")], "E_TRUNCATED", "line 9"),
    "no end_header, much data": (GOOD[: GOOD.index(b"end_header")] + bytes(1_000_000),
        "E_TOO_LARGE", ""),
    "endless comments": (GOOD.replace(b"element vertex", b"comment x\n" * 2000 + b"element vertex"),
        "E_TOO_LARGE", "line 1000"),
    "end_header at the limit": (GOOD.replace(b"element vertex",
        b"comment " + b"x" * (65_535 - GOOD.index(b"\nend_header") - 19) + b"\nelement vertex"),
        "E_TOO_LARGE", ""),
    "no format": (GOOD.replace(b"format ascii 1.0\n", b""), "E_FORMAT", "header"),
    "unknown encoding": (GOOD.replace(b"ascii", b"utf8"), "E_FORMAT", "line 2"),
    "unknown version": (GOOD.replace(b" 1.0", b" 2.0"), "E_UNSUPPORTED", "line 2"),
    "unknown keyword": (GOOD.replace(b"element face", b"elemnt face"), "E_FORMAT", "line 7"),
    "binary rubbish in the header": (GOOD.replace(b"element face", b"\x00\xff\xfe face"),
        "E_FORMAT", "line 7"),
    "negative count": (GOOD.replace(b"vertex 4", b"vertex -4"), "E_FORMAT", "line 3"),
    "element twice": (text(V4 + V4 + F1, V4_TEXT), "E_FORMAT", "line 7"),
    "property twice": (GOOD.replace(b"property float y\n", b"property float x\n"), "E_FORMAT",
        "line 5"),
    "property before elements": (GOOD.replace(b"element vertex", b"property int a\nelement vertex"),
        "E_FORMAT", "line 3"),
    "unknown type": (GOOD.replace(b"float y", b"real y"), "E_FORMAT", "line 5"),
    "list with float count": (GOOD.replace(b"list uchar", b"list float"), "E_FORMAT", "line 8"),
    "no vertex element": (GOOD.replace(b"element vertex", b"element point"), "E_FORMAT", "header"),
    "no z": (GOOD.replace(b"float z", b"float w"), "E_FORMAT", "header"),
    "no face element": (text(V4 + F1.partition("\n")[2], V4_TEXT), "E_FORMAT", "header"),
    "x is a list": (GOOD.replace(b"property float x", b"property list uchar float x"), "E_FORMAT",
        "header"),
    "corners are no list": (GOOD.replace(b"list uchar int vertex_indices", b"int vertex_indices"),
        "E_FORMAT", ""),
    "empty lists of 64-bit indices": (binary(V4 + "element face 2\n"
        "property list uchar uint64 vertex_indices\n", V4_BYTES + bytes(2)), "E_NO_FACES",
        "element face"),
    "binary: half a face": (binary(V4 + F1, V4_BYTES + b"\x03\0\0"), "E_TRUNCATED", "face 0"),
    "binary: negative list count": (binary(V4 + F1.replace("uchar", "char"),
        V4_BYTES + b"\xff" + bytes(12)), "E_FORMAT", "face 0"),
    "binary: list count of 1.8e19": (binary(V4 + F1.replace("uchar", "uint64"),
        V4_BYTES + b"\xff" * 8 + bytes(12)), "E_FORMAT", "face 0"),
    "binary: 1e19 vertices": (binary(V4.replace("4", "1" + "0" * 19) + F1, V4_BYTES), "E_TRUNCATED",
        "vertex 4"),
    "binary: 1e19 faces": (binary(V4 + F1.replace("face 1", "face 1" + "0" * 19),
        V4_BYTES + b"\x03" + bytes(12)), "E_TRUNCATED", "face 1"),
    "binary: index too large": (tetra(LE, [(0, 1, 2), (0, 1, 4)]), "E_INDEX", "face 1"),
    "binary: index negative": (tetra(LE, [(0, 1, -1)]), "E_INDEX", "face 0"),
    "binary: index of 2**63": (tetra(LE, [(0, 1, 2**63)], list=[("vertex_indices", "uint64",
        "uchar")]), "E_INDEX", "face 0"),
    "binary: index 1.5": (tetra(LE, [(0, 1, 1.5)], list=[("vertex_indices", "float", "uchar")]),
        "E_FORMAT", "face 0"),
    "binary: index 1e300": (tetra(LE, [(0, 1, 1e300)], list=[("vertex_indices", "double",
        "uchar")]), "E_INDEX", "face 0"),
    "binary: index in a mixed file": (tetra(BE, [(0, 1, 2), (0, 1, 2, 3), (0, 1, 9)]), "E_INDEX",
        "face 2"),
    "binary: wrong byte order": (tetra(LE, list=[("vertex_indices", "int",
        "int")]).replace(b"little", b"big"), "E_TRUNCATED", "face 0"),
    "binary: NaN": (tetra(LE, corners=[*CORNERS[:2], [0, float("nan"), 0]]), "E_NONFINITE",
        "vertex 2"),
    "binary: signalling NaN": (tetra(LE).replace(struct.pack("<f", 1.0), b"\x01\x00\x80\x7f"),
        "E_NONFINITE", "vertex 1"),
    "binary: strip index": (binary(
        V4 + "element tristrips 1\nproperty list int int vertex_indices\n",
        V4_BYTES + struct.pack("<6i", 5, 0, 1, -2, 2, 3)), "E_INDEX", "tristrips 0"),
    "point cloud": (binary(V4, V4_BYTES), "E_NO_FACES", ""),
    "faces but no vertices": (tetra(LE, corners=[]), "E_INDEX", "face 0"),
    "faces of two corners": (tetra(LE, [(0, 1), (2, 3)]), "E_NO_FACES", "element face"),
    "faces under another name": (tetra(LE).replace(b"vertex_indices", b"corner_numbers"),
        "E_NO_FACES", "element face"),
    "ascii: header only": (text(V4 + F1, ""), "E_TRUNCATED", "vertex 0, line 10"),
    "ascii: cut in the last line": (text(V4 + F1, V4_TEXT + "3 0 1"), "E_TRUNCATED", "face 0"),
    "ascii: a billion vertices": (text(V4.replace("4", "1000000000") + F1, V4_TEXT + "3 0 1 2\n"),
        "E_FORMAT", "vertex 4, line 14"),
    "ascii: 1e19 faces": (text(V4 + F1.replace("face 1", "face 1" + "0" * 19),
        V4_TEXT + "3 0 1 2\n"), "E_TRUNCATED", "face 1"),
    "ascii: too few values": (cells("1 0"), "E_FORMAT", "vertex 1, line 11"),
    "ascii: too many values": (cells("1 0 0 0"), "E_FORMAT", "vertex 1, line 11"),
    "ascii: a record on two lines": (cells(face="3 0\n1 2"), "E_FORMAT", "face 0, line 14"),
    "ascii: list shorter than its count": (text(V4 + F1.replace("face 1", "face 2"),
        V4_TEXT + "4 0 1 2\n3 0 1 2\n"), "E_FORMAT", "face 0, line 14"),
    "ascii: fractional list count": (cells(face="3.0 0 1 2"), "E_FORMAT", "face 0, line 14"),
    **{f"ascii: coordinate {word[:9]}": (cells(f"1 {word} 0"), "E_FORMAT", "line 11")
        for word in ("zero", "0.5^2", "0,5", "1e-5x", "0.1234567890123456789_1", "1.0`1")},
    **{f"ascii: corner {word[:9]}": (cells(face=f"3 0 {word} 2"), "E_FORMAT", "line 14")
        for word in ("one", "1.5", "9" * 30)},
    "ascii: index too large": (cells(face="\n3 0 1 4"), "E_INDEX", "face 0, line 15"),
    "ascii: index negative": (cells(face="3 0 1 -1"), "E_INDEX", "line 14"),
    "ascii: nan": (cells("1 nan 0"), "E_NONFINITE", "vertex 1, line 11"),
    "ascii said, binary data": (tetra(LE).replace(LE.encode(), b"ascii"), "E_FORMAT", "line 2"),
    "ascii: word for a normal": (text(
        V4 + "property float nx\nproperty float ny\nproperty float nz\n" + F1,
        V4_TEXT.replace("\n", " 0 0 one\n") + "3 0 1 2\n"), "E_FORMAT", "line 13"),
}  # fmt: skip


def test_a_promise_of_gigabytes_allocates_next_to_nothing():
    promises = [row[0] for name, row in DAMAGED.items() if "billion" in name or "e19" in name]
    for is_traced in (False, True):
        if is_traced:  # all that is needed is loaded
            tracemalloc.start()
        for data in promises:
            with pytest.raises(MsalError):
                ply.read(data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


def test_an_element_without_properties_takes_no_room_however_large():
    head = "element nothing 18446744073709551615\n" + V4 + F1
    for data in (binary(head, tetra(LE)[-61:]), text(head, V4_TEXT + "3 0 1 2\n")):
        assert len(ply.read(data).faces) == 1


@pytest.mark.parametrize("extra", [[], [("near", "int", "uchar")]])
def test_whole_numbers_that_no_double_holds_are_replaced_and_kept(extra):
    wide = [("x", "float", ""), ("y", "uint64", ""), ("z", "int64", "")]
    rows = [
        [k % 2, 2**62 + 4097 * k, k // 2 - 2**53 - 1, *[[1] * k for _ in extra]] for k in range(4)
    ]
    vertex = Element("vertex", wide + extra, rows)
    data = plain_ply.written(Ply(LE, [vertex, Element("face", LIST, [[[0, 1, 2]], [[3, 2, 1]]])]))
    mesh = ply.read(data)
    vertices = mesh.vertices.copy()
    vertices[::2] += 65536.0
    output = rewritten(mesh, vertices)
    vertices[2, 2] = 2.0**63
    with pytest.raises(ContentError, match="new z of vertex 2"):
        mesh.replaced(vertices)
    vertices[2, 2] = mesh.vertices[2, 2] + 65536.0
    damaged = bytearray(output)
    # The last bit of the y that stays, in the second record.
    damaged[data.index(b"end_header\n") + 11 + 20 + len(extra) + 4] ^= 1
    with pytest.raises(InternalError):
        mesh.check(damaged, vertices)
