"""What the codecs make of known files and of damaged ones, as sums made once and compared since.

    python -m tests.frozen.corpus_sums                          everything, 3,000 mutants per format
    python -m tests.frozen.corpus_sums --format ply,obj         two formats
    python -m tests.frozen.corpus_sums --mutants 300            faster; 0 for ordinary files alone
    python -m tests.frozen.corpus_sums --write                  replace the sums

Each file is read, displaced, written, re-encoded and, unless it is a mutant, convert.  There are
two sums: ``data`` (error codes, arrays, bytes, how many warnings) and ``texts`` (messages, places,
hints, warnings, losses).  A change of words changes ``texts`` alone.

Inputs are the sample meshes, the corpus of fuzzing, ``inputs.tar.xz`` (malformed files, and files
that the tests of the readers made when it was written) and mutants of the seeds in that archive.
With MSAL_DATA real meshes are compared too.
"""

from __future__ import annotations

import argparse
import functools
import gzip
import hashlib
import json
import multiprocessing
import os
import time
import warnings
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from msal_cli.codecs import normal_warnings, open_mesh, vertex_property
from msal_cli.codecs.conversion import WRITABLE, convert
from msal_cli.codecs.header import of_beginning
from msal_cli.errors import MsalError
from msal_cli.storage.gzip_streams import expand
from tests.frozen.corpus_inputs import formats, mutant, ordinary_files, real_files
from tests.frozen.sums import environment
from tests.fuzz.seeds import seeds

KEPT = Path(__file__).with_name("corpus_sums.json")

BLOCK = 100
"""Mutants of one sum."""

HEAD_BYTES = 1 << 16
LARGE_BYTES = 1 << 16
"""Larger files are converted to ``PLAIN`` formats only, and mutants are smaller."""

PLAIN = ("ply", "obj", "stl", "gltf", "3mf", "off")

ENCODINGS = ("same", "ascii", "binary")
PRECISIONS = ("same", "float32", "float64")

Step = tuple[str, str, str]
"""What was done, its data, its texts."""


def digest(*parts: Any) -> str:
    """A short sum of bytes, arrays and texts; lengths are in it."""
    total = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            total.update(f"{part.dtype.str} {part.shape} ".encode())
            part = np.ascontiguousarray(part).tobytes()
        elif isinstance(part, str):
            part = part.encode("utf-8", "surrogatepass")
        part = memoryview(part).cast("B")
        total.update(f"{len(part)} ".encode())
        total.update(part)
    return total.hexdigest()[:16]


def plain_bytes(data: Any) -> Any:
    """Content without gzip, whose bytes depend on the system's zlib."""
    head = bytes(memoryview(data)[:2])
    return gzip.decompress(data) if head == b"\x1f\x8b" else data


def displaced(vertices: Any) -> Any:
    """Every third vertex moved by up to a hundredth of the extent."""
    moved = vertices.copy()
    extent = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    index = np.arange(0, len(vertices), 3, dtype=np.float64)
    moved[::3] += 0.01 * extent * np.sin(index[:, None] + np.arange(3.0))
    return moved


def attempt(steps: list[Step], label: str, work: Callable[[], tuple[str, str]]) -> bool:
    """Do ``work`` and keep its data and texts, or its error."""
    try:
        data, texts = work()
    except MsalError as error:
        words = [str(getattr(error, name, "") or "") for name in ("message", "where", "hint")]
        steps.append((label, error.code, " | ".join(words)))
        return False
    except Exception as error:
        steps.append((label, f"!{type(error).__name__}", ""))
        return False
    steps.append((label, data, texts))
    return True


def outcome(data: bytes, format: str, *, is_mutant: bool) -> list[Step]:
    """All that is made of the content of one file."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _outcome(data, format, is_mutant)


def _outcome(data: bytes, format: str, is_mutant: bool) -> list[Step]:
    steps: list[Step] = [("input", digest(data), "")]
    name = f"scan.{format}" if format else "scan"
    opened: dict[str, Any] = {}

    def load() -> tuple[str, str]:
        whole, notes = expand(data, name)
        opened["file"] = open_mesh(whole, name if format != "gz" else "scan", None)
        opened["whole"] = whole
        return digest(whole), str(notes)

    def describe() -> tuple[str, str]:
        file = opened["file"]
        facts = [file.format, file.encoding, file.precision, file.n_polygons, file.merged_vertices]
        facts += [file.properties, file.references, len(file.warnings)]
        sums = digest(file.vertices, file.faces)
        return f"{sums} {[str(fact) for fact in facts]}", "\n".join(file.warnings)

    def same() -> tuple[str, str]:
        output = file.replaced(file.vertices.copy())
        return ("same" if bytes(output) == bytes(opened["whole"]) else digest(output)), ""

    def replaced() -> tuple[str, str]:
        opened["output"] = file.replaced(moved)
        return digest(plain_bytes(opened["output"])), ""

    def check(output: str) -> tuple[str, str]:
        file.check(opened[output], moved)
        return "ok", ""

    def encode(encoding: str, precision: str) -> tuple[str, str]:
        return digest(plain_bytes(file.encoded(moved, encoding, precision))), ""

    def conversion(to: str) -> tuple[str, str]:
        output, losses = convert(file, moved, to)
        return f"{digest(output)} {len(losses)}", "\n".join(losses)

    def about_normals() -> tuple[str, str]:
        lines = normal_warnings(file, moved)
        return str(len(lines)), "\n".join(lines)

    attempt(steps, "forecast", lambda: (str(of_beginning(data[:HEAD_BYTES], len(data), name)), ""))
    if not attempt(steps, "read", load) or not attempt(steps, "arrays", describe):
        return steps
    file = opened["file"]
    moved = displaced(file.vertices)
    attempt(steps, "polygons", lambda: (digest(*map(np.asarray, file.polygons())), ""))
    attempt(steps, "same", same)
    if attempt(steps, "replaced", replaced):
        attempt(steps, "check", lambda: check("output"))
    attempt(steps, "check of another", lambda: check("whole"))
    attempt(steps, "normals", about_normals)
    for encoding in ENCODINGS:
        for precision in PRECISIONS:
            label = f"encoded {encoding} {precision}"
            attempt(steps, label, functools.partial(encode, encoding, precision))
    for name in ("x", "quality", "nothing"):
        numbers = functools.partial(vertex_property, file, name)
        attempt(steps, f"property {name}", lambda of=numbers: (digest(of()), ""))
    if not is_mutant:
        for to in PLAIN if len(data) > LARGE_BYTES else WRITABLE:
            attempt(steps, f"to {to}", functools.partial(conversion, to))
    return steps


Task = tuple[str, str, int]
"""A format, and the name of a group of ordinary files or of mutants with its number."""

Sums = dict[str, tuple[str, str]]

GROUPS = 4
"""Into how many tasks the ordinary files of a format go."""


def contents(task: Task) -> Iterator[tuple[str, bytes]]:
    """The files of a task by name."""
    format, kind, number = task
    if kind == "mutants":
        for at in range(number * BLOCK, (number + 1) * BLOCK):
            yield f"mutant {at}", mutant(format, at)
    elif kind == "real":
        yield from real_files(format)
    else:
        yield from list(ordinary_files(format).items())[number::GROUPS]


def outcomes(task: Task) -> Iterator[tuple[str, list[Step]]]:
    """What is made of each file of a task."""
    for name, data in contents(task):
        format = task[0]
        if format == "none" or name.startswith(("malformed/", "sample/", "data/")):
            # The suffixes are a part of what is tested.
            suffixes = name.rpartition("/")[2].partition(".")[2]
            format = suffixes if format != "none" or suffixes else ""
        yield name, outcome(data, format, is_mutant=task[1] == "mutants")


def sums_of(task: Task) -> tuple[Task, Sums, float]:
    """Sums of data and of texts: one pair per ordinary file, or one for all mutants of a block."""
    began = time.perf_counter()
    lines: dict[str, list[Step]] = dict(outcomes(task))
    if task[1] == "mutants":
        lines = {
            str(task[2]): [
                (f"{name} {step[0]}", *step[1:]) for name, steps in lines.items() for step in steps
            ]
        }
    sums = {
        name: (
            digest(*(f"{label}: {data}" for label, data, _ in steps))[:12],
            digest(*(f"{label}: {texts}" for label, _, texts in steps))[:12],
        )
        for name, steps in lines.items()
    }
    return task, sums, time.perf_counter() - began


def tasks(chosen: tuple[str, ...], n_mutants: int) -> list[Task]:
    """The tasks for some formats."""
    found: list[Task] = []
    for format in chosen:
        found += [(format, "files", number) for number in range(GROUPS)]
        if os.environ.get("MSAL_DATA"):
            found.append((format, "real", 0))
        if format != "none" and seeds(format):
            found += [(format, "mutants", number) for number in range(n_mutants // BLOCK)]
    return found


def different(task: Task, sums: Sums, kept: Any) -> dict[str, str]:
    """The files, or blocks, of a task that differ, and in what."""
    format, kind, _ = task
    earlier = kept.get(format, {}).get(kind, {})
    found = {}
    for name, pair in sums.items():
        before = earlier.get(name)
        if before is None:
            found[name] = "new"
            continue
        words = [("data", "texts")[k] for k in (0, 1) if pair[k] != before[k]]
        if words:
            found[name] = " and ".join(words)
    return found


def compare(chosen: tuple[str, ...], n_mutants: int, arguments: argparse.Namespace) -> int:
    """Compare, and write if asked; returns how many sums differ."""
    document = json.loads(KEPT.read_text()) if KEPT.exists() else {"formats": {}}
    kept = document["formats"]
    seconds: dict[str, float] = {}
    written: dict[str, Any] = {}
    n_compared = n_different = 0
    work = tasks(chosen, n_mutants)
    with multiprocessing.Pool(arguments.jobs) as pool:
        run = pool.imap(sums_of, work) if arguments.jobs > 1 else map(sums_of, work)
        for task, sums, took in run:
            seconds[task[0]] = seconds.get(task[0], 0.0) + took
            n_compared += len(sums)
            if arguments.write:
                format, kind, _ = task
                written.setdefault(format, {}).setdefault(kind, {}).update(sums)
                continue
            found = different(task, sums, kept)
            n_different += len(found)
            for name, words in found.items():
                print(f"{task[0]} {task[1]} {name}: {words}", flush=True)
    print(", ".join(f"{format} {took:.1f} s" for format, took in seconds.items()))
    if arguments.write:
        for format, kinds in written.items():
            kept[format] = kept.get(format, {}) | kinds
        document = {"environment": here(), "formats": kept}
        KEPT.write_text(json.dumps(document, separators=(",", ":")).replace("],", "],\n") + "\n")
        return 0
    print(f"{n_compared} sums compared, {n_different} different")
    return n_different


def here() -> dict[str, str]:
    """What the sums depend on beside the code."""
    from importlib.metadata import version

    names = ("meshio", "trimesh")
    return environment() | {"zlib": zlib.ZLIB_VERSION} | {name: version(name) for name in names}


def main(words: list[str] | None = None) -> None:
    """Compare or write the sums."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--format", default="", help="formats, separated by commas")
    parser.add_argument("--mutants", type=int, default=3000, help="per format, in steps of 100")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args(words)
    chosen = tuple(arguments.format.split(",")) if arguments.format else (*formats(), "none")
    if compare(chosen, arguments.mutants, arguments):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
