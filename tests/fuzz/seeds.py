"""Small good files that between them use every path of the readers; mutants are made of them."""

from __future__ import annotations

import functools
import tarfile
from pathlib import Path

INPUTS = Path(__file__).parents[1] / "frozen" / "inputs.tar.xz"


@functools.cache
def archived() -> dict[str, bytes]:
    """The files of ``inputs.tar.xz`` by name: ``seeds/FORMAT/...``, ``malformed/...`` and
    ``made/FORMAT/...``."""
    with tarfile.open(INPUTS) as archive:
        entries = [(entry.name, archive.extractfile(entry)) for entry in archive]
        return {name: file.read() for name, file in entries if file is not None}


@functools.cache
def seeds(format: str) -> tuple[bytes, ...]:
    """The good files of a format."""
    start = f"seeds/{format}/"
    return tuple(data for name, data in sorted(archived().items()) if name.startswith(start))
