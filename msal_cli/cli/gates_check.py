"""The checks of ``msal compare``: gates, and the figures of an earlier run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.job.comparison_record import ComparisonRecord
    from msal_cli.report.gates import Gate

DEFAULT_TOLERANCE = 0.01


@dataclass(frozen=True)
class Checks:
    """Gates, and the figures of an earlier run by path; None if there are none."""

    gates: tuple[Gate, ...]
    earlier: Mapping[str, Any] | None
    tolerance: float

    def judge_pair(self, record: ComparisonRecord) -> ComparisonRecord:
        """The record of two files with what became of the gates."""
        from msal_cli.report import baseline

        if self.earlier is None or record.error is not None:
            return self._judge([record], [None])[0]
        # A baseline of one pair is that of this pair, whatever the files are called.
        before = next(iter(self.earlier.values())) if len(self.earlier) == 1 else None
        before = before or baseline.partner(record.after, self.earlier)
        if before is None:
            raise UsageError(
                f"the baseline has no figures of {record.after!r}",
                hint="make it anew with msal compare --json",
            )
        return self._judge([record], [before])[0]

    def judge_pairs(self, records: Mapping[str, ComparisonRecord]) -> list[ComparisonRecord]:
        """The records by path with what became of the gates."""
        from msal_cli.report import baseline

        earlier = [baseline.partner(name, self.earlier or {}) for name in records]
        return self._judge(list(records.values()), earlier)

    def _judge(
        self, records: Sequence[ComparisonRecord], earlier: Sequence[Any]
    ) -> list[ComparisonRecord]:
        from msal_cli.report import baseline
        from msal_cli.report.gates import with_gates

        return [
            record
            if record.error is not None or before is None
            else replace(
                record,
                gates=record.gates + baseline.compare_with_baseline(record, before, self.tolerance),
            )
            for record, before in zip(with_gates(self.gates, records), earlier, strict=True)
        ]


def build_checks(
    expressions: Sequence[str], baseline: str | None, tolerance: float | None, unit: str | None
) -> Checks:
    """The checks: gates, and the report at the path ``baseline``.

    ``unit`` is that of the files' lengths, where it is known.

    Raises
    ------
    UsageError
        for an expression that means nothing.
    MsalError
        if the baseline cannot be read, or is none.
    """
    from msal_cli.job.comparison_record import ComparisonRecord
    from msal_cli.report.gates import parse_gates
    from msal_cli.report.read_comparison import comparisons
    from msal_cli.storage import gzip_streams

    gates = parse_gates(expressions, ComparisonRecord, unit)
    if baseline is None:
        return Checks(gates, None, 0.0)
    earlier = comparisons(bytes(gzip_streams.read_whole(baseline)), baseline)
    return Checks(gates, earlier, DEFAULT_TOLERANCE if tolerance is None else tolerance)
