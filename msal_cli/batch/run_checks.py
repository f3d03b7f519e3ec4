"""Numbers with which no run can do its work."""

from __future__ import annotations

from msal_cli.errors import UsageError
from msal_cli.job.settings import Limits, least_memory_bytes


def check_numbers(jobs: int | None, retries: int, stop_after_failures: int | None) -> None:
    """Refuse numbers of jobs, of retries and of failures that mean nothing; UsageError."""
    if jobs is not None and jobs < 1:
        raise UsageError(f"the number of jobs must be at least 1, not {jobs}")
    if stop_after_failures is not None and stop_after_failures < 1:
        raise UsageError(
            f"the number of failures to stop after must be at least 1, not {stop_after_failures}"
        )
    if retries < 0:
        raise UsageError(f"the number of retries must be at least 0, not {retries}")


def check_limits(limits: Limits) -> None:
    """Refuse limits within which no file can be denoised; UsageError."""
    if limits.timeout_s is not None and not limits.timeout_s > 0.0:
        raise UsageError(f"a file cannot be done within {limits.timeout_s:g} s")
    if limits.max_faces is not None and limits.max_faces < 1:
        raise UsageError(f"no file has {limits.max_faces} faces at most")
    least = least_memory_bytes()
    if limits.memory_bytes is not None and limits.memory_bytes < least:
        raise UsageError(
            f"a memory limit of {limits.memory_bytes / 1e6:.0f} MB is not enough for any file",
            hint=f"msal itself takes {least / 1e6:.0f} MB",
        )
