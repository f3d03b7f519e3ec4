"""Supervised worker processes: the crash of one costs only its current file.

Every worker is a fresh interpreter that does one task at a time.  Two threads of the parent read
its answers and what it prints, and put messages into one queue; all decisions are made in
the thread that iterates.  No signal of the terminal reaches a worker, and a worker ends when its
pipe is closed, so none outlives the parent.

The parent writes pickles to the standard input of a worker and reads pickles from its standard
output.  The worker moves both to private descriptors first, so that a library which prints or reads
cannot interfere.
"""

from __future__ import annotations

import collections
import contextlib
import faulthandler
import functools
import json
import logging
import math
import os
import pickle
import queue
import re
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from typing import IO, Any

from msal_cli.batch import schedule
from msal_cli.batch.schedule import Failed, Message, Work
from msal_cli.errors import ResourceError
from msal_cli.job.records import Failure, MeshRecord
from msal_cli.job.room import FORECAST
from msal_cli.job.settings import Settings, Task
from msal_cli.light_dataclass import dataclass, field
from msal_cli.machine import forget_peak, memory_bytes, peak_bytes, usable_cores

Denoise = Callable[..., MeshRecord]
"""A function that denoises one file, such as ``pipeline.denoise_file``."""

# Without -P the first entry of the search path would be the current folder, which may contain
# anything.
_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from msal_cli.batch.workers import serve; serve()"
)
_THREAD_VARIABLES = ("MSAL_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_MAX_FALSE_STARTS = 3
_GONE_WITHIN_S = 2.0

# Loading libraries takes long if many processes read them from one network disk.
_READY_WITHIN_S = 600.0

# A process that has not ended so long after SIGKILL hangs in the kernel, perhaps on a dead disk.
_ENDS_WITHIN_S = 10.0

_OUT_OF_MEMORY = re.compile(
    r"bad_alloc|out of memory|cannot allocate memory|failed to map segment|MemoryError|"
    r"memory allocation",
    re.IGNORECASE,
)

_STUCK = "the worker did not exit after SIGKILL; check for a hung disk or network mount"

_log = logging.getLogger("msal.batch")

# A worker is replaced after this many files, or when its memory has grown this much.
_FILES_PER_WORKER = 1000
_GROWTH_BYTES = 512 << 20

# More messages would waste the time of both processes; a file that is done sooner shows no stages.
_BETWEEN_PROGRESS_S = 0.05


class WorkerPool:
    def __init__(self, work: Work) -> None:
        self._work = work
        self._limits = work.limits
        self._jobs = max(1, min(work.jobs, len(work.tasks)))
        self._queue = schedule.TaskQueue(work)
        # For tasks that were lost with their workers: how often, and why the last time.
        self._n_losses: collections.Counter[int] = collections.Counter()
        self._reasons: dict[int, str] = {}
        self._warnings: set[tuple[str, str]] = set()
        self._workers: list[WorkerProcess] = []
        self._inbox: Inbox = queue.SimpleQueue()
        self._false_starts = 0

    def stop(self) -> None:
        self._queue.drop()

    def interrupt(self) -> None:
        self._inbox.put((None, ()))

    def batches(self) -> Generator[list[Message], None, None]:
        """Messages, as they come (see ``schedule.Engine``).

        A task whose worker dies is tried again after all others, alone, in a fresh worker.
        """
        try:
            messages = self._assign()
            while True:
                if messages:
                    yield messages
                if not self._is_busy() and self._queue.is_empty:
                    return
                messages, is_interrupted = [], False
                for worker, message in self._receive():
                    if worker is None:
                        is_interrupted = True
                    else:
                        messages += self._handle_message(worker, message)
                if is_interrupted:
                    yield messages + self._stop_workers()
                    raise schedule.Interrupt
                messages += self._kill_overdue()
                if messages and self._work.reports_first:
                    yield messages
                    messages = []
                # The next tasks go out before the caller processes the results.
                messages += self._assign()
        finally:
            self._end()

    # Assigning tasks

    def _is_busy(self) -> bool:
        return any(worker.current_task is not None for worker in self._workers)

    def _active(self) -> list[WorkerProcess]:
        return [worker for worker in self._workers if not worker.is_dismissed]

    def _assign(self) -> list[Message]:
        """Give tasks to idle workers, and start workers for the rest."""
        if self._queue.is_next_exclusive:
            return [] if self._is_busy() else self._assign_exclusive()
        cores = max(1, self._work.cores // self._jobs)
        started: list[Message] = []
        for worker in self._active():
            if worker.cores != cores and len(self._queue):
                # It was started to run alone, with a thread for every core.
                if worker.current_task is None:
                    worker.dismiss()
            elif worker.is_ready and worker.current_task is None:
                index = self._queue.pop(*self._occupancy(worker))
                started += [] if index is None else self._send_task(worker, index)
        n_free = sum(worker.current_task is None for worker in self._active())
        while (
            len(self._active()) < self._jobs
            and n_free < len(self._queue)
            and self._queue.may_start(*self._occupancy())
        ):
            try:
                self._start(cores)
            except ResourceError as error:
                if not self._active():
                    raise
                _log.info("%s; going on with %d workers", error, len(self._active()))
                break
            n_free += 1
        return started

    def _assign_exclusive(self) -> list[Message]:
        """Give the next task, which must run alone, to a fresh worker that has all cores."""
        unused = [
            worker
            for worker in self._active()
            if not worker.n_done and worker.cores >= self._work.cores
        ]
        alone = unused[0] if unused else self._start(self._work.cores)
        for worker in self._active():
            if worker is not alone:
                worker.dismiss()
        return self._send_task(alone, self._queue.pop_exclusive()) if alone.is_ready else []

    def _occupancy(self, excluded: WorkerProcess | None = None) -> tuple[list[int], int]:
        """The current tasks, and the bytes of memory of idle workers, without ``excluded``."""
        others = [worker for worker in self._active() if worker is not excluded]
        idle_bytes = sum(worker.resident_bytes for worker in others if worker.current_task is None)
        current = [worker.current_task for worker in others if worker.current_task is not None]
        return current, idle_bytes

    def _send_task(self, worker: WorkerProcess, index: int) -> list[Message]:
        if not worker.send((index, self._work.tasks[index])):
            # It died idle; the task never reached it, and the message about its end follows.
            self._queue.put_back(index, is_retry=index in self._reasons)
            worker.is_dismissed = True
            return []
        worker.current_task = index
        if self._limits.timeout_s is not None:
            worker.deadline = time.monotonic() + self._limits.timeout_s
        return [schedule.Started(index)]

    # Messages

    def _receive(self) -> list[tuple[WorkerProcess | None, tuple[Any, ...]]]:
        first = min((worker.deadline for worker in self._workers), default=math.inf)
        if os.name == "nt":
            # Windows delivers Ctrl-C to a waiting thread only between two waits.
            first = min(first, time.monotonic() + 0.2)
        patience_s = None if first == math.inf else max(0.0, first - time.monotonic())
        messages = []
        with contextlib.suppress(queue.Empty):
            messages.append(self._inbox.get(timeout=patience_s))
            while True:
                messages.append(self._inbox.get_nowait())
        return messages

    def _kill_overdue(self) -> list[Message]:
        lost: list[Message] = []
        now = time.monotonic()
        for worker in self._workers:
            if now < worker.deadline:
                continue
            if not worker.is_overdue:
                worker.is_overdue = True
                worker.deadline = now + _ENDS_WITHIN_S
                worker.dismiss()
            elif worker.current_task is not None:
                # It may still write, so the task is not started a second time.
                failure = Failure("E_TIMEOUT", self._timeout_text(), _STUCK)
                lost.append(Failed(worker.current_task, failure))
                worker.current_task, worker.deadline = None, math.inf
        return lost

    def _handle_message(self, worker: WorkerProcess, message: tuple[Any, ...]) -> list[Message]:
        kind, *rest = message
        if kind == "ready":
            worker.is_ready = True
            worker.pid = rest[0]
            worker.deadline = math.inf
            self._false_starts = 0
        elif kind == "progress":
            return [schedule.Progress(*rest)]
        elif kind == "log":
            name, level, text = rest
            is_repeated = level >= logging.WARNING and (name, text) in self._warnings
            if level >= logging.WARNING:
                self._warnings.add((name, text))
            # A problem of the machine is reported by every worker.
            logging.getLogger(name).log(logging.DEBUG if is_repeated else level, "%s", text)
        elif kind == "returned":
            index, result, resident = rest
            self._finish(worker, resident)
            return [schedule.Returned(index, result, self._reasons.get(index, ""))]
        elif kind == "raised":
            index, reason = rest
            self._finish(worker, 0)
            hint = "this is a defect of msal; please report it"
            return [Failed(index, Failure("E_INTERNAL", reason, hint))]
        elif kind == "exhausted":
            # Its heap is fragmented, so the worker is replaced.
            worker.dismiss()
            return self._handle_loss(worker, self._out_of_memory("not enough memory"))
        elif kind == "unusable":
            raise ResourceError(
                f"the workers cannot work: {rest[0].strip().splitlines()[-1]}",
                hint="msal or a library that it needs is not installed properly",
            )
        elif kind == "gone":
            return self._handle_exit(worker, rest[0])
        return []

    def _finish(self, worker: WorkerProcess, resident: int) -> None:
        worker.current_task = None
        worker.deadline = math.inf
        worker.n_done += 1
        worker.resident_bytes = resident
        worker.first_bytes = worker.first_bytes or resident
        has_grown = resident - worker.first_bytes > _GROWTH_BYTES
        if worker.n_done >= _FILES_PER_WORKER or has_grown:
            worker.dismiss()

    # Losses

    def _handle_exit(self, worker: WorkerProcess, code: int) -> list[Message]:
        self._remove(worker)
        if worker.current_task is not None:
            for line in worker.last_lines:
                _log.info("worker %d, before it ended: %s", worker.pid, line)
            return self._handle_loss(worker, self._cause_of_death(worker, code))
        if not worker.is_ready and (worker.is_overdue or not worker.is_dismissed):
            self._false_starts += 1
            if self._false_starts >= _MAX_FALSE_STARTS:
                how = f"the last one {describe_exit(code)}"
                line = worker.last_lines[-1] if worker.last_lines else "it printed nothing"
                raise ResourceError(
                    f"the workers end before they start: {how}; {line}",
                    hint="there may not be enough memory, or too many processes or open files",
                )
        return []

    def _cause_of_death(self, worker: WorkerProcess, code: int) -> Failure:
        """The failure of the current task of a worker that died."""
        if worker.is_overdue:
            hint = "raise --timeout, or look at the file: it may be very large, or damaged"
            return Failure("E_TIMEOUT", self._timeout_text(), hint)
        is_limited = code != -9 and self._limits.memory_bytes is not None
        if is_limited and any(map(_OUT_OF_MEMORY.search, worker.last_lines)):
            return self._out_of_memory(f"the worker {describe_exit(code)} because memory ran out")
        hint = "a library broke on this file; it may be damaged"
        if code == -9:
            hint = "the system may have run out of memory: run fewer jobs at once"
        return Failure("E_CRASH", f"the worker {describe_exit(code)}", hint)

    def _out_of_memory(self, reason: str) -> Failure:
        limit = self._limits.memory_bytes
        if limit is None:
            hint = "run fewer jobs at once, or on a machine with more memory"
            return Failure("E_MEMORY", reason, hint)
        reason = f"{reason}, with a limit of {limit / 1e6:,.0f} MB"
        return Failure("E_MEMORY", reason, "raise --memory-limit if the machine has more")

    def _timeout_text(self) -> str:
        return f"it was not done within {self._limits.timeout_s:g} s"

    def _handle_loss(self, worker: WorkerProcess, failure: Failure) -> list[Message]:
        index, reason = worker.current_task, failure.message
        assert index is not None
        worker.current_task = None
        worker.is_dismissed = True
        if objection := self._work.on_loss(index):
            return [Failed(index, Failure("E_CHANGED", f"{objection}; {reason}", failure.hint))]
        self._n_losses[index] += 1
        n_tries = self._n_losses[index]
        if n_tries <= self._work.retries:
            self._reasons[index] = reason
            self._queue.retry(index)
            return [schedule.Retried(index, reason)]
        if n_tries > 1:
            reason += ", as at the first try" if n_tries == 2 else f" ({n_tries} tries)"
        return [Failed(index, replace(failure, message=reason))]

    # Starting and ending processes

    def _start(self, cores: int) -> WorkerProcess:
        """Start a worker that computes with ``cores`` threads; ResourceError if that fails."""
        environment = dict(os.environ)
        # Values that the user has set stay.
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
                env=environment,
                **grouped,
            )
        except OSError as error:
            raise ResourceError(
                f"no worker can be started: {error.strerror}",
                hint="there may not be enough memory, or too many processes or open files",
            ) from None
        worker = WorkerProcess(process, process.pid, cores, time.monotonic() + _READY_WITHIN_S)
        self._workers.append(worker)
        output_reader = threading.Thread(target=_read_output, args=(worker,), daemon=True)
        arguments = (worker, output_reader, self._inbox)
        message_reader = threading.Thread(target=_read_messages, args=arguments, daemon=True)
        worker.readers += [output_reader, message_reader]
        for thread in worker.readers:
            thread.start()
        work, level = self._work, _log.getEffectiveLevel()
        worker.send((work.function, work.common, level, self._limits.memory_bytes))
        return worker

    def _stop_workers(self) -> list[Message]:
        """Kill all workers; return the results that they had sent before."""
        for worker in self._workers:
            worker.dismiss()
        messages: list[Message] = []
        deadline = time.monotonic() + _GONE_WITHIN_S
        with contextlib.suppress(queue.Empty):
            while self._workers:
                sender, message = self._inbox.get(timeout=max(0.0, deadline - time.monotonic()))
                if sender is not None and message[0] == "gone":
                    self._remove(sender)
                elif sender is not None and message[0] == "returned":
                    messages += self._handle_message(sender, message)
        return messages

    def _end(self) -> None:
        for worker in self._workers:
            worker.process.kill()
        deadline = time.monotonic() + _GONE_WITHIN_S
        for worker in list(self._workers):
            try:
                worker.process.wait(timeout=max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                # It hangs in the kernel, perhaps on a dead network disk; the kill stays pending.
                _log.warning("worker %d does not end", worker.pid)
                continue
            self._remove(worker)

    def _remove(self, worker: WorkerProcess) -> None:
        self._workers.remove(worker)
        worker.close()
        if worker.current_task is not None:
            self._work.on_death(worker.pid, worker.current_task)


def describe_exit(code: int) -> str:
    """How a process ended, in words, from the exit code that ``subprocess`` gives."""
    if code < 0:
        try:
            return f"was killed by {signal.Signals(-code).name}"
        except ValueError:
            return f"was killed by signal {-code}"
    if code >= 0x80000000:
        return f"ended with the exception 0x{code:08X}"
    return f"ended with exit status {code}"


# One process


@dataclass(eq=False)
class WorkerProcess:
    """One worker and its state.

    ``deadline`` is when (``time.monotonic``) it is to be killed; ``is_overdue`` that it was.
    """

    process: subprocess.Popen[bytes]
    pid: int
    cores: int
    deadline: float = math.inf
    readers: list[threading.Thread] = field(default_factory=list)
    is_ready: bool = False
    is_dismissed: bool = False
    is_overdue: bool = False
    current_task: int | None = None
    n_done: int = 0
    first_bytes: int = 0
    resident_bytes: int = 0
    last_lines: collections.deque[str] = field(default_factory=lambda: collections.deque(maxlen=40))

    def send(self, message: object) -> bool:
        """Send a message; False if the worker has died, which its reader will report."""
        try:
            send(self.process.stdin, message)
        except OSError:
            return False
        return True

    def dismiss(self) -> None:
        self.is_dismissed = True
        self.process.kill()

    def close(self) -> None:
        """Close the pipes; the worker has ended."""
        for thread in self.readers:
            thread.join(1.0)
        if not any(thread.is_alive() for thread in self.readers):
            # Otherwise a grandchild has a pipe open, and its descriptor must not be reused.
            for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
                # What could not be sent is lost with the worker.
                with contextlib.suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]


Inbox = queue.SimpleQueue[tuple[WorkerProcess | None, tuple[Any, ...]]]
"""Messages of workers; those without a worker are from the parent to itself."""


def _read_messages(worker: WorkerProcess, output_reader: threading.Thread, inbox: Inbox) -> None:
    try:
        while True:
            inbox.put((worker, pickle.load(worker.process.stdout)))  # type: ignore[arg-type]
    except (EOFError, OSError, pickle.UnpicklingError):
        code = worker.process.wait()
        # What it printed last is worth a moment, but a grandchild may hold that pipe for ever.
        output_reader.join(0.5)
        inbox.put((worker, ("gone", code)))


def _read_output(worker: WorkerProcess) -> None:
    while line := worker.process.stderr.readline(1 << 16):  # type: ignore[union-attr]
        text = line[:4096].decode(errors="replace").rstrip()
        worker.last_lines.append(text)
        _log.debug("worker %d prints: %s", worker.process.pid, text)


# Inside a worker


def send(pipe: IO[bytes] | None, message: object) -> None:
    """Send one message to a pipe; OSError if it has no reader."""
    # Pickled first, so that an object which cannot be pickled leaves no half of a message.
    pipe.write(pickle.dumps(message, protocol=5))  # type: ignore[union-attr]
    pipe.flush()  # type: ignore[union-attr]


def serve() -> None:
    """Do tasks until the parent closes the pipe or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Use copies of standard input and output; the originals then lead to /dev/null and stderr.
    sys.stdout.flush()
    orders, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    faulthandler.enable()
    lock = threading.Lock()

    def respond(*message: Any) -> None:
        """Send a message to the parent, from any thread."""
        try:
            with lock:
                send(answers, message)
        except OSError:
            os._exit(0)

    try:
        # ``function`` and ``common`` are those of ``schedule.Work``.
        function, common, log_level, limit = pickle.load(orders)
        root = logging.getLogger()
        root.addHandler(_ParentLog(respond))
        root.setLevel(logging.WARNING)
        logging.getLogger("msal").setLevel(log_level)
    except EOFError:
        return
    except BaseException:
        respond("unusable", traceback.format_exc())
        return
    if limit is not None and not sys.platform.startswith("linux"):
        threading.Thread(target=_watch_memory, args=(limit, respond), daemon=True).start()
    tasks: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()

    def receive() -> None:
        # When the parent ends, this process ends at once, even within a task.
        try:
            while True:
                tasks.put(pickle.load(orders))
        except (EOFError, pickle.UnpicklingError):
            os._exit(0)

    threading.Thread(target=receive, daemon=True).start()
    respond("ready", os.getpid())
    while True:
        index, task = tasks.get()
        work = functools.partial(function, task, common)
        _run_task(work, index, limit, respond)


def _run_task(
    work: Callable[..., Any], index: int, limit: int | None, respond: Callable[..., None]
) -> None:
    begun = time.monotonic()
    last = ("", 0.0)

    def on_progress(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        is_new = stage != last[0] and (not last[0] or now - begun >= _BETWEEN_PROGRESS_S)
        if is_new or done == total or now - last[1] >= _BETWEEN_PROGRESS_S:
            last = (stage, now)
            respond("progress", index, stage, done, total)

    try:
        with limited_memory(limit):
            result = work(on_progress)
        respond("returned", index, result, memory_bytes("VmRSS"))
    except MemoryError:
        respond("exhausted")
    except BaseException as error:
        # SystemExit included: a library must not end the worker in silence.
        logging.getLogger("msal.batch").error("%s", traceback.format_exc())
        respond("raised", index, f"{type(error).__name__}: {error}")


@contextlib.contextmanager
def limited_memory(limit: int | None) -> Iterator[None]:
    """Let Linux refuse memory once about ``limit`` bytes are resident, not counting pages of files,
    which it can reclaim.

    The system can limit private writable memory (RLIMIT_DATA), touched or not.  Some of it is never
    touched (stacks of threads, buffers of libraries), while the code of libraries is resident but
    not writable.  So the difference of the two, measured for every file, is added to the limit.
    """
    if limit is None or not sys.platform.startswith("linux"):
        yield
        return
    import resource

    import numpy as np

    import msal_cli.job.pipeline  # noqa: F401

    # The linear algebra library reserves 100 MB, 40 MB of which become resident, and would abort
    # the process if that were refused; so it reserves them now.
    _ = np.ones((200, 200)) @ np.ones((200, 200))
    # The peak so far may include pages of files.
    forget_peak()
    own = memory_bytes("VmData") - memory_bytes("VmRSS")
    # Kernels will start threads, and a limit may leave less than their stacks of 8 MB.
    own += (usable_cores() + 1) * (8 << 20)
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = max(0, limit + own)
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _watch_memory(limit: int, respond: Callable[..., None]) -> None:
    """End this process once it uses more than ``limit`` bytes, where the system refuses nothing."""
    while True:
        time.sleep(0.05)
        used = memory_bytes("VmRSS") or peak_bytes() or 0
        if used > limit:
            respond("exhausted")
            os._exit(1)


class _ParentLog(logging.Handler):
    def __init__(self, respond: Callable[..., None]) -> None:
        super().__init__()
        self._respond = respond

    def emit(self, record: logging.LogRecord) -> None:
        self._respond("log", record.name, record.levelno, self.format(record))


def denoise_in_worker(
    task: Task, common: tuple[Denoise, Settings], on_progress: Callable[[str, int, int], None]
) -> MeshRecord:
    """Denoise one file in a worker.  MemoryError is raised again, so that the file gets a second
    try alone and the worker, whose heap is fragmented, is replaced; but not where the forecast
    refused the file, because a second try would end the same."""
    denoise, settings = common
    record = denoise(task, settings, on_progress)
    error = record.error
    if error is not None and error.code == "E_MEMORY" and error.where != FORECAST:
        raise MemoryError(error.message)
    return record
