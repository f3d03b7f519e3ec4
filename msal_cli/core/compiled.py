"""Kernels: Python functions over arrays and numbers, compiled by numba once per machine.

Importing numba, and letting it load its own cache, takes longer than denoising a small mesh.  So
the machine code is kept in a cache of our own (``machine_code``) and loaded from there: numba
is imported only where there is something to compile.

The key of a cached kernel holds everything that its code depends on: the byte code and constants
of the kernel and of all kernels that it calls, the types of its arguments, the versions of Python,
numba and LLVM, and the processor.  A change anywhere makes a new key.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import hashlib
import logging
import os
import threading
import types
from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np

from msal_cli.core import machine_code

AUTO = "auto"
"""The route of what choosing takes, and what is mostly chosen, beyond the default method."""

_LOCK = threading.RLock()
_log = logging.getLogger("msal.core")

# Not in ``ahead``, which nobody imports whose kernels are all in the cache.
_EXPECTED: dict[str, None] = {}


class Kernel:
    """A compiled function; call it like the function itself.

    Arguments are numbers, truth values and arrays of native byte order; results are numbers, or
    tuples of numbers.  The interpreter lock is released while it runs.  Kernels may call kernels.
    With ``NUMBA_DISABLE_JIT=1`` in the environment it is the plain Python function.
    """

    def __init__(self, function: types.FunctionType) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self._native: dict[tuple[Any, ...], Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        """The result of the function for these arguments."""
        kinds = tuple([kind(argument) for argument in arguments])
        native = self._native.get(kinds)
        if native is None:
            with _LOCK:
                native = self._native.get(kinds) or self._prepared(kinds)
                self._native[kinds] = native
        return native(*arguments)

    def _prepared(self, kinds: tuple[Any, ...]) -> Callable[..., Any]:
        if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
            return self.function
        name, said = self._key(kinds)
        try:
            code = machine_code.found(name, said)
            if code is None:
                from msal_cli.core import ahead

                ahead.begin(name, kinds, tuple(_EXPECTED))
                with machine_code.alone(name, said), _garbage_left():
                    # Whoever was first has kept it by now.
                    code = machine_code.found(name, said)
                    if code is None:
                        code = self._compiled(kinds)
                        machine_code.keep(name, said, code)
            return machine_code.loaded(code, kinds)
        except (ImportError, AttributeError) as error:
            # A numba that has changed inside still compiles; only every start takes longer.
            _log.info("the machine code of %s cannot be kept: %s", name, error)
            return cast("Callable[..., Any]", self._for_numba())

    def keep_ahead(self, kinds: tuple[Any, ...]) -> None:
        """Compile for arguments of these kinds and keep it, unless others have or are at it."""
        name, said = self._key(kinds)
        if machine_code.found(name, said) is None:
            with machine_code.if_in_nobodys_hand(name, said) as is_free, _garbage_left():
                # It may have been kept a moment ago.
                if is_free and machine_code.found(name, said) is None:
                    machine_code.keep(name, said, self._compiled(kinds))

    def _key(self, kinds: tuple[Any, ...]) -> tuple[str, str]:
        """The name of the machine code, and all that it depends on."""
        module = self.function.__module__.rpartition(".")[2]
        return f"{module}.{self.function.__name__}", repr((self.fingerprint, kinds))

    def _compiled(self, kinds: tuple[Any, ...]) -> machine_code.Code:
        signature = tuple(_numba_type(one) for one in kinds)
        self.dispatcher.compile(signature)
        result = self.dispatcher.overloads[signature]
        # What numba's own cache keeps; there is no public way to it.
        return machine_code.Code(
            symbol=result.fndesc.llvm_func_name,
            results=_result_kinds(result.signature.return_type),
            code=result.library._get_compiled_object(),
        )

    @functools.cached_property
    def fingerprint(self) -> str:
        """A hash of all in the source that the machine code depends on."""
        said = []
        waiting, seen = [self], {id(self)}
        while waiting:
            kernel = waiting.pop()
            code, known = kernel.function.__code__, kernel.function.__globals__
            # Names of attributes are among these too; what is hashed in vain does no harm.
            values = {name: known[name] for name in _names(code) if name in known}
            said.append((_plain_code(code), [(name, _plain(one)) for name, one in values.items()]))
            for one in values.values():
                if isinstance(one, Kernel) and id(one) not in seen:
                    seen.add(id(one))
                    waiting.append(one)
        return hashlib.sha256(repr(said).encode()).hexdigest()

    @functools.cached_property
    def dispatcher(self) -> Any:
        """The function as numba compiles it for other kernels and for the cache."""
        # Wrappers for callers in Python would take a third of the time to compile.
        return self._for_numba(no_cpython_wrapper=True, no_cfunc_wrapper=True)

    def _for_numba(self, **options: bool) -> Any:
        from numba import njit

        known = self.function.__globals__
        called = {
            name: known[name].dispatcher
            for name in _globals_used(self.function.__code__)
            if isinstance(known.get(name), Kernel)
        }
        function = types.FunctionType(
            self.function.__code__, {**known, **called}, self.function.__name__
        )
        function.__module__ = self.function.__module__
        # A division by zero gives infinity or no number, as in numpy: a check would be a branch,
        # and a loop with a branch does not become vector code.
        decorate: Any = njit(  # type: ignore[call-overload]
            nogil=True, error_model="numpy", **options
        )
        return decorate(function)


@contextlib.contextmanager
def _garbage_left() -> Iterator[None]:
    """No search for garbage meanwhile: numba makes objects by the million that are needed, and the
    searches among them take a fifth of the time of compiling."""
    is_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if is_enabled:
            gc.enable()


def compiled(function: Callable[..., Any]) -> Kernel:
    """Make a kernel of a function over arrays and numbers (a decorator)."""
    return Kernel(cast(types.FunctionType, function))


def expect(route: str) -> None:
    """Say that this run will need the kernels of a route (see ``ahead``) beside its file's.

    They are compiled ahead once the run lacks any kernel; until then this does nothing.
    """
    _EXPECTED[route] = None


def kind(argument: Any) -> str | tuple[str, int, str, bool, bool]:
    """What decides the machine code for an argument.

    The name of a number's type, or of an array: type, dimensions, layout (C, F or any), whether
    it can be written, whether it is aligned.

    Raises
    ------
    TypeError
        for anything else.
    """
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return argument.dtype.str, argument.ndim, layout, flags.writeable, flags.aligned
    if isinstance(argument, bool | np.bool_):
        return "bool"
    if isinstance(argument, np.generic):
        return argument.dtype.name
    if isinstance(argument, float):
        return "float64"
    if isinstance(argument, int):
        return "int64" if argument < 1 << 63 else "uint64"
    raise TypeError(f"a kernel takes arrays and numbers, not {type(argument).__name__}")


def _numba_type(one: Any) -> Any:
    from numba import from_dtype
    from numba import types as numba_types

    if isinstance(one, str):
        return numba_types.boolean if one == "bool" else getattr(numba_types, one)
    dtype, ndim, layout, is_writeable, is_aligned = one
    return numba_types.Array(
        from_dtype(np.dtype(dtype)), ndim, layout, readonly=not is_writeable, aligned=is_aligned
    )


def _result_kinds(of: Any) -> list[str] | str | None:
    """The name of a number's type, several for a tuple, None for no result."""
    from numba import types as numba_types

    if of == numba_types.none:
        return None
    if isinstance(of, numba_types.BaseTuple):
        return [cast(str, _result_kinds(one)) for one in cast("list[Any]", of)]
    if isinstance(of, numba_types.Literal):
        of = of.literal_type
    return "bool" if of == numba_types.boolean else str(of)


# What the machine code depends on


def _names(code: types.CodeType) -> list[str]:
    """The names of globals, and of attributes, in the order in which the code has them."""
    names = list(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names += _names(constant)
    return names


def _globals_used(code: types.CodeType) -> set[str]:
    import dis

    names = {one.argval for one in dis.get_instructions(code) if one.opname == "LOAD_GLOBAL"}
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names |= _globals_used(constant)
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
