"""Damaged files by the ten thousand, damaged where it hurts; every one can be made again.

    python -m tests.fuzz.mutants                  30,000 of every format
    python -m tests.fuzz.mutants ply 100000       more of one
    python -m tests.fuzz.mutants ply 1 4711       number 4711 alone

Mutant number k of a format depends on nothing but its seeds and k.  It is made of a good file by
one to four changes: bits, bytes, pieces cut out, doubled, moved or taken from another file, lines
exchanged, numbers made extreme; and by changes of the header, of entries of JSON, or of the content
within gzip, around which all lengths and checksums are right.
"""

import base64
import copy
import gzip
import io
import json
import random
import re
import struct
import sys
import time
import warnings
import zipfile
import zlib
from collections import Counter
from typing import Any

from tests.fuzz.seeds import seeds
from tests.fuzz.survival import FORMATS, outcome

NUMBERS = [
    b"0", b"-0", b"1", b"-1", b"2", b"3", b"127", b"128", b"255", b"256", b"-129", b"32768",
    b"65535", b"65536", b"2147483647", b"2147483648", b"-2147483649", b"4294967295", b"4294967296",
    b"9223372036854775807", b"9223372036854775808", b"18446744073709551615",
    b"18446744073709551616", b"1000000000000", b"9" * 40, b"1e5", b"1e39", b"1e308", b"1e400",
    b"1e-400", b"-1.5", b".5", b"5.", b"nan", b"-inf", b"1.#IND", b"0x1", b"1_0", b"+7", b"--1",
    b"",
]  # fmt: skip
WORDS = {
    "ply": b"char uchar short ushort int uint int64 uint64 float double list x y z nx vertex face"
    b" tristrips vertex_indices vertex_index property element comment end_header ascii"
    b" binary_little_endian binary_big_endian 1.0".split(),
    "obj": b"v vn vt f fo l p o g usemtl mtllib s # \\ // / 1/1 1//1 -1 \\\n".split(b" "),
    "3mf": b"model object mesh vertices vertex triangles triangle components component build item"
    b' x= y= z= v1= v2= v3= id= objectid= transform= unit= p:path= xmlns= " < > /> </ <!-- --> &lt;'
    b" UTF-8 UTF-16 inch Type Target Relationship http://schemas.microsoft.com".split(),
    "stl": b"solid facet normal outer loop vertex endloop endfacet endsolid".split(),
    "glb": b"glTF JSON accessors bufferViews buffers meshes primitives attributes POSITION NORMAL"
    b" indices mode count byteOffset byteLength byteStride componentType VEC3 SCALAR nodes children"
    b" matrix translation rotation scale mesh targets min max uri asset data:;base64,".split(),
}
BYTES = [
    b"\0", b"\xff", b"\n", b"\r", b" ", b"\t", b"-", b".", b"e", b"#", b"/", b"\\\n", b"\x7f\x80"
]  # fmt: skip
WORDS_32 = [0, 1, 2, 255, 65535, 2**31 - 1, 2**31, 2**32 - 1, 0x7F800000, 0xFF800000, 0x7FC00000]
VALUES: list[Any] = [
    0, 1, -1, 3, 4, 5, 6, 12, 5120, 5121, 5123, 5125, 5126, 2**31, 2**32 - 1, 2**40, 2**63, 10**30,
    0.5, -0.0, 1e300, 1e39, True, None, "", "VEC3", "SCALAR", "POSITION", "\ud800", [], {}, [0],
    [[]], [0] * 16, {"a": {}},
]  # fmt: skip


def mutant(format: str, number: int) -> bytes:
    """The mutant of that number."""
    dice = random.Random(f"{format} {number}")
    data = dice.choice(seeds(format))
    if format not in FORMATS:  # of other formats only numbers, lines and bytes are known
        for _ in range(dice.choice((1, 1, 1, 2, 3))):
            data = dice.choice((_number, _number, _lines, _bytes))(format, data, dice)
        return data
    changes = dice.choice((1, 1, 1, 2, 3, 4))
    if format == "gz":
        return _packed(data, changes, dice)
    for _ in range(changes):
        data = change(format, data, dice)
    return data


def change(format: str, data: bytes, dice: random.Random) -> bytes:
    """One change of the content of a file, most often one that its format has a name for."""
    if format == "glb":
        return _changed_scene(data, dice)
    if format == "gltf":
        return _changed_description(data, dice)
    if format == "3mf":
        return _changed_package(data, dice)
    if format == "stl" and not data.startswith(b"solid") and dice.random() < 0.5:
        return _changed_facets(data, dice)
    if format in WORDS and dice.random() < 0.6:
        change_text = dice.choice(
            (_number, _number, _word, _lines, _header if format == "ply" else _word)
        )
        return change_text(format, data, dice)
    return _bytes(format, data, dice)


def _bytes(format: str, data: bytes, dice: random.Random) -> bytes:
    """Something changed anywhere, without regard to what it is."""
    result = bytearray(data)
    at = dice.randrange(len(result) + 1)
    piece = result[at : at + dice.choice((1, 2, 4, 8, 12, 50, 200))]
    kind = dice.randrange(8)
    if kind == 0 and piece:
        result[at] ^= 1 << dice.randrange(8)
    elif kind == 1 and piece:
        result[at] = dice.randrange(256)
    elif kind == 2:
        result[at:at] = dice.choice(BYTES)
    elif kind == 3:
        del result[at : at + len(piece)]
    elif kind == 4:
        result[at:at] = piece * dice.choice((1, 1, 2, 40))
    elif kind == 5:
        to = dice.randrange(len(result) + 1)
        result[to:to] = piece
    elif kind == 6:
        other = dice.choice(seeds(format))
        start = dice.randrange(len(other))
        result[at : at + len(piece)] = other[start : start + dice.randrange(200)]
    elif dice.random() < 0.5:
        del result[at:]
    else:
        result[at : at + 4] = struct.pack("<I", dice.choice(WORDS_32))
    return bytes(result)


def _replace_match(pattern: bytes, data: bytes, new: list[bytes], dice: random.Random) -> bytes:
    """One match of ``pattern`` replaced by one of ``new``."""
    found = list(re.finditer(pattern, data))
    if not found:
        return data
    match = dice.choice(found)
    return data[: match.start()] + dice.choice(new) + data[match.end() :]


def _number(format: str, data: bytes, dice: random.Random) -> bytes:
    return _replace_match(rb"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?", data, NUMBERS, dice)


def _word(format: str, data: bytes, dice: random.Random) -> bytes:
    pattern = b"|".join(re.escape(word) for word in WORDS[format])
    return _replace_match(rb"(?<![^\s])(?:" + pattern + rb")(?![^\s])", data, WORDS[format], dice)


def _lines(format: str, data: bytes, dice: random.Random) -> bytes:
    """Two lines exchanged, or one cut out or doubled."""
    lines = data.splitlines(keepends=True) or [b""]
    i, j = dice.randrange(len(lines)), dice.randrange(len(lines))
    kind = dice.randrange(3)
    if kind == 0:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 1:
        del lines[i]
    else:
        lines.insert(j, lines[i])
    return b"".join(lines)


def _header(format: str, data: bytes, dice: random.Random) -> bytes:
    """A change of a number, a word or lines above ``end_header``."""
    size = data.find(b"end_header")
    head, rest = data[: max(size, 0)], data[max(size, 0) :]
    return dice.choice((_number, _word, _lines))(format, head, dice) + rest


def _changed_facets(data: bytes, dice: random.Random) -> bytes:
    """A binary STL file with an extreme number or another count, or whole facets moved."""
    result = bytearray(data)
    facets = max((len(data) - 84) // 50, 1)
    at = 84 + 50 * dice.randrange(facets)
    kind = dice.randrange(4)
    if kind == 0:
        count = dice.choice((facets - 1, facets + 1, 2 * facets, *WORDS_32))
        result[80:84] = struct.pack("<I", count % 2**32)
    elif kind == 1:
        at += 4 * dice.randrange(12)
        result[at : at + 4] = struct.pack("<I", dice.choice(WORDS_32))
    elif kind == 2:
        result[at:at] = result[at : at + 50]
        result[80:84] = struct.pack("<I", facets + 1)
    else:
        del result[at : at + 50]
        result[80:84] = struct.pack("<I", facets - 1)
    return bytes(result)


def _changed_scene(data: bytes, dice: random.Random) -> bytes:
    """A GLB file with a change of its bytes, or of one entry of its description."""
    try:
        (size,) = struct.unpack_from("<I", data, 12)
        content = json.loads(data[20 : 20 + size])
        rest = data[20 + size :]
    except (struct.error, ValueError):
        return _bytes("glb", data, dice)
    if dice.random() < 0.3:
        return _bytes("glb", data, dice)
    if dice.random() < 0.15 and len(rest) > 8:
        rest = rest[:8] + _bytes("glb", rest[8:], dice)
        rest = struct.pack("<I", len(rest) - 8) + rest[4:]
    content = copy.deepcopy(content)
    for _ in range(dice.choice((1, 1, 2))):
        _change_entry(content, dice)
    text = json.dumps(content, ensure_ascii=dice.random() < 0.9).encode("utf-8", "surrogatepass")
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + rest
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _changed_description(data: bytes, dice: random.Random) -> bytes:
    """A .gltf file with a change of its bytes, of its buffer, or of one entry."""
    try:
        content = json.loads(data)
        uri = content["buffers"][0]["uri"]
        binary = base64.b64decode(uri.partition(",")[2])
    except (ValueError, LookupError, TypeError, AttributeError):
        return _bytes("gltf", data, dice)
    if dice.random() < 0.2:
        return _bytes("gltf", data, dice)
    if dice.random() < 0.3:
        binary = _bytes("glb", binary, dice)
        content["buffers"][0]["uri"] = uri[: uri.find(",") + 1] + base64.b64encode(binary).decode()
    else:
        _change_entry(content, dice)
    text = json.dumps(content, indent=dice.choice((None, 1)), ensure_ascii=dice.random() < 0.9)
    return text.encode("utf-8", "surrogatepass")


def _changed_package(data: bytes, dice: random.Random) -> bytes:
    """A 3MF file with a change of its bytes, or of one member, around which all is right."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError):
        # Damaged by the change before.
        return _bytes("3mf", data, dice)
    if dice.random() < 0.25 or not members:
        return _bytes("3mf", data, dice)
    models = [name for name in members if name.endswith((".model", ".rels"))] or list(members)
    name = dice.choice(models)
    change = dice.choice((_number, _number, _word_anywhere, _word_anywhere, _lines, _bytes))
    members[name] = change("3mf", members[name], dice)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", dice.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as new:
        for member, content in members.items():
            new.writestr(zipfile.ZipInfo(member, (1980, 1, 1, 0, 0, 0)), content)
    return file.getvalue()


def _word_anywhere(format: str, data: bytes, dice: random.Random) -> bytes:
    """A word replaced by another, whatever stands around it."""
    pattern = b"|".join(re.escape(word) for word in WORDS[format])
    return _replace_match(pattern, data, WORDS[format], dice)


def _change_entry(content: Any, dice: random.Random) -> None:
    """One entry of a tree of dicts and lists set, cut out, doubled or copied from elsewhere."""
    holders = [content] if isinstance(content, dict | list) else []
    places: list[tuple[Any, Any]] = []
    for holder in holders:
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        for key in keys:
            places.append((holder, key))
            if isinstance(holder[key], dict | list):
                holders.append(holder[key])
    if not places:
        return
    holder, key = dice.choice(places)
    kind = dice.randrange(5)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, list):
        holder.insert(key, copy.deepcopy(holder[key]))
    elif kind == 2:
        other, place = dice.choice(places)
        holder[key] = copy.deepcopy(other[place])
    else:
        holder[key] = copy.deepcopy(dice.choice(VALUES))


def _packed(data: bytes, changes: int, dice: random.Random) -> bytes:
    """A changed file in gzip, or a file in changed gzip."""
    format = next(name for name in ("ply", "obj", "stl", "glb") if data in seeds(name))
    is_inside = dice.random() < 0.5
    for _ in range(changes * is_inside):
        data = change(format, data, dice)
    packed = _in_members(data, 0.2, dice)
    for _ in range(changes * (not is_inside)):
        packed = _bytes("gz", packed, dice)
    return packed


def _in_members(data: bytes, chance: float, dice: random.Random) -> bytes:
    """Gzip of one member, or by that chance of two."""
    cut = dice.randrange(len(data) + 1) if dice.random() < chance else 0
    parts = [data[:cut], data[cut:]] if cut else [data]
    return b"".join(gzip.compress(part, dice.choice((0, 1, 9)), mtime=0) for part in parts)


def campaign(format: str, count: int, first: int = 0) -> tuple[Counter[str], float]:
    """What ``count`` mutants ended in, and the seconds; numpy's warnings are failures too."""
    tally: Counter[str] = Counter()
    began = time.perf_counter()
    for number in range(first, first + count):
        data = mutant(format, number)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                tally[outcome(data, format)] += 1
        except BaseException as failure:
            raise AssertionError(
                f"mutant {number} of {format}: python -m tests.fuzz.mutants {format} 1 {number}"
            ) from failure
    return tally, time.perf_counter() - began


def main(arguments: list[str]) -> None:
    """Run the mutants that were asked for, and print how many, how fast and what they ended in."""
    formats = arguments[:1] or FORMATS
    count, first = (int(word) for word in (arguments[1:] + ["30000", "0"][len(arguments[1:]) :]))
    for format in formats:
        campaign(format, 50)  # kernels are compiled
        tally, seconds = campaign(format, count, first)
        ends = ", ".join(f"{code} {number}" for code, number in tally.most_common())
        print(
            f"{format}: {count} mutants in {seconds:.1f} s, {count / seconds:.0f} a second: {ends}",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
