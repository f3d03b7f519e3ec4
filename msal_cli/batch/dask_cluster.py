"""A Dask cluster behind an address.

Nothing here blocks but ``open`` and ``close``; events of the cluster go to ``on_event``, which
Dask's own thread calls.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

from msal_cli.batch.dask_worker import (
    TOPIC,
    storage_access_error,
    version_mismatch,
)
from msal_cli.errors import ResourceError, UsageError, install_hint

_CONNECT_S = 10.0
_ANSWER_S = 30.0
_SILENCE_S = 5.0
_BETWEEN_LOOKS_S = 1.0
_CLOSED_WITHIN_S = 1.5

_log = logging.getLogger("msal.dask")


class DaskCluster:
    """The way to a Dask scheduler and its workers.

    Parameters
    ----------
    scheduler : the scheduler's address.
    on_event : called from another thread with ``("threads", n)`` every second (n is None while the
        scheduler does not answer), ``("messages", address, run, bytes)`` and ``("answer", number,
        bytes or exception)``.
    """

    def __init__(self, scheduler: str, on_event: Callable[..., None]) -> None:
        self._scheduler = scheduler
        self._on_event = on_event
        self._is_closed = False
        self._undo = contextlib.ExitStack()
        self._client: Any = None

    # Beginning

    def open(self, patience_s: float) -> None:
        """Connect, and wait until there is a worker.

        Raises
        ------
        UsageError : Dask is not installed, or there is no scheduler.
        ResourceError : no worker comes within ``patience_s``.
        """
        try:
            import distributed
        except ImportError as error:
            raise not_installed() from error
        self._undo.enter_context(_captured_logs())
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                self._client = distributed.Client(
                    self._scheduler, set_as_default=False, timeout=_CONNECT_S
                )
        except (OSError, ValueError, TimeoutError, RuntimeError) as error:
            raise UsageError(
                f"there is no Dask scheduler at {self._scheduler}: {error}",
                hint="`dask scheduler` prints its address when it starts",
            ) from error
        for one in caught:
            # Such as other versions of Dask or Python at the workers, in a table.
            _log.info("Dask warns: %s", one.message)
        self._wait_for_workers(patience_s)

    def _wait_for_workers(self, patience_s: float) -> None:
        started = time.monotonic()
        is_reported = False
        while not self._is_closed:
            waited = time.monotonic() - started
            try:
                if self._request(self._client.scheduler.ncores()):
                    return
            except (OSError, TimeoutError) as error:
                _log.debug("the scheduler does not answer: %s", error)
            if waited > patience_s:
                raise no_workers(self._scheduler, waited)
            if waited > _SILENCE_S and not is_reported:
                is_reported = True
                _log.warning("waiting for workers at the Dask scheduler %s", self._scheduler)
            time.sleep(0.1)

    def check(self, version: str, must_exist: tuple[str, ...]) -> None:
        """Refuse workers that would do something else than this process.

        Raises
        ------
        UsageError : a worker has another version of msal, or does not see the files of the run.
        """

        # Sent by value: a worker may not have msal at all.
        def probe(paths: tuple[str, ...]) -> tuple[str | None, list[str]]:

            try:
                from msal_cli.version import __version__
            except ImportError:
                return None, []
            return __version__, [path for path in paths if not os.path.exists(path)]

        try:
            answers = self._request(
                self._client.run(probe, must_exist, on_error="return", asynchronous=True)
            )
        except (OSError, TimeoutError) as error:
            raise ResourceError(f"the Dask workers do not answer: {error}") from error
        for address, answer in sorted(answers.items()):
            if isinstance(answer, Exception):
                # It may have died this very moment; what matters is checked with every batch.
                _log.warning("the Dask worker at %s does not answer: %s", address, answer)
                continue
            theirs, missing = answer
            if theirs != version:
                raise UsageError(
                    version_mismatch(address, theirs, version),
                    hint="install the same version of msal-cli everywhere",
                )
            if missing:
                raise UsageError(
                    storage_access_error(address, missing[0]),
                    hint="inputs and outputs must lie where all machines see them by the same path",
                )

    def watch(self) -> None:
        """Begin to report workers and messages."""
        self._client.subscribe_topic(TOPIC, self._forward)
        self._call_soon(self._poll_workers())

    # Work

    def submit(self, key: str, number: int, version: str, payload: bytes) -> Any:
        """Hand a batch to Dask; the future must be kept until the answer is there."""

        # Sent by value: the scheduler looks at the function, and needs not have msal.
        def msal(version: str, payload: bytes) -> bytes:
            from msal_cli.batch.dask_worker import run_batch

            return run_batch(version, payload)

        future = self._client.submit(msal, version, payload, key=key, pure=False)
        self._call_soon(self._watch_future(future, number))
        return future

    def cancel(self, future: Any) -> None:
        """Take a batch back; if it has begun, its worker gives it up soon."""
        self._client.cancel([future], asynchronous=False)

    async def _watch_future(self, future: Any, number: int) -> None:
        answer: Any
        try:
            (answer,) = await self._client.gather([future], asynchronous=True)
        except asyncio.CancelledError as error:
            answer = error
        except Exception as error:
            answer = error
        self._on_event("answer", number, answer)

    async def _poll_workers(self) -> None:
        while not self._is_closed:
            try:
                threads = await asyncio.wait_for(self._client.scheduler.ncores(), _CONNECT_S)
                self._on_event("threads", sum(threads.values()))
            except (Exception, asyncio.CancelledError) as error:
                if self._is_closed:
                    return
                _log.debug("the scheduler does not answer: %s", error)
                self._on_event("threads", None)
            await asyncio.sleep(_BETWEEN_LOOKS_S)

    def _forward(self, event: tuple[float, Any]) -> None:
        _, message = event
        if isinstance(message, dict) and "messages" in message:
            self._on_event("messages", message["address"], message["run"], message["messages"])

    def _call_soon(self, coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self._client.loop.asyncio_loop)

    def _request(self, awaitable: Any) -> Any:
        async def answer() -> Any:
            return await asyncio.wait_for(awaitable, _ANSWER_S)

        return self._call_soon(answer()).result()

    # Ending

    def close(self) -> None:
        """Close the connection; two seconds at most."""
        self._is_closed = True
        closing = threading.Thread(target=self._close_dask, daemon=True)
        closing.start()
        closing.join(_CLOSED_WITHIN_S)
        self._undo.close()

    def _close_dask(self) -> None:
        try:
            if self._client is not None:
                self._client.close(timeout=_CLOSED_WITHIN_S)
        except Exception as error:
            # Whatever Dask meets on its way out, the work is done or given up already.
            _log.debug("at the end of the Dask client: %s", error)


def not_installed() -> UsageError:
    """The error for a Python without Dask distributed."""
    return UsageError("Dask is not installed", hint=install_hint("dask"))


def no_workers(scheduler: str, waited_s: float) -> ResourceError:
    """The error for a scheduler without workers."""
    return ResourceError(
        f"no worker at the Dask scheduler {scheduler} for {waited_s:.0f} s",
        hint="start some with `dask worker ADDRESS`, then run the same command again",
    )


class _LogCapture(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        _log.debug("%s: %s", record.name, record.getMessage())


@contextlib.contextmanager
def _captured_logs() -> Any:
    """Dask's loggers print to standard error; have them write to our log meanwhile."""
    names = ("distributed", "distributed.client", "tornado", "tornado.application", "asyncio")
    capture = _LogCapture()
    before = []
    for logger in map(logging.getLogger, names):
        before.append((logger, logger.handlers[:], logger.propagate))
        logger.handlers[:] = [capture]
        logger.propagate = False
    try:
        yield
    finally:
        for logger, handlers, propagates in before:
            logger.handlers[:] = handlers
            logger.propagate = propagates
