"""``--engine`` and ``--scheduler``: who hands out the files of a run."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.batch.engine import EngineFactory

_ADDRESS = r"(?a)([a-z]+://)?(\[[0-9a-fA-F:]+\]|[^\s:/]+):\d+"


def refuse_contradictions(
    engine: str, scheduler: str | None, jobs: int | None, *, in_place: bool
) -> None:
    """Check the options of the engine, also against others.

    Raises
    ------
    UsageError : they contradict each other, or Dask is not installed.
    """
    if engine == "workers":
        if scheduler is not None:
            raise UsageError("--scheduler needs --engine dask")
        return
    if scheduler is None:
        raise UsageError(
            "--engine dask needs a scheduler",
            hint="give --scheduler tcp://HOST:8786, or --scheduler local for this machine",
        )
    if scheduler != "local" and not re.fullmatch(_ADDRESS, scheduler):
        raise UsageError(
            f"--scheduler {scheduler}: this is not an address",
            hint="such as tcp://host:8786 or tls://host:8786; or the word local",
        )
    if scheduler != "local" and jobs is not None:
        raise UsageError(
            "-j is for this machine; a Dask cluster has as many workers as it has",
            hint="leave -j away, or use --scheduler local",
        )
    if in_place:
        raise UsageError(
            "--in-place cannot be used with Dask, which may do a file twice",
            hint="name an output folder with -o, or leave --engine dask away",
        )
    _refuse_without_dask()


def _refuse_without_dask() -> None:
    import importlib.util

    from msal_cli.batch.dask_cluster import not_installed

    if importlib.util.find_spec("distributed") is None:
        raise not_installed()


def chosen(engine: str, scheduler: str | None) -> EngineFactory | None:
    """What makes the engine; None is the ordinary one."""
    if engine == "workers" or scheduler is None:
        return None
    from functools import partial

    from msal_cli.batch.dask_engine import DaskEngine

    return partial(DaskEngine, scheduler=scheduler)
