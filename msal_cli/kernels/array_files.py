"""Memory of large arrays: kept for the next ones, or in files without a name, so that the system
moves them in and out of memory.

numpy asks an allocator of ours (NEP 49, ``kernel_build/array_files.c``) for the memory of its
arrays, and so do kernels for theirs.  In files, that of a large one is a mapped file of a scratch
folder that no other user can open, whose space is taken at once, and which ends with its array or
the process.
The functions that compute are the same, and so are the bytes.
"""

import ctypes
import functools
import importlib
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from msal_cli.kernels.library import open_library

_SET_HANDLER = 304
"""The place of ``PyDataMem_SetHandler`` in numpy's table of functions, the same since 1.22."""

_lock = threading.Lock()
_users = 0
_keepers = 0


class Scratch(NamedTuple):
    """What arrays in files take now and have taken at most, in bytes, and why the last one was
    refused (``errno``; 0 if none was)."""

    current_bytes: int
    peak_bytes: int
    error: int


def can_use_files() -> bool:
    """Whether arrays can live in files here."""
    return sys.platform.startswith("linux") and sys.byteorder == "little"


def are_used() -> bool:
    """Whether large arrays of this process live in files now."""
    return _users > 0


@contextmanager
def arrays_in_files(folder: str, smallest: int) -> Iterator[None]:
    """Have arrays of ``smallest`` bytes and more, which are made in this thread and by kernels,
    live in files of a folder.

    The first folder counts where several calls are at work in one process.  Raises OSError where
    it cannot be opened.
    """
    global _users
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with _lock:
            _users += 1
            if _users == 1:
                open_library().msal_use_array_files(os.dup(handle), ctypes.c_size_t(smallest))
    finally:
        os.close(handle)
    try:
        with _own_allocator():
            yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                open_library().msal_use_array_files(-1, ctypes.c_size_t(0))


@contextmanager
def kept_memory() -> Iterator[None]:
    """Have large arrays, which are made in this thread and by kernels, take memory of those that
    have ended: what the system gives has to be cleared first, and it may take long to find.

    With the arrays it is no more than these have taken, and at the end it is released.
    """
    global _keepers
    if not can_use_files():
        yield
        return
    with _lock:
        _keepers += 1
        if _keepers == 1:
            open_library().msal_keep_memory(1)
    try:
        with _own_allocator():
            yield
    finally:
        with _lock:
            _keepers -= 1
            if not _keepers:
                open_library().msal_keep_memory(0)


def release_kept() -> None:
    """Give back what ``kept_memory`` keeps now: a file that is written takes memory, too."""
    with _lock:
        if _keepers:
            open_library().msal_keep_memory(1)


def count_scratch() -> Scratch:
    """What arrays in files take."""
    now, peak, error = ctypes.c_size_t(), ctypes.c_size_t(), ctypes.c_int()
    if can_use_files():
        open_library().msal_count_array_files(*map(ctypes.byref, (now, peak, error)))
    return Scratch(now.value, peak.value, error.value)


@contextmanager
def _own_allocator() -> Iterator[None]:
    """Have numpy ask ours for the memory of arrays that are made in this thread."""
    before = _set_handler()(_handler())
    try:
        yield
    finally:
        _set_handler()(before)


@functools.cache
def _handler() -> Any:
    new_capsule = ctypes.pythonapi.PyCapsule_New
    new_capsule.restype = ctypes.py_object
    new_capsule.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    handler = ctypes.c_char.in_dll(open_library(), "msal_array_handler")
    return new_capsule(ctypes.addressof(handler), b"mem_handler", None)


@functools.cache
def _set_handler() -> Any:
    """numpy's function that takes a handler and gives the one before."""
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
