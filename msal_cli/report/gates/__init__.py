"""Gates: expressions that say when a file's record is not good enough, and what became of them.

``abs(volume_change) > 1%`` is broken by a file whose volume changed by more than that.  Text is
parsed by ``grammar``, its names and units are those of a record's fields (``quantities``), and
``evaluation`` compares units with each other before any file is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from msal_cli.job.records import GateResult

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from msal_cli.job.comparison_record import ComparisonRecord
    from msal_cli.job.records import MeshRecord
    from msal_cli.report.gates.evaluation import Meaning
    from msal_cli.report.gates.quantities import Quantity

_AGAINST_INPUT = {
    "mean_angular_error_deg": "normal_change.mean_deg",
    "max_angular_error_deg": "normal_change.max_deg",
}

Record = TypeVar("Record", "MeshRecord", "ComparisonRecord")


@dataclass(frozen=True)
class Gate:
    """One expression, its meaning, the quantities that it names, in the order in which it does,
    and the names of those of which it asks whether they are known."""

    expression: str
    meaning: Meaning
    quantities: Mapping[str, Quantity]
    tested: frozenset[str]


def parse_gates(
    expressions: Sequence[str], kind: Hashable, file_unit: str | None = None
) -> tuple[Gate, ...]:
    """The gates of several expressions over records of one kind.

    ``file_unit`` is the unit of the files' lengths, such as ``mm``, where it is known.

    Raises
    ------
    UsageError
        for what is no comparison, a name that no such record has, or units that do not go together;
        it names the column.
    """
    from msal_cli.report.gates.evaluation import check_units
    from msal_cli.report.gates.grammar import Expression
    from msal_cli.report.gates.quantities import quantities

    known = quantities(kind) if expressions else {}
    gates = []
    for text in expressions:
        expression = Expression(text)
        meaning = check_units(expression, known, file_unit)
        named = {name: known[name] for name in expression.names}
        gates.append(Gate(text, meaning, named, expression.names_in_known))
    return tuple(gates)


def refuse_without_reference(gates: Sequence[Gate], remedy: str) -> None:
    """Refuse gates on what is measured against a reference, where there is none.

    A gate that asks whether the value is known may stay.  ``remedy`` says how to get a reference.

    Raises
    ------
    UsageError
        for the first such gate.
    """
    from msal_cli.errors import UsageError

    for gate in gates:
        for name, quantity in gate.quantities.items():
            if quantity.needs_reference and name not in gate.tested:
                own = _AGAINST_INPUT.get(name)
                instead = f", or write {own}: the angle to the input's normals" if own else ""
                raise UsageError(
                    f"the gate {gate.expression!r}: {name} is measured against a reference, and "
                    "there is none",
                    hint=remedy + instead,
                )


def names_field(gates: Sequence[Gate], field: str) -> bool:
    """Whether any gate depends on a field of the record, or on one within it."""
    paths = {path for gate in gates for one in gate.quantities.values() for path in one.fields}
    return any(path == field or path.startswith(f"{field}.") for path in paths)


def evaluate_gates(gates: Sequence[Gate], record: Any) -> tuple[GateResult, ...]:
    """What each gate says of one record.

    What is not known decides nothing: ``volume.valid and abs(volume_change) > 1%`` holds for an
    open mesh, and ``abs(volume_change) > 1%`` cannot be decided, which counts as broken.
    """
    return tuple(_evaluate(gate, record) for gate in gates)


def with_gates(gates: Sequence[Gate], records: Sequence[Record]) -> list[Record]:
    """The records with the results of the gates, but for those of files that failed or were not
    dealt with: their status says enough."""
    from dataclasses import replace

    if not gates:
        return list(records)
    return [
        record
        if record.error is not None or getattr(record, "status", "") == "planned"
        else replace(record, gates=evaluate_gates(gates, record))
        for record in records
    ]


def is_any_broken(records: Sequence[MeshRecord] | Sequence[ComparisonRecord]) -> bool:
    """Whether any record has a broken gate."""
    return any(gate.broken for record in records for gate in record.gates)


def _evaluate(gate: Gate, record: Any) -> GateResult:
    from msal_cli.report.gates.evaluation import Values

    values = Values(record, gate.quantities)
    verdict = gate.meaning.value(values)
    known = {name: values.raw(name) for name in gate.quantities}
    words = ", ".join(map(values.words, gate.quantities)) or "it names nothing of the file"
    if verdict is None:
        unknown = [values.why_unknown(name) for name, value in known.items() if value is None]
        words = "; ".join(unknown) or f"it cannot be computed: {words}"
    return GateResult(
        expression=gate.expression,
        broken=verdict is not False,
        decided=verdict is not None,
        # Of data, true is 1.
        values={name: value if value is None else value + 0 for name, value in known.items()},
        reason=words,
    )
