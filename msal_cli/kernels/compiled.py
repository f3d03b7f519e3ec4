"""Kernels: Python functions over arrays and numbers, compiled by numba when msal is built.

``python -m kernel_build`` in a checkout, and the build of a wheel, compile every kernel for the
argument types in ``kernel_build/signatures.txt`` into one shared library, from which ``library``
loads it at the first call.  A combination of types that is not listed is an error.
"""

import functools
import os
import threading
import types
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from msal_cli.kernels import library

_LOCK = threading.RLock()


class Kernel:
    """A compiled function; call it like the function itself.

    Arguments are numbers, truth values and arrays of native byte order; results are numbers, or
    tuples of numbers.  The interpreter lock is released while it runs.  Kernels may call kernels.
    With ``MSAL_INTERPRET_KERNELS=1`` in the environment it is the plain Python function.
    """

    def __init__(self, function: types.FunctionType) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self._native: dict[tuple[library.ArgType, ...], Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        """The result of the function for these arguments."""
        arg_types = tuple([arg_type(argument) for argument in arguments])
        native = self._native.get(arg_types)
        if native is None:
            with _LOCK:
                native = self._native.get(arg_types) or self._load(arg_types)
                self._native[arg_types] = native
        return native(*arguments)

    def _load(self, arg_types: tuple[library.ArgType, ...]) -> Callable[..., Any]:
        if os.environ.get("MSAL_INTERPRET_KERNELS", "0") not in ("", "0"):
            return self.function
        return library.load(self, arg_types)

    @property
    def name(self) -> str:
        """Module and function, as in ``"geometry._face_vectors"``."""
        module = self.function.__module__.rpartition(".")[2]
        return f"{module}.{self.function.__name__}"


def compiled(function: Callable[..., Any]) -> Kernel:
    """Make a kernel of a function over arrays and numbers (a decorator)."""
    return Kernel(cast(types.FunctionType, function))


def arg_type(argument: Any) -> library.ArgType:
    """What decides the machine code for an argument.

    Of a number the code of its type; of an array that of its items, dimensions and layout (C, F or
    any).  Whether it is writeable or aligned makes no difference.  Raises TypeError for anything
    else.
    """
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return argument.dtype.str, argument.ndim, layout
    if isinstance(argument, bool | np.bool_):
        return "b1"
    if isinstance(argument, np.generic):
        return argument.dtype.str[1:]
    if isinstance(argument, float):
        return "f8"
    if isinstance(argument, int):
        return "i8" if argument < 1 << 63 else "u8"
    if isinstance(argument, tuple):
        # Only kernels that are interpreted give each other tuples in this way.
        return f"({', '.join(str(arg_type(one)) for one in argument)})"
    raise TypeError(f"a kernel takes arrays and numbers, not {type(argument).__name__}")
