"""The files whose outcomes are frozen: kept ones, mutants made of kept seeds, and real scans."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from pathlib import Path

from tests.frozen.kept import ROOT
from tests.frozen.sums import REAL
from tests.fuzz import mutants
from tests.fuzz.seeds import archived, kept, seeds

FUZZED = ("ply", "obj", "stl", "glb", "gltf", "3mf", "gz")
"""Formats with mutants and a corpus of their own; for all others bytes and numbers are changed."""


def formats() -> tuple[str, ...]:
    """All formats that are compared."""
    found = {name.split("/")[1] for name in archived() if name.startswith(("seeds/", "made/"))}
    return (*FUZZED, *sorted(found - set(FUZZED)))


def mutant(format: str, number: int) -> bytes:
    """The mutant of that number."""
    if format in FUZZED:
        return mutants.mutant(format, number)
    dice = random.Random(f"{format} {number}")
    data = dice.choice(seeds(format))
    for _ in range(dice.choice((1, 1, 1, 2, 3))):
        change = dice.choice((mutants._number, mutants._number, mutants._lines, mutants._bytes))
        data = change(format, data, dice)
    return data


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
        found |= {f"fuzz/{name[:10]}": data for name, data in kept(format).items()}
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
