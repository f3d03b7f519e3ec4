"""Many files on a Dask cluster, each as a task.

What a file does to the process that works on it (a segfault, memory that runs out) must not cost
the Dask worker, so the task is done by a ``WorkerPool`` of one process.  Dask gives a task to
another worker when one dies, and gives up (``KilledWorker``) when several did; then the file is
tried again at the end, alone.
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
        self._submitted: dict[Any, int] = {}
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
        folders = map(os.path.abspath, self._work.folders)
        self._probes = [os.path.join(folder, temporary_name("probe")) for folder in folders]
        try:
            for probe in self._probes:
                Path(probe).touch()
            self._connect()
            _log.info("waiting for workers at the Dask scheduler %s", self._scheduler)
            started = time.monotonic()
            while not self._has_workers():
                if self._is_interrupted:
                    raise Interrupt
                self._require_patience(started)
                time.sleep(_BETWEEN_CHECKS_S)
            weights = self._work.weights
            # Large files first, so that none is left to run alone at the end.
            for index in sorted(self._work.tasks, key=lambda index: -weights.get(index, 0)):
                self._submit(index)
            yield from self._run()
        finally:
            self._close()
            for probe in self._probes:
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

    def _has_workers(self) -> bool:
        try:
            return bool(self._client.nthreads())
        except (OSError, TimeoutError) as error:
            _log.debug("the scheduler does not answer: %s", error)
            return False

    def _require_patience(self, since: float) -> None:
        if (waited := time.monotonic() - since) > _PATIENCE_S:
            raise ResourceError(
                f"no worker at the Dask scheduler {self._scheduler} for {waited:.0f} s",
                hint="start some with `dask worker ADDRESS`, then run the same command again",
            )

    # Work

    def _submit(self, index: int) -> None:
        # Sent by value, and all else as bytes: the scheduler need not have msal.
        def msal(version: str, payload: bytes) -> bytes:
            from msal_cli.batch.dask import denoise_in_child

            return denoise_in_child(version, payload)

        work = self._work
        common = (os.getcwd(), work.function, work.common)
        must_exist = (*self._probes, os.path.join(os.getcwd(), ""))
        payload = pickle.dumps(
            (must_exist, common, work.limits, work.retries, index, work.tasks[index])
        )
        future = self._client.submit(msal, __version__, payload, pure=False)
        self._submitted[future] = index
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
                self._submit(self._suspects.pop())
            if self._is_interrupted:
                raise Interrupt
            try:
                future, answer = self._inbox.get(timeout=_BETWEEN_CHECKS_S)
            except queue.Empty:
                now = time.monotonic()
                if now - looked > 5 * _BETWEEN_CHECKS_S:
                    seen_workers = now if self._has_workers() else seen_workers
                    looked = now
                    self._require_patience(seen_workers)
                continue
            if (end := self._handle_answer(self._submitted.pop(future), answer)) is not None:
                yield [Started(end.index), end]

    def _handle_answer(self, index: int, answer: Any) -> Returned | Failed | None:
        """How a task has ended; None if it is to be tried again."""
        if isinstance(answer, bytes):
            end: Returned | Failed = pickle.loads(answer)
            return end
        if isinstance(answer, UsageError):
            raise answer
        if type(answer).__name__ != "KilledWorker":
            raise ResourceError(
                f"Dask cannot go on: {type(answer).__name__}: {answer}", hint=_GOES_ON
            )
        self._tries[index] += 1
        if self._tries[index] <= max(1, self._work.retries):
            self._suspects.append(index)
            return None
        hint = "a library broke on this file, or the machines ran out of memory"
        return Failed(index, "crash", "Dask workers died while at work on it", hint)

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
    """Do a file in a child process of this Dask worker; the pickled message about its end.

    Raises UsageError if this worker has another version of msal, or does not see the files.
    """
    from distributed import get_worker

    worker = get_worker()
    if version != __version__:
        raise UsageError(
            f"the Dask worker at {worker.address} has msal {__version__}, and here is {version}",
            hint="install the same version of msal-cli everywhere",
        )
    must_exist, common, limits, retries, index, task = pickle.loads(payload)
    if missing := [path for path in must_exist if not os.path.exists(path)]:
        raise UsageError(
            f"the Dask worker at {worker.address} does not see {os.path.dirname(missing[0])}",
            hint="inputs and outputs must lie where all machines see them by the same path",
        )
    folders = [Path(common[0], folder) for folder in output_folders([task])]
    work = Work(
        {index: task},
        run_in_folder,
        common,
        limits=limits,
        retries=retries,
        on_death=lambda pid, index: sweep_after(pid, folders),
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
    end = None
    try:
        for messages in pool.batches():
            for message in messages:
                end = message if isinstance(message, Returned | Failed) else end
    except Interrupt:
        pass
    finally:
        is_over.set()
    return pickle.dumps(end)


def run_in_folder(
    task: Any, common: tuple[str, Callable[..., Any], Any], on_progress: Callable[..., None]
) -> Any:
    """Do a task in the folder from which msal was started, as relative paths want it."""
    folder, function, its_common = common
    if os.path.isdir(folder):
        os.chdir(folder)
    return function(task, its_common, on_progress)
