"""3MF: numbers of positions replaced in the XML inside the archive, all else kept."""

from __future__ import annotations

import io
import re
import shutil
import struct
import subprocess
import zipfile
import zlib

import numpy as np
import pytest

from msal_cli.codecs import open_mesh, threemf
from msal_cli.codecs.conversion import convert
from msal_cli.codecs.zip_archive import Archive
from msal_cli.errors import InternalError, UnsupportedError
from tests.codecs import plain_3mf
from tests.codecs.plain_3mf import MODEL, mesh, model, package, rels, shape
from tests.shapes import cube, noisy, torus

VERTICES, FACES = cube()
CUBE = mesh([[f"{x:.3f}" for x in row] for row in VERTICES], FACES)
PICTURE = bytes(range(256))


def simple(**options) -> bytes:
    """A cube with a thumbnail and settings of a slicer."""
    more = {"Metadata/plate.png": PICTURE, "Metadata/Slic3r_PE.config": b"; infill = 15%\n" * 50}
    return package(model(shape(1, CUBE)), more, **options)


def moved_corner(file: threemf.ThreeMfFile) -> np.ndarray:
    vertices = file.vertices.copy()
    vertices[7] += [0.25, 0.5, -0.125]
    return vertices


def texts(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])
@pytest.mark.parametrize("streamed", [False, True])
def test_only_the_numbers_of_moved_vertices_change(method, streamed, tmp_path):
    data = simple(method=method, streamed=streamed)
    file = threemf.ThreeMfFile(data)
    assert np.array_equal(file.vertices, VERTICES) and np.array_equal(file.faces, FACES)
    assert file.replaced(file.vertices.copy()) is data
    vertices = moved_corner(file)
    output = file.replaced(vertices)
    file.check(output, vertices)
    before, after = texts(data), texts(output)
    assert list(before) == list(after)
    old, new = before.pop(MODEL), after.pop(MODEL)
    assert before == after
    # 0.001 is finer than 1e-7 of the cube, so that there are more decimals than the file has.
    wanted = b'x="1.2500000" y="1.5000000" z="0.8750000"'
    assert new == old.replace(b'x="1.000" y="1.000" z="1.000"', wanted)
    # All that says how members were packed is as it was, but for sizes, checksums and offsets.
    for was, now in zip(
        *(zipfile.ZipFile(io.BytesIO(one)).infolist() for one in (data, output)), strict=True
    ):
        for word in (
            "filename", "date_time", "compress_type", "comment", "extra", "flag_bits",
            "create_system", "create_version", "extract_version", "external_attr",
        ):  # fmt: skip
            assert getattr(was, word) == getattr(now, word), word
        if was.filename != MODEL:
            assert was.compress_size == now.compress_size
            head = slice(was.header_offset, was.header_offset + 30 + was.compress_size)
            there = slice(now.header_offset, now.header_offset + 30 + now.compress_size)
            assert data[head] == output[there]
    assert output.endswith(b"kept")
    assert np.array_equal(open_mesh(output, "a.3mf").vertices, vertices)
    if unzip := shutil.which("unzip"):
        (tmp_path / "a.3mf").write_bytes(output)
        done = subprocess.run([unzip, "-t", tmp_path / "a.3mf"], capture_output=True, check=False)
        assert done.returncode == 0, done.stdout


def test_sizes_in_the_header_and_behind_the_data_both_change():
    data = bytearray(simple(streamed=True))
    info = zipfile.ZipFile(io.BytesIO(data)).getinfo(MODEL)
    numbers = info.CRC, info.compress_size, info.file_size
    struct.pack_into("<3L", data, info.header_offset + 14, *numbers)
    file = threemf.ThreeMfFile(bytes(data))
    output = file.replaced(moved_corner(file))
    now = zipfile.ZipFile(io.BytesIO(output)).getinfo(MODEL)
    expected = now.CRC, now.compress_size, now.file_size
    assert expected != numbers
    assert struct.unpack_from("<3L", output, now.header_offset + 14) == expected
    at = now.header_offset + 30 + len(MODEL) + now.compress_size
    assert output[at : at + 16] == b"PK\x07\x08" + struct.pack("<3L", *expected)


def test_members_with_wide_sizes_and_gaps_between_them():
    # As miniz and some others write them: ZIP64 fields although the sizes would fit without.
    content = model(shape(1, CUBE))
    pieces, directory = [], []
    for name, text in (("_rels/.rels", plain_3mf.ROOT), (MODEL, content), ("z.bin", b"zz")):
        packed = zlib.compress(text)[2:-4]
        raw, at = name.encode(), sum(map(len, pieces))
        numbers = struct.pack("<QQ", len(text), len(packed))
        crc = zlib.crc32(text)
        both = struct.pack("<5H L", 45, 0, 8, 0x6000, 0x5A21, crc) + b"\xff" * 8
        local = b"PK\x03\x04" + both + struct.pack("<2H", len(raw), 20) + raw
        pieces += [local + struct.pack("<2H", 1, 16) + numbers + packed, b"\0" * 5]
        entry = b"PK\x01\x02" + struct.pack("<H", 45) + both
        entry += struct.pack("<5H2L", len(raw), 28, 0, 0, 0, 0, 0xFFFFFFFF) + raw
        directory.append(entry + struct.pack("<2H", 1, 24) + numbers + struct.pack("<Q", at))
    body, central = b"".join(pieces), b"".join(directory)
    end_64 = b"PK\x06\x06" + struct.pack(
        "<Q2H2L4Q", 44, 45, 45, 0, 0, 3, 3, len(central), len(body)
    )
    locator = b"PK\x06\x07" + struct.pack("<LQL", 0, len(body + central), 1)
    end = b"PK\x05\x06" + struct.pack("<4H2LH", 0, 0, 0xFFFF, 0xFFFF, 2**32 - 1, 2**32 - 1, 0)
    data = body + central + end_64 + locator + end
    assert texts(data)[MODEL] == content
    file = threemf.ThreeMfFile(data)
    vertices = moved_corner(file)
    output = file.replaced(vertices)
    file.check(output, vertices)
    assert texts(output)["z.bin"] == b"zz"
    assert np.array_equal(open_mesh(output, "a.3mf").vertices, vertices)


def parts_of_equal_numbers() -> bytes:
    """Two parts whose objects have the same number, put together by the root's components."""
    vertices, faces = torus(8, 6)
    root = model(
        shape(
            7,
            '<components><component objectid="1" p:path="/3D/Objects/a.model"/>'
            '<component objectid="1" p:path="/3D/Objects/b.model" '
            'transform="0 1 0 -1 0 0 0 0 1 10 0 0"/></components>',
        ),
        '<item objectid="7" transform="1 0 0 0 1 0 0 0 1 0 0 5"/>',
        'requiredextensions="p"',
    )
    other = model(shape(1, mesh(vertices.round(4).tolist(), faces)), "")
    return package(
        {MODEL: root, "3D/Objects/a.model": model(shape(1, CUBE), ""), "3D/Objects/b.model": other}
    )


def test_parts_of_equal_numbers_stay_apart():
    trimesh = pytest.importorskip("trimesh")
    data = parts_of_equal_numbers()
    file = threemf.ThreeMfFile(data)
    assert len(file.faces) == 12 + 96
    assert "2 parts" in file.properties
    # Placed as the build says: turned, shifted, and both lifted.
    own = torus(8, 6)[0].round(4)
    assert np.allclose(file.vertices[:8], VERTICES + [0, 0, 5])
    assert np.allclose(file.vertices[8:], own[:, [1, 0, 2]] * [-1, 1, 1] + [10, 0, 5])
    vertices = noisy(file.vertices, 1)
    vertices[3:20] = file.vertices[3:20]
    output = file.replaced(vertices)
    file.check(output, vertices)
    assert np.allclose(threemf.ThreeMfFile(output).vertices, vertices, atol=1e-6)
    new, old = texts(output), texts(data)
    assert new[MODEL] == old[MODEL]
    stay = re.findall(rb"<vertex[^>]*>", old["3D/Objects/b.model"])[:12]
    assert stay == re.findall(rb"<vertex[^>]*>", new["3D/Objects/b.model"])[:12]
    pytest.importorskip("lxml"), pytest.importorskip("networkx")
    # trimesh merges parts of equal numbers; given apart it judges what was written.
    for name in ("3D/Objects/a.model", "3D/Objects/b.model"):
        content = new[name].replace(b"<build></build>", b'<build><item objectid="1"/></build>')
        scene = trimesh.load_scene(io.BytesIO(package(content)), file_type="3mf", process=False)
        (part,) = scene.geometry.values()
        expected = {
            len(mesh.vertices): mesh.vertices
            for model in threemf.ThreeMfFile(output).package.models.values()
            for mesh in model.meshes.values()
        }
        assert np.allclose(part.vertices, expected[len(part.vertices)])


def test_components_that_use_each_other_come_to_an_end():
    # Doubled at each of 60 levels, and a circle at the end.
    nested = "".join(
        shape(
            k,
            f'<components><component objectid="{k + 1}"/><component objectid="{k + 1}"/>'
            "</components>",
        )
        for k in range(1, 60)
    )
    last = '<components><component objectid="99"/><component objectid="1"/></components>'
    file = threemf.ThreeMfFile(package(model(nested + shape(60, last) + shape(99, CUBE))))
    assert len(file.faces) == 12


OTHER_FORMS = {
    "single quotes": mesh(VERTICES, FACES, "<vertex x='{0}' y='{1}' z='{2}'/>"),
    "another order": mesh(VERTICES, FACES, '<vertex z="{2}" x="{0}" y = "{1}" />'),
    "with end tags": mesh(VERTICES, FACES, '<vertex x="{0}" y="{1}" z="{2}"></vertex>'),
    "more attributes": mesh(VERTICES, FACES, '<vertex x="{0}" p:UUID="é" y="{1}" z="{2}"/>'),
    "over lines": mesh(VERTICES, FACES, '<vertex\n x="{0}"\n\ty="{1}" z=" {2} "\n/>'),
    "comments": mesh(VERTICES, FACES, '<!--<vertices>--><vertex x="{0}" y="{1}" z="{2}"/>'),
    "materials": mesh(
        VERTICES, FACES, triangle='<triangle v1="{0}" v2="{1}" v3="{2}" pid="5" p1="0"/>'
    ),
    "corners elsewhere": mesh(
        VERTICES, FACES, triangle='<triangle pid="9" v3="{2}" v1="{0}" v2="{1}"/>'
    ),
    "exponents": mesh([[f"{x:+.2e}" for x in row] for row in VERTICES], FACES),
    "in a comment": "<!-- <vertices> <vertex x=\"1\" y=\"1\" z=\"1\"/> </vertices> -->" + CUBE,
}  # fmt: skip


@pytest.mark.parametrize("streamed", [False, True])
def test_the_check_sees_every_byte_of_the_archive(streamed):
    """Times, flags, sizes in local headers and behind the data: what other readers may go by."""
    file = threemf.ThreeMfFile(simple(streamed=streamed))
    vertices = moved_corner(file)
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    archive = Archive(output)
    packed = archive.find(MODEL)
    # Compressed data have a checksum of their own, and bits that mean nothing.
    begin = len(output) - len(output[output.index(archive.packed(packed)) :])
    for at in (*range(begin), *range(begin + packed.compress_size, len(output))):
        wrong = bytearray(output)
        wrong[at] ^= 1
        with pytest.raises(InternalError):
            file.check(wrong, vertices)


@pytest.mark.parametrize("name", OTHER_FORMS)
def test_every_form_of_a_mesh(name):
    data = package(model(shape(1, OTHER_FORMS[name])))
    file = threemf.ThreeMfFile(data)
    assert np.array_equal(file.vertices, VERTICES)
    assert np.array_equal(file.faces, FACES)
    vertices = moved_corner(file)
    output = file.replaced(vertices)
    file.check(output, vertices)
    again = threemf.ThreeMfFile(output)
    assert np.array_equal(again.vertices, vertices)
    # Everything else of the XML is there: without the numbers the texts are equal.
    plain = [
        re.sub(rb"(?:[-+]|&#43;)?[0-9][-+.0-9e]*", b"", texts(one)[MODEL]) for one in (data, output)
    ]
    assert plain[0] == plain[1]


@pytest.mark.parametrize(
    ("attributes", "inside", "more", "what"),
    [
        ('xmlns:s="http://schemas.microsoft.com/3dmanufacturing/slice/2015/07"',
         shape(1, CUBE, ' s:slicestackid="3"'), {}, "slices"),
        ('xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"',
         shape(1, CUBE.replace("</mesh>", "<b:beamlattice/></mesh>")), {}, "a beam lattice"),
        ("", shape(1, CUBE), {"_rels/.rels": plain_3mf.ROOT.replace(
            b"<Relationship ", rels(("/o", "http://schemas.openxmlformats.org/package/2006/"
            "relationships/digital-signature/origin")).partition(b"<Relationship ")[1]
            + b'Target="/o" Id="s" Type="http://schemas.openxmlformats.org/package/2006/'
            b'relationships/digital-signature/origin"/><Relationship ', 1)}, "signature"),
    ],
)  # fmt: skip
def test_what_would_no_longer_fit_is_read_and_not_changed(attributes, inside, more, what):
    data = package(model(inside, attributes=attributes), more)
    file = threemf.ThreeMfFile(data)
    assert file.replaced(file.vertices.copy()) is data
    with pytest.raises(UnsupportedError, match=what):
        file.replaced(moved_corner(file))
    assert len(convert(file, VERTICES, "stl")[0]) == 84 + 50 * 12
