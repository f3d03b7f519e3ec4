"""VTK's XML files."""

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
from tests.codecs.patching import patched
from tests.shapes import noisy, torus

VERTICES, FACES = torus(12, 8)
COMPRESSORS = {"zlib": "vtkZLibDataCompressor", "lzma": "vtkLZMADataCompressor"}
PACK = {"zlib": zlib.compress, "lzma": partial(lzma.compress, preset=0)}
KINDS = {"f4": "Float32", "f8": "Float64", "i8": "Int64", "i4": "Int32", "u1": "UInt8"}


class Writer:
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
        head = (
            f'<?xml version="1.0"?>\n<!-- kept -->\n<VTKFile type="{kind}" byte_order="{order}" '
            f'header_type="{header}"{packed}>\n<{kind}>\n'
        )
        tail = b""
        if self.appended:
            coding = {"raw": b"raw", "appended": b"base64"}[self.mode]
            tail = b'<AppendedData encoding="%s">\n_%s\n</AppendedData>\n' % (coding, self.appended)
        return head.encode() + body + f"</{kind}>\n".encode() + tail + b"</VTKFile>\n"


def vtu(writer: Writer, vertices=VERTICES, faces=FACES, fields=(), real="f8") -> bytes:
    n = len(faces)
    pieces = [
        f'<Piece NumberOfPoints="{len(vertices)}" NumberOfCells="{n}">\n<PointData>'.encode(),
        *(writer.array(name, values) for name, values in fields),
        b"</PointData><Points>",
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
    data = vtu(Writer(**WRITERS[name]), fields=[("height", height)], real=real)
    file, moved, output = patched(data, "a.vtu")
    assert np.array_equal(file.faces, FACES)
    assert file.precision == {"f4": "float32", "f8": "float64"}[real]
    assert file.properties == ("point.height",)
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
    writer = Writer(mode, "zlib")
    flat = np.zeros_like(VERTICES)
    flat[:, :2] = np.arange(2 * len(flat)).reshape(-1, 2)
    data = vtu(writer, flat, fields=[("before", np.arange(5.0))])
    file = open_mesh(data, "a.vtu")
    output = bytes(file.replaced(noisy(file.vertices)))
    old, new = ([int(one) for one in re.findall(rb'offset="(\d+)"', d)] for d in (data, output))
    assert new[:2] == old[:2]
    growth = len(output) - len(data) - sum(len(str(n)) - len(str(o)) for n, o in zip(new, old))  # noqa: B905
    assert [n - o for n, o in zip(new[2:], old[2:], strict=True)] == [growth] * 3
    assert growth > 100


def test_bounds_that_vtk_writes_beside_points_follow():
    writer = Writer()
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
    writer = Writer("base64", "zlib")
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
    data = vtu(Writer("base64", "zlib"))
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
    writer = Writer("raw")
    points = writer.array("Points", np.zeros((1 << 12, 3)))
    piece = b'<Piece NumberOfPoints="4096"><Points>' + points + b"</Points></Piece>"
    data = writer.whole("PolyData", piece * 100)
    with pytest.raises(MsalError, match="and all to") as caught:
        open_mesh(data, "a.vtp")
    assert caught.value.code == "E_TOO_LARGE"


DOCTYPE = b'<!DOCTYPE a [<!ENTITY b "c"><!ENTITY d "&b;&b;">]>'
ZLIB = vtu(Writer("base64", "zlib"))
DAMAGED = {
    "xml.vtu": (b"<?xml version='1.0'?><VTKFile type='UnstructuredGrid'></VTKFile>", "E_FORMAT"),
    "cut.vtu": (vtu(Writer("raw"))[:-2000], "E_TRUNCATED"),
    "cut in an array.vtu": (ZLIB[: len(ZLIB) // 2], "E_TRUNCATED"),
    "cut in a tag.vtu": (ZLIB[:-3], "E_TRUNCATED"),
    "twice.vtu": (
        vtu(Writer("raw")).replace(b"NumberOfPoints=", b'NumberOfPoints="9" x='), "E_FORMAT",
    ),
    "LZ4.vtu": (ZLIB.replace(b"vtkZLib", b"vtkLZ4"), "E_UNSUPPORTED"),
    "base64.vtu": (ZLIB.replace(b'"binary">\n  ', b'"binary">\n  A'), "E_TRUNCATED"),
    "lattice.vtu": (vtu(Writer()).replace(b"Grid", b"Lattice"), "E_UNSUPPORTED"),
    "no XML.vtu": (vtu(Writer()).replace(b"<Cells>", b"<Cells><"), "E_FORMAT"),
    "index.vtu": (vtu(Writer(), faces=FACES + 5), "E_INDEX"),
    "polygons.vtu": (Writer().whole("PolyData", b""), "E_FORMAT"),
    "entities.vtu": (DOCTYPE + vtu(Writer())[22:], "E_UNSUPPORTED"),
}  # fmt: skip
