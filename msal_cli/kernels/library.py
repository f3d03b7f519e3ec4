"""Kernels: Python functions over arrays and numbers, compiled by numba when msal is built.

``python -m kernel_build`` in a checkout, and the build of a wheel, compile every kernel for the
argument types in ``kernel_build/signatures.txt`` into one shared library, from which it is loaded
at its first call.  Combinations that are not listed raise an error.  The table beside the library
has a line for each::

    geometry._sums(i8, f8[:, ::1], f8[::1])    geometry__sums_1f0c    f8    2    9c56...

It gives, separated by tabs, the signature (numpy's codes of types; ``f8[:, ::1]`` is an array in
C order, ``[::1, :]`` in Fortran order), the symbol, the types of the results, the positions of the
arguments that the kernel writes to, and a hash of its source, in a checkout.

On x86-64 the library has code for two levels of processor; ``MSAL_CPU=v2`` chooses the lower.
"""

import ctypes
import functools
import os
import sys
import threading
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from msal_cli.errors import InternalError

ArgType = str | tuple[str, int, str]
"""The type of an argument, see ``arg_type``."""

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
LIBRARY = Path(__file__).with_name(f"_kernels{SUFFIX}")
TABLE = Path(__file__).with_name("_kernels.txt")

_REBUILD = "python -m kernel_build"
_NATIVE_ORDER = ("|", "<" if sys.byteorder == "little" else ">")
_C_TYPES: dict[str, Any] = {
    "b1": ctypes.c_uint8,
    "i1": ctypes.c_int8,
    "i2": ctypes.c_int16,
    "i4": ctypes.c_int32,
    "i8": ctypes.c_int64,
    "u1": ctypes.c_uint8,
    "u2": ctypes.c_uint16,
    "u4": ctypes.c_uint32,
    "u8": ctypes.c_uint64,
    "f4": ctypes.c_float,
    "f8": ctypes.c_double,
}


_LOCK = threading.RLock()


class Kernel:
    """A compiled function, which is called like the Python function.

    Arguments are numbers, booleans and arrays of native byte order; results are numbers, or tuples
    of numbers.  The interpreter lock is released while it runs.  Kernels may call kernels.  With
    ``MSAL_INTERPRET_KERNELS=1`` in the environment it is the plain Python function.
    """

    def __init__(self, function: types.FunctionType) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self._native: dict[tuple[ArgType, ...], Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        """The result of the function for these arguments."""
        arg_types = tuple([arg_type(argument) for argument in arguments])
        native = self._native.get(arg_types)
        if native is None:
            with _LOCK:
                native = self._native.get(arg_types) or self._load(arg_types)
                self._native[arg_types] = native
        return native(*arguments)

    def _load(self, arg_types: tuple[ArgType, ...]) -> Callable[..., Any]:
        if os.environ.get("MSAL_INTERPRET_KERNELS", "0") not in ("", "0"):
            return self.function
        return load(self, arg_types)

    @property
    def name(self) -> str:
        """Module and function, as in ``"geometry._face_vectors"``."""
        module = self.function.__module__.rpartition(".")[2]
        return f"{module}.{self.function.__name__}"


def compiled(function: Callable[..., Any]) -> Kernel:
    """Decorator that makes a kernel of a function over arrays and numbers."""
    return Kernel(cast(types.FunctionType, function))


def arg_type(argument: Any) -> ArgType:
    """The type of an argument, which selects the machine code.

    For a number it is the code of its type; for an array that of its items, its dimensions and
    layout (C, F or any), whether or not it is writeable or aligned.  Raises TypeError for others.
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
        # Only interpreted kernels pass tuples to each other.
        return f"({', '.join(str(arg_type(one)) for one in argument)})"
    raise TypeError(f"a kernel takes arrays and numbers, not {type(argument).__name__}")


class Entry(NamedTuple):
    """The table's entry of a kernel for one combination of argument types."""

    symbol: str
    results: str
    written: frozenset[int]


def load(kernel: Kernel, arg_types: tuple[ArgType, ...]) -> Callable[..., Any]:
    """The machine code of a kernel for these argument types, as a function; InternalError if the
    library does not have it."""
    text = signature(kernel.name, arg_types)
    entry = _entries().get(text)
    if entry is None:
        if not TABLE.exists():
            raise _missing("is not installed")
        raise InternalError(
            f"the kernel library has no {text}",
            hint="please report this line; developers: add the signature to "
            f"kernel_build/signatures.txt and run {_REBUILD}",
        )
    return bind(open_library(), entry, arg_types)


def signature(name: str, arg_types: tuple[ArgType, ...]) -> str:
    """The key of a kernel with its argument types in the table."""
    return f"{name}({', '.join([_type_text(arg_type) for arg_type in arg_types])})"


def _type_text(arg_type: ArgType) -> str:
    if isinstance(arg_type, str):
        return arg_type
    code, ndim, layout = arg_type
    steps = [":"] * ndim
    if ndim and layout != "A":
        steps[-1 if layout == "C" else 0] = "::1"
    order = "" if code[0] in _NATIVE_ORDER else "swapped "
    return f"{order}{code[1:]}[{', '.join(steps)}]"


def read_table(text: str) -> dict[str, Entry]:
    """The entries of a table by their signatures."""
    entries = {}
    for line in text.splitlines():
        key, symbol, results, written, _ = line.split("\t")
        positions = frozenset([int(at) for at in written.split()])
        entries[key] = Entry(symbol, results, positions)
    return entries


@functools.cache
def _entries() -> dict[str, Entry]:
    try:
        return read_table(TABLE.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}


@functools.cache
def open_library() -> ctypes.CDLL:
    """The library of kernels; InternalError if it cannot be loaded."""
    try:
        return ctypes.CDLL(str(LIBRARY))
    except OSError as error:
        raise _missing(f"cannot be loaded: {error}") from None


def level_suffix(library: ctypes.CDLL) -> str:
    """The suffix of symbols for this processor; InternalError if ``MSAL_CPU`` names a level that
    the library or the processor does not have."""
    level: int = library.msal_cpu_level()
    wanted = os.environ.get("MSAL_CPU", "")
    if not level:
        return ""
    if wanted and wanted not in {f"v{number}" for number in range(2, level + 1)}:
        raise InternalError(
            f"MSAL_CPU is {wanted}, but this processor has v2 to v{level}", hint="unset MSAL_CPU"
        )
    suffix = f"_{wanted or f'v{level}'}"
    if not hasattr(library, f"msal_has{suffix}"):
        raise InternalError(
            f"the kernel library has no code for x86-64{suffix.replace('_', '-')}",
            hint=f"build all levels of processor: {_REBUILD} --all-levels",
        )
    return suffix


def _missing(what: str) -> InternalError:
    return InternalError(
        f"the library of compiled kernels {what}",
        hint=f"install msal again for this system; in a checkout: {_REBUILD}",
    )


# Calls


def bind(library: ctypes.CDLL, entry: Entry, arg_types: tuple[ArgType, ...]) -> Callable[..., Any]:
    """A function that runs a kernel of ``library`` with arguments of these types.

    It raises ValueError if the kernel would write to a read-only array, and RuntimeError if the
    kernel raises an exception.
    """
    function = _prototype(arg_types)((entry.symbol + level_suffix(library), library))
    result_types = entry.results.strip("()").replace(",", " ").split()
    result_struct = _structure(tuple(result_types))
    fields = [f"r{at}" for at in range(len(result_types))]
    is_tuple = entry.results.startswith("(")
    are_arrays = [not isinstance(arg_type, str) for arg_type in arg_types]
    written = [at for at in sorted(entry.written) if are_arrays[at]]

    def call(*arguments: Any) -> Any:
        for at in written:
            if not arguments[at].flags.writeable:
                raise ValueError(f"argument {at} of the kernel {entry.symbol} is read-only")
        failure = ctypes.c_void_p()
        result = result_struct()
        passed: list[Any] = [ctypes.addressof(result), ctypes.addressof(failure)]
        for argument, is_array in zip(arguments, are_arrays, strict=True):
            if is_array:
                passed += (None, None, argument.size, argument.itemsize, argument.ctypes.data)
                passed += argument.shape
                passed += argument.strides
            else:
                # ctypes does not accept numpy's numbers.
                passed.append(argument.item() if hasattr(argument, "item") else argument)
        if function(*passed):
            raise RuntimeError(f"the kernel {entry.symbol} failed")
        if not fields:
            return None
        values = [getattr(result, field) for field in fields]
        return tuple(values) if is_tuple else values[0]

    return call


def _prototype(arg_types: tuple[ArgType, ...]) -> Any:
    """numba's calling convention: pointers to the result and to an exception, then arguments.

    An array becomes its owner and parent (unused here), size, item size, address, shape, strides.
    """
    size = ctypes.c_ssize_t
    slots: list[Any] = [ctypes.c_void_p, ctypes.c_void_p]
    for arg_type in arg_types:
        if isinstance(arg_type, str):
            slots.append(_C_TYPES[arg_type])
        else:
            slots += [ctypes.c_void_p, ctypes.c_void_p, size, size, ctypes.c_void_p]
            slots += [size] * (2 * arg_type[1])
    return ctypes.CFUNCTYPE(ctypes.c_int32, *slots)


@functools.cache
def _structure(names: tuple[str, ...]) -> Any:
    fields = [
        (f"r{at}", ctypes.c_bool if name == "b1" else _C_TYPES[name])
        for at, name in enumerate(names)
    ]
    # Code without a result still clears the memory for one.
    return type("Result", (ctypes.Structure,), {"_fields_": fields or [("none", ctypes.c_void_p)]})
