"""A worker process seen from the parent: how it is started, read and closed."""

from __future__ import annotations

import collections
import json
import logging
import math
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from msal_cli.batch.worker import Assignment, read_message, write_message
from msal_cli.errors import ResourceError

# Without -P the first entry of the search path would be the current folder, which may hold any
# files.
_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from msal_cli.batch.worker import serve; serve()"
)
_THREAD_VARIABLES = ("MSAL_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_LAST_LINES = 40

_log = logging.getLogger("msal.batch")


@dataclass(eq=False)
class WorkerProcess:
    """One worker and what is known of it.

    ``deadline`` is when (``time.monotonic``) it is to be killed, and ``is_overdue`` that it was;
    ``kills_before`` counts the processes that the system had killed because memory ran out when
    its current task began, and ``is_near_limit`` that it was seen close to its memory limit.
    """

    process: subprocess.Popen[bytes]
    pid: int
    cores: int
    deadline: float = math.inf
    readers: list[threading.Thread] = field(default_factory=list)
    is_ready: bool = False
    is_dismissed: bool = False
    is_overdue: bool = False
    is_near_limit: bool = False
    current_task: int | None = None
    n_done: int = 0
    first_bytes: int = 0
    resident_bytes: int = 0
    kills_before: int = 0
    last_lines: collections.deque[str] = field(
        default_factory=lambda: collections.deque(maxlen=_LAST_LINES)
    )

    def send(self, message: object) -> bool:
        """Send a message; False if the worker has died, which its reader will report."""
        try:
            write_message(self.process.stdin.fileno(), message)  # type: ignore[union-attr]
        except OSError:
            return False
        return True

    def dismiss(self) -> None:
        """End it at once, whatever it does."""
        self.is_dismissed = True
        self.process.kill()

    def close(self) -> None:
        """Close the pipes; the worker has ended."""
        for thread in self.readers:
            thread.join(1.0)
        if not any(thread.is_alive() for thread in self.readers):
            # Otherwise a grandchild has a pipe open, and its number must not be given to another.
            for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
                if pipe is not None:
                    pipe.close()


Inbox = queue.SimpleQueue[tuple[WorkerProcess | None, tuple[Any, ...]]]
"""Messages of workers; those without a worker are from the parent to itself."""


def start_worker(assignment: Assignment, cores: int, inbox: Inbox) -> WorkerProcess:
    """A new worker that computes with ``cores`` threads and sends its messages to ``inbox``.

    Raises
    ------
    ResourceError
        if the system cannot start a process.
    """
    environment = dict(os.environ)
    # What the user has set stays.
    for name in _THREAD_VARIABLES:
        environment.setdefault(name, str(cores))
    command = [sys.executable, "-P", "-X", f"utf8={sys.flags.utf8_mode}", "-c", _BOOT]
    # A group of its own keeps the terminal's Ctrl-C from the worker: the parent decides.
    grouped: dict[str, Any] = {"process_group": 0}
    if sys.platform == "win32":
        grouped = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    try:
        process = subprocess.Popen(
            [*command, json.dumps(sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            env=environment,
            **grouped,
        )
    except OSError as error:
        raise ResourceError(
            f"no worker can be started: {error.strerror}",
            hint="there may not be enough memory, or too many processes",
        ) from None
    worker = WorkerProcess(process, process.pid, cores)
    output_reader = threading.Thread(target=_read_output, args=(worker,), daemon=True)
    message_reader = threading.Thread(
        target=_read_messages, args=(worker, output_reader, inbox), daemon=True
    )
    for thread in (output_reader, message_reader):
        worker.readers.append(thread)
        thread.start()
    worker.send(assignment)
    return worker


def _read_messages(worker: WorkerProcess, output_reader: threading.Thread, inbox: Inbox) -> None:
    handle = worker.process.stdout.fileno()  # type: ignore[union-attr]
    try:
        while True:
            inbox.put((worker, read_message(handle)))
    except (EOFError, OSError):
        code = worker.process.wait()
        # What it printed last is worth a moment, but a grandchild may hold that pipe for ever.
        output_reader.join(0.5)
        inbox.put((worker, ("gone", code)))


def _read_output(worker: WorkerProcess) -> None:
    handle = worker.process.stderr.fileno()  # type: ignore[union-attr]
    rest = b""
    while part := os.read(handle, 1 << 16):
        *lines, rest = (rest + part).split(b"\n")
        rest = rest[-4096:]
        _note(worker, lines)
    _note(worker, [rest] if rest else [])


def _note(worker: WorkerProcess, lines: Sequence[bytes]) -> None:
    for line in lines:
        text = line[:4096].decode(errors="replace").rstrip()
        worker.last_lines.append(text)
        _log.debug("worker %d prints: %s", worker.process.pid, text)
