"""Many files on a Dask cluster, each as a task.

A file may crash the process that works on it (a segfault, memory that runs out).  So that this does
not cost the Dask worker, each task runs in a ``WorkerPool`` of one process.  When a Dask worker
dies, Dask gives its tasks to others, and gives up on a task (``KilledWorker``) after several
deaths; that file is tried again at the end, alone.
"""

import collections
import contextlib
import logging
import os
import pickle
import threading
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

from msal_cli.batch.plan import output_folders
from msal_cli.batch.schedule import Failed, Interrupt, Message, Returned, Started, Work
from msal_cli.batch.workers import WorkerPool
from msal_cli.errors import ResourceError, UsageError
from msal_cli.job.records import Failure
from msal_cli.storage.atomic import sweep, temporary_name
from msal_cli.version import __version__

_CONNECT_S = 10.0
_PATIENCE_S = 60.0
_BETWEEN_CHECKS_S = 0.2
_DEATHS = Failure(
    "E_CRASH",
    "Dask workers died while at work on it",
    "a library broke on this file, or the machines ran out of memory",
)

_log = logging.getLogger("msal.dask")


class DaskEngine:
    """A ``schedule.Engine`` on the Dask cluster whose scheduler has the address ``scheduler``.

    All its workers must see the inputs and outputs by the same paths.
    """

    def __init__(self, work: Work, scheduler: str) -> None:
        self._work = work
        self._scheduler = scheduler
        folders = map(os.path.abspath, work.folders)
        self._probes = [os.path.join(folder, temporary_name("probe")) for folder in folders]
        self._is_stopped = self._is_interrupted = False

    def stop(self) -> None:
        """Give up the tasks that have not ended; their files are not reported."""
        self._is_stopped = True

    def interrupt(self) -> None:
        self._is_interrupted = True

    def batches(self) -> Generator[list[Message], None, None]:
        client = None
        try:
            for probe in self._probes:
                Path(probe).touch()
            client = _connect(self._scheduler)
            yield from self._run(client)
        finally:
            if client is not None:
                with contextlib.suppress(Exception):
                    # The scheduler drops the tasks of a client that has disconnected.
                    client.close(timeout=1.5)
            for probe in self._probes:
                Path(probe).unlink(missing_ok=True)
            # A process killed with its Dask worker on this machine leaves its temporary files.
            sweep(output_folders(self._work.tasks.values()))

    def _run(self, client: Any) -> Generator[list[Message], None, None]:
        from distributed import as_completed

        weights = self._work.weights
        # Large files first, so that none is left to run alone at the end.
        order = sorted(self._work.tasks, key=lambda index: -weights.get(index, 0))
        indices = {self._submit(client, index): index for index in order}
        ended = as_completed(indices, loop=client.loop, with_results=True, raise_errors=False)
        # Tasks whose workers died, perhaps because of another task: they run last, one by one.
        suspects: list[int] = []
        tries: collections.Counter[int] = collections.Counter()
        seen_workers = time.monotonic()
        while (indices or suspects) and not self._is_stopped:
            if self._is_interrupted:
                raise Interrupt
            if not indices:
                index = suspects.pop()
                future = self._submit(client, index)
                indices[future] = index
                ended.add(future)
            for future, answer in ended.next_batch(block=False):
                seen_workers, index = time.monotonic(), indices.pop(future)
                tries[index] += 1
                if (end := _read_answer(index, answer)) is not None:
                    yield [Started(index), end]
                elif tries[index] <= max(1, self._work.retries):
                    suspects.append(index)
                else:
                    yield [Started(index), Failed(index, _DEATHS)]
            if ended.has_ready():
                continue
            if _has_workers(client):
                seen_workers = time.monotonic()
            elif (waited := time.monotonic() - seen_workers) > _PATIENCE_S:
                raise ResourceError(
                    f"no worker at the Dask scheduler {self._scheduler} for {waited:.0f} s",
                    hint="start some with `dask worker ADDRESS`, then run the same command again",
                )
            time.sleep(_BETWEEN_CHECKS_S)

    def _submit(self, client: Any, index: int) -> Any:
        # Sent by value, with arguments as bytes, so that the scheduler does not need msal.
        def msal(version: str, payload: bytes) -> bytes:
            from msal_cli.batch.dask import denoise_in_child

            return denoise_in_child(version, payload)

        work = self._work
        common = (os.getcwd(), work.function, work.common)
        must_exist = (*self._probes, os.path.join(os.getcwd(), ""))
        payload = pickle.dumps(
            (must_exist, common, work.limits, work.retries, index, work.tasks[index])
        )
        return client.submit(msal, __version__, payload, pure=False)


def _connect(scheduler: str) -> Any:
    """A client connected to the scheduler; UsageError if none answers."""
    import distributed

    # These loggers print to standard error.
    for name in ("distributed", "distributed.client", "tornado.application", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        return distributed.Client(scheduler, set_as_default=False, timeout=_CONNECT_S)
    except (OSError, ValueError, TimeoutError, RuntimeError) as error:
        raise UsageError(
            f"there is no Dask scheduler at {scheduler}: {error}",
            hint="`dask scheduler` prints its address when it starts",
        ) from error


def _has_workers(client: Any) -> bool:
    try:
        return bool(client.nthreads())
    except (OSError, TimeoutError) as error:
        _log.debug("the scheduler does not answer: %s", error)
        return False


def _read_answer(index: int, answer: Any) -> Returned | Failed | None:
    """How a task has ended; None if its Dask workers died.  Any other error of Dask is raised."""
    if isinstance(answer, bytes):
        end: Returned | Failed = pickle.loads(answer)
        return end
    # An error comes as (type, value, traceback).
    error = answer[1] if isinstance(answer, tuple) else answer
    if type(error).__name__ == "KilledWorker":
        return None
    if isinstance(error, UsageError):
        raise error
    hint = "finished files are kept; the same command goes on from there"
    raise ResourceError(f"Dask cannot go on: {type(error).__name__}: {error}", hint=hint)


def denoise_in_child(version: str, payload: bytes) -> bytes:
    """Denoise a file in a child process of this Dask worker; return its last message, pickled.

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
        on_death=lambda pid, index: sweep(folders, pid),
    )
    pool = WorkerPool(work)
    key, is_over = worker.get_current_task(), threading.Event()

    def end_if_cancelled() -> None:
        # The run that submitted this task may have ended, or have been killed.
        while not is_over.wait(_BETWEEN_CHECKS_S):
            task = worker.state.tasks.get(key)
            if task is None or task.state in ("cancelled", "released", "forgotten"):
                pool.interrupt()
                return

    threading.Thread(target=end_if_cancelled, daemon=True).start()
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
    """Run a task in the folder from which msal was started, so that relative paths are valid."""
    folder, function, its_common = common
    if os.path.isdir(folder):
        os.chdir(folder)
    return function(task, its_common, on_progress)
