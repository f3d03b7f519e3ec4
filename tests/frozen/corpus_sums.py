"""What the codecs make of known files and of damaged ones, as sums made once and compared since.

    python -m tests.frozen.corpus_sums [--jobs N]       everything
    python -m tests.frozen.corpus_sums ply obj          two formats
    python -m tests.frozen.corpus_sums --write          replace the sums

Each file is read, displaced, written, re-encoded and, unless it is a mutant, convert.  There are
two sums: ``data`` (error codes, arrays, bytes, how many warnings) and ``texts`` (messages, places,
hints, warnings, losses).  A change of words changes ``texts`` alone.

Inputs are the sample meshes, the corpus of fuzzing, ``inputs.tar.xz`` (malformed files, and files
that the tests of the readers made when it was written) and mutants of the seeds in that archive.
With MSAL_DATA real meshes are compared too.
"""

import functools
import gzip
import multiprocessing
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from msal_cli.codecs import open_mesh
from msal_cli.codecs.conversion import convert
from msal_cli.codecs.detection import WRITABLE
from msal_cli.codecs.header import of_beginning
from msal_cli.errors import MsalError
from msal_cli.storage.gzip_streams import expand, is_gzip
from tests.codecs.patching import polygons_of
from tests.frozen import kept
from tests.frozen.kept import ROOT, data_and_texts, digest
from tests.frozen.sums import REAL
from tests.fuzz import mutants
from tests.fuzz.seeds import archived, seeds
from tests.fuzz.seeds import kept as kept_by_fuzzing
from tests.fuzz.survival import FORMATS as FUZZED

KEPT = Path(__file__).with_name("corpus_sums.json")

BLOCK, N_BLOCKS = 100, 3
"""Mutants of one sum, and how many such sums a format has."""

HEAD_BYTES = 1 << 16
LARGE_BYTES = 1 << 16
"""Larger files are converted to ``PLAIN`` formats only, and mutants are smaller."""

PLAIN = ("ply", "obj", "stl", "gltf", "3mf", "off")

ENCODINGS = ("same", "ascii", "binary")
PRECISIONS = ("same", "float32", "float64")


def formats() -> tuple[str, ...]:
    """All formats that are compared."""
    found = {name.split("/")[1] for name in archived() if name.startswith(("seeds/", "made/"))}
    return (*FUZZED, *sorted(found - set(FUZZED)))


def format_of(name: str) -> str:
    """The format under which a file is listed."""
    suffix = name.rpartition(".")[2] if "." in name else ""
    return suffix if suffix in formats() else "none"


def ordinary_files(format: str) -> dict[str, bytes]:
    """All files of a format but mutants, by name."""
    found: dict[str, bytes] = {}
    for path in sorted((ROOT / "sample_meshes").glob("*_*.*")):
        if path.suffix != ".py" and format_of(path.name) == format:
            found[f"sample/{path.name}"] = path.read_bytes()
    if format in FUZZED:
        found |= {f"fuzz/{name[:10]}": data for name, data in kept_by_fuzzing(format).items()}
    for name, data in archived().items():
        kind, _, rest = name.partition("/")
        listed = kind == "malformed" and format_of(rest) == format
        if listed or (kind != "malformed" and rest.startswith(f"{format}/")):
            found[name] = data
    return found


def real_files(format: str) -> Iterator[tuple[str, bytes]]:
    """The files of the folder MSAL_DATA, none where it is not set."""
    folder = os.environ.get("MSAL_DATA", "")
    for file in REAL if folder else ():
        if format_of(file) == format:
            yield f"data/{file}", Path(folder, file).read_bytes()


Step = tuple[str, str, str]
"""What was done, its data, its texts."""


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
        whole = expand(data, name)
        opened["file"] = open_mesh(whole, name if format != "gz" else "scan", None)
        opened["whole"] = whole
        return digest(whole), str(is_gzip(data))

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

    attempt(steps, "forecast", lambda: (str(of_beginning(data[:HEAD_BYTES], len(data), name)), ""))
    if not attempt(steps, "read", load) or not attempt(steps, "arrays", describe):
        return steps
    file = opened["file"]
    moved = displaced(file.vertices)
    attempt(steps, "polygons", lambda: (digest(*polygons_of(file)), ""))
    attempt(steps, "same", same)
    if attempt(steps, "replaced", replaced):
        attempt(steps, "check", lambda: check("output"))
    attempt(steps, "check of another", lambda: check("whole"))
    # Once there were warnings about normals; the sums are of the time before.
    steps.append(("normals", "0", ""))
    for encoding in ENCODINGS:
        for precision in PRECISIONS:
            label = f"encoded {encoding} {precision}"
            attempt(steps, label, functools.partial(encode, encoding, precision))
    for name in ("x", "quality", "nothing"):
        numbers = functools.partial(file.vertex_property, name)
        attempt(steps, f"property {name}", lambda of=numbers: (digest(of()), ""))
    if not is_mutant:
        for to in PLAIN if len(data) > LARGE_BYTES else WRITABLE:
            attempt(steps, f"to {to}", functools.partial(conversion, to))
    return steps


Task = tuple[str, str, int]
"""A format, and the name of a group of ordinary files or of mutants with its number."""

GROUPS = 4
"""Into how many tasks the ordinary files of a format go."""


def contents(task: Task) -> Iterator[tuple[str, bytes]]:
    """The files of a task by name."""
    format, kind, number = task
    if kind == "mutants":
        for at in range(number * BLOCK, (number + 1) * BLOCK):
            yield f"mutant {at}", mutants.mutant(format, at)
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


def sums_of(task: Task) -> dict[str, list[str]]:
    """Sums of data and of texts: a pair per ordinary file, or one for all mutants of a block."""
    lines: dict[str, list[Step]] = dict(outcomes(task))
    if task[1] == "mutants":
        steps = [
            (f"{name} {step[0]}", *step[1:]) for name, found in lines.items() for step in found
        ]
        lines = {str(task[2]): steps}
    return {
        f"{task[0]} {task[1]} {name}": data_and_texts(
            (f"{label}: {data}" for label, data, _ in steps),
            (f"{label}: {texts}" for label, _, texts in steps),
        )
        for name, steps in lines.items()
    }


def tasks(chosen: Sequence[str]) -> Iterator[Task]:
    """The tasks for some formats."""
    for format in chosen:
        for number in range(GROUPS):
            yield format, "files", number
        if os.environ.get("MSAL_DATA"):
            yield format, "real", 0
        if format != "none" and seeds(format):
            for number in range(N_BLOCKS):
                yield format, "mutants", number


if __name__ == "__main__":
    parser = kept.options(str(__doc__))
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    work = tasks(given.names or (*formats(), "none"))
    with multiprocessing.Pool(given.jobs) as pool:
        found = (pair for sums in pool.imap(sums_of, work) for pair in sums.items())
        kept.settle(KEPT, found, kept.environment("meshio", "trimesh"), given)
