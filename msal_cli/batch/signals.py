"""Ctrl-C and the signals that ask a run to end, noticed at a moment when the run can obey."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn


class Terminated(KeyboardInterrupt):
    """SIGTERM or SIGHUP asked the run to end; ``exit_status`` is 128 + ``signum``.

    It is a KeyboardInterrupt so that whoever cleans up after Ctrl-C cleans up after this too.
    """

    def __init__(self, signum: int) -> None:
        super().__init__(f"ended by {signal.Signals(signum).name}")
        self.signum = signum
        self.exit_status = 128 + signum


def raise_for(signum: int) -> NoReturn:
    """KeyboardInterrupt for SIGINT, Terminated for any other signal."""
    if signum == signal.SIGINT:
        raise KeyboardInterrupt
    raise Terminated(signum)


@contextmanager
def noticed(on_signal: Callable[[int], None]) -> Iterator[None]:
    """Call ``on_signal(number)`` at the first SIGINT, SIGTERM or SIGHUP, and raise at the second.

    Only signals that still have Python's default handler are taken over, only in the main thread
    (Python offers no other), and all are given back at the end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    is_noticed = False

    def handle(signum: int, frame: FrameType | None) -> None:
        nonlocal is_noticed
        if is_noticed:
            raise_for(signum)
        is_noticed = True
        on_signal(signum)

    defaults = {"SIGINT": signal.default_int_handler, "SIGTERM": signal.SIG_DFL}
    defaults["SIGHUP"] = signal.SIG_DFL
    taken = {}
    try:
        for name, default in defaults.items():
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) == default:
                taken[number] = signal.signal(number, handle)
        yield
    finally:
        for number, previous in taken.items():
            signal.signal(number, previous)
