"""The list of kernels and argument types that the library is made of, ``signatures.txt``.

``python -m kernel_build.record`` writes it anew from what the tests ask for.  A line may also be
added by hand, as the error for a combination that is not listed gives it.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Iterable
from pathlib import Path

from msal_cli.kernels.library import Kernel

LIST = Path(__file__).with_name("signatures.txt")


@functools.cache
def listed() -> tuple[str, ...]:
    """The lines of the list, such as ``welding._mark(i4[::1], b1[::1])``."""
    return tuple(LIST.read_text(encoding="utf-8").splitlines())


def write(signatures: Iterable[str]) -> None:
    """Replace the list."""
    LIST.write_text("\n".join(sorted(set(signatures))) + "\n", encoding="utf-8")


def kernel_of(signature: str) -> Kernel:
    """The kernel that a line names."""
    module, _, function = signature.partition("(")[0].partition(".")
    try:
        kernel = getattr(importlib.import_module(f"msal_cli.kernels.{module}"), function)
    except (ImportError, AttributeError):
        kernel = None
    if not isinstance(kernel, Kernel):
        raise SystemExit(f"{LIST.name} has {signature}, but there is no such kernel: take it out")
    return kernel


def arg_types_of(signature: str) -> list[str]:
    """The argument types of a line: ``["f8[:, ::1]", "i8"]``."""
    inside = signature.partition("(")[2].removesuffix(")")
    types, depth, start = [], 0, 0
    for at, letter in enumerate(inside):
        depth += {"[": 1, "]": -1}.get(letter, 0)
        if letter == "," and not depth:
            types.append(inside[start:at].strip())
            start = at + 1
    return [*types, inside[start:].strip()] if inside else []
