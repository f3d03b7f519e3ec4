"""What ``msal compare`` holds its records against: gates, and the figures of an earlier run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.job.comparison_record import ComparisonRecord
    from msal_cli.report.gates import Gate

DEFAULT_TOLERANCE = 0.01


@dataclass(frozen=True)
class Measure:
    """Gates, and the figures of an earlier run by path; None if there are none."""

    gates: tuple[Gate, ...]
    earlier: Mapping[str, Any] | None
    tolerance: float

    def names_field(self, field: str) -> bool:
        """Whether a gate depends on a field of the record."""
        from msal_cli.report import gates

        return gates.names_field(self.gates, field)

    def of_two(self, record: ComparisonRecord) -> ComparisonRecord:
        """The record of two files with what became of the gates."""
        from msal_cli.report import baseline

        if self.earlier is None or record.error is not None:
            return self._judged([record], [None])[0]
        # A baseline of one pair is that of this pair, whatever the files are called.
        before = next(iter(self.earlier.values())) if len(self.earlier) == 1 else None
        before = before or baseline.partner(record.after, self.earlier)
        if before is None:
            raise UsageError(
                f"the baseline has no figures of {record.after!r}",
                hint="make it anew with msal compare --json",
            )
        return self._judged([record], [before])[0]

    def of_many(
        self, records: Sequence[ComparisonRecord], names: Sequence[str]
    ) -> list[ComparisonRecord]:
        """The records of folders, known by relative paths, with what became of the gates."""
        from msal_cli.report import baseline

        earlier = self.earlier or {}
        return self._judged(records, [baseline.partner(name, earlier) for name in names])

    def _judged(
        self, records: Sequence[ComparisonRecord], known: Sequence[Any]
    ) -> list[ComparisonRecord]:
        from dataclasses import replace

        from msal_cli.report import baseline
        from msal_cli.report.gates import with_gates

        return [
            record
            if record.error is not None or before is None
            else replace(
                record, gates=record.gates + baseline.judged(record, before, self.tolerance)
            )
            for record, before in zip(with_gates(self.gates, records), known, strict=True)
        ]

    def vanished(self, names: Sequence[str]) -> list[str]:
        """Paths of which the baseline has figures, and of which there are no files any more."""
        from msal_cli.report import baseline

        return baseline.missing(names, self.earlier or {})


def measure_of(
    expressions: Sequence[str],
    baseline: str | None,
    tolerance: float | None,
    file_unit: str | None = None,
) -> Measure:
    """What records are to be held against: gates, and the report at the path ``baseline``.

    ``file_unit`` is the unit of the files' lengths, where it is known.

    Raises
    ------
    UsageError
        for an expression that means nothing, or a tolerance without a baseline.
    MsalError
        if the baseline cannot be read, or is none.
    """
    from msal_cli import codecs as files
    from msal_cli.job.comparison_record import ComparisonRecord
    from msal_cli.report import read_comparison as comparison_reading
    from msal_cli.report.gates import parsed

    gates = parsed(expressions, ComparisonRecord, file_unit)
    if baseline is None:
        if tolerance is not None:
            raise UsageError("--tolerance needs --baseline", hint="name an earlier report")
        return Measure(gates, None, 0.0)
    data = bytes(files.read_whole(baseline))
    earlier = comparison_reading.comparisons(data, baseline)
    return Measure(gates, earlier, DEFAULT_TOLERANCE if tolerance is None else tolerance)
