"""The inside of a Dask worker: a batch of files, done by a supervised child process.

What a file does to the process that works on it (a segfault, memory that runs out) must not cost
the Dask worker, which others may share.  So every batch goes to a ``Crew`` of one worker, which
stays for the next batch of the same run, because starting it takes half a second.
"""

from __future__ import annotations

import collections
import logging
import os
import pickle
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msal_cli import __version__
from msal_cli.batch import manifest_dirs as homes
from msal_cli.batch import temporary_files as temporaries
from msal_cli.batch.schedule import Schedule
from msal_cli.batch.worker_messages import Advanced, Lost, Message, Returned
from msal_cli.batch.worker_pool import Crew, Interrupt
from msal_cli.errors import ResourceError
from msal_cli.job.settings import Limits

TOPIC = "msal"
"""The topic of Dask's events under which workers tell what happens, file by file."""

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
    log_level : what the parent wants to hear.
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


def in_folder(
    task: Any, common: tuple[str, Callable[..., Any], Any], on_progress: Callable[..., None]
) -> Any:
    """Do a task in the folder from which msal was started, as relative paths want it."""
    folder, function, its_common = common
    if os.path.isdir(folder):
        os.chdir(folder)
    return function(task, its_common, on_progress)


def do_batch(version: str, payload: bytes) -> bytes:
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
        raise ResourceError(objection_to_version(address, __version__, version))
    order: Order
    order, tasks = pickle.loads(payload)
    for path in order.must_exist:
        if not os.path.exists(path):
            raise ResourceError(objection_to_blindness(address, path))
    key = worker.get_current_task()

    def is_wanted() -> bool:
        # A run that ended, or that was killed, no longer waits for its tasks.
        task = worker.state.tasks.get(key)
        return task is not None and task.state not in ("cancelled", "released", "forgotten")

    def tell(messages: list[Message]) -> None:
        news = {"run": order.run, "address": address, "news": pickle.dumps(messages)}
        worker.log_event(TOPIC, news)

    started = time.perf_counter()
    with _borrowed(order) as bench:
        messages = bench.done(tasks, is_wanted, tell)
    spent = time.perf_counter() - started
    return pickle.dumps(Answer(address, spent, messages, _lines.drained()))


def objection_to_version(address: str, theirs: str | None, ours: str) -> str:
    """In words: this worker runs another msal."""
    has = "has no msal" if theirs is None else f"has msal {theirs}"
    return f"the Dask worker at {address} {has}, and here is {ours}"


def objection_to_blindness(address: str, path: str) -> str:
    """In words: this worker does not see the files of the run."""
    return f"the Dask worker at {address} does not see {os.path.dirname(path) or path!r}"


class _Bench:
    """A crew of one worker that stays, and the thread that leads it.

    The system ends a child with the very thread that has started it, and Dask's threads come and
    go; so the crew has a thread of its own, which lives as long as the crew.
    """

    def __init__(self, order: Order) -> None:
        self.run = order.run
        self.is_broken = False
        self._folder = order.folder
        self._tasks: dict[int, Any] = {}
        self._heard: queue.SimpleQueue[list[Message] | BaseException] = queue.SimpleQueue()
        self._crew = Crew(
            {},
            in_folder,
            (order.folder, order.function, order.common),
            jobs=1,
            cores=order.cores,
            limits=order.limits,
            schedule=Schedule((), retries=order.retries),
            on_death=self._clear_away,
            stays=True,
        )
        self._thread = threading.Thread(target=self._lead, name="msal", daemon=True)
        self._thread.start()

    def done(
        self,
        tasks: dict[int, Any],
        is_wanted: Callable[[], bool],
        tell: Callable[[list[Message]], None],
    ) -> list[Message]:
        """Do tasks; stop in the middle once they are not wanted any more."""
        self._tasks = tasks
        self._crew.add(tasks)
        everything: list[Message] = []
        left = set(tasks)
        while left:
            try:
                heard = self._heard.get(timeout=_BETWEEN_CHECKS_S)
            except queue.Empty:
                heard = []
            if not is_wanted():
                self.end()
                break
            if isinstance(heard, BaseException):
                self.is_broken = True
                raise heard
            news: list[Message] = [one for one in heard if not isinstance(one, Advanced)]
            if news:
                tell(news)
            everything += news
            left -= {one.index for one in news if isinstance(one, Returned | Lost)}
        return everything

    def end(self) -> None:
        """Let the worker go; harmless if that has been done."""
        self.is_broken = True
        self._crew.interrupt()

    def _lead(self) -> None:
        try:
            for messages in self._crew.batches():
                self._heard.put(messages)
        except Interrupt:
            return
        except BaseException as error:
            self._heard.put(error)

    def _clear_away(self, pid: int, index: int) -> None:
        for folder in homes.folders([self._tasks[index]]):
            temporaries.sweep_after(pid, Path(self._folder, folder))


class _Idle:
    """Benches that wait for the next batch of their run; those that wait too long are let go."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._benches: dict[_Bench, threading.Timer] = {}

    def taken(self, run: str) -> _Bench | None:
        with self._lock:
            for bench in self._benches:
                if bench.run == run:
                    self._benches.pop(bench).cancel()
                    return bench
        return None

    def put(self, bench: _Bench) -> None:
        timer = threading.Timer(_IDLE_S, self._expire, [bench])
        timer.daemon = True
        with self._lock:
            self._benches[bench] = timer
        timer.start()

    def _expire(self, bench: _Bench) -> None:
        with self._lock:
            is_idle = self._benches.pop(bench, None) is not None
        if is_idle:
            bench.end()


class _Lines(logging.Handler):
    """The last lines of msal's log in this process, to be sent home with the next answer."""

    def __init__(self) -> None:
        super().__init__()
        self._kept: collections.deque[tuple[str, int, str]] = collections.deque(maxlen=_MOST_LINES)

    def emit(self, record: logging.LogRecord) -> None:
        self._kept.append((record.name, record.levelno, self.format(record)))

    def drained(self) -> list[tuple[str, int, str]]:
        lines = []
        while self._kept:
            lines.append(self._kept.popleft())
        return lines


_idle = _Idle()
_lines = _Lines()


@contextmanager
def _borrowed(order: Order) -> Iterator[_Bench]:
    """A bench for one batch: one that stayed from the last batch of the run, or a new one."""
    logger = logging.getLogger("msal")
    if _lines not in logger.handlers:
        logger.addHandler(_lines)
        logger.propagate = False
    logger.setLevel(order.log_level)
    bench = _idle.taken(order.run) or _Bench(order)
    try:
        yield bench
    except BaseException:
        bench.end()
        raise
    if not bench.is_broken:
        _idle.put(bench)
