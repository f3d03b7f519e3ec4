"""Many files on a Dask cluster, in batches of some seconds' work.

Dask gives a batch to another worker when one dies, and gives up (``KilledWorker``) when several
did.  One file may be at fault, or none; so the files of such a batch are handed out singly, and
one that seems to kill workers even then gets its second try when nothing else is under way.
"""

from __future__ import annotations

import collections
import contextlib
import itertools
import logging
import math
import os
import pickle
import queue
import secrets
import threading
import time
from collections.abc import Generator
from concurrent.futures import CancelledError
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msal_cli.batch import temporary_files
from msal_cli.batch.dask_cluster import DaskCluster, no_workers
from msal_cli.batch.dask_worker import Answer, Order
from msal_cli.batch.engine import Interrupt, Work
from msal_cli.batch.events import Failed, Losses, Message, Retried, Returned, Started
from msal_cli.batch.manifest_dirs import output_folders
from msal_cli.errors import MsalError, ResourceError, UsageError
from msal_cli.job.records import MeshRecord
from msal_cli.storage.atomic import temporary_name
from msal_cli.storage.urls import is_url
from msal_cli.version import __version__

_FIRST_FILES = 4
_GROWTH = 4
_AIM_S = 5.0
_LEAST_S = 1.0
_PER_THREAD = 2
_PATIENCE_S = 60.0

_log = logging.getLogger("msal.dask")


@dataclass(frozen=True)
class _Batch:
    indices: tuple[int, ...]
    future: Any


class DaskEngine:
    """An ``engine.Engine`` on Dask distributed.

    Parameters
    ----------
    work : what is to be done; inputs and outputs must be where all workers see them.
    scheduler : the scheduler's address.

    Raises
    ------
    UsageError : a task is in place; a batch that is done twice would denoise it twice.
    """

    def __init__(self, work: Work, scheduler: str) -> None:
        if any(task.in_place for task in work.tasks.values()):
            raise UsageError(
                "files cannot be denoised in place with Dask, which may do a batch twice",
                hint="name an output folder with -o, or leave --engine dask away",
            )
        self._work = work
        self._run = secrets.token_hex(8)
        self._scheduler = scheduler
        self._inbox: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
        self._cluster = DaskCluster(scheduler, lambda *event: self._inbox.put(event))
        self._probes: list[str] = []
        # What is not done yet, and of it: not handed out, the large ones apart, which go first and
        # singly; of a batch that killed its workers; of a batch of one that did.
        self._open = set(work.tasks)
        large = [index for index in work.weights if index in work.tasks]
        self._large = collections.deque(sorted(large, key=work.weights.__getitem__, reverse=True))
        self._waiting = collections.deque(sorted(self._open.difference(large)))
        self._suspects: collections.deque[int] = collections.deque()
        self._retries: collections.deque[int] = collections.deque()
        self._losses = Losses(work.retries)
        self._started: set[int] = set()
        self._submitted: dict[int, _Batch] = {}
        self._numbers = itertools.count()
        self._threads = 0
        self._seen_workers = time.monotonic()
        self._seconds_per_file: float | None = None
        self._largest_batch = 0
        self._is_connected = False

    def stop(self) -> None:
        """See ``Engine.stop``; batches that have begun go on."""
        self._large.clear()
        self._waiting.clear()
        for number, batch in list(self._submitted.items()):
            if not self._started.intersection(batch.indices):
                del self._submitted[number]
                self._cluster.cancel(batch.future)

    def interrupt(self) -> None:
        """See ``Engine.interrupt``."""
        self._inbox.put(("interrupt",))

    def add(self, tasks: dict[int, Any]) -> None:
        """See ``Engine.add``; each task is handed out singly."""
        self._inbox.put(("more", tasks))

    def batches(self) -> Generator[list[Message], None, None]:
        """See ``Engine.batches``."""
        try:
            self._create_probes()
            threading.Thread(target=self._connect, name="msal-dask", daemon=True).start()
            while True:
                messages: list[Message] = []
                fault: Exception | None = None
                for kind, *rest in self._receive():
                    try:
                        if kind == "interrupt":
                            raise Interrupt
                        messages += self._handle_event(kind, rest)
                    except (Interrupt, MsalError) as error:
                        fault = fault or error
                if fault is None:
                    self._submit_batches()
                if messages:
                    yield messages
                if fault is not None:
                    raise fault
                is_over = self._is_connected and not (self._submitted or self._has_waiting())
                if is_over and not self._work.stays:
                    return
        finally:
            self._end()

    # Beginning and ending

    def _connect(self) -> None:
        """In a thread of its own, because it takes seconds in which a signal must be obeyed."""
        try:
            self._cluster.open(_PATIENCE_S)
            self._cluster.check(__version__, self._must_exist())
            self._inbox.put(("connected",))
            self._cluster.watch()
        except MsalError as error:
            self._inbox.put(("fault", error))
        except Exception as error:
            _log.debug("the way to the Dask cluster", exc_info=True)
            self._inbox.put(("fault", _dask_error(error)))

    def _create_probes(self) -> None:
        """Make a file in every folder with a manifest; workers on shared storage see them."""
        for folder in self._work.folders:
            probe = os.path.join(os.path.abspath(folder), temporary_name("probe"))
            Path(probe).touch()
            self._probes.append(probe)

    def _must_exist(self) -> tuple[str, ...]:
        if all(
            is_url(path) or os.path.isabs(path)
            for task in self._work.tasks.values()
            for path in (task.input, task.output)
        ):
            return tuple(self._probes)
        return (*self._probes, os.path.join(os.getcwd(), ""))

    def _end(self) -> None:
        self._cluster.close()
        for probe in self._probes:
            Path(probe).unlink(missing_ok=True)
        # A worker of this machine that was killed with its Dask worker cannot do that itself.
        temporary_files.sweep(output_folders(self._work.tasks.values()))

    # Handing out

    def _has_waiting(self) -> bool:
        return bool(self._large or self._waiting or self._suspects or self._retries)

    def _submit_batches(self) -> None:
        while self._threads and len(self._submitted) < _PER_THREAD * self._threads:
            if self._large:
                self._submit([self._large.popleft()])
            elif self._waiting:
                n = self._next_size()
                self._submit([self._waiting.popleft() for _ in range(n)])
            elif self._suspects:
                self._submit([self._suspects.popleft()])
            elif self._retries and not self._submitted:
                self._submit([self._retries.popleft()])
                return
            else:
                return

    def _next_size(self) -> int:
        """Files in the next batch: some seconds' work, less towards the end."""
        left = len(self._waiting)
        fair = math.ceil(left / (_PER_THREAD * self._threads))
        if self._seconds_per_file is None:
            return max(1, min(_FIRST_FILES, fair))
        pace = max(self._seconds_per_file, 1e-4)
        wanted = min(round(_AIM_S / pace), _GROWTH * max(1, self._largest_batch))
        return max(1, min(wanted, max(fair, math.ceil(_LEAST_S / pace)), left))

    def _submit(self, indices: list[int]) -> None:
        number = next(self._numbers)
        work = self._work
        order = Order(
            run=self._run,
            function=work.function,
            common=work.common,
            # A worker does as many files at the same time as it has threads.
            cores=1,
            limits=work.limits,
            retries=work.retries,
            log_level=logging.getLogger("msal").getEffectiveLevel(),
            folder=os.getcwd(),
            must_exist=self._must_exist(),
        )
        payload = pickle.dumps((order, {index: work.tasks[index] for index in indices}))
        key = f"msal-{self._run}-{number}"
        future = self._cluster.submit(key, number, __version__, payload)
        self._submitted[number] = _Batch(tuple(indices), future)
        self._started.difference_update(indices)

    # Events

    def _receive(self) -> list[tuple[Any, ...]]:
        events = [self._inbox.get()]
        with contextlib.suppress(queue.Empty):
            while True:
                events.append(self._inbox.get_nowait())
        return events

    def _handle_event(self, kind: str, rest: list[Any]) -> list[Message]:
        if kind == "more":
            (tasks,) = rest
            self._work.tasks.update(tasks)
            self._open.update(tasks)
            self._large.extend(tasks)
        elif kind == "connected":
            self._is_connected = True
            self._seen_workers = time.monotonic()
        elif kind == "fault":
            raise rest[0]
        elif kind == "threads":
            self._note_threads(*rest)
        elif kind == "messages":
            address, run, messages = rest
            return self._new_messages(address, pickle.loads(messages)) if run == self._run else []
        elif kind == "answer":
            return self._handle_answer(*rest)
        return []

    def _note_threads(self, threads: int | None) -> None:
        if threads:
            self._threads = threads
            self._seen_workers = time.monotonic()
            return
        waited = time.monotonic() - self._seen_workers
        if waited > _PATIENCE_S:
            raise no_workers(self._scheduler, waited)

    def _new_messages(self, address: str, messages: list[Message]) -> list[Message]:
        """The messages that are new: workers send each twice, at once and with the batch."""
        new: list[Message] = []
        for one in messages:
            index = one.index
            if index not in self._open:
                continue
            if isinstance(one, Returned | Failed):
                self._open.remove(index)
                if index not in self._started:
                    new.append(Started(index))
                new.append(self._complete(address, one))
            elif not (isinstance(one, Started) and index in self._started):
                self._started.add(index)
                new.append(one)
                if isinstance(one, Retried):
                    self._started.discard(index)
        return new

    def _complete(self, address: str, message: Returned | Failed) -> Message:
        """The message with what only this process knows."""
        if not isinstance(message, Returned):
            return message
        earlier = self._losses.reasons.get(message.index, message.earlier)
        record = message.result
        if isinstance(record, MeshRecord) and record.error and record.error.code == "E_READ":
            path = self._work.tasks[message.index].input
            if os.path.exists(path):
                hint = (
                    f"this machine sees it, but the Dask worker at {address} does not: "
                    "inputs must lie where all machines see them by the same path"
                )
                record = replace(record, error=replace(record.error, hint=hint))
        return replace(message, earlier=earlier, result=record)

    def _handle_answer(self, number: int, answer: object) -> list[Message]:
        batch = self._submitted.pop(number, None)
        if batch is None:
            return []
        if isinstance(answer, bytes):
            return self._handle_result(batch, pickle.loads(answer))
        if type(answer).__name__ == "KilledWorker":
            return self._handle_killed(batch, answer)
        if isinstance(answer, MsalError):
            raise answer
        if isinstance(answer, CancelledError):
            raise ResourceError(
                f"the Dask scheduler {self._scheduler} was lost, or took the work back",
                hint="finished files are kept; the same command goes on from there",
            )
        raise _dask_error(answer)

    def _handle_result(self, batch: _Batch, answer: Answer) -> list[Message]:
        for name, level, text in answer.lines:
            logging.getLogger(name).log(level, "%s", text)
        if not self._work.weights.keys() & set(batch.indices):
            pace = answer.seconds / len(batch.indices)
            known = self._seconds_per_file
            self._seconds_per_file = pace if known is None else 0.5 * (known + pace)
        self._largest_batch = max(self._largest_batch, len(batch.indices))
        messages = self._new_messages(answer.address, answer.messages)
        # What is left of a batch that its worker gave up by itself.
        self._waiting.extend(index for index in batch.indices if index in self._open)
        return messages

    def _handle_killed(self, batch: _Batch, error: object) -> list[Message]:
        left = [index for index in batch.indices if index in self._open]
        deaths = getattr(error, "allowed_failures", 0) + 1
        workers = "a Dask worker" if deaths == 1 else f"{deaths} Dask workers"
        reason = f"{workers} died while at work on it"
        if len(batch.indices) > 1:
            _log.info("%s with a batch of %d files; they go singly now", workers, len(left))
            self._suspects.extend(left)
            return []
        hint = "a library broke on this file, or the machines ran out of memory"
        outcomes: list[Message] = []
        for index in left:
            outcome = self._losses.add(index, "crash", reason, hint)
            if isinstance(outcome, Retried):
                self._retries.append(index)
            else:
                self._open.remove(index)
            outcomes.append(outcome)
        return outcomes


def _dask_error(error: object) -> ResourceError:
    return ResourceError(
        f"Dask cannot go on: {type(error).__name__}: {error}",
        hint="finished files are kept; the same command goes on from there",
    )
