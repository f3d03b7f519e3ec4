"""3MF: numbers replaced in the XML inside the archive, all else kept; hostile archives."""

import io
import re
import shutil
import struct
import subprocess
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest

from msal_cli.codecs import open_mesh, threemf, threemf_model
from msal_cli.codecs.conversion import convert
from msal_cli.codecs.zip_archive import Archive
from msal_cli.errors import InternalError, MsalError, UnsupportedError
from tests.codecs import plain_3mf
from tests.codecs.patching import rewritten
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
    output = rewritten(file, vertices)
    before, after = texts(data), texts(output)
    assert list(before) == list(after)
    old, new = before.pop(MODEL), after.pop(MODEL)
    assert before == after
    # 0.001 is finer than 1e-7 of the cube, so that there are more decimals than the file has.
    wanted = b'x="1.2500000" y="1.5000000" z="0.8750000"'
    assert new == old.replace(b'x="1.000" y="1.000" z="1.000"', wanted)
    # All that says how members were packed is as it was, but for sizes, checksums and offsets.
    changing = ("header_offset", "CRC", "compress_size", "file_size", "_end_offset")
    infos = (zipfile.ZipFile(io.BytesIO(one)).infolist() for one in (data, output))
    for was, now in zip(*infos, strict=True):
        for word in set(zipfile.ZipInfo.__slots__) - set(changing):
            assert getattr(was, word, None) == getattr(now, word, None), word
        if was.filename != MODEL:
            head, there = (slice(one.header_offset, one.header_offset + 30 + was.compress_size)
                           for one in (was, now))  # fmt: skip
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
    output = rewritten(file, vertices)
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
            'transform="0 1 0 1 0 0 0 0 1 10 0 0"/></components>',
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
    # Placed as the build says: mirrored, so that the corners turn, shifted, and both lifted.
    own = torus(8, 6)[0].round(4)
    assert np.allclose(file.vertices[:8], VERTICES + [0, 0, 5])
    assert np.allclose(file.vertices[8:], own[:, [1, 0, 2]] + [10, 0, 5])
    assert np.linalg.det(file.vertices[file.faces[12:]]).sum() > 0.0
    vertices = noisy(file.vertices, 1)
    vertices[3:20] = file.vertices[3:20]
    output = rewritten(file, vertices)
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
            for model in threemf.ThreeMfFile(output).models.values()
            for mesh in model.meshes.values()
        }
        assert np.allclose(part.vertices, expected[len(part.vertices)])


def test_components_that_use_each_other_come_to_an_end():
    # Doubled at each of 60 levels, and a circle at the end.
    def both(k, i, j):
        pair = f'<component objectid="{i}"/><component objectid="{j}"/>'
        return shape(k, f"<components>{pair}</components>")

    nested = "".join(both(k, k + 1, k + 1) for k in range(1, 60))
    file = threemf.ThreeMfFile(package(model(nested + both(60, 99, 1) + shape(99, CUBE))))
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
    output = rewritten(file, vertices)
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
    output = rewritten(file, vertices)
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


def edited(old: str, new: str, **more) -> bytes:
    text = model(shape(1, CUBE))
    assert old.encode() in text
    return package(text.replace(old.encode(), new.encode()), **more)


def with_flag(data: bytes, name: str, flag: int) -> bytes:
    """An archive with a flag set at one member, in both of its headers."""
    out = bytearray(data)
    for info in zipfile.ZipFile(io.BytesIO(data)).infolist():
        if info.filename == name:
            out[info.header_offset + 6] |= flag
    at = out.find(b"PK\x01\x02")
    while at >= 0:
        if out[at + 46 :].startswith(name.encode()):
            out[at + 8] |= flag
        at = out.find(b"PK\x01\x02", at + 4)
    return bytes(out)


def overlapping() -> bytes:
    """The model's entry in the directory leads to the local header of the member before it."""
    data = bytearray(simple())
    entries = zipfile.ZipFile(io.BytesIO(bytes(data))).infolist()
    last = data.rfind(b"PK\x01\x02")
    struct.pack_into("<L", data, last + 42, entries[2].header_offset)
    return bytes(data)


def named_twice() -> bytes:
    file = io.BytesIO(simple())
    with pytest.warns(UserWarning), zipfile.ZipFile(file, "a") as archive:
        archive.writestr(MODEL, b"<model/>")
    return file.getvalue()


def with_local_size(data: bytes, size: int) -> bytes:
    """An archive whose model has another size in its local header."""
    out = bytearray(data)
    info = zipfile.ZipFile(io.BytesIO(data)).getinfo(MODEL)
    struct.pack_into("<L", out, info.header_offset + 22, size)
    return bytes(out)


def with_version(version: int) -> bytes:
    """An archive whose last member needs another version of the zip format, in tenths."""
    data = bytearray(simple())
    data[data.rfind(b"PK\x01\x02") + 6] = version
    return bytes(data)


WHOLE = simple()
DOCTYPE = '<!DOCTYPE model [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;">]><!-- kept'
SECURE = "http://schemas.microsoft.com/3dmanufacturing/securecontent/2019/04"
DAMAGED = {
    "only a magic": (b"PK\x03\x04", "E_TRUNCATED"),
    "not a zip": (b"<model/>" + bytes(100), "E_FORMAT"),
    "cut": (WHOLE[:-1], "E_TRUNCATED"),
    "empty archive": (b"PK\x05\x06" + bytes(18), "E_FORMAT"),
    "several disks": (WHOLE[:-22] + WHOLE[-22:-18] + b"\1" + WHOLE[-17:], "E_UNSUPPORTED"),
    "an encrypted model": (with_flag(WHOLE, MODEL, 1), "E_UNSUPPORTED"),
    "an unknown compression": (simple(method=zipfile.ZIP_BZIP2), "E_UNSUPPORTED"),
    "a newer zip format": (with_version(255), "E_UNSUPPORTED"),
    "overlapping members": (overlapping(), "E_FORMAT"),
    "a local header that says something else": (with_local_size(WHOLE, 77), "E_FORMAT"),
    "a name twice": (named_twice(), "E_FORMAT"),
    "no relationships": (package(model(shape(1, CUBE)), {"_rels/.rels": b"<a/>"}), "E_FORMAT"),
    "no such model": (package({"3D/other.model": model(shape(1, CUBE))}), "E_FORMAT"),
    "encrypted by the standard": (
        package(model(shape(1, CUBE)), {"_rels/.rels": rels(
            ("/k", "http://schemas.microsoft.com/3dmanufacturing/2019/04/keystore"))}),
        "E_UNSUPPORTED",
    ),
    "a model that is cut": (package(model(shape(1, CUBE))[:-400]), "E_TRUNCATED"),
    "UTF-16": (package("<model/>".encode("utf-16")), "E_UNSUPPORTED"),
    "an unknown encoding": (edited("UTF-8", "UTF5.."), "E_UNSUPPORTED"),
    "no UTF-8": (package(model(shape(1, CUBE)).replace("é".encode(), b"\xff")), "E_FORMAT"),
    "entities": (edited("<!-- kept", DOCTYPE), "E_UNSUPPORTED"),
    "a required extension": (
        edited("<model ", f'<model xmlns:sc="{SECURE}" requiredextensions="sc" '), "E_UNSUPPORTED",
    ),
    "an unknown unit": (edited("<model ", '<model unit="furlong" '), "E_FORMAT"),
    "a word for a number": (edited('x="1.000" y="1.000"', 'x="one" y="1.000"'), "E_FORMAT"),
    "no y": (edited('x="1.000" y="1.000"', 'x="1.000"'), "E_FORMAT"),
    "an open tag at the end": (edited("</vertices>", '<vertex x="1"</vertices>'), "E_FORMAT"),
    "NaN": (edited('x="1.000" y="1.000"', 'x="NaN" y="1.000"'), "E_NONFINITE"),
    "an index beyond": (edited('v1="0"', 'v1="8"'), "E_INDEX"),
    "a negative index": (edited('v1="0"', 'v1="-1"'), "E_FORMAT"),
    "no third corner": (edited(' v3="', ' v4="'), "E_FORMAT"),
    "two objects of one number": (package(model(shape(1, CUBE) * 2)), "E_FORMAT"),
    "two meshes": (package(model(shape(1, CUBE * 2))), "E_FORMAT"),
    "two lists": (edited("<triangles>", "<vertices></vertices><triangles>"), "E_FORMAT"),
    "an item of nothing": (edited('objectid="1"', 'objectid="2"'), "E_FORMAT"),
    "a part that is missing": (edited('objectid="1"', 'objectid="1" p:path="/3D/b.model"'),
                               "E_FORMAT"),
    "a transform of eleven": (
        edited('objectid="1"', 'objectid="1" transform="1 0 0 0 1 0 0 0 1 0 0"'), "E_FORMAT",
    ),
    "no triangles": (package(model(shape(1, mesh(VERTICES, [])))), "E_NO_FACES"),
    "very deep": (package(model("<a>" * 101 + shape(1, CUBE) + "</a>" * 101)), "E_TOO_LARGE"),
    "long relationships": (
        package(model(shape(1, CUBE)), {"_rels/.rels": b"<!--" + b"0" * 2_000_000}),
        "E_TOO_LARGE",
    ),
    "a bomb": (package(model("<!--" + "0" * 40_000_000 + "-->" + shape(1, CUBE))), "E_TOO_LARGE"),
}  # fmt: skip


def test_a_bomb_takes_no_memory():
    data, _ = DAMAGED["a bomb"]
    tracemalloc.start()
    with pytest.raises(MsalError, match=r"^it expands to"):
        open_mesh(data, "a.3mf")
    # A declared size that is not true is not believed, and not gone beyond either.
    lie = bytearray(data)
    for head, place in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        at = lie.find(head)
        while at >= 0:
            if struct.unpack_from("<L", lie, at + place)[0] > 40_000_000:
                struct.pack_into("<L", lie, at + place, 1000)
            at = lie.find(head, at + 4)
    with pytest.raises(MsalError, match="a checksum is wrong"):
        open_mesh(bytes(lie), "a.3mf")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2_000_000


def test_parts_share_one_room(monkeypatch):
    monkeypatch.setattr(threemf, "ALWAYS_EXPANDED", 3_000)
    monkeypatch.setattr(threemf, "LARGEST_RATIO", 0)
    open_mesh(package(model(shape(1, CUBE))), "a.3mf")
    with pytest.raises(MsalError, match="there is room"):
        open_mesh(parts_of_equal_numbers(), "a.3mf")


def test_very_many_items(monkeypatch):
    monkeypatch.setattr(threemf_model, "MAX_USES", 10)
    ten, eleven = (package(model(shape(1, CUBE), '<item objectid="1"/>' * n)) for n in (10, 11))
    assert len(open_mesh(ten, "a.3mf").faces) == 12
    with pytest.raises(MsalError, match="more than 10 components and items"):
        open_mesh(eleven, "a.3mf")
