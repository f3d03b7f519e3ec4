"""Coverage-guided fuzzing of the readers, one format at a time, with atheris.

    pip install atheris
    python -m tests.fuzz.readers ply FOUND tests/fuzz/corpus/ply -runs=100000
    python -m tests.fuzz.readers ply FOUND tests/fuzz/corpus/ply -runs=100000 --interpreted
    python -m tests.fuzz.readers ply FOUND tests/fuzz/corpus/ply -runs=100000 --shipped
    python -m tests.fuzz.readers ply SMALLEST FOUND -merge=1 --interpreted

Formats are those of ``survival.FORMATS``.  FOUND is a folder that receives every file that reaches
something new; the corpus that is kept beside this file is only read.  Further options go to
libFuzzer.  The scanners are compiled kernels that atheris cannot see into, so that there are
three ways to run, which can share their corpus: ``--interpreted`` runs the kernels as Python,
several times slower, with coverage of their branches and with every index checked; without it
they are compiled and called by numba, and coverage is that of the code around them; ``--shipped``
calls them as msal itself does, which starts sooner but takes some forty times as long a call.

A crash is anything but an error of msal's own, more than 2 s of processor time for one file, or
memory beyond ``MOST_MEMORY``.  libFuzzer then writes the file as ``crash-...`` and stops.  Every
hundred thousand files a line says what they ended in.
"""

from __future__ import annotations

import functools
import gzip
import os
import random
import struct
import sys
import tempfile
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable
from typing import Any

MOST_SECONDS = 2.0
MOST_MEMORY = 3 << 30
"""Address space beyond which an allocation fails, with everything imported in it."""

_TOLD_EVERY = 100_000
_SCANNERS = (
    "digits",
    "plain_numbers",
    "text",
    "obj_plain",
    "obj_scan",
    "plain_patch",
    "statements",
    "ply_plain",
    "ply_scan",
    "stl_scan",
)

WORDS = {
    "ply": "ply format ascii binary_little_endian binary_big_endian 1.0 comment obj_info element"
    " vertex face tristrips property list char uchar short ushort int uint int64 uint64 float"
    " double uint8 float32 x y z nx ny nz vertex_indices vertex_index end_header TextureFile",
    "obj": "v vn vt vp f fo l p o g s usemtl mtllib // / \\ # nan inf 1.#IND 1e400 -1 2147483648",
    "stl": "solid facet normal outer loop vertex endloop endfacet endsolid nan inf 1e39",
    "glb": "glTF JSON accessors bufferViews buffers meshes primitives attributes POSITION NORMAL"
    " indices mode count byteOffset byteLength byteStride componentType 5126 5125 5123 5121 VEC3"
    " SCALAR nodes children matrix translation rotation scale mesh targets min max 1e400 NaN",
}
WORDS["gltf"] = WORDS["glb"] + " buffers uri byteLength asset version data:;base64,"
WORDS["3mf"] = (
    "PK model object mesh vertices vertex triangles triangle components component build item x= y="
    " z= v1= v2= v3= id= objectid= transform= unit= p:path= xmlns= UTF-8 Type Target Relationship"
)
WORDS["gz"] = " ".join(WORDS.values())
"""What the formats are made of; libFuzzer puts these words in."""

Mutate = Callable[[bytes, int], bytes]


def main(arguments: list[str]) -> None:
    """Fuzz the reader of ``arguments[0]`` for ever, or as long as libFuzzer's options say."""
    import atheris

    format, *options = arguments
    modes = [option for option in options if option in ("--interpreted", "--shipped")]
    is_interpreted, is_shipped = "--interpreted" in modes, "--shipped" in modes
    if is_interpreted:
        os.environ["MSAL_INTERPRET_KERNELS"] = "1"
    elif not is_shipped:
        _call_by_numba()
    seen = ["msal_cli.codecs"] + [f"msal_cli.kernels.{name}" for name in _SCANNERS * is_interpreted]
    # What numba compiles must not be instrumented: it does not know the calls that are put in.
    with atheris.instrument_imports(include=seen):
        import msal_cli.codecs.glb
        import msal_cli.codecs.gltf
        import msal_cli.codecs.obj
        import msal_cli.codecs.ply
        import msal_cli.codecs.stl
        import msal_cli.codecs.threemf

        if is_interpreted:
            import msal_cli.kernels.obj_fast
            import msal_cli.kernels.obj_scan
            import msal_cli.kernels.ply_scan
            import msal_cli.kernels.stl_scan  # noqa: F401
    import numpy as np

    from tests.fuzz.survival import outcome

    if is_interpreted:
        np.seterr(all="ignore")  # integers that wrap do so in silence once they are compiled
    else:
        warnings.simplefilter("error")
    _limit_memory()
    tally: Counter[str] = Counter()
    words = _words(format)

    def seconds(data: bytes) -> float:
        began = time.process_time()
        tally[outcome(data, format)] += 1
        return time.process_time() - began

    def one(data: bytes) -> None:
        if not tally:
            os.unlink(words)  # libFuzzer has read it, and leaves without saying so
        spent = seconds(data)
        # The first use of a kernel compiles it; a file that is truly slow is so again.
        if spent > MOST_SECONDS and not is_interpreted and seconds(data) > MOST_SECONDS:
            raise AssertionError(f"{len(data)} bytes took {spent:.1f} s")
        if tally.total() % _TOLD_EVERY == 0:
            print(f"{tally.total()} files: {dict(tally.most_common())}", flush=True)

    def mutated(data: bytes, size: int, seed: int) -> bytes:
        return MUTATED[format](data, size, random.Random(seed), atheris.Mutate)

    extra = {"custom_mutator": mutated} if format in MUTATED else {}
    fixed = ["-timeout=60", "-rss_limit_mb=2500", "-print_final_stats=1", f"-dict={words}"]
    # libFuzzer starts itself again by this line when it merges.
    program = " ".join([sys.executable, "-m", "tests.fuzz.readers", format, *modes])
    given = [option for option in options if option not in modes]
    atheris.Setup([program, *fixed, *given], one, **extra)
    atheris.Fuzz()


def _call_by_numba() -> None:
    """Let numba call the kernels that it compiles, and cache them for every source of theirs."""
    import hashlib
    from pathlib import Path

    from kernel_build.numba_kernels import to_dispatcher
    from msal_cli.kernels import compiled

    sources = sorted(Path(compiled.__file__).parent.glob("*.py"))
    key = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
    os.environ["NUMBA_CACHE_DIR"] = os.path.join(tempfile.gettempdir(), f"msal-fuzz-{key[:16]}")

    class Called(compiled.Kernel):
        @functools.cached_property
        def by_numba(self) -> Any:
            return to_dispatcher(self, cache=True)

        def __call__(self, *arguments: Any) -> Any:
            return self.by_numba(*arguments)

    compiled.Kernel = Called  # type: ignore[misc]


def _limit_memory() -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))


def _words(format: str) -> str:
    """The path of libFuzzer's dictionary of a format."""
    with tempfile.NamedTemporaryFile("w", suffix=".dict", delete=False) as file:
        for word in WORDS[format].split():
            escaped = word.replace("\\", "\\\\")
            file.write(f'"{escaped}"\n')
    return file.name


def gzip_mutated(data: bytes, size: int, dice: random.Random, mutate: Mutate) -> bytes:
    """Mostly a valid file around mutated content, since a checksum stops all other mutants."""
    if dice.random() < 0.3:
        return mutate(data, size)
    try:
        content = zlib.decompressobj(wbits=31).decompress(data, 1 << 16)
    except zlib.error:
        content = data
    content = mutate(content, max(size, len(content) + 1))
    cut = dice.randrange(len(content) + 1) if dice.random() < 0.1 else 0
    parts = [content[:cut], content[cut:]] if cut else [content]
    packed = b"".join(gzip.compress(part, dice.choice((0, 1, 9)), mtime=0) for part in parts)
    if dice.random() < 0.1:
        packed = packed[:-8] + struct.pack("<II", dice.getrandbits(32), dice.getrandbits(32))
    return packed[:size]


def glb_mutated(data: bytes, size: int, dice: random.Random, mutate: Mutate) -> bytes:
    """Mostly a mutant of one chunk, the lengths around it put right."""
    if len(data) < 20 or dice.random() < 0.3:
        return mutate(data, size)
    (length,) = struct.unpack_from("<I", data, 12)
    text, rest = data[20 : 20 + length], data[28 + length :]
    if dice.random() < 0.7:
        text = mutate(text, max(size - len(rest) - 28, len(text) + 1))
    else:
        rest = mutate(rest, max(size - len(text) - 28, len(rest) + 1))
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(rest), b"BIN\0") + rest
    return (struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)[:size]


def stl_mutated(data: bytes, size: int, dice: random.Random, mutate: Mutate) -> bytes:
    """Often with the count that a binary file of that size should have."""
    data = mutate(data, size)
    if len(data) < 134 or dice.random() < 0.5 or data[:80].lstrip().startswith(b"solid"):
        return data
    return data[:80] + struct.pack("<I", (len(data) - 84) // 50) + data[84:]


MUTATED = {"gz": gzip_mutated, "glb": glb_mutated, "stl": stl_mutated}
"""Mutation that keeps whole what would else stop nearly every mutant at the door."""


if __name__ == "__main__":
    main(sys.argv[1:])
