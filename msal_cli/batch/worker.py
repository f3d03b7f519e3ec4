"""The inside of a worker process: take a task, do it, hand back the result, wait for the next.

The parent writes to standard input and reads from what was standard output; both are hidden from
everything else first, so that a library which prints or reads cannot interfere.
A message is a pickle behind its length (8 bytes, little endian).
"""

from __future__ import annotations

import faulthandler
import logging
import os
import pickle
import queue
import signal
import struct
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from msal_cli.job.room import are_arrays_in_files
from msal_cli.job.settings import FORECAST
from msal_cli.machine import peak_bytes, usable_cores

if TYPE_CHECKING:
    from msal_cli.job.pipeline import OnProgress
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Settings, Task

    Denoise = Callable[..., MeshRecord]
    """What does one file, such as ``pipeline.denoise_file``."""

_LENGTH = struct.Struct("<Q")

# More often is a waste of both processes' time, and the stages of a file that is done sooner are
# nothing to see.
_BETWEEN_PROGRESS_S = 0.05

_BETWEEN_CHECKS_S = 0.05

_STACK_BYTES = 8 << 20


@dataclass(frozen=True)
class Assignment:
    """The first message to a worker: ``function(task, common, on_progress)`` is its work, and
    ``memory_bytes`` what it may use for it."""

    function: Callable[[Any, Any, Callable[[str, int, int], None]], Any]
    common: Any
    log_level: int
    memory_bytes: int | None = None


def write_message(handle: int, message: object) -> None:
    """Send one message to a pipe; OSError if it has no reader."""
    body = pickle.dumps(message, protocol=5)
    rest = memoryview(_LENGTH.pack(len(body)) + body)
    while rest:
        rest = rest[os.write(handle, rest) :]


def read_message(handle: int) -> Any:
    """The next message of a pipe; EOFError at its end, also within a message."""
    (length,) = _LENGTH.unpack(_read_exactly(handle, _LENGTH.size))
    return pickle.loads(_read_exactly(handle, length))


def _read_exactly(handle: int, length: int) -> bytes:
    parts = []
    while length:
        part = os.read(handle, min(length, 1 << 20))
        if not part:
            raise EOFError
        parts.append(part)
        length -= len(part)
    return b"".join(parts)


def serve() -> None:
    """Work until the parent closes the pipe or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _die_with_parent()
    orders, answers = _private_pipes()
    faulthandler.enable()
    outgoing = _Outgoing(answers)
    try:
        assignment: Assignment = read_message(orders)
        _log_to_parent(outgoing, assignment.log_level)
    except EOFError:
        return
    except BaseException:
        outgoing.send("unusable", traceback.format_exc())
        return
    limit = assignment.memory_bytes
    if limit is not None:
        _load_libraries()
        threading.Thread(target=_watch_memory, args=(limit, outgoing), daemon=True).start()
    tasks: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(orders, tasks), daemon=True).start()
    outgoing.send("ready", os.getpid())
    while True:
        _do(assignment, *tasks.get(), outgoing)


def _receive(orders: int, tasks: queue.SimpleQueue[tuple[int, Any]]) -> None:
    """Pass tasks on; end the whole process, even in the middle of a task, with the parent."""
    while True:
        try:
            tasks.put(read_message(orders))
        except EOFError:
            os._exit(0)


class _Outgoing:
    """The way to the parent, for all threads."""

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self._lock = threading.Lock()

    def send(self, *message: Any) -> None:
        try:
            with self._lock:
                write_message(self._handle, message)
        except OSError:
            os._exit(0)


def _do(assignment: Assignment, index: int, task: Any, outgoing: _Outgoing) -> None:
    begun = time.monotonic()
    last = ("", 0.0)

    def on_progress(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        is_new = stage != last[0] and (not last[0] or now - begun >= _BETWEEN_PROGRESS_S)
        if is_new or done == total or now - last[1] >= _BETWEEN_PROGRESS_S:
            last = (stage, now)
            outgoing.send("progress", index, stage, done, total)

    try:
        if assignment.memory_bytes is not None:
            _limit_memory(assignment.memory_bytes)
        result = assignment.function(task, assignment.common, on_progress)
        outgoing.send("returned", index, result, memory_bytes("self", "VmRSS"))
    except MemoryError:
        outgoing.send("exhausted")
    except BaseException as error:
        # SystemExit included: a library must not end the worker in silence.
        logging.getLogger("msal.batch").error("%s", traceback.format_exc())
        outgoing.send("raised", index, f"{type(error).__name__}: {error}")


def _load_libraries() -> None:
    """Load what every file needs, before memory is limited.

    The library of linear algebra reserves 100 MB that it hardly touches; refused, it would end the
    process, however high the limit is above the 40 MB that are resident.
    """
    import numpy as np

    import msal_cli.job.pipeline  # noqa: F401

    _ = np.ones((200, 200)) @ np.ones((200, 200))


def _limit_memory(limit: int) -> None:
    """Have Linux refuse memory once about ``limit`` bytes are resident.

    The system can bound private writable memory (RLIMIT_DATA), touched or not.  Some of it never
    is (stacks of threads, buffers of libraries), while the code of libraries is resident and not
    writable, so the difference of the two is allowed for, anew for every file.
    """
    if not sys.platform.startswith("linux"):
        return
    import resource

    own = memory_bytes("self", "VmData") - memory_bytes("self", "VmRSS")
    # Kernels will start threads, and a limit may leave less than their stacks.
    own += (usable_cores() + 1) * _STACK_BYTES
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    wanted = max(0, limit + own)
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))


def _watch_memory(limit: int, outgoing: _Outgoing) -> None:
    """End this process once it has used too much: where the system cannot refuse memory, and for
    pages of files, which Linux does not count.  Those of arrays are released by ``room``."""
    while True:
        time.sleep(_BETWEEN_CHECKS_S)
        used = memory_bytes("self", "VmRSS") or peak_bytes() or 0
        if used > limit and not are_arrays_in_files():
            outgoing.send("exhausted")
            os._exit(1)


def _private_pipes() -> tuple[int, int]:
    """Copies of standard input and output; the originals then lead to nothing and to stderr."""
    sys.stdout.flush()
    orders, answers = os.dup(0), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    if sys.platform == "win32":
        import msvcrt

        msvcrt.setmode(orders, os.O_BINARY)
        msvcrt.setmode(answers, os.O_BINARY)
    return orders, answers


def _die_with_parent() -> None:
    """On Linux, ask the system to kill this process with its parent, however busy it is."""
    if not sys.platform.startswith("linux"):
        return
    try:
        import ctypes

        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, int(signal.SIGKILL), 0, 0, 0)
    except (ImportError, OSError, AttributeError):
        # The end of the pipe has the same effect, only a moment later.
        return


class _ParentLog(logging.Handler):
    def __init__(self, outgoing: _Outgoing) -> None:
        super().__init__()
        self._outgoing = outgoing

    def emit(self, record: logging.LogRecord) -> None:
        self._outgoing.send("log", record.name, record.levelno, self.format(record))


def _log_to_parent(outgoing: _Outgoing, level: int) -> None:
    root = logging.getLogger()
    root.addHandler(_ParentLog(outgoing))
    root.setLevel(logging.WARNING)
    logging.getLogger("msal").setLevel(level)


def memory_bytes(pid: int | str, name: str) -> int:
    """A figure of ``/proc/PID/status`` such as ``VmRSS``; 0 where it is not known."""
    try:
        with open(f"/proc/{pid}/status", "rb") as file:
            for line in file:
                if line.startswith(name.encode() + b":"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    return 0


def denoise_in_worker(
    task: Task, common: tuple[Denoise, Settings], on_progress: OnProgress
) -> MeshRecord:
    """One file, in a worker.  MemoryError is raised again, so that the file gets its second try
    alone and the worker, whose heap is fragmented, is replaced.  That there was not enough memory
    by forecast would come again."""
    denoise, settings = common
    record = denoise(task, settings, on_progress)
    error = record.error
    if error is not None and error.code == "E_MEMORY" and error.where != FORECAST:
        raise MemoryError(error.message)
    return record
