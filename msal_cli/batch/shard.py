"""Shards: which files of a plan one of N processes takes, on one machine or on many.

A file belongs to the shard that a hash of its relative path says.  No process asks another, and a
file keeps its shard whatever other files come or go; only another N deals them out anew.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from msal_cli.errors import UsageError

MOST = 1_000_000
"""Shards at most; more would be fewer files a shard than the largest folders have."""

COUNT_VARIABLE = "MSAL_SHARDS"
"""The environment variable that gives N where the system that starts the processes does not."""


@dataclass(frozen=True, slots=True)
class Shard:
    """The ``number``-th of ``count`` shards; the first is 1."""

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    @property
    def file_part(self) -> str:
        """How the shard's own files are told apart: ``2-of-4``."""
        return f"{self.number}-of-{self.count}"

    def has(self, relative: str) -> bool:
        """Whether a file of this relative path (written with ``/``) is one of this shard's."""
        return stable_hash(relative) % self.count == self.number - 1


def stable_hash(relative: str) -> int:
    """The first eight bytes, the highest first, of the SHA-256 of a path's own bytes."""
    try:
        name = os.fsencode(relative)
    except UnicodeEncodeError:
        # No file has such a name, but an address may.
        name = relative.encode("utf-8", "surrogatepass")
    return int.from_bytes(hashlib.sha256(name).digest()[:8], "big")


def settled(text: str, environment: Mapping[str, str]) -> Shard:
    """The shard that ``K/N``, ``auto`` or ``auto/N`` stands for in this environment.

    ``auto`` is what Slurm (array tasks, else tasks of a step), AWS Batch (array jobs) or Kubernetes
    (indexed jobs) says in the environment.  Where that has no N, as in Kubernetes, it comes from
    ``auto/N`` or from the variable MSAL_SHARDS.

    Raises
    ------
    UsageError : it is none of these; nothing is found; what is found does not fit together.
    """
    first, _, last = text.partition("/")
    if first != "auto":
        number, count = _whole(first), _whole(last)
        if number is None or count is None or not 1 <= number <= count <= MOST:
            raise UsageError(
                f"--shard {text}: a shard is K/N with 1 <= K <= N <= {MOST}, auto or auto/N",
                hint="four processes take --shard 1/4, 2/4, 3/4 and 4/4",
            )
        return Shard(number, count)
    wanted = _wanted(text, environment)
    found = {one.place: one for one in _found(environment)}
    if not found:
        raise UsageError(
            f"--shard {text}: no variable of Slurm, AWS Batch or Kubernetes tells which shard this "
            "is",
            hint="give --shard K/N, or run it in an array job or an indexed job",
        )
    if len(found) > 1:
        told = " and ".join(sorted(f"{one.system} ({one.told})" for one in found.values()))
        raise UsageError(f"--shard {text}: {told} say different things", hint="give --shard K/N")
    return next(iter(found.values())).shard(text, wanted)


@dataclass(frozen=True, slots=True)
class _Place:
    """What a system said: ``index`` from 0, and how many there are, where it says so."""

    system: str
    told: str
    index: int
    count: int | None

    @property
    def place(self) -> tuple[int, int | None]:
        return self.index, self.count

    def shard(self, text: str, wanted: int | None) -> Shard:
        if self.count is not None and wanted is not None and self.count != wanted:
            raise UsageError(
                f"--shard {text}: {self.system} runs {self.count} processes ({self.told}), "
                f"not {wanted}",
                hint="leave the number out, or start as many",
            )
        count = self.count if wanted is None else wanted
        if count is None:
            raise UsageError(
                f"--shard {text}: {self.system} does not tell how many shards there are",
                hint=f"give --shard auto/N, or set {COUNT_VARIABLE}",
            )
        if not 0 <= self.index < count <= MOST:
            raise UsageError(
                f"--shard {text}: {self.system} says {self.told}, which is none of {count} shards",
                hint="number the tasks without gaps, or give --shard K/N",
            )
        return Shard(self.index + 1, count)


def _wanted(text: str, environment: Mapping[str, str]) -> int | None:
    """N as the user gave it, by the option or by the variable."""
    _, slash, last = text.partition("/")
    source, given = (f"--shard {text}", last) if slash else ("", environment.get(COUNT_VARIABLE))
    if not slash:
        source = f"{COUNT_VARIABLE}={given}"
    if not given and not slash:
        return None
    count = _whole(given or "")
    if count is None or not 1 <= count <= MOST:
        raise UsageError(f"{source}: the number of shards must be a whole number from 1 to {MOST}")
    return count


def _found(environment: Mapping[str, str]) -> Iterator[_Place]:
    def number(name: str, default: int | None = None) -> int:
        given = environment.get(name)
        if given is None and default is not None:
            return default
        value = _whole(given or "")
        if value is None:
            raise UsageError(
                f"{name}={given or ''} is not a whole number",
                hint="give --shard K/N instead of auto",
            )
        return value

    if environment.get("SLURM_ARRAY_TASK_ID"):
        yield _slurm_array(number)
    elif environment.get("SLURM_PROCID"):
        yield _slurm_step(number, environment)
    if environment.get("AWS_BATCH_JOB_ARRAY_INDEX"):
        index = number("AWS_BATCH_JOB_ARRAY_INDEX")
        size = "AWS_BATCH_JOB_ARRAY_SIZE"
        count = number(size) if _is_set(environment, size) else None
        yield _Place("AWS Batch", f"AWS_BATCH_JOB_ARRAY_INDEX={index}", index, count)
    if environment.get("JOB_COMPLETION_INDEX"):
        index = number("JOB_COMPLETION_INDEX")
        yield _Place("Kubernetes", f"JOB_COMPLETION_INDEX={index}", index, None)


def _slurm_array(number: Callable[..., int]) -> _Place:
    task = number("SLURM_ARRAY_TASK_ID")
    lowest, step = number("SLURM_ARRAY_TASK_MIN"), number("SLURM_ARRAY_TASK_STEP", 1)
    count = number("SLURM_ARRAY_TASK_COUNT")
    told = f"SLURM_ARRAY_TASK_ID={task}, _MIN={lowest}, _STEP={step}"
    # Tasks with gaps (--array=1,2,7) have no place that could be counted out.
    index, rest = divmod(task - lowest, step) if step else (-1, 0)
    return _Place("Slurm", told, -1 if rest else index, count)


def _slurm_step(number: Callable[..., int], environment: Mapping[str, str]) -> _Place:
    index = number("SLURM_PROCID")
    count = number(
        "SLURM_STEP_NUM_TASKS" if _is_set(environment, "SLURM_STEP_NUM_TASKS") else "SLURM_NTASKS"
    )
    is_script = _is_set(environment, "SLURM_JOB_ID") and not _is_set(environment, "SLURM_STEP_ID")
    if is_script and index == 0 and count > 1:
        # It would take the first shard, and nobody the others.
        raise UsageError(
            f"this is the batch script itself, not one of the {count} tasks of a step",
            hint="start it with srun, or leave --shard away",
        )
    return _Place("Slurm", f"SLURM_PROCID={index}", index, count)


def _is_set(environment: Mapping[str, str], name: str) -> bool:
    return bool(environment.get(name))


def _whole(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 9 else None
