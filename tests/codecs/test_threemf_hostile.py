"""Damaged and hostile 3MF files: each its error, its place, and little memory."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile

import pytest

from msal_cli.codecs import open_mesh, threemf, threemf_model
from msal_cli.errors import MsalError
from tests.codecs.plain_3mf import MODEL, mesh, model, package, rels, shape
from tests.codecs.test_threemf import CUBE, VERTICES, parts_of_equal_numbers, simple


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
    for count in (10, 11):
        data = package(model(shape(1, CUBE), '<item objectid="1"/>' * count))
        if count == 10:
            assert len(open_mesh(data, "a.3mf").faces) == 12
            continue
        with pytest.raises(MsalError, match="more than 10 components and items"):
            open_mesh(data, "a.3mf")
