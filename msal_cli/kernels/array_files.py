"""Memory for large arrays: reused from freed ones, or mapped from unnamed files to save memory.

numpy takes the memory of its arrays from our allocator (NEP 49, ``kernel_build/array_files.c``),
and so do kernels.  With files, the memory of a large array is a mapped file in a scratch folder,
which no other user can open.  Its disk space is reserved at once, and freed with the array or at
the end of the process.  The functions that compute are the same, and so are the bytes.
"""

import ctypes
import functools
import importlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from msal_cli.kernels.library import open_library

_SET_HANDLER = 304
"""Index of ``PyDataMem_SetHandler`` in numpy's table of functions, the same since 1.22."""

_lock = threading.Lock()
_users = {"files": 0, "kept": 0}


class Scratch(NamedTuple):
    """Current and peak size of arrays in files, bytes, and ``errno`` of the last failure or 0."""

    current_bytes: int
    peak_bytes: int
    error: int


def can_use_files() -> bool:
    """Whether this system supports arrays in files."""
    return sys.platform.startswith("linux") and sys.byteorder == "little"


def are_used() -> bool:
    """Whether large arrays of this process are in files now."""
    return _users["files"] > 0


@contextmanager
def arrays_in_files(folder: str, smallest: int) -> Iterator[None]:
    """Keep arrays of ``smallest`` bytes and more, made by this thread and kernels, in files of a
    folder.

    If several calls are active in one process, the folder of the first is used; OSError if that
    cannot be opened.
    """
    use = open_library().msal_use_array_files

    def begin() -> None:
        use(os.open(folder, os.O_RDONLY | os.O_DIRECTORY), ctypes.c_size_t(smallest))

    with _own_allocator("files", begin, lambda: use(-1, ctypes.c_size_t(0))):
        yield


@contextmanager
def kept_memory() -> Iterator[None]:
    """Reuse the memory of freed large arrays for new ones, in this thread and in kernels: new
    memory has to be cleared first by the system, and may be slow to get.

    In total no more memory is used than at the peak of these arrays; it is freed at the end.
    """
    if not can_use_files():
        yield
        return
    keep = open_library().msal_keep_memory
    with _own_allocator("kept", lambda: keep(1), lambda: keep(0)):
        yield


def release_kept() -> None:
    """Free the memory that ``kept_memory`` holds now, for the cache of a file that is written."""
    with _lock:
        if _users["kept"]:
            open_library().msal_keep_memory(1)


def count_scratch() -> Scratch:
    """Current and peak size of arrays in files."""
    now, peak, error = ctypes.c_size_t(), ctypes.c_size_t(), ctypes.c_int()
    if can_use_files():
        open_library().msal_count_array_files(*map(ctypes.byref, (now, peak, error)))
    return Scratch(now.value, peak.value, error.value)


@contextmanager
def _own_allocator(
    purpose: str, begin: Callable[[], object], end: Callable[[], object]
) -> Iterator[None]:
    """Make numpy use our allocator in this thread; ``begin`` is called for the first user of this
    purpose, and ``end`` after the last one."""
    with _lock:
        if not _users[purpose]:
            begin()
        _users[purpose] += 1
    try:
        before = _set_handler()(_handler())
        try:
            yield
        finally:
            _set_handler()(before)
    finally:
        with _lock:
            _users[purpose] -= 1
            if not _users[purpose]:
                end()


@functools.cache
def _handler() -> Any:
    new_capsule = ctypes.pythonapi.PyCapsule_New
    new_capsule.restype = ctypes.py_object
    new_capsule.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    handler = ctypes.c_char.in_dll(open_library(), "msal_array_handler")
    return new_capsule(ctypes.addressof(handler), b"mem_handler", None)


@functools.cache
def _set_handler() -> Any:
    """numpy's function that sets a memory handler and returns the previous one."""
    try:
        core = importlib.import_module("numpy._core._multiarray_umath")
    except ImportError:  # before numpy 2
        core = importlib.import_module("numpy.core._multiarray_umath")
    get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    get_pointer.restype = ctypes.c_void_p
    get_pointer.argtypes = (ctypes.py_object, ctypes.c_char_p)
    table = ctypes.cast(get_pointer(core._ARRAY_API, None), ctypes.POINTER(ctypes.c_void_p))
    address = table[_SET_HANDLER]
    assert address is not None
    return ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)(address)
