"""Ranges of bytes of a file that is too large to be read whole."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from msal_cli.arrays import Bytes
from msal_cli.errors import InputError, TruncatedError
from msal_cli.storage.regular import NotRegularError, open_regular

BLOCK_BYTES = 8 << 20
"""Bytes that are read at a time where the order of reading is free."""


def file_size(path: str) -> int:
    """Bytes of a regular file; InputError (``E_READ``) where the system cannot open it."""
    try:
        with open_regular(path, buffering=0) as file:
            return os.fstat(file.fileno()).st_size
    except (OSError, ValueError) as failure:
        raise _unreadable(path, failure) from failure


def read_range(path: str, start: int, stop: int) -> Bytes:
    """The bytes (stop - start,) of a file from ``start`` to ``stop``.

    Raises
    ------
    InputError
        with code ``E_READ`` if the system cannot read it.
    TruncatedError
        if the file has become shorter than ``stop``.
    """
    data = np.empty(stop - start, dtype=np.uint8)
    try:
        with open_regular(path, buffering=0) as file:
            file.seek(start)
            rest = data.data
            while len(rest):
                got = file.readinto(rest)  # type: ignore[attr-defined]
                if not got:
                    raise TruncatedError(
                        "the file became shorter while it was read",
                        where=f"byte {stop - len(rest)}",
                        path=path,
                        hint="let no other program write it, and run again",
                    )
                rest = rest[got:]
    except (OSError, ValueError) as failure:
        raise _unreadable(path, failure) from failure
    return data


def split_range(start: int, stop: int, most: int) -> Iterator[tuple[int, int]]:
    """Parts of ``most`` numbers at the most from ``start`` up to ``stop``."""
    for low in range(start, stop, most):
        yield low, min(low + most, stop)


def _unreadable(path: str, failure: OSError | ValueError) -> InputError:
    reason = getattr(failure, "strerror", None) or str(failure)
    return InputError(
        f"the file cannot be read: {reason}",
        path=path,
        code="E_READ",
        hint="write what comes through it to a file first"
        if isinstance(failure, NotRegularError)
        else "check that it exists and that you may read it",
    )
