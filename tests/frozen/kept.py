"""Sums that are kept in JSON files beside the code: compared with new ones, or replaced."""

import argparse
import hashlib
import json
import platform
import re
import zlib
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from kernel_build.sources import check_library

ROOT = Path(__file__).resolve().parents[2]


def environment(*packages: str) -> dict[str, str]:
    """What bytes depend on beside the code, with the versions of some packages."""
    features = np.show_config(mode="dicts")["SIMD Extensions"]
    return {
        "numpy": np.__version__,
        "machine": platform.machine(),
        "libc": " ".join(platform.libc_ver()),
        "simd": " ".join(features["baseline"] + features["found"]),
        "zlib": zlib.ZLIB_VERSION,
    } | {name: version(name) for name in packages}


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


def data_and_texts(data: Iterable[str], texts: Iterable[str]) -> list[str]:
    """A pair of sums: of what programs read, and of words for people."""
    return [digest(*data)[:12], digest(*texts)[:12]]


def describe_change(before: Any, after: Any) -> str:
    """What of a sum, or of a pair of them, differs; empty if nothing does."""
    if before is None or isinstance(after, str):
        return "" if before == after else "new" if before is None else "bytes"
    parts = zip(("data", "texts"), before, after, strict=True)
    return " and ".join(word for word, old, new in parts if old != new)


def options(description: str) -> argparse.ArgumentParser:
    """A parser for names that select, and ``--write``."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help="replace the sums")
    parser.add_argument("names", nargs="*", metavar="NAME")
    return parser


def settle(
    path: Path, found: Iterable[tuple[str, Any]], here: dict[str, str], given: argparse.Namespace
) -> None:
    """Print which sums differ from those in a file, and exit with 1, or replace them there by the
    options ``given``."""
    check_library()
    document = json.loads(path.read_text())
    sums, n_different = {}, 0
    for name, made in found:
        sums[name] = made
        change = describe_change(document["sums"].get(name), made)
        if change:
            n_different += 1
            print(f"{name}: {change}", flush=True)
    print(f"{len(sums)} compared, {n_different} different")
    if given.write:
        if given.names and document["environment"] != here:
            raise SystemExit("the sums were made elsewhere: replace all, or none")
        document = {"environment": here, "sums": dict(sorted((document["sums"] | sums).items()))}
        text = json.dumps(document, indent=1)
        path.write_text(re.sub(r"\[\n\s+(.*),\n\s+(.*)\n\s+\]", r"[\1, \2]", text) + "\n")
    elif n_different:
        raise SystemExit(1)
