"""How files are denoised by tiles, and what a run by tiles may use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from msal_cli.job.settings import Limits

if TYPE_CHECKING:
    from msal_cli.batch.engine import EngineFactory
    from msal_cli.batch.interrupts import Cancellation
    from msal_cli.batch.shard import Shard


@dataclass(frozen=True)
class TileOptions:
    """How files are denoised by tiles.

    Attributes
    ----------
    is_forced : all files are; otherwise those that do not fit into memory.
    scratch : folder for temporary files; None is that of the output.
    """

    is_forced: bool = False
    scratch: str | None = None


@dataclass(frozen=True)
class TileJob:
    """What a run by tiles may use.

    Attributes
    ----------
    options : see there; None where tiles are no way.
    limits : of the file; memory is that of all processes together.
    jobs : tasks at the same time at most.
    retries : how often a task is tried again whose worker was lost.
    engine : what runs the tasks; None is worker processes.
    cancellation : ends the run from another thread.
    shard : this process is one of several that take tasks of the same file.
    on_progress : called with ``("tiles", done, total)``, in parts of the whole cost.
    """

    options: TileOptions | None
    limits: Limits
    jobs: int
    retries: int = 1
    engine: EngineFactory | None = None
    cancellation: Cancellation | None = None
    shard: Shard | None = None
    on_progress: Callable[[str, int, int], None] = lambda stage, done, total: None
