"""Calls into other people's readers and writers, made harmless.

What they print, log or warn about is caught; ``sys.exit``, endless loops, recursion, missing
packages and every exception become errors of ours.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import logging
import re
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from msal_cli.errors import (
    FormatError,
    InputError,
    MsalError,
    ResourceError,
    TooLargeError,
    UnsupportedError,
)

LEAST_S = 30.0
"""Seconds that any file may take to be read or written by a library."""

SLOWEST_BYTES_PER_S = 500_000.0
"""A large file may take longer: half the speed of the slowest reader measured (ascii, 1 MB/s)."""

_PACKAGES = {"collada": "pycollada"}
_MOST_NOTES = 5
_TEMPORARY = re.compile(r"[^\s'\"]*\bmsal-[A-Za-z0-9_]{8}[/\\]")
"""The folder that a library was given to write to; its name says nothing, and differs each time."""

T = TypeVar("T")


class _OutOfTimeError(BaseException):
    """Raised within a library; not an Exception, so that its own handlers let it through."""


def time_limit_s(size: int) -> float:
    """Seconds that a file of ``size`` bytes may take."""
    return LEAST_S + size / SLOWEST_BYTES_PER_S


def guarded(call: Callable[[], T], library: str, what: str, size: int) -> tuple[T, tuple[str, ...]]:
    """The result of ``call()`` and what the library had to say, one line each.

    Parameters
    ----------
    call : calls the library.
    library : its name, for messages.
    what : what it does, such as ``"read this VTK file"``.
    size : bytes to be dealt with, from which the time limit follows.

    Raises
    ------
    FormatError
        if the library gives up, in whatever way.
    UnsupportedError
        if it lacks a package, or says that it does not support something.
    TooLargeError
        if it runs out of memory.
    ResourceError
        with code ``E_TIMEOUT`` if it does not end.
    """
    limit_s = time_limit_s(size)
    talk = io.StringIO()
    try:
        with _silenced(talk):
            result = _limited(call, limit_s)
    except MsalError:
        raise
    except _OutOfTimeError:
        raise ResourceError(
            f"{library} did not {what} within {limit_s:.0f} s",
            code="E_TIMEOUT",
            hint="the file is probably damaged; export it again, or convert it to PLY",
        ) from None
    except ImportError as failure:
        raise _missing(failure, library, what) from failure
    except MemoryError as failure:
        raise TooLargeError(
            f"{library} ran out of memory when it was to {what}",
            hint="the file is damaged or very large; convert it to PLY",
        ) from failure
    except (Exception, SystemExit) as failure:
        raise _refused(failure, library, what, talk.getvalue()) from failure
    lines = [" ".join(line.split()) for line in talk.getvalue().splitlines()]
    notes = dict.fromkeys(line.removeprefix("Warning: ") for line in lines if line)
    return result, tuple(f"{library}: {note}" for note in list(notes)[:_MOST_NOTES])


def _missing(failure: ImportError, library: str, what: str) -> UnsupportedError:
    name = getattr(failure, "name", None) or ""
    package = _PACKAGES.get(name, name)
    for word in str(failure).replace("`", " ").split():
        # trimesh raises an ImportError of its own that names what to install.
        if not package and word in _PACKAGES.values():
            package = word
    return UnsupportedError(
        f"{library} cannot {what} without the package {package or '(see its documentation)'}",
        hint=f"pip install {package}" if package else "",
    )


def _refused(failure: BaseException, library: str, what: str, talk: str) -> InputError:
    said = " ".join(str(failure).split()) if isinstance(failure, Exception) else ""
    if not said or said.isdigit():
        said = " ".join(talk.split()) or type(failure).__name__
    said = _TEMPORARY.sub("", said)
    if len(said) > 200:
        said = said[:197] + "..."
    # What was read and cannot be written is no fault of the file's.
    unsupported = isinstance(failure, NotImplementedError) or what.startswith("write")
    kind = UnsupportedError if unsupported else FormatError
    return kind(
        f"{library} cannot {what}: {said}",
        hint="check the file in another program, or convert it to PLY, OBJ or STL",
    )


@contextlib.contextmanager
def _silenced(talk: io.StringIO) -> Iterator[None]:
    logger = logging.getLogger("trimesh")
    was_disabled = logger.disabled
    logger.disabled = True
    try:
        with (
            contextlib.redirect_stdout(talk),
            contextlib.redirect_stderr(talk),
            warnings.catch_warnings(),
            np.errstate(all="ignore"),
        ):
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = was_disabled


def _limited(call: Callable[[], T], limit_s: float) -> T:
    """The result of ``call()``, or ``_OutOfTimeError`` in this thread if it takes longer.

    The readers' endless loops are loops in Python, into which CPython can raise from another
    thread, on every system; a child process per file would cost more than most files take.
    """
    thread = threading.get_ident()
    lock = threading.Lock()
    ended = threading.Event()

    def watch() -> None:
        wait_s = limit_s
        while not ended.wait(wait_s):
            with lock:
                if not ended.is_set():
                    _raise_in(thread, _OutOfTimeError)
            # Once may not be enough: a bare ``except`` in the library swallows it.
            wait_s = 1.0

    def stop() -> None:
        with lock:
            ended.set()
            _raise_in(thread, None)  # takes back one that is pending

    watcher = threading.Thread(target=watch, name="msal-guard", daemon=True)
    try:
        watcher.start()
        return call()
    finally:
        # It may still arrive while the watch is called off, but no second time within a second.
        try:
            stop()
        except _OutOfTimeError:
            stop()
        watcher.join()


def _raise_in(thread: int, kind: type[BaseException] | None) -> None:
    ctypes.pythonapi.PyThreadState_SetAsyncExc(
        ctypes.c_ulong(thread), ctypes.py_object(kind) if kind else None
    )
