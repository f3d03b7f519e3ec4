"""End a run on Ctrl-C or a signal, at a moment when it can clean up."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn

MAX_DELAY_S = 1.0  # seconds after a signal at which `end_if_late` ends the process

# SIGBREAK is Ctrl-Break, and the only signal by which a program on Windows can ask another to end.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")


class Terminated(KeyboardInterrupt):
    """SIGTERM, SIGHUP or SIGBREAK asked the run to end; ``exit_status`` is 128 + ``signum``.

    It is a KeyboardInterrupt so that code which cleans up after Ctrl-C cleans up after this too.
    """

    def __init__(self, signum: int) -> None:
        super().__init__(f"ended by {signal.Signals(signum).name}")
        self.signum = signum
        self.exit_status = 128 + signum


def raise_for(signum: int) -> NoReturn:
    if signum == signal.SIGINT:
        raise KeyboardInterrupt
    raise Terminated(signum)


def end_at_once(signum: int, frame: FrameType | None = None) -> NoReturn:
    """End the process with one line and status 128 + ``signum``; nothing is cleaned up.

    A handler that raises an exception may have no effect instead: Python drops exceptions in
    destructors, and some code, such as parts of imports, ignores all exceptions.
    """
    # The interrupted code may hold the lock of Python's buffered streams.
    start = b"\n" if os.isatty(2) else b""
    try:
        os.write(2, start + b"msal: interrupted\n")
    finally:
        os._exit(128 + signum)


class Cancellation:
    """Ends a run from another thread, as Ctrl-C ends one in the main thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._is_requested = False
        self._on_request: Callable[[], object] = lambda: None

    def request(self) -> None:
        """Ask the run to end; it raises KeyboardInterrupt soon after."""
        with self._lock:
            self._is_requested = True
            self._on_request()

    def check(self) -> None:
        """Raise KeyboardInterrupt if the run has been asked to end."""
        if self._is_requested:
            raise KeyboardInterrupt

    @contextmanager
    def notify(self, on_request: Callable[[], object]) -> Iterator[None]:
        """Within the block, call ``on_request()`` at a request, or now if there was one already."""
        with self._lock:
            self._on_request = on_request
            if self._is_requested:
                on_request()
        try:
            yield
        finally:
            with self._lock:
                self._on_request = lambda: None


@contextmanager
def end_on_signal() -> Iterator[None]:
    """Let SIGINT, SIGTERM and the like end the process at once, while nothing has been touched."""
    with _install(end_at_once), end_if_late(lambda: None):
        yield


@contextmanager
def catch_signals(on_signal: Callable[[int], None] = raise_for) -> Iterator[None]:
    """Call ``on_signal(number)`` at the first SIGINT, SIGTERM or the like; the second ends at once.

    Only signals that no other code handles are caught, and only in the main thread, because Python
    runs handlers nowhere else.  All handlers are restored at the end.
    """
    is_first = True

    def handle(signum: int, frame: FrameType | None) -> None:
        nonlocal is_first
        if not is_first:
            end_at_once(signum)
        is_first = False
        on_signal(signum)

    with _install(handle):
        yield


@contextmanager
def end_if_late(clean: Callable[[], object]) -> Iterator[None]:
    """End the process ``MAX_DELAY_S`` after a signal if the block has not been left by then.

    Python runs a handler only once the main thread returns from compiled code, and a kernel can
    take long on a large mesh.  At the signal itself Python writes its number to a pipe.  A thread
    that reads the pipe calls ``clean()`` and ends the process; it ignores signals whose handler
    was not installed here, or has been replaced since the block was entered.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    try:
        receiver, sender = os.pipe()
    except OSError:
        # Too many files are open; the handler itself still works.
        yield
        return
    # Missing on Windows before Python 3.12, and not needed there.
    if hasattr(os, "set_blocking"):
        os.set_blocking(sender, False)
    is_left = threading.Event()
    # Leave alone the signals that other code handles.
    handlers = {
        number: handler
        for number in _numbers()
        if getattr(handler := signal.getsignal(number), "__module__", None) == __name__
    }

    def listen() -> None:
        while number := os.read(receiver, 1):
            handler = handlers.get(number[0])
            if handler is None or signal.getsignal(number[0]) is not handler:
                continue
            if not is_left.wait(MAX_DELAY_S):
                try:
                    clean()
                finally:
                    end_at_once(number[0])

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    previous_fd = signal.set_wakeup_fd(sender, warn_on_full_buffer=False)
    try:
        yield
    finally:
        is_left.set()
        signal.set_wakeup_fd(previous_fd)
        os.close(sender)
        thread.join()
        os.close(receiver)


def _numbers() -> tuple[int, ...]:
    """The signals that ask a process to end, of those that this system has."""
    return tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))


@contextmanager
def _install(handle: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    """Within the block, ``handle`` is the handler of all signals that no other code handles."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    unhandled = (signal.SIG_DFL, signal.default_int_handler, end_at_once)
    previous: dict[int, Any] = {}
    try:
        for number in _numbers():
            if signal.getsignal(number) in unhandled:
                previous[number] = signal.signal(number, handle)
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
