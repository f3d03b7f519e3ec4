"""A test that must not wait: an alarm ends it where it does."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Fail with AssertionError if the block takes longer; for POSIX, in the main thread."""

    def fail(signum: int, frame: object) -> None:
        raise AssertionError(f"it waits: {seconds} s have passed")

    before = signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
