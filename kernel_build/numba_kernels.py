"""Kernels as numba compiles them."""

from __future__ import annotations

import dis
import functools
import types
from typing import Any, cast

from kernel_build.sources import is_kernel_module
from msal_cli.kernels.library import Kernel


def to_dispatcher(kernel: Kernel, **options: bool) -> Any:
    """The kernel as a function of numba's, with the options of ``numba.njit``.

    Kernels that it calls become functions of numba's too.
    """
    return _dispatcher(kernel, tuple(sorted(options.items())))


@functools.cache
def _dispatcher(kernel: Kernel, options: tuple[tuple[str, bool], ...]) -> Any:
    from numba import njit

    from kernel_build.lanes import COMPILED

    known = kernel.function.__globals__
    called = {}
    for name in _globals_used(kernel.function.__code__):
        value = known.get(name)
        if isinstance(value, Kernel):
            called[name] = _dispatcher(value, options)
        elif isinstance(value, types.FunctionType) and value in COMPILED:
            called[name] = COMPILED[value]
        elif is_kernel_module(value):
            called[name] = _module(value, options)
    function = types.FunctionType(
        kernel.function.__code__, {**known, **called}, kernel.function.__name__
    )
    function.__module__ = kernel.function.__module__
    # A division by zero gives infinity or no number, as in numpy: a check would be a branch,
    # and a loop with a branch does not become vector code.
    decorate: Any = njit(nogil=True, error_model="numpy", **dict(options))  # type: ignore[call-overload]
    return decorate(function)


@functools.cache
def _module(module: types.ModuleType, options: tuple[tuple[str, bool], ...]) -> types.ModuleType:
    """The same module with numba's functions in place of kernels, to be inlined before anything
    else: what they return would stay in memory otherwise."""
    copy = types.ModuleType(module.__name__)
    inlined = (*options, ("forceinline", True))
    for name, value in vars(module).items():
        vars(copy)[name] = _dispatcher(value, inlined) if isinstance(value, Kernel) else value
    return copy


def _globals_used(code: types.CodeType) -> set[str]:
    names = {one.argval for one in dis.get_instructions(code) if one.opname == "LOAD_GLOBAL"}
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names |= _globals_used(constant)
    return names


def numba_type(text: str, *, is_written: bool) -> Any:
    """numba's type for one of ``library.signature``, such as ``f8[:, ::1]``."""
    from numba import types as numba_types
    from numba.np.numpy_support import from_dtype

    code, _, steps = text.partition("[")
    scalar = numba_types.boolean if code == "b1" else from_dtype(_dtype(code))
    if not steps:
        return scalar
    dimensions = steps.removesuffix("]").split(", ")
    layout: Any = "A"
    if "::1" in dimensions:
        layout = "C" if dimensions[-1] == "::1" else "F"
    array: Any = numba_types.Array
    # Not aligned: the same instructions serve arrays of both kinds at the same speed.
    return array(scalar, len(dimensions), layout, readonly=not is_written, aligned=False)


def _dtype(code: str) -> Any:
    import numpy as np

    return np.dtype(code)


def result_types(of: Any) -> str:
    """The types of a result as in the table: ``f8``, ``(f8, i8)``, nothing for none."""
    from numba import types as numba_types
    from numba.np.numpy_support import as_dtype

    if of == numba_types.none:
        return ""
    if isinstance(of, numba_types.BaseTuple):
        return f"({', '.join([result_types(one) for one in list(cast(Any, of))])})"
    if isinstance(of, numba_types.Literal):
        of = of.literal_type
    return "b1" if of == numba_types.boolean else str(as_dtype(of).str[1:])
