"""Hashes of the sources of kernels, which tell what was edited since the library was built."""

from __future__ import annotations

import functools
import hashlib
import types
from typing import Any

import numpy as np

from kernel_build.signatures import kernel_of
from msal_cli.kernels import library


def check_library() -> None:
    """Exit if a kernel was edited after the library of a checkout was built."""
    for line in library.TABLE.read_text(encoding="utf-8").splitlines():
        signature, *_, made_of = line.split("\t")
        if made_of and source_hash(kernel_of(signature)) != made_of:
            raise SystemExit(f"{signature} was edited: python -m kernel_build")


@functools.cache
def source_hash(kernel: Any) -> str:
    """A hash of the byte code and constants of a ``Kernel`` and of all kernels that it calls; not
    of docstrings and comments."""
    parts: list[Any] = []
    waiting, seen = [kernel], {id(kernel)}
    while waiting:
        function = waiting.pop().function
        code, known = function.__code__, function.__globals__
        if function.__doc__ and code.co_consts[:1] == (function.__doc__,):
            code = code.replace(co_consts=(None, *code.co_consts[1:]))
        # These include names of attributes; to hash too much does no harm.
        modules = [value for value in known.values() if is_kernel_module(value)]
        known = {name: value for of in (*map(vars, modules), known) for name, value in of.items()}
        values = {name: known[name] for name in _names(code) if name in known}
        parts.append((_plain_code(code), [(name, _plain(one)) for name, one in values.items()]))
        for value in values.values():
            if isinstance(value, type(kernel)) and id(value) not in seen:
                seen.add(id(value))
                waiting.append(value)
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def _names(code: types.CodeType) -> list[str]:
    """The names of globals, and of attributes, in the order in which the code has them."""
    names = list(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names += _names(constant)
    return names


def _plain_code(code: types.CodeType) -> tuple[Any, ...]:
    constants = [
        _plain_code(one) if isinstance(one, types.CodeType) else _plain(one)
        for one in code.co_consts
    ]
    return code.co_code, constants, code.co_names, code.co_varnames, code.co_flags


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()
    if value is None or isinstance(value, bool | int | float | str | bytes | tuple | np.generic):
        # The type counts too: 1, 1.0 and True are compiled differently.
        return type(value).__name__, repr(value)
    return getattr(value, "__name__", type(value).__name__)


def is_kernel_module(value: Any) -> bool:
    """Whether a value is a module of kernels, which kernels call as ``module.function``."""
    return isinstance(value, types.ModuleType) and value.__name__.startswith("msal_cli.kernels.")
