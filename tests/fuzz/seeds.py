"""Small good files that between them use every path of the readers, and the corpus of fuzzing."""

import functools
import tarfile
from pathlib import Path

CORPUS = Path(__file__).parent / "corpus"
"""For each format the smallest files that reach all that was reached."""

INPUTS = Path(__file__).parents[1] / "frozen" / "inputs.tar.xz"


def unpack(path: Path) -> dict[str, bytes]:
    """The files of an archive by name."""
    with tarfile.open(path) as archive:
        entries = [(entry.name, archive.extractfile(entry)) for entry in archive]
        return {name: file.read() for name, file in entries if file is not None}


def kept(format: str) -> dict[str, bytes]:
    """The corpus of a format."""
    return unpack(CORPUS / f"{format}.tar.xz")


@functools.cache
def archived() -> dict[str, bytes]:
    """``seeds/FORMAT/...``, ``malformed/...`` and ``made/FORMAT/...``."""
    return unpack(INPUTS)


@functools.cache
def seeds(format: str) -> tuple[bytes, ...]:
    """The good files of a format, of which mutants are made."""
    start = f"seeds/{format}/"
    return tuple(data for name, data in sorted(archived().items()) if name.startswith(start))
