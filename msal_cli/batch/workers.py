"""Supervised worker processes: whatever happens to one of them costs the file in its hand.

Every worker is a fresh interpreter with one task at a time.  Two threads of the parent listen to
each (one to its answers, one to what it prints) and put what they hear into one queue; all
decisions are made in the thread that iterates.  No signal of the terminal reaches a worker, and a
worker ends when its pipe does, so none outlives the parent.
"""

from __future__ import annotations

import collections
import json
import logging
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any

from msal_cli.batch.processes import ending
from msal_cli.batch.worker import Assignment, read_message, write_message
from msal_cli.errors import ResourceError

# Without -P the first entry of the search path would be the current folder, which is full of
# somebody else's files.
_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from msal_cli.batch.worker import serve; serve()"
)
_THREAD_VARIABLES = ("MSAL_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_FALSE_STARTS = 3
_GONE_WITHIN_S = 2.0
_LAST_WORDS = 40

_log = logging.getLogger("msal.batch")


@dataclass(frozen=True, slots=True)
class Began:
    """A worker has taken task ``index`` in hand."""

    index: int


@dataclass(frozen=True, slots=True)
class Advanced:
    """What ``on_progress`` was called with."""

    index: int
    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Returned:
    """The result of task ``index``; ``earlier`` tells what ended a first try, if there was one."""

    index: int
    result: Any
    earlier: str = ""


@dataclass(frozen=True, slots=True)
class Lost:
    """Task ``index`` has no result: ``"crash"`` and ``"memory"`` even at a second try."""

    index: int
    cause: str
    reason: str
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Again:
    """Task ``index`` was lost with its worker and will be tried once more."""

    index: int
    reason: str


Message = Began | Advanced | Returned | Lost | Again


@dataclass(eq=False)
class _Worker:
    process: subprocess.Popen[bytes]
    pid: int
    threads: list[threading.Thread] = field(default_factory=list)
    is_ready: bool = False
    is_dismissed: bool = False
    in_hand: int | None = None
    n_done: int = 0
    first_bytes: int = 0
    last_words: collections.deque[str] = field(
        default_factory=lambda: collections.deque(maxlen=_LAST_WORDS)
    )


class Interrupt(Exception):  # noqa: N818 - it is a message, not a fault
    """Raised by ``Crew.batches`` after ``Crew.interrupt``, when all workers are gone."""


class Crew:
    """Does many tasks in worker processes.

    Parameters
    ----------
    tasks : the tasks by index; any picklable values.
    function : module-level; called in a worker as ``function(task, common, on_progress)``.
    common : picklable second argument of every call.
    jobs : workers at the same time.
    cores : cores to share; each worker is told its part in the environment (``MSAL_THREADS``).
    files_per_worker : a worker is replaced after so many tasks.
    growth_bytes : ... or once it holds so much more memory than after its first task.
    on_death : called with the process id of every worker that has ended and the index of the task
        that it had in hand, to clear away what it left.
    stays : when all is done the workers wait for what ``add`` brings, until ``interrupt``.
    """

    def __init__(
        self,
        tasks: dict[int, Any],
        function: Callable[..., Any],
        common: Any,
        *,
        jobs: int,
        cores: int,
        files_per_worker: int = 1000,
        growth_bytes: int = 512 << 20,
        on_death: Callable[[int, int], None] = lambda pid, index: None,
        stays: bool = False,
    ) -> None:
        self._tasks = tasks
        self._stays = stays
        self._assignment = Assignment(function, common, _log.getEffectiveLevel())
        self._jobs = max(1, min(jobs, len(tasks)))
        self._cores = cores
        self._files_per_worker = files_per_worker
        self._growth_bytes = growth_bytes
        self._on_death = on_death
        self._waiting = collections.deque(tasks)
        self._again: collections.deque[int] = collections.deque()
        self._earlier: dict[int, str] = {}
        self._workers: list[_Worker] = []
        self._heard: queue.SimpleQueue[tuple[_Worker | None, tuple[Any, ...]]] = queue.SimpleQueue()
        self._false_starts = 0

    def stop(self) -> None:
        """Hand out no task that was not begun; those in hand, and second tries, go on."""
        self._waiting.clear()

    def add(self, tasks: dict[int, Any]) -> None:
        """Bring more tasks to a crew that stays; may be called from another thread."""
        self._heard.put((None, ("more", tasks)))

    def interrupt(self) -> None:
        """Give up what is in hand and end; may be called from a signal handler."""
        self._heard.put((None, ()))

    def batches(self) -> Generator[list[Message], None, None]:
        """What happens, in the order in which it is heard; each list is all that was there.

        A task whose worker dies is tried once more after all others, alone, in a fresh worker.
        Workers are gone when the iteration ends, however it ends.

        Raises
        ------
        Interrupt : after ``interrupt``; results that had arrived until then were given before.
        ResourceError : no worker can be started.
        """
        try:
            messages = self._staffed()
            while True:
                if messages:
                    yield messages
                if not (self._stays or self._has_work()):
                    return
                messages, is_interrupted = [], False
                for worker, message in self._all_heard():
                    if worker is None and message:
                        self._take(message[1])
                    elif worker is None:
                        is_interrupted = True
                    else:
                        messages += self._understood(worker, message)
                if is_interrupted:
                    yield messages + self._last_messages()
                    raise Interrupt
                # The next tasks go out before anybody deals with the last results.
                messages += self._staffed()
        finally:
            self._end()

    # Handing out

    def _take(self, tasks: dict[int, Any]) -> None:
        if self._has_work():
            self._tasks = self._tasks | tasks
        else:
            # Nothing that is done with is kept, so that a crew can stay for ever.
            self._tasks = tasks
            self._earlier.clear()
        self._waiting.extend(tasks)

    def _has_work(self) -> bool:
        return bool(self._is_busy() or self._waiting or self._again)

    def _is_busy(self) -> bool:
        return any(worker.in_hand is not None for worker in self._workers)

    def _staffed(self) -> list[Message]:
        """Give tasks to the idle and start workers for the rest."""
        if not self._waiting and self._again and not self._is_busy():
            # A second try is alone on the machine: the first may have failed for want of memory.
            unused = [worker for worker in self._staff() if not worker.n_done]
            alone = unused[0] if unused else self._started(self._cores)
            for worker in self._staff():
                if worker is not alone:
                    self._dismiss(worker)
            return self._given(alone, self._again) if alone.is_ready else []
        began: list[Message] = []
        for worker in self._staff():
            if worker.is_ready and worker.in_hand is None and self._waiting:
                began += self._given(worker, self._waiting)
        n_free = sum(worker.in_hand is None for worker in self._staff())
        while len(self._staff()) < self._jobs and n_free < len(self._waiting):
            try:
                self._started(max(1, self._cores // self._jobs))
            except ResourceError as error:
                if not self._staff():
                    raise
                _log.info("%s; going on with %d workers", error, len(self._staff()))
                break
            n_free += 1
        return began

    def _staff(self) -> list[_Worker]:
        return [worker for worker in self._workers if not worker.is_dismissed]

    def _given(self, worker: _Worker, queue_of: collections.deque[int]) -> list[Message]:
        index = queue_of.popleft()
        try:
            write_message(worker.process.stdin.fileno(), (index, self._tasks[index]))  # type: ignore[union-attr]
        except OSError:
            # It died idle; the task never reached it, and the news of its end is on the way.
            queue_of.appendleft(index)
            worker.is_dismissed = True
            return []
        worker.in_hand = index
        return [Began(index)]

    # Listening

    def _all_heard(self) -> list[tuple[_Worker | None, tuple[Any, ...]]]:
        heard = [self._next_heard()]
        while True:
            try:
                heard.append(self._heard.get_nowait())
            except queue.Empty:
                return heard

    def _next_heard(self) -> tuple[_Worker | None, tuple[Any, ...]]:
        while True:
            try:
                # Windows delivers Ctrl-C to a waiting thread only between two waits.
                return self._heard.get(timeout=0.2 if os.name == "nt" else None)
            except queue.Empty:
                continue

    def _understood(self, worker: _Worker, message: tuple[Any, ...]) -> list[Message]:
        kind, *rest = message
        if kind == "ready":
            worker.is_ready = True
            worker.pid = rest[0]
            self._false_starts = 0
        elif kind == "progress":
            return [Advanced(*rest)]
        elif kind == "log":
            name, level, text = rest
            logging.getLogger(name).log(level, "%s", text)
        elif kind == "returned":
            index, result, resident = rest
            self._finish(worker, resident)
            return [Returned(index, result, self._earlier.get(index, ""))]
        elif kind == "raised":
            index, reason = rest
            self._finish(worker, 0)
            return [Lost(index, "exception", reason, "this is a defect of msal; please report it")]
        elif kind == "exhausted":
            # What is left of its heap cannot be trusted with another file: it is replaced too.
            return self._lost(
                worker,
                "memory",
                "not enough memory",
                "run fewer jobs at once, or on a machine with more memory",
            )
        elif kind == "unusable":
            raise ResourceError(
                f"the workers cannot work: {rest[0].strip().splitlines()[-1]}",
                hint="msal or a library that it needs is not installed properly",
            )
        elif kind == "gone":
            return self._buried(worker, rest[0])
        return []

    def _finish(self, worker: _Worker, resident: int) -> None:
        worker.in_hand = None
        worker.n_done += 1
        worker.first_bytes = worker.first_bytes or resident
        if (
            worker.n_done >= self._files_per_worker
            or resident - worker.first_bytes > self._growth_bytes
        ):
            self._dismiss(worker)

    def _buried(self, worker: _Worker, code: int) -> list[Message]:
        index = worker.in_hand
        self._part_with(worker)
        if index is not None:
            for line in worker.last_words:
                _log.info("worker %d, before it ended: %s", worker.pid, line)
            if code == -9:
                hint = "the system may have run out of memory: run fewer jobs at once"
            else:
                hint = "a library broke on this file; it may be damaged"
            return self._lost(worker, "crash", f"the worker {ending(code)}", hint)
        if not worker.is_ready and not worker.is_dismissed:
            self._false_starts += 1
            if self._false_starts >= _FALSE_STARTS:
                words = worker.last_words[-1] if worker.last_words else "it said nothing"
                raise ResourceError(
                    f"the workers end before they start: the last one {ending(code)}; {words}",
                    hint="there may not be enough memory, or too many processes",
                )
        return []

    def _lost(self, worker: _Worker, cause: str, reason: str, hint: str) -> list[Message]:
        index = worker.in_hand
        assert index is not None
        worker.in_hand = None
        self._dismiss(worker)
        if index in self._earlier:
            return [Lost(index, cause, f"{reason}, as at the first try", hint)]
        self._earlier[index] = reason
        self._again.append(index)
        return [Again(index, reason)]

    # Starting and ending processes

    def _started(self, threads: int) -> _Worker:
        environment = dict(os.environ)
        # What the user has set for himself stays.
        for name in _THREAD_VARIABLES:
            environment.setdefault(name, str(threads))
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
        worker = _Worker(process, process.pid)
        self._workers.append(worker)
        for listen in (self._overhear, self._listen):
            thread = threading.Thread(target=listen, args=(worker,), daemon=True)
            worker.threads.append(thread)
            thread.start()
        try:
            write_message(process.stdin.fileno(), self._assignment)  # type: ignore[union-attr]
        except OSError:
            # It has died already, which the listening thread will tell.
            return worker
        return worker

    def _listen(self, worker: _Worker) -> None:
        handle = worker.process.stdout.fileno()  # type: ignore[union-attr]
        try:
            while True:
                self._heard.put((worker, read_message(handle)))
        except (EOFError, OSError):
            code = worker.process.wait()
            # What it printed last is worth a moment, but a grandchild may hold that pipe for ever.
            worker.threads[0].join(0.5)
            self._heard.put((worker, ("gone", code)))

    def _overhear(self, worker: _Worker) -> None:
        handle = worker.process.stderr.fileno()  # type: ignore[union-attr]
        rest = b""
        while part := os.read(handle, 1 << 16):
            *lines, rest = (rest + part).split(b"\n")
            rest = rest[-4096:]
            self._note(worker, lines)
        self._note(worker, [rest] if rest else [])

    def _note(self, worker: _Worker, lines: Sequence[bytes]) -> None:
        for line in lines:
            text = line[:4096].decode(errors="replace").rstrip()
            worker.last_words.append(text)
            _log.debug("worker %d prints: %s", worker.process.pid, text)

    def _dismiss(self, worker: _Worker) -> None:
        worker.is_dismissed = True
        worker.process.kill()

    def _last_messages(self) -> list[Message]:
        """End all workers and hear out what they had sent."""
        for known in self._workers:
            self._dismiss(known)
        messages: list[Message] = []
        deadline = time.monotonic() + _GONE_WITHIN_S
        while self._workers:
            try:
                worker, message = self._heard.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                break
            if worker is None:
                continue
            if message[0] == "gone":
                self._part_with(worker)
            elif message[0] == "returned":
                messages += self._understood(worker, message)
        return messages

    def _end(self) -> None:
        for worker in self._workers:
            worker.process.kill()
        deadline = time.monotonic() + _GONE_WITHIN_S
        for worker in list(self._workers):
            try:
                worker.process.wait(timeout=max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                # It sits in the kernel, on a dead network disk perhaps; the kill stays pending.
                _log.warning("worker %d does not end", worker.pid)
                continue
            self._part_with(worker)

    def _part_with(self, worker: _Worker) -> None:
        """Let go of a worker that has ended."""
        self._workers.remove(worker)
        for thread in worker.threads:
            thread.join(1.0)
        if not any(thread.is_alive() for thread in worker.threads):
            # Otherwise a grandchild holds a pipe, and its number must not be given to another.
            for pipe in (worker.process.stdin, worker.process.stdout, worker.process.stderr):
                if pipe is not None:
                    pipe.close()
        if worker.in_hand is not None:
            self._on_death(worker.pid, worker.in_hand)
