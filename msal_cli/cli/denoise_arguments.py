"""The command line of ``msal denoise``, as its modules hand it on."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Request:
    """The command line of ``msal denoise``, as click has read it."""

    inputs: tuple[str, ...]
    output: str | None
    method: str | None
    iterations: str | None
    factor: str | None
    mollify: str | None
    schedule: str | None
    assignments: tuple[str, ...]
    auto: bool
    keep: str | None
    strength: float | None
    prefer: str | None
    auto_budget: float | None
    max_move: str | None
    lock: tuple[str, ...]
    despike: bool | None
    weights: str | None
    min_noise: str | None
    unit: str | None
    include: tuple[str, ...]
    exclude: tuple[str, ...]
    in_place: bool
    backup: str | None
    no_backup: bool
    to: str | None
    encoding: str
    precision: str
    strict: bool
    format: str | None
    jobs: int | None
    timeout: float | None
    memory_limit: int | None
    max_faces: int | None
    retries: int | None
    fail_fast: bool
    max_failures: int | None
    engine: str
    scheduler: str | None
    dry_run: bool
    force: bool
    fresh: bool
    retry_failed: bool
    shard: str | None
    fields: tuple[str, ...]
    checks: tuple[str, ...]
    reference: str | None
    fail_on: tuple[str, ...]
    reports: tuple[str, ...]
    as_json: bool
    quiet: bool
    verbose: int
    log_file: str | None
