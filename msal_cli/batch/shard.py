"""Shards: which files of a plan one of N processes takes, on one machine or on many.

A file belongs to the shard that a hash of its relative path says.  No process asks another, and a
file keeps its shard whatever other files come or go; only another N deals them out anew.
"""

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from msal_cli.errors import UsageError

MAX_SHARDS = 1_000_000
"""More would be fewer files a shard than the largest folders have."""


@dataclass(frozen=True, slots=True)
class Shard:
    """The ``number``-th of ``count`` shards; the first is 1."""

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    @property
    def file_part(self) -> str:
        """How the shard's own files are distinguished: ``2-of-4``."""
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


def parse_shard(text: str, environment: Mapping[str, str]) -> Shard:
    """The shard that ``K/N``, ``auto`` or ``auto/N`` means in this environment.

    ``auto`` takes it from the variables of array jobs of Slurm or AWS Batch, or of indexed jobs of
    Kubernetes, which has no N: that comes from ``auto/N``.

    Raises UsageError if it is none of these, or variables are missing or contradict one another.
    """
    first, slash, last = text.partition("/")
    if first != "auto":
        number, count = _parse_int(first), _parse_int(last)
        if number is None or count is None or not 1 <= number <= count <= MAX_SHARDS:
            raise UsageError(
                f"--shard {text}: a shard is K/N with 1 <= K <= N <= {MAX_SHARDS}, auto or auto/N",
                hint="four processes take --shard 1/4, 2/4, 3/4 and 4/4",
            )
        return Shard(number, count)
    expected = _parse_int(last)
    if slash and (expected is None or not 1 <= expected <= MAX_SHARDS):
        raise UsageError(
            f"--shard {text}: the number of shards must be a whole number from 1 to {MAX_SHARDS}"
        )
    jobs = {job[2:]: job for job in _read_environment(environment)}
    if not jobs:
        raise UsageError(
            f"--shard {text}: no variable of Slurm, AWS Batch or Kubernetes says which shard this "
            "is",
            hint="give --shard K/N, or run it in an array job or an indexed job",
        )
    if len(jobs) > 1:
        names = " and ".join(sorted(f"{name} ({words})" for name, words, _, _ in jobs.values()))
        raise UsageError(f"--shard {text}: {names} say different things", hint="give --shard K/N")
    ((system, variables, index, own_count),) = jobs.values()
    if own_count is not None and expected is not None and own_count != expected:
        raise UsageError(
            f"--shard {text}: {system} runs {own_count} processes ({variables}), not {expected}",
            hint="leave the number out, or start as many",
        )
    count = own_count if expected is None else expected
    if count is None:
        raise UsageError(
            f"--shard {text}: {system} does not say how many shards there are",
            hint="give --shard auto/N",
        )
    if not 0 <= index < count <= MAX_SHARDS:
        raise UsageError(
            f"--shard {text}: {system} says {variables}, which is none of {count} shards",
            hint="number the tasks without gaps, or give --shard K/N",
        )
    return Shard(index + 1, count)


def _read_environment(environment: Mapping[str, str]) -> Iterator[tuple[str, str, int, int | None]]:
    """System, its variables in words, index from 0, and how many there are, if that is known."""

    def number(name: str, default: int | None = None) -> int:
        text = environment.get(name)
        if text is None and default is not None:
            return default
        value = _parse_int(text or "")
        if value is None:
            raise UsageError(
                f"{name}={text or ''} is not a whole number",
                hint="give --shard K/N instead of auto",
            )
        return value

    def is_set(name: str) -> bool:
        return bool(environment.get(name))

    if is_set("SLURM_ARRAY_TASK_ID"):
        task = number("SLURM_ARRAY_TASK_ID")
        lowest, step = number("SLURM_ARRAY_TASK_MIN"), number("SLURM_ARRAY_TASK_STEP", 1)
        count = number("SLURM_ARRAY_TASK_COUNT")
        variables = f"SLURM_ARRAY_TASK_ID={task}, _MIN={lowest}, _STEP={step}"
        # Tasks with gaps (--array=1,2,7) have no index that could be counted.
        index, rest = divmod(task - lowest, step) if step else (-1, 0)
        yield ("Slurm", variables, -1 if rest else index, count)
    if is_set("AWS_BATCH_JOB_ARRAY_INDEX"):
        index, size = number("AWS_BATCH_JOB_ARRAY_INDEX"), "AWS_BATCH_JOB_ARRAY_SIZE"
        total = number(size) if is_set(size) else None
        yield ("AWS Batch", f"AWS_BATCH_JOB_ARRAY_INDEX={index}", index, total)
    if is_set("JOB_COMPLETION_INDEX"):
        index = number("JOB_COMPLETION_INDEX")
        yield ("Kubernetes", f"JOB_COMPLETION_INDEX={index}", index, None)


def _parse_int(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 9 else None
