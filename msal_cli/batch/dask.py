"""Many files on a Dask cluster, a few files a task.

What a file does to the process that works on it (a segfault, memory that runs out) must not cost
the Dask worker, so the files of a task are done by a ``WorkerPool`` of one process.  Dask gives a
task to another worker when one dies, and gives up (``KilledWorker``) when several did; then its
files go out again at the end, one by one.
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
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

from msal_cli.batch.plan import output_folders
from msal_cli.batch.schedule import Failed, Interrupt, Message, Returned, Started, Work
from msal_cli.batch.workers import WorkerPool
from msal_cli.errors import ResourceError, UsageError, install_hint
from msal_cli.storage.atomic import sweep, sweep_after, temporary_name
from msal_cli.version import __version__

MAX_FILES_PER_TASK = 16
_CONNECT_S = 10.0
_PATIENCE_S = 60.0
_BETWEEN_CHECKS_S = 0.2
_CLOSED_WITHIN_S = 1.5
_GOES_ON = "finished files are kept; the same command goes on from there"

_log = logging.getLogger("msal.dask")


class DaskEngine:
    """A ``schedule.Engine`` on Dask distributed; all workers must see the inputs and outputs.

    ``scheduler`` is an address.
    """

    def __init__(self, work: Work, scheduler: str) -> None:
        self._work = work
        self._scheduler = scheduler
        self._inbox: queue.SimpleQueue[tuple[Any, Any]] = queue.SimpleQueue()
        self._client: Any = None
        self._submitted: dict[Any, list[int]] = {}
        # Lost with their workers, as others may have been beside them: they go last, one by one.
        self._suspects: list[int] = []
        self._tries: collections.Counter[int] = collections.Counter()
        self._is_stopped = self._is_interrupted = False

    def stop(self) -> None:
        """Hand out nothing more; files of tasks that have begun are not reported."""
        self._is_stopped = True

    def interrupt(self) -> None:
        self._is_interrupted = True

    def batches(self) -> Generator[list[Message], None, None]:
        probes = [
            os.path.join(os.path.abspath(folder), temporary_name("probe"))
            for folder in self._work.folders
        ]
        try:
            for probe in probes:
                Path(probe).touch()
            self._connect()
            _log.info("waiting for workers at the Dask scheduler %s", self._scheduler)
            started = time.monotonic()
            while not (n_threads := self._count_threads()):
                if self._is_interrupted:
                    raise Interrupt
                self._require_patience(started)
                time.sleep(_BETWEEN_CHECKS_S)
            self._check_workers((*probes, os.path.join(os.getcwd(), "")))
            self._submit_all(n_threads)
            yield from self._run()
        finally:
            self._close()
            for probe in probes:
                Path(probe).unlink(missing_ok=True)
            # A worker of this machine that was killed with its Dask worker cannot do that itself.
            sweep(output_folders(self._work.tasks.values()))

    def _connect(self) -> None:
        try:
            import distributed
        except ImportError as error:
            raise not_installed() from error
        # They print to standard error.
        for name in ("distributed", "distributed.client", "tornado.application", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        try:
            self._client = distributed.Client(
                self._scheduler, set_as_default=False, timeout=_CONNECT_S
            )
        except (OSError, ValueError, TimeoutError, RuntimeError) as error:
            raise UsageError(
                f"there is no Dask scheduler at {self._scheduler}: {error}",
                hint="`dask scheduler` prints its address when it starts",
            ) from error

    def _count_threads(self) -> int:
        """Threads of all workers; 0 if the scheduler does not answer."""
        try:
            return sum(self._client.nthreads().values())
        except (OSError, TimeoutError) as error:
            _log.debug("the scheduler does not answer: %s", error)
            return 0

    def _require_patience(self, since: float) -> None:
        if (waited := time.monotonic() - since) > _PATIENCE_S:
            raise ResourceError(
                f"no worker at the Dask scheduler {self._scheduler} for {waited:.0f} s",
                hint="start some with `dask worker ADDRESS`, then run the same command again",
            )

    def _check_workers(self, must_exist: tuple[str, ...]) -> None:
        """Refuse workers that have another msal or do not see the files."""

        # Sent by value: a worker may not have msal at all.
        def probe(paths: tuple[str, ...]) -> tuple[str | None, list[str]]:
            try:
                from msal_cli.version import __version__
            except ImportError:
                return None, []
            return __version__, [path for path in paths if not os.path.exists(path)]

        answers = self._client.run(probe, must_exist, on_error="return")
        for address, answer in sorted(answers.items()):
            if isinstance(answer, Exception):
                # It may have died this very moment; the version is checked with every task.
                _log.warning("the Dask worker at %s does not answer: %s", address, answer)
                continue
            version, missing = answer
            if version != __version__:
                has = "has no msal" if version is None else f"has msal {version}"
                raise UsageError(
                    f"the Dask worker at {address} {has}, and here is {__version__}",
                    hint="install the same version of msal-cli everywhere",
                )
            if missing:
                raise UsageError(
                    f"the Dask worker at {address} does not see {os.path.dirname(missing[0])}",
                    hint="inputs and outputs must lie where all machines see them by the same path",
                )

    # Work

    def _submit_all(self, n_threads: int) -> None:
        """Hand out the large files singly and first, and then the others."""
        weights = self._work.weights
        large = sorted(weights.keys() & self._work.tasks.keys(), key=weights.__getitem__)
        small = sorted(self._work.tasks.keys() - weights.keys())
        n_each = max(1, min(MAX_FILES_PER_TASK, len(small) // (4 * n_threads)))
        for index in reversed(large):
            self._submit([index])
        for start in range(0, len(small), n_each):
            self._submit(small[start : start + n_each])

    def _submit(self, indices: list[int]) -> None:
        # Sent by value, and all else as bytes: the scheduler need not have msal.
        def msal(version: str, payload: bytes) -> bytes:
            from msal_cli.batch.dask import denoise_in_child

            return denoise_in_child(version, payload)

        work = self._work
        common = (os.getcwd(), work.function, work.common)
        tasks = {index: work.tasks[index] for index in indices}
        payload = pickle.dumps((common, work.limits, work.retries, tasks))
        future = self._client.submit(msal, __version__, payload, pure=False)
        self._submitted[future] = indices
        future.add_done_callback(self._note_end)

    def _note_end(self, future: Any) -> None:
        """Called in a thread of Dask's."""
        answer: Any
        try:
            answer = future.result()
        except BaseException as error:
            answer = error
        self._inbox.put((future, answer))

    def _run(self) -> Generator[list[Message], None, None]:
        seen_workers = looked = time.monotonic()
        while (self._submitted or self._suspects) and not self._is_stopped:
            if not self._submitted:
                self._submit([self._suspects.pop()])
            if self._is_interrupted:
                raise Interrupt
            try:
                future, answer = self._inbox.get(timeout=_BETWEEN_CHECKS_S)
            except queue.Empty:
                now = time.monotonic()
                if now - looked > 5 * _BETWEEN_CHECKS_S:
                    seen_workers = now if self._count_threads() else seen_workers
                    looked = now
                    self._require_patience(seen_workers)
                continue
            messages = self._handle_answer(self._submitted.pop(future), answer)
            if messages:
                yield [part for each in messages for part in (Started(each.index), each)]

    def _handle_answer(self, indices: list[int], answer: Any) -> list[Message]:
        if isinstance(answer, bytes):
            messages: list[Message] = pickle.loads(answer)
            return messages
        if isinstance(answer, ResourceError):
            raise answer
        if type(answer).__name__ != "KilledWorker":
            raise ResourceError(
                f"Dask cannot go on: {type(answer).__name__}: {answer}", hint=_GOES_ON
            )
        self._tries.update(indices)
        if len(indices) > 1 or self._tries[indices[0]] <= self._work.retries:
            self._suspects += indices
            return []
        hint = "a library broke on this file, or the machines ran out of memory"
        return [Failed(indices[0], "crash", "Dask workers died while at work on it", hint)]

    def _close(self) -> None:
        """Take back what has not been done, and close the connection; two seconds at most."""
        if self._client is None:
            return

        def close() -> None:
            with contextlib.suppress(Exception):
                self._client.cancel(list(self._submitted))
                self._client.close(timeout=_CLOSED_WITHIN_S)

        closing = threading.Thread(target=close, daemon=True)
        closing.start()
        closing.join(_CLOSED_WITHIN_S)


def not_installed() -> UsageError:
    """The error for a Python without Dask distributed."""
    return UsageError("Dask is not installed", hint=install_hint("dask"))


def denoise_in_child(version: str, payload: bytes) -> bytes:
    """Do some files in a child process of this Dask worker; pickled messages about their ends.

    Raises ResourceError if this worker has another version of msal.
    """
    from distributed import get_worker

    worker = get_worker()
    if version != __version__:
        raise ResourceError(
            f"the Dask worker at {worker.address} has msal {__version__}, and here is {version}",
            hint=_GOES_ON,
        )
    common, limits, retries, tasks = pickle.loads(payload)

    def clean_up(pid: int, index: int) -> None:
        folders = output_folders([tasks[index]])
        sweep_after(pid, [Path(common[0], folder) for folder in folders])

    # A worker does as many files at the same time as it has threads.
    work = Work(
        dict(tasks), run_in_folder, common, limits=limits, retries=retries, on_death=clean_up
    )
    pool = WorkerPool(work)
    key, is_over = worker.get_current_task(), threading.Event()

    def end_if_unwanted() -> None:
        # A run that ended, or that was killed, no longer waits for its tasks.
        while not is_over.wait(_BETWEEN_CHECKS_S):
            task = worker.state.tasks.get(key)
            if task is None or task.state in ("cancelled", "released", "forgotten"):
                pool.interrupt()
                return

    threading.Thread(target=end_if_unwanted, daemon=True).start()
    messages: list[Message] = []
    try:
        for batch in pool.batches():
            messages += [each for each in batch if isinstance(each, Returned | Failed)]
    except Interrupt:
        pass
    finally:
        is_over.set()
    return pickle.dumps(messages)


def run_in_folder(
    task: Any, common: tuple[str, Callable[..., Any], Any], on_progress: Callable[..., None]
) -> Any:
    """Do a task in the folder from which msal was started, as relative paths want it."""
    folder, function, its_common = common
    if os.path.isdir(folder):
        os.chdir(folder)
    return function(task, its_common, on_progress)
