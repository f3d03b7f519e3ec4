"""SHA-256 of files, worked out while something else is done."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable

from msal_cli.storage.buffers import Buffer

LARGE_BYTES = 1 << 20
"""Bytes from which on a thread is worth its start."""

_PIECE = 4 << 20


def sha256_meanwhile(data: Buffer) -> Callable[[], str]:
    """Begin to hash ``data``, which must not change; call what is returned for the hex digits.

    Other threads run on: a second core hashes while the first one parses, and even a single core
    hashes while the disk writes.
    """
    if len(data) < LARGE_BYTES:
        digits = hashlib.sha256(data).hexdigest()
        return lambda: digits
    state = hashlib.sha256()
    thread = threading.Thread(target=state.update, args=(data,), daemon=True)
    try:
        thread.start()
    except RuntimeError:
        # The system gives no more threads.
        digits = hashlib.sha256(data).hexdigest()
        return lambda: digits

    def wait() -> str:
        thread.join()
        return state.hexdigest()

    return wait
