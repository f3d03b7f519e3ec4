"""What denoising commands make of records: measures, gates, and lines of the log."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.cli.denoise_request import Request
    from msal_cli.cli.environment import Clock
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Settings
    from msal_cli.report.document import Run
    from msal_cli.report.gates import Gate

_log = logging.getLogger("msal.denoise")


def judge(
    settings: Settings,
    records: Sequence[MeshRecord],
    references: Sequence[str],
    gates: Sequence[Gate],
) -> tuple[Sequence[MeshRecord], bool]:
    """The records, measured against their references and with what became of the gates; and
    whether any gate is broken."""
    if references:
        from msal_cli.job.comparison import with_references

        records = with_references(records, references, settings.format)
    if not gates:
        return records, False
    from msal_cli.report.gates import is_any_broken, with_gates

    records = with_gates(gates, records)
    log_gates(records)
    return records, is_any_broken(records)


def describe_run(
    request: Request,
    settings: Settings,
    clock: Clock,
    command: tuple[str, ...],
    *,
    interrupted: bool,
) -> Run:
    """The run, for its reports."""
    from dataclasses import asdict

    from msal_cli.cli import environment
    from msal_cli.report.document import Run
    from msal_cli.version import __version__

    is_reported = request.reports or request.as_json
    return Run(
        version=__version__,
        command=command,
        settings=asdict(settings),
        started=clock.started,
        finished=clock.now(),
        seconds=clock.seconds(),
        interrupted=interrupted,
        machine=environment.describe_machine() if is_reported else {},
    )


def log_record(record: MeshRecord) -> None:
    """One line of the log per file; a failure is printed elsewhere, so it is no warning here."""
    if record.error is not None:
        place = f"{record.error.where}: " if record.error.where else ""
        why = f"{record.error.code}: {place}{record.error.message}"
        _log.info("%s: failed: %s", record.input, why)
        return
    seconds = record.seconds.total if record.seconds is not None else 0.0
    _log.info("%s: %s in %.3f s -> %s", record.input, record.status, seconds, record.output)
    if record.choice is not None:
        _log.info("%s: %s", record.input, record.choice.reason)
    if record.left_alone is not None:
        _log.info("%s: left as it is: %s", record.input, record.left_alone)
    for warning in record.warnings:
        _log.info("%s: %s", record.input, warning)


def log_gates(records: Sequence[MeshRecord]) -> None:
    """One line of the log per broken gate."""
    for record in records:
        for gate in record.gates:
            if gate.broken:
                _log.info("%s: broke %s: %s", record.input, gate.expression, gate.reason)
