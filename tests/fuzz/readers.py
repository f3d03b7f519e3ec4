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
import os
import random
import sys
import tempfile
import time
import warnings
from collections import Counter
from typing import Any

MOST_SECONDS = 2.0
MOST_MEMORY = 3 << 30
"""Address space beyond which an allocation fails, with everything imported in it."""

_TOLD_EVERY = 100_000
_SCANNERS = (
    "numbers",
    "text",
    "obj_scan",
    "statements",
    "ply_scan",
    "stl_facets",
)


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
        if is_interpreted:
            pass

    import numpy as np

    from tests.fuzz import mutants
    from tests.fuzz.survival import outcome

    mutants.seeds(format)  # what makes them is imported before warnings are errors
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
        dice = random.Random(seed)
        if dice.random() < 0.5:
            return bytes(atheris.Mutate(data, size))
        return mutants.change(format, data, dice)[:size]

    fixed = ["-timeout=60", "-rss_limit_mb=2500", "-print_final_stats=1", f"-dict={words}"]
    # libFuzzer starts itself again by this line when it merges.
    program = " ".join([sys.executable, "-m", "tests.fuzz.readers", format, *modes])
    given = [option for option in options if option not in modes]
    atheris.Setup([program, *fixed, *given], one, custom_mutator=mutated)
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
    from tests.fuzz.mutants import NUMBERS, WORDS

    formats = WORDS if format == "gz" else ["glb" if format == "gltf" else format]
    words = {word for one in formats for word in WORDS[one]}
    with tempfile.NamedTemporaryFile("w", suffix=".dict", delete=False) as file:
        for word in sorted({*words, *NUMBERS} - {b""}):
            escaped = "".join(f"\\x{byte:02x}" for byte in word)
            file.write(f'"{escaped}"\n')
    return file.name


if __name__ == "__main__":
    main(sys.argv[1:])
