"""VTK's legacy and XML files."""

from __future__ import annotations

import base64
import lzma
import re
import zlib
from functools import partial

import meshio
import numpy as np
import pytest

from msal_cli.codecs import open_mesh, vtk_xml
from msal_cli.errors import MsalError
from tests.codecs.patching import changed_lines, patched, polygons_of, texts_between_numbers
from tests.shapes import grid, noisy, torus

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1]], dtype=float)
CODES = {"float": ">f4", "double": ">f8", "int": ">i4", "vtktypeint64": ">i8", "char": ">i1"}


class Writer:
    """A file put together piece by piece, as text or binary."""

    def __init__(self, is_text: bool, dataset: str, version: str = "4.2") -> None:
        word = "ASCII" if is_text else "BINARY"
        self.is_text = is_text
        self.data = (
            f"# vtk DataFile Version {version}\na title\n{word}\nDATASET {dataset}\n".encode()
        )

    def add(self, line: str, values=(), kind: str = "int") -> Writer:
        self.data += line.encode() + b"\n"
        values = np.asarray(values)
        if self.is_text:
            self.data += " ".join(map(str, values.reshape(-1).tolist())).encode()
        else:
            self.data += values.astype(CODES[kind]).tobytes()
        self.data += b"\n" * (len(values) > 0)
        return self

    def points(self, values=POINTS, kind: str = "double") -> Writer:
        return self.add(f"POINTS {len(values)} {kind}", values, kind)


def counted(rows) -> list[int]:
    return [number for row in rows for number in (len(row), *row)]


ENCODINGS = pytest.mark.parametrize("is_text", [True, False], ids=["ascii", "binary"])


@ENCODINGS
@pytest.mark.parametrize("kind", ["float", "double"])
def test_polygonal_data(is_text, kind):
    rows = [[0, 1, 3, 2], [0, 1, 5, 4], [1, 3, 5]]
    writer = Writer(is_text, "POLYDATA").points(kind=kind)
    writer.add("VERTICES 1 2", [1, 0]).add("LINES 1 3", [2, 0, 1])
    writer.add("POLYGONS 3 14", counted(rows))
    file, moved, output = patched(writer.data, "a.vtk")
    assert [one.tolist() for one in polygons_of(file)] == rows
    assert len(file.faces) == 5
    assert file.encoding == ("ascii" if is_text else "binary_big_endian")
    assert file.precision == {"float": "float32", "double": "float64"}[kind]
    if is_text:
        assert changed_lines(writer.data, output) == [5]
    else:
        head, points, rest = writer.data.partition(POINTS.astype(CODES[kind]).tobytes())
        assert points and output == head + moved.astype(CODES[kind]).tobytes() + rest


@ENCODINGS
def test_strips_become_triangles_that_face_one_way(is_text):
    writer = Writer(is_text, "POLYDATA", "3.0").points()
    writer.add("TRIANGLE_STRIPS 1 6", [5, 0, 1, 2, 3, 4])
    file, _, _ = patched(writer.data, "a.vtk")
    assert file.faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]
    assert file.warnings == ("1 triangle strip read as triangles, and kept",)


@ENCODINGS
@pytest.mark.parametrize("version", ["2.0", "5.1"])
def test_unstructured_grids_with_pixels_and_volumes(is_text, version):
    cells = [[0, 1, 2, 3], [0, 1, 3], [0, 1, 2, 4], [0, 1], [0, 1, 5, 4], [2, 3, 0, 1, 4]]
    types = [8, 5, 10, 3, 9, 7]
    writer = Writer(is_text, "UNSTRUCTURED_GRID", version).points()
    if version == "5.1":
        offsets = np.cumsum([0, *map(len, cells)])
        writer.add(f"CELLS {len(offsets)} {offsets[-1]}")
        writer.add("OFFSETS vtktypeint64", offsets, "vtktypeint64")
        writer.add("CONNECTIVITY vtktypeint64", np.concatenate(cells), "vtktypeint64")
    else:
        writer.add(f"CELLS {len(cells)} {len(counted(cells))}", counted(cells))
    writer.add(f"CELL_TYPES {len(types)}", types)
    file, _, _ = patched(writer.data, "a.vtk")
    assert [one.tolist() for one in polygons_of(file)] == [[0, 1, 3, 2], [0, 1, 3], *cells[4:]]
    assert file.warnings[0].startswith("other cells (1 tetrahedron), kept; their corners move")


@ENCODINGS
def test_attributes_stay_and_normals_follow(is_text):
    vertices, faces = grid()
    n, m = len(vertices), len(faces)
    writer = Writer(is_text, "POLYDATA", "5.1")
    writer.add("FIELD FieldData 1").add("TIME 1 1 double", [1.5], "double")
    writer.add("METADATA\nINFORMATION 0\n\n"[:-1]).points(vertices)
    writer.add("METADATA\nINFORMATION 1\nNAME L2_NORM LOCATION vtkDataArray\nDATA 2 0 1\n")
    writer.add(f"POLYGONS {m + 1} {3 * m}")
    writer.add("OFFSETS vtktypeint64", 3 * np.arange(m + 1), "vtktypeint64")
    writer.add("CONNECTIVITY vtktypeint64", faces, "vtktypeint64")
    writer.add(f"CELL_DATA {m}").add("SCALARS id int 1\nLOOKUP_TABLE default", np.arange(m))
    writer.add(f"POINT_DATA {n}").add("SCALARS h float\nLOOKUP_TABLE t", np.arange(n), "float")
    writer.add("LOOKUP_TABLE t 1", [1, 2, 3, 4], "char")
    writer.add("NORMALS up float", np.tile([0.0, 0.0, 2.0], (n, 1)), "float")
    writer.add("VECTORS v double", vertices, "double")
    writer.add("FIELD more 1").add(f"w 2 {n} float", np.zeros(2 * n), "float")
    turned = vertices[:, [2, 0, 1]]
    file, _, output = patched(writer.data, "a.vtk", np.r_[turned[:-1], vertices[-1:]])
    assert file.warnings == ()
    assert file.properties == (
        "field TIME", "cell.id", "point.h", "point.t", "point.up", "point.v", "point.w"
    )  # fmt: skip
    if is_text:
        lines = output.splitlines()
        row = lines[lines.index(b"NORMALS up float") + 1].split()
        assert np.allclose(np.array(row[:3], dtype=float), [1, 0, 0], atol=1e-6)
        assert texts_between_numbers(output) == texts_between_numbers(writer.data)
        assert len(changed_lines(writer.data, output)) == 2
    else:
        at = output.index(b"NORMALS up float\n") + len(b"NORMALS up float\n")
        assert np.frombuffer(output[at : at + 12], ">f4").tolist() == [1, 0, 0]
        assert output[at + 12 * n :] == writer.data[at + 12 * n :]


def grid_of(cells, types, points=POINTS) -> bytes:
    writer = Writer(True, "UNSTRUCTURED_GRID").points(points)
    writer.add(f"CELLS {len(cells)} {len(counted(cells))}", counted(cells))
    return writer.add(f"CELL_TYPES {len(types)}", types).data


TRIANGLE = grid_of([[0, 1, 2]], [5])

DAMAGED = {
    "points.vtk": (Writer(True, "UNSTRUCTURED_GRID").points().data, "E_NO_FACES"),
    "curved.vtk": (grid_of([[0, 1, 2, 3, 4, 5]], [22]), "E_UNSUPPORTED"),
    "index.vtk": (grid_of([[0, 1, 9]], [5]), "E_INDEX"),
    "nan.vtk": (grid_of([[0, 1, 2]], [5], POINTS * np.nan), "E_NONFINITE"),
    "corners.vtk": (grid_of([[0, 1, 2, 3]], [5]), "E_FORMAT"),
    "kinds.vtk": (grid_of([[0, 1, 2]], [5, 5]), "E_FORMAT"),
    "int.vtk": (TRIANGLE.replace(b"POINTS 6 double", b"POINTS 6 int"), "E_UNSUPPORTED"),
    "cells.vtk": (TRIANGLE.replace(b"CELLS 1 4", b"CELLS 2 4"), "E_FORMAT"),
    "many points.vtk": (TRIANGLE.replace(b"POINTS 6 ", b"POINTS 99999999999 "), "E_TRUNCATED"),
    "cut.vtk": (Writer(False, "POLYDATA").points().data[:-9], "E_TRUNCATED"),
    "many.vtk": (Writer(False, "POLYDATA").add("POINTS 99999999999 float").data, "E_TRUNCATED"),
    "image.vtk": (
        Writer(True, "STRUCTURED_POINTS").add("DIMENSIONS 2 2 1").data, "E_UNSUPPORTED",
    ),
    "no points.vtk": (
        Writer(True, "POLYDATA").add("POLYGONS 1 4", [3, 0, 1, 2]).data, "E_FORMAT",
    ),
}  # fmt: skip


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("kind", ["vtk", "vtk42", "vtu"])
def test_meshio_reads_what_became_of_its_files(tmp_path, kind, binary):
    vertices, faces = torus(12, 8)
    path = tmp_path / f"a.{kind[:3]}"
    more = {"binary": binary} if kind == "vtu" else {"binary": binary, "file_format": kind}
    meshio.Mesh(vertices, [("triangle", faces)]).write(path, **more)
    file = open_mesh(path.read_bytes(), path.name)
    assert np.allclose(file.vertices, vertices, rtol=0, atol=1e-10)
    assert np.array_equal(file.faces, faces)
    moved = noisy(file.vertices, 1)
    path.write_bytes(file.replaced(moved))
    judged = meshio.read(path)
    assert np.allclose(judged.points, moved, rtol=0, atol=1e-10)
    assert np.array_equal(judged.cells[0].data, faces)


VERTICES, FACES = torus(12, 8)
COMPRESSORS = {"zlib": "vtkZLibDataCompressor", "lzma": "vtkLZMADataCompressor"}
PACK = {"zlib": zlib.compress, "lzma": partial(lzma.compress, preset=0)}
KINDS = {"f4": "Float32", "f8": "Float64", "i8": "Int64", "i4": "Int32", "u1": "UInt8"}


class XmlWriter:
    """A file with arrays of one mode: ascii, base64, raw or appended base64; perhaps packed."""

    def __init__(self, mode="ascii", packed="", order="<", header="u8", block=480) -> None:
        self.mode, self.packed, self.order, self.header, self.block = (
            mode, packed, order, header, block
        )  # fmt: skip
        self.appended = b""

    def encoded(self, values: np.ndarray, is_raw: bool) -> bytes:
        content = values.astype(self.order + values.dtype.str[1:]).tobytes()
        if not self.packed:
            head = np.array([len(content)], self.order + self.header).tobytes()
            return head + content if is_raw else base64.b64encode(head + content)
        blocks = [content[at : at + self.block] for at in range(0, len(content), self.block)]
        packed = [PACK[self.packed](one) for one in blocks]
        counts = [len(blocks), self.block, len(content) % self.block, *map(len, packed)]
        head = np.array(counts, self.order + self.header).tobytes()
        if is_raw:
            return head + b"".join(packed)
        return base64.b64encode(head) + base64.b64encode(b"".join(packed))

    def array(self, name: str, values, extra: str = "", inner: bytes = b"") -> bytes:
        values = np.asarray(values)
        width = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
        head = f'<DataArray type="{KINDS[values.dtype.str[1:]]}" Name="{name}"{width}{extra}'
        if self.mode == "ascii":
            text = " ".join(map(str, values.reshape(-1).tolist()))
            return f'{head} format="ascii">\n{text}\n'.encode() + inner + b"</DataArray>\n"
        if self.mode == "base64":
            body = b"\n  " + self.encoded(values, False) + b"\n"
            return f'{head} format="binary">'.encode() + body + inner + b"</DataArray>\n"
        at = len(self.appended)
        self.appended += self.encoded(values, self.mode == "raw")
        return f'{head} format="appended" offset="{at}">'.encode() + inner + b"</DataArray>\n"

    def whole(self, kind: str, body: bytes) -> bytes:
        packed = f' compressor="{COMPRESSORS[self.packed]}"' if self.packed else ""
        order = "LittleEndian" if self.order == "<" else "BigEndian"
        header = {"u4": "UInt32", "u8": "UInt64"}[self.header]
        # What only arrays of bytes need may be left out.
        types = f' byte_order="{order}" header_type="{header}"' * (self.mode != "ascii")
        head = (
            f'<?xml version="1.0"?>\n<!-- kept -->\n<VTKFile type="{kind}"{types}{packed}>\n'
            f"<{kind}>\n"
        )
        tail = b""
        if self.appended:
            coding = {"raw": b"raw", "appended": b"base64"}[self.mode]
            tail = b'<AppendedData encoding="%s">\n_%s\n</AppendedData>\n' % (coding, self.appended)
        return head.encode() + body + f"</{kind}>\n".encode() + tail + b"</VTKFile>\n"


def vtu(writer: XmlWriter, vertices=VERTICES, faces=FACES, fields=(), real="f8") -> bytes:
    n = len(faces)
    pieces = [
        f'<Piece NumberOfPoints="{len(vertices)}" NumberOfCells="{n}">\n<PointData>'.encode(),
        *(writer.array(name, values) for name, values in fields),
        b'</PointData><CellData Normals="CN">' + writer.array("CN", np.ones((n, 3))),
        b"</CellData><Points>",
        writer.array("Points", vertices.astype(real)),
        b"</Points><Cells>",
        writer.array("connectivity", faces.reshape(-1).astype("i8")),
        writer.array("offsets", 3 * np.arange(1, n + 1)),
        writer.array("types", np.full(n, 5, "u1")),
        b"</Cells></Piece>\n",
    ]
    return writer.whole("UnstructuredGrid", b"".join(pieces))


WRITERS = {
    "ascii": {},
    "base64": {"mode": "base64"},
    "base64 of 32 bits": {"mode": "base64", "header": "u4"},
    "base64 zlib": {"mode": "base64", "packed": "zlib"},
    "base64 lzma": {"mode": "base64", "packed": "lzma", "header": "u4"},
    "raw": {"mode": "raw"},
    "raw, big-endian": {"mode": "raw", "order": ">"},
    "raw zlib": {"mode": "raw", "packed": "zlib"},
    "raw lzma, big-endian": {"mode": "raw", "packed": "lzma", "order": ">"},
    "appended base64": {"mode": "appended"},
    "appended base64 zlib": {"mode": "appended", "packed": "zlib"},
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_way_to_store_arrays(tmp_path, name):
    real = "f4" if name == "raw" else "f8"
    height = np.arange(len(VERTICES)) * 0.5
    data = vtu(XmlWriter(**WRITERS[name]), fields=[("height", height)], real=real)
    file, moved, output = patched(data, "a.vtu")
    assert np.array_equal(file.faces, FACES)
    assert file.precision == {"f4": "float32", "f8": "float64"}[real]
    assert file.properties == ("point.height", "cell.CN") and "of cells are" in file.warnings[0]
    assert output[: data.index(b"<Points>")] == data[: data.index(b"<Points>")] or "offset" in name
    if "lzma" in name or "big-endian" in name or name.startswith("appended"):
        return  # meshio does not read these, or not rightly
    (tmp_path / "b.vtu").write_bytes(output)
    judged = meshio.read(tmp_path / "b.vtu")
    assert np.abs(judged.points - moved).max() < 1e-6
    assert np.array_equal(judged.cells[0].data, FACES)
    assert np.array_equal(judged.point_data["height"], height)


@pytest.mark.parametrize("mode", ["raw", "appended"])
def test_offsets_of_arrays_behind_compressed_points_move(mode):
    writer = XmlWriter(mode, "zlib")
    flat = np.zeros_like(VERTICES)
    flat[:, :2] = np.arange(2 * len(flat)).reshape(-1, 2)
    data = vtu(writer, flat, fields=[("before", np.arange(5.0))])
    file = open_mesh(data, "a.vtu")
    output = bytes(file.replaced(noisy(file.vertices)))
    old, new = (np.array(re.findall(rb'offset="(\d+)"', d), dtype=int) for d in (data, output))
    longer = sum(map(len, map(str, new))) - sum(map(len, map(str, old)))
    growth = len(output) - len(data) - longer
    assert growth > 100 and (new - old).tolist() == [0, 0, 0, growth, growth, growth]


def test_bounds_that_vtk_writes_beside_points_follow():
    writer = XmlWriter()
    key = b'<InformationKey name="L2_NORM_RANGE" length="2"><Value index="0">1</Value>'
    key += b'<Value index="1">9</Value></InformationKey>'
    data = vtu(writer)
    array = writer.array("Points", VERTICES, ' RangeMin="1" RangeMax="9"', key)
    data = re.sub(
        rb"<Points>.*?</Points>", lambda _: b"<Points>" + array + b"</Points>", data, flags=re.S
    )
    _, moved, output = patched(data, "a.vtu")
    lengths = np.linalg.norm(moved, axis=1)
    found = re.search(rb'RangeMin="(.*?)" RangeMax="(.*?)"', output)
    assert np.allclose([float(one) for one in found.groups()], [lengths.min(), lengths.max()])
    found = re.findall(rb"<Value[^>]*>(.*?)</Value>", output)
    assert np.allclose([float(one) for one in found], [lengths.min(), lengths.max()])


def test_polygonal_data_in_pieces():
    writer = XmlWriter("base64", "zlib")
    pieces = []
    for shift in (0.0, 5.0):
        pieces += [
            b'<Piece NumberOfPoints="4" NumberOfPolys="1" NumberOfStrips="1"><Points>',
            writer.array("Points", np.array([[0, 0, shift], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])),
            b"</Points><Strips>",
            writer.array("connectivity", np.array([0, 1, 3, 2])),
            writer.array("offsets", np.array([4])),
            b"</Strips><Polys>",
            writer.array("connectivity", np.array([0, 1, 2, 3], "i4")),
            writer.array("offsets", np.array([4], "i4")),
            b"</Polys></Piece>",
        ]
    file, _, _ = patched(writer.whole("PolyData", b"".join(pieces)), "a.vtp")
    assert file.faces.tolist()[:4] == [[0, 1, 3], [3, 1, 2], [0, 1, 2], [0, 2, 3]]
    assert file.faces.tolist()[4] == [4, 5, 7]


def test_a_file_that_expands_to_far_more_is_refused():
    content = bytes(1 << 22)
    packed = zlib.compress(content)
    head = np.array([1000, 1 << 22, 0, *[len(packed)] * 1000], "<u8").tobytes()
    data = vtu(XmlWriter("base64", "zlib"))
    bomb = base64.b64encode(head) + base64.b64encode(packed) * 1000
    at = data.index(b"<Points>")
    inside = data.index(b'format="binary">', at) + len(b'format="binary">')
    data = data[:inside] + bomb + data[data.index(b"</DataArray>", inside) :]
    with pytest.raises(MsalError, match="expands to 4,194,304,000") as caught:
        open_mesh(data, "a.vtu")
    assert caught.value.code == "E_TOO_LARGE"


def test_many_pieces_that_share_one_array_are_refused(monkeypatch):
    monkeypatch.setattr(vtk_xml, "ALWAYS_EXPANDED", 1 << 20)
    monkeypatch.setattr(vtk_xml, "MAX_RATIO", 4)
    writer = XmlWriter("raw")
    points = writer.array("Points", np.zeros((1 << 12, 3)))
    piece = b'<Piece NumberOfPoints="4096"><Points>' + points + b"</Points></Piece>"
    data = writer.whole("PolyData", piece * 100)
    with pytest.raises(MsalError, match="and all to") as caught:
        open_mesh(data, "a.vtp")
    assert caught.value.code == "E_TOO_LARGE"


DOCTYPE = b'<!DOCTYPE a [<!ENTITY b "c"><!ENTITY d "&b;&b;">]>'
ZLIB = vtu(XmlWriter("base64", "zlib"))
DAMAGED_XML = {
    "xml.vtu": (b"<?xml version='1.0'?><VTKFile type='UnstructuredGrid'></VTKFile>", "E_NO_FACES"),
    "cut.vtu": (vtu(XmlWriter("raw"))[:-2000], "E_TRUNCATED"),
    "cut in an array.vtu": (ZLIB[: len(ZLIB) // 2], "E_TRUNCATED"),
    "cut in a tag.vtu": (ZLIB[:-3], "E_TRUNCATED"),
    "twice.vtu": (
        vtu(XmlWriter("raw")).replace(b"NumberOfPoints=", b'NumberOfPoints="9" x='), "E_FORMAT",
    ),
    "LZ4.vtu": (ZLIB.replace(b"vtkZLib", b"vtkLZ4"), "E_UNSUPPORTED"),
    "base64.vtu": (ZLIB.replace(b'"binary">\n  ', b'"binary">\n  A'), "E_TRUNCATED"),
    "lattice.vtu": (vtu(XmlWriter()).replace(b"Grid", b"Lattice"), "E_UNSUPPORTED"),
    "no XML.vtu": (vtu(XmlWriter()).replace(b"<Cells>", b"<Cells><"), "E_FORMAT"),
    "index.vtu": (vtu(XmlWriter(), faces=FACES + 5), "E_INDEX"),
    "polygons.vtu": (XmlWriter().whole("PolyData", b""), "E_FORMAT"),
    "entities.vtu": (DOCTYPE + vtu(XmlWriter())[22:], "E_UNSUPPORTED"),
}  # fmt: skip
