"""The inside of a Dask worker: a batch of files, done by a supervised child process.

What a file does to the process that works on it (a segfault, memory that runs out) must not cost
the Dask worker, which others may share.  So every batch goes to a ``WorkerPool`` of one worker,
which stays for the next batch of the same run, because starting it takes half a second.
"""

from __future__ import annotations

import collections
import contextlib
import logging
import os
import pickle
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msal_cli.batch import temporary_files
from msal_cli.batch.engine import Interrupt, Work
from msal_cli.batch.events import Failed, Message, Progress, Returned
from msal_cli.batch.manifest_dirs import output_folders
from msal_cli.batch.worker_pool import WorkerPool
from msal_cli.errors import ResourceError
from msal_cli.job.settings import Limits
from msal_cli.version import __version__

TOPIC = "msal"
"""The topic of Dask's events under which workers report, file by file."""

_IDLE_S = 30.0
_BETWEEN_CHECKS_S = 0.2
_MOST_LINES = 1000


@dataclass(frozen=True)
class Order:
    """What all batches of a run have in common.

    Attributes
    ----------
    run : a name that no other run has.
    function, common : as in ``engine.Work``.
    cores : cores for one child process.
    limits, retries : as in ``engine.Work``; a second try is alone in its own worker only.
    log_level : of the parent.
    folder : the parent's current folder, to which relative paths belong.
    must_exist : files and folders that a worker sees if it shares the file system.
    """

    run: str
    function: Callable[..., Any]
    common: Any
    cores: int
    limits: Limits
    retries: int
    log_level: int
    folder: str
    must_exist: tuple[str, ...]


@dataclass(frozen=True)
class Answer:
    """What became of a batch, at which worker, and how long (seconds) it took."""

    address: str
    seconds: float
    messages: list[Message]
    lines: list[tuple[str, int, str]]


def run_in_folder(
    task: Any, common: tuple[str, Callable[..., Any], Any], on_progress: Callable[..., None]
) -> Any:
    """Do a task in the folder from which msal was started, as relative paths want it."""
    folder, function, its_common = common
    if os.path.isdir(folder):
        os.chdir(folder)
    return function(task, its_common, on_progress)


def run_batch(version: str, payload: bytes) -> bytes:
    """Do some files; the Dask task.  ``payload`` is a pickled (Order, tasks by index), and what
    comes back a pickled Answer, so that Dask never looks into either.

    Raises
    ------
    ResourceError : this worker cannot do the work of this run; its address is in the message.
    """
    from distributed import get_worker

    worker = get_worker()
    address = worker.address
    if version != __version__:
        raise ResourceError(version_mismatch(address, __version__, version))
    order: Order
    order, tasks = pickle.loads(payload)
    for path in order.must_exist:
        if not os.path.exists(path):
            raise ResourceError(storage_access_error(address, path))
    key = worker.get_current_task()

    def is_wanted() -> bool:
        # A run that ended, or that was killed, no longer waits for its tasks.
        task = worker.state.tasks.get(key)
        return task is not None and task.state not in ("cancelled", "released", "forgotten")

    def send(messages: list[Message]) -> None:
        event = {"run": order.run, "address": address, "messages": pickle.dumps(messages)}
        worker.log_event(TOPIC, event)

    started = time.perf_counter()
    with _borrow_pool(order) as pool:
        messages = pool.done(tasks, is_wanted, send)
    spent = time.perf_counter() - started
    return pickle.dumps(Answer(address, spent, messages, _log_queue.drain()))


def version_mismatch(address: str, theirs: str | None, ours: str) -> str:
    """The message for a worker with another version of msal."""
    has = "has no msal" if theirs is None else f"has msal {theirs}"
    return f"the Dask worker at {address} {has}, and here is {ours}"


def storage_access_error(address: str, path: str) -> str:
    """The message for a worker that does not see the files of the run."""
    return f"the Dask worker at {address} does not see {os.path.dirname(path) or path!r}"


class _StayingPool:
    """A pool of one worker that stays, and the thread that runs it.

    The system ends a child with the very thread that has started it, and Dask's threads come and
    go; so the pool has a thread of its own, which lives as long as the pool.
    """

    def __init__(self, order: Order) -> None:
        self.run = order.run
        self.is_broken = False
        self._folder = order.folder
        self._tasks: dict[int, Any] = {}
        self._inbox: queue.SimpleQueue[list[Message] | BaseException] = queue.SimpleQueue()
        work = Work(
            {},
            run_in_folder,
            (order.folder, order.function, order.common),
            cores=order.cores,
            limits=order.limits,
            retries=order.retries,
            on_death=self._sweep_after,
            stays=True,
        )
        self._pool = WorkerPool(work)
        threading.Thread(target=self._run, name="msal", daemon=True).start()

    def done(
        self,
        tasks: dict[int, Any],
        is_wanted: Callable[[], bool],
        send: Callable[[list[Message]], None],
    ) -> list[Message]:
        """Do tasks; stop in the middle once they are not wanted any more."""
        self._tasks = tasks
        self._pool.add(tasks)
        everything: list[Message] = []
        left = set(tasks)
        while left:
            received: list[Message] | BaseException = []
            with contextlib.suppress(queue.Empty):
                received = self._inbox.get(timeout=_BETWEEN_CHECKS_S)
            if not is_wanted():
                self.end()
                break
            if isinstance(received, BaseException):
                self.is_broken = True
                raise received
            new: list[Message] = [one for one in received if not isinstance(one, Progress)]
            if new:
                send(new)
            everything += new
            left -= {one.index for one in new if isinstance(one, Returned | Failed)}
        return everything

    def end(self) -> None:
        """End the worker; harmless if that has been done."""
        self.is_broken = True
        self._pool.interrupt()

    def _run(self) -> None:
        try:
            for messages in self._pool.batches():
                self._inbox.put(messages)
        except Interrupt:
            return
        except BaseException as error:
            self._inbox.put(error)

    def _sweep_after(self, pid: int, index: int) -> None:
        for folder in output_folders([self._tasks[index]]):
            temporary_files.sweep_after(pid, Path(self._folder, folder))


class _LogQueue(logging.Handler):
    """The last lines of msal's log in this process, sent to the run with the next answer."""

    def __init__(self) -> None:
        super().__init__()
        self._kept: collections.deque[tuple[str, int, str]] = collections.deque(maxlen=_MOST_LINES)

    def emit(self, record: logging.LogRecord) -> None:
        self._kept.append((record.name, record.levelno, self.format(record)))

    def drain(self) -> list[tuple[str, int, str]]:
        return [self._kept.popleft() for _ in range(len(self._kept))]


_log_queue = _LogQueue()

# Pools that wait for the next batch of their run, each with the timer that ends it.
_idle: dict[_StayingPool, threading.Timer] = {}
_idle_lock = threading.Lock()


@contextlib.contextmanager
def _borrow_pool(order: Order) -> Iterator[_StayingPool]:
    """A pool for one batch: one that stayed from the last batch of the run, or a new one."""
    logger = logging.getLogger("msal")
    if _log_queue not in logger.handlers:
        logger.addHandler(_log_queue)
        logger.propagate = False
    logger.setLevel(order.log_level)
    with _idle_lock:
        pool = next((one for one in _idle if one.run == order.run), None)
        if pool is not None:
            _idle.pop(pool).cancel()
    pool = pool or _StayingPool(order)
    try:
        yield pool
    except BaseException:
        pool.end()
        raise
    if not pool.is_broken:
        timer = threading.Timer(_IDLE_S, _end_idle, [pool])
        timer.daemon = True
        with _idle_lock:
            _idle[pool] = timer
        timer.start()


def _end_idle(pool: _StayingPool) -> None:
    with _idle_lock:
        is_idle = _idle.pop(pool, None) is not None
    if is_idle:
        pool.end()
