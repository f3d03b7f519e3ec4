"""What it costs to refuse a file that lies: seconds and memory, each file in a process of its own.

    python benchmarks/hostile_headers.py

Prints a table.  Processor seconds and the growth of resident memory are those of reading alone,
after everything is imported and a small whole file of the format has been read.
"""

from __future__ import annotations

import gzip
import json
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

MOST_SECONDS = 0.2
MOST_BYTES = 150_000_000

GIGABYTE = 10**9
BINARY = "binary_little_endian"
XYZ = "property float x\nproperty float y\nproperty float z\n"
LIST = "property list uchar int vertex_indices\n"
V4 = struct.pack("<12f", 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1)
V4_TEXT = b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"


class Lie(NamedTuple):
    """``pieces`` are the bytes of the file, which is then made ``size`` bytes long, if given."""

    name: str
    code: str
    pieces: Callable[[], Iterator[bytes]]
    size: int | None = None


def lie(name: str, code: str, *pieces: bytes, size: int | None = None) -> Lie:
    return Lie(name, code, lambda: iter(pieces), size)


def ply(vertices: object, faces: object, *, encoding: str = BINARY, list_line: str = LIST) -> bytes:
    return (
        f"ply\nformat {encoding} 1.0\nelement vertex {vertices}\n{XYZ}"
        f"element face {faces}\n{list_line}end_header\n"
    ).encode()


def glb(content: object, binary: bytes = bytes(48), **lengths: int) -> bytes:
    text = content if isinstance(content, bytes) else json.dumps(content).encode()
    chunks = struct.pack("<II", lengths.get("json", len(text)), 0x4E4F534A) + text
    chunks += struct.pack("<II", lengths.get("chunk", len(binary)), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, lengths.get("whole", 12 + len(chunks))) + chunks


def scene(**changes: object) -> dict[str, object]:
    """A description of one triangle; ``changes`` to its first accessor, view and primitives."""
    view = {"buffer": 0, "byteLength": 48, **dict(changes.get("view", {}))}  # type: ignore[call-overload]
    positions = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
    positions |= dict(changes.get("accessor", {}))  # type: ignore[call-overload]
    indices = {"bufferView": 0, "componentType": 5121, "count": 48, "type": "SCALAR"}
    primitives = changes.get("primitives", [{"attributes": {"POSITION": 0}}])
    return {
        "accessors": [positions, indices],
        "bufferViews": [view],
        "buffers": [{"byteLength": 48}],
        "meshes": [{"primitives": primitives}],
    }


def bomb() -> Iterator[bytes]:
    """Ten megabytes that expand to ten gigabytes."""
    member = gzip.compress(bytes(100 << 20), 9, mtime=0)
    for _ in range(100):
        yield member


GOOD = {
    ".ply": ply(4, 1, encoding="ascii") + V4_TEXT + b"3 0 1 2\n",
    ".obj": OBJ + b"f 1 2 3\n",
    ".stl": b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    b"endloop\nendfacet\nendsolid\n",
    ".glb": glb(scene(), V4),
}
"""What is read first, so that kernels and the libraries behind them are loaded."""


def lies() -> Iterator[Lie]:
    """The hostile files, by format."""
    deep = b'{"a":' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    with_list = {"uint": "property list uint int vertex_indices\n"}
    with_list["int"] = with_list["uint"].replace("list uint", "list int")
    with_list["uint64"] = with_list["uint"].replace("list uint", "list uint64")
    yield lie("10^12 vertices.ply", "E_TRUNCATED", ply(10**12, 1), V4)
    yield lie("10^12 vertices, 1 GB.ply", "E_TRUNCATED", ply(10**12, 1), size=GIGABYTE)
    yield lie("10^12 faces.ply", "E_TRUNCATED", ply(4, 10**12), V4, b"\3" + bytes(12))
    yield lie(
        "10^12 vertices in text.ply", "E_TRUNCATED", ply(10**12, 1, encoding="ascii"), V4_TEXT
    )
    yield lie("2^63 vertices.ply", "E_TRUNCATED", ply(2**63, 1), V4)
    yield lie("2^64-1 faces.ply", "E_TRUNCATED", ply(4, 2**64 - 1), V4)
    yield lie("2^70 vertices.ply", "E_FORMAT", ply(2**70, 1), V4)
    yield lie("-1 vertices.ply", "E_FORMAT", ply(-1, 1), V4)
    yield lie("count of 100,000 digits.ply", "E_TOO_LARGE", ply("9" * 100_000, 1), V4)
    for kind, code, count in (
        ("uint", "E_TRUNCATED", struct.pack("<I", 2**32 - 1)),
        ("int", "E_FORMAT", struct.pack("<i", -1)),
        ("uint64", "E_FORMAT", struct.pack("<Q", 2**63)),
        ("uint64", "E_FORMAT", struct.pack("<Q", 2**64 - 1)),
    ):
        head = ply(4, 1, list_line=with_list[kind])
        number = int.from_bytes(count, "little", signed=kind == "int")
        yield lie(f"list of {number}.ply", code, head, V4, count, bytes(64))
    yield lie(
        "list of 2^32-1 in text.ply",
        "E_FORMAT",
        ply(4, 1, encoding="ascii"),
        V4_TEXT,
        b"4294967295 0 1 2\n",
    )
    many = "".join(f"property float p{k}\n" for k in range(100_000))
    yield lie("100,000 properties.ply", "E_TOO_LARGE", ply(4, 1, list_line=many), V4)
    many = "".join(f"element e{k} 1\n" for k in range(100_000))
    yield lie("100,000 elements.ply", "E_TOO_LARGE", ply(4, 1, list_line=many), V4)
    start = b"ply\nformat ascii 1.0\ncomment "
    yield lie("no end to the header, 1 GB.ply", "E_TOO_LARGE", start, size=GIGABYTE)
    yield lie("a header line of 100 MB.ply", "E_TOO_LARGE", start, b"a" * 10**8)
    yield lie("100 MB of comments.ply", "E_TOO_LARGE", start, b"a\ncomment " * 10**7)
    yield lie("four vertices and 1 GB.ply", "E_TOO_LARGE", ply(4, 1), V4, size=GIGABYTE)
    yield lie("four vertices and 100 GB.ply", "E_TOO_LARGE", ply(4, 1), V4, size=10**11)
    text = ply(4, 1, encoding="ascii") + V4_TEXT + b"3 0 1 2\n"
    yield lie("index of 10^12.ply", "E_INDEX", text[:-2], b"1000000000000\n")

    yield lie("10^12.obj", "E_INDEX", OBJ, b"f 1 2 1000000000000\n")
    yield lie("-10^12.obj", "E_INDEX", OBJ, b"f 1 2 -1000000000000\n")
    yield lie("10^18 and more.obj", "E_INDEX", OBJ, b"f 1 2 " + b"9" * 1000 + b"\n")
    yield lie("a number of 10 MB.obj", "E_NONFINITE", OBJ, b"v 0 0 ", b"1" * 10**7, b"\nf 1 2 4\n")
    yield lie("a face of 10 MB.obj", "E_INDEX", OBJ, b"f" + b" 1" * (5 * 10**6) + b" 9\n")
    yield lie("a line of 10 MB.obj", "E_NO_FACES", b"v 0 0 0 # ", b"a" * 10**7)
    yield lie("10 MB of 'v '.obj", "E_FORMAT", b"v " * (5 * 10**6))
    yield lie("10 MB of 'f 1 1 1'.obj", "E_NO_FACES", b"f 1 1 1\n" * 1_250_000)
    yield lie("100 GB.obj", "E_TOO_LARGE", OBJ, size=10**11)

    header = bytes(80)
    yield lie("2^32-1 facets.stl", "E_TRUNCATED", header, b"\xff" * 4, bytes(50))
    yield lie("2^32-1 facets, 1 GB.stl", "E_TRUNCATED", header, b"\xff" * 4, size=GIGABYTE)
    yield lie("one facet and 1 GB.stl", "E_TOO_LARGE", header, b"\1\0\0\0", size=GIGABYTE)
    yield lie("one facet and 100 GB.stl", "E_TOO_LARGE", header, b"\1\0\0\0", size=10**11)
    yield lie("a name of 10 MB.stl", "E_TRUNCATED", b"solid ", b"a" * 10**7)
    yield lie("10 MB of 'solid'.stl", "E_FORMAT", b"solid a\n" * 1_250_000)
    facet = b"facet normal 0 0 1\nouter loop\nvertex "
    yield lie(
        "a number of 10 MB.stl",
        "E_NONFINITE",
        b"solid\n",
        facet,
        b"1" * 10**7,
        b" 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n",
    )

    yield lie("whole length 2^32-1.glb", "E_TRUNCATED", glb(scene(), whole=2**32 - 1))
    yield lie("JSON of 2^32-1.glb", "E_TRUNCATED", glb(scene(), json=2**32 - 1))
    yield lie("binary chunk of 2^32-1.glb", "E_TRUNCATED", glb(scene(), chunk=2**32 - 1))
    yield lie(
        "1 GB of JSON.glb",
        "E_TOO_LARGE",
        glb(b"{", b"", whole=GIGABYTE, json=GIGABYTE - 20),
        size=GIGABYTE,
    )
    yield lie("100,000 lists deep.glb", "E_FORMAT", glb(deep))
    yield lie("integer of a million digits.glb", "E_FORMAT", glb(b'{"a":' + b"9" * 10**6 + b"}"))
    yield lie("count of 10^13.glb", "E_FORMAT", glb(scene(accessor={"count": 10**13})))
    yield lie("count of 10^11.glb", "E_TRUNCATED", glb(scene(accessor={"count": 10**11})))
    yield lie("count of -1.glb", "E_FORMAT", glb(scene(accessor={"count": -1})))
    yield lie("offset of 2^63.glb", "E_FORMAT", glb(scene(view={"byteOffset": 2**63})))
    yield lie("stride of 2^39.glb", "E_TRUNCATED", glb(scene(view={"byteStride": 2**39})))

    yield Lie("a bomb of 10 GB.ply.gz", "E_TOO_LARGE", bomb)
    yield lie("100 GB.ply.gz", "E_TOO_LARGE", b"\x1f\x8b\x08", size=10**11)
    yield lie("10^12 vertices.ply.gz", "E_TRUNCATED", gzip.compress(ply(10**12, 1) + V4, mtime=0))


CHILD = """
import sys, time
from msal_cli import codecs
from msal_cli.codecs.header import read_input
from msal_cli.storage.gzip_streams import expand
from msal_cli.errors import MsalError

def resident():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))

goods, bads = sys.argv[1:5], sys.argv[5:]
for path in goods:
    codecs.open_mesh(read_input(path), path)
for path in bads:
    before, began, code = resident(), time.process_time(), "ok"
    try:
        codecs.open_mesh(expand(read_input(path), path), path)
    except MsalError as error:
        code = error.code
    print(code, time.process_time() - began, resident() - before)
"""


def refused(some: Iterable[Lie], folder: Path) -> list[tuple[str, float, int]]:
    """The code that each lie ends in, its seconds, and the bytes that the peak of memory grew.

    All are read by one process, one after the other; Linux only.
    """
    paths = []
    for suffix, data in GOOD.items():
        paths.append(folder / f"good{suffix}")
        paths[-1].write_bytes(data)
    for one in some:
        paths.append(folder / one.name)
        with paths[-1].open("wb") as file:
            file.writelines(one.pieces())
            if one.size is not None:
                file.truncate(one.size)
    try:
        done = subprocess.run(
            [sys.executable, "-c", CHILD, *map(str, paths)],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
        )
    finally:
        for path in paths:
            path.unlink()
    lines = (line.split() for line in done.stdout.splitlines())
    return [(code, float(seconds), int(grown)) for code, seconds, grown in lines]


def main() -> None:
    """Print the table; exit status 1 if a file is not refused as it should be."""
    wrong = 0
    print("| file | code | seconds | MB |\n|---|---|---:|---:|")
    with tempfile.TemporaryDirectory() as folder:
        for one in lies():
            ((code, seconds, grown),) = refused([one], Path(folder))
            is_right = code == one.code and seconds < MOST_SECONDS and grown < MOST_BYTES
            wrong += not is_right
            print(
                f"| {one.name} | {code} | {seconds:.3f} | {grown / 1e6:.0f} |"
                + ("" if is_right else f" not {one.code}, or too dear"),
                flush=True,
            )
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
