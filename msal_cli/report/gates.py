"""Gates: expressions that say when a file's record is not good enough, and their results.

``abs(volume_change) > 1%`` is broken by a file whose volume changed by more than that.  Names are
the numbers of a record, with the units of its fields; units are compared with each other while
the text is parsed, before any file is read.  A value that is not known, or cannot be computed, is
None and stays so, except that ``and`` and ``or`` may be decided without it.
"""

from __future__ import annotations

import difflib
import functools
import math
import operator
import re
import typing
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

from msal_cli.errors import UsageError
from msal_cli.job.constraints import COMPARISONS, UNIT_PATTERN, in_file_units
from msal_cli.job.plain_data import value_at
from msal_cli.job.records import GateResult
from msal_cli.report.data import leaf_fields

if typing.TYPE_CHECKING:
    from msal_cli.job.records import ComparisonRecord, MeshRecord

Value = float | bool | None
Record = TypeVar("Record", "MeshRecord", "ComparisonRecord")

MAX_LENGTH = 300
"""Characters of an expression, which bounds how deep its meaning can be nested."""

_MAX_DEPTH = 20

# Quantities


@dataclass(frozen=True)
class Unit:
    """What a number is.

    ``constant`` is a number in the expression, ``number`` one that is counted or in a
    unit which the name says (degrees, seconds), ``quotient`` one of two alike.  ``percent`` and
    ``relative`` are in percent, and a bare number means percent beside the first and nothing beside
    the second.  ``edges`` is in mean edge lengths, ``length`` in file units to a ``power``.
    """

    kind: str
    power: int = 0

    def __str__(self) -> str:
        if self.kind == "length":
            return {2: "an area", 3: "a volume"}.get(self.power, "a length")
        words = {"percent": "a percentage", "relative": "a percentage", "edges": "a length"}
        return words.get(self.kind, "a plain number")


TRUTH, CONSTANT, NUMBER = Unit("truth"), Unit("constant"), Unit("number")
QUOTIENT, PERCENT, RELATIVE = Unit("quotient"), Unit("percent"), Unit("relative")
EDGES, LENGTH = Unit("edges"), Unit("length", 1)

SHORT_NAMES: dict[str, tuple[tuple[str, ...], Unit | None]] = {
    "volume_change": (("volume.change_percent", "volume_change_percent"), RELATIVE),
    "area_change": (("area.change_percent", "area_change_percent"), RELATIVE),
    "mean_displacement": (("displacement.mean",), None),
    "rms_displacement": (("displacement.rms",), None),
    "p95_displacement": (("displacement.p95",), None),
    "max_displacement": (("displacement.max",), None),
    "moved_vertices": (("displacement.moved_vertices",), None),
    "mean_angular_error_deg": (("reference.mean_angular_error_deg",), None),
    "max_angular_error_deg": (("reference.max_angular_error_deg",), None),
    "vertex_error_percent": (("reference.vertex_error_percent",), None),
    "hausdorff": (("reference.hausdorff",), None),
    "self_intersections": (("self_intersections.created",), None),
    "fixed_border_vertices": (("tile_set.fixed_border_vertices",), None),
    "noise": (("noise_estimate.file_units",), None),
    "risk": (("choice.risk_edges",), None),
    "seconds": (("seconds.total",), None),
}
"""The fields behind a short name, of which the first known one counts, and its unit if it differs.

Of these, a kind of record has the ones that it has fields for."""

_LENGTHS = {"hausdorff", "seam_gap", "tile_gap", "largest_weld", "mean_edge_length", "file_units"}
_STATISTICS = {"mean", "rms", "p95", "max"}
_POWERS = {"volume": 3, "area": 2}
_AGAINST_INPUT = {
    "mean_angular_error_deg": "normal_change.mean_deg",
    "max_angular_error_deg": "normal_change.max_deg",
}


@dataclass(frozen=True)
class Quantity:
    """The value of a name: the first of these fields that is known, in its unit."""

    name: str
    fields: tuple[str, ...]
    unit: Unit

    def value_in(self, record: Any) -> Any:
        """The value in a record; None if it is not known there."""
        values = (value_at(record, path) for path in self.fields)
        return next((v for v in values if v is not None and v - v == 0.0), None)

    def describe(self, record: Any) -> str:
        """The value with its unit: ``max_displacement is 0.0123 (0.62e)``."""
        value, edge = self.value_in(record), _edge_length(record)
        if value is None:
            return self.why_unknown(record)
        if isinstance(value, bool):
            return f"{self.name} is {'true' if value else 'false'}"
        end = {"percent": "%", "relative": "%", "edges": "e"}.get(self.unit.kind, "")
        if self.unit == LENGTH and edge is not None and self.name != "mean_edge_length":
            end = f" ({value / edge:.4g}e)"
        return f"{self.name} is {f'{value:,}' if isinstance(value, int) else f'{value:.6g}'}{end}"

    @property
    def needs_reference(self) -> bool:
        """Whether it is measured against a reference mesh, and against nothing else."""
        return all(path.startswith("reference.") for path in self.fields)

    def why_unknown(self, record: Any) -> str:
        """Why there is no value in a record, in words."""
        volume = getattr(record, "volume", None)
        reference: Any = getattr(record, "reference", None)
        why = ""
        if volume is not None and not volume.valid and any("volume" in p for p in self.fields):
            why = volume.reason or "the volume means nothing"
        elif self.needs_reference and reference is None:
            why = "nothing was measured against a reference"
        elif self.needs_reference and reference.error is not None:
            why = reference.error.message
        elif any(path.startswith("self_intersections.") for path in self.fields):
            why = "count them with --check self-intersections"
        elif self.name == "tile_gap" or self.fields[0].startswith("tile_set."):
            why = "files are denoised as one with --tile-set"
        elif self.name == "despiked":
            why = "outliers were not looked for, as --despike does"
        return f"{self.name} is not known{f': {why}' if why else ' for this file'}"


@functools.cache
def quantities(kind: Hashable) -> Mapping[str, Quantity]:
    """Everything that can be named of a kind of record, short names first."""
    fields = {
        path: TRUTH if part is bool else _unit(path)
        for path, parts in leaf_fields(typing.cast("type[Any]", kind))
        for part in parts
        if part in (bool, int, float)
    }
    found = {}
    for name, (paths, unit) in SHORT_NAMES.items():
        there = tuple(path for path in paths if path in fields)
        if there:
            found[name] = Quantity(name, there, unit or fields[there[0]])
    return found | {name: Quantity(name, (name,), unit) for name, unit in fields.items()}


def _unit(path: str) -> Unit:
    parent, _, name = path.rpartition(".")
    group = parent.rpartition(".")[2]
    if name.endswith("_percent"):
        return PERCENT
    is_count = name.startswith(("boundary", "non_manifold", "inconsistent"))
    if name.endswith("_edges") and not is_count:
        return EDGES
    if name in _LENGTHS or (name in _STATISTICS and group):
        return LENGTH
    return Unit("length", _POWERS[group]) if group in _POWERS else NUMBER


def _edge_length(record: Any) -> float | None:
    edge: float | None = record.mean_edge_length
    return edge if edge and edge - edge == 0.0 else None


# Expressions

_HINT = "write what breaks the gate, such as 'abs(volume_change) > 1%'; see docs/gates.md"
_HINTS = {"=": "equal is ==", "&": "write and", "|": "write or", "!": "write not, or != "}
_MAX_PARTS = {"abs": 1, "known": 1, "min": 9, "max": 9}
_PRECEDENCE = {"or": 1, "and": 2, "not": 3, **dict.fromkeys(COMPARISONS, 4)}
_PRECEDENCE |= {"+": 5, "-": 5, "*": 6, "/": 6}
_UNARY = 7
_JOINED: dict[str, Callable[..., float]]
_JOINED = {"+": operator.add, "-": operator.sub, "min": min, "max": max}
_LITERALS = {"": CONSTANT, "%": PERCENT, "e": EDGES}
_PLAIN = (CONSTANT, NUMBER, QUOTIENT)
_BARE = (CONSTANT, QUOTIENT)
_PERCENTS = (PERCENT, RELATIVE)

# An e that no digits follow is the unit of mean edge lengths, else an exponent.
_TOKEN = re.compile(
    rf"(?a)\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?P<unit>%|(?:e|{UNIT_PATTERN})\b)?"
    r"|(?P<name>[A-Za-z_][\w.]*)|(?P<sign><=|>=|==|!=|[<>()+\-*/,])|(?P<other>\S))"
)


class _Meaning(NamedTuple):
    """A part of an expression: its unit, its value in a record, the column of its operator, and its
    name if it is nothing but that."""

    unit: Unit
    value: Callable[[Any], Value]
    at: int
    name: str = ""


class _Token(NamedTuple):
    """A ``number``, ``name``, ``sign`` (also and, or, not) or the ``end``; ``at`` is from 1."""

    kind: str
    text: str
    at: int
    unit: str = ""


class _Parser:
    """Reads an expression by the precedence of its operators."""

    def __init__(self, text: str, known: Mapping[str, Quantity], file_unit: str | None) -> None:
        self._text = text
        self._known = known
        self._file_unit = file_unit
        self._depth = 0
        self.names: dict[str, Quantity] = {}
        self.tested: set[str] = set()
        if len(text) > MAX_LENGTH:
            self._text = text[:40] + "..."
            raise self._error(MAX_LENGTH, f"it is longer than {MAX_LENGTH} characters")
        self._tokens = list(self._read_tokens())[::-1]

    def parse(self) -> _Meaning:
        """The meaning of the whole."""
        whole = self._read(0)
        self._require("end")
        if whole.unit != TRUTH:
            why = "it is a number, and a gate is broken or not"
            raise self._error(whole.at, why, "compare it, as in 'max_displacement > 0.5e'")
        return whole

    def _error(self, at: int, why: str, hint: str = _HINT) -> UsageError:
        return UsageError(f"the gate {self._text!r}, column {at}: {why}", hint=hint)

    def _read_tokens(self) -> Iterator[_Token]:
        for match in _TOKEN.finditer(self._text.rstrip()):
            kind = next(name for name in ("number", "name", "sign", "other") if match[name])
            word, at = match[kind], match.start(kind) + 1
            if kind == "other":
                raise self._error(at, f"{word!r} means nothing here", _HINTS.get(word, _HINT))
            kind = "sign" if word in ("and", "or", "not") else kind
            yield _Token(kind, word, at, match["unit"] or "")
        yield _Token("end", "", len(self._text) + 1)

    def _misplaced(self, token: _Token, before: str = "") -> UsageError:
        what = "it ends too early" if token.kind == "end" else f"{token.text!r} is out of place"
        return self._error(token.at, before + what)

    def _require(self, kind: str) -> None:
        token = self._tokens.pop()
        if kind not in (token.kind, token.text):
            raise self._misplaced(token, "')' is missing, " if kind == ")" else "")

    def _read(self, precedence: int) -> _Meaning:
        """A part, up to an operator that does not bind more than ``precedence``."""
        token = self._tokens.pop()
        if token.text == "not" and precedence <= _PRECEDENCE["not"]:
            inner = self._truth(self._read(_PRECEDENCE["not"]), "not")
            left = _Meaning(TRUTH, _apply(operator.not_, inner.value), token.at)
        elif token.kind == "sign" and token.text in "+-":
            left = self._read(_UNARY)
            if token.text == "-":
                self._check_numbers(left)
                left = _Meaning(left.unit, _apply(operator.neg, left.value), token.at)
        elif token.kind == "number":
            left = self._number(token)
        elif token.kind == "name":
            left = self._call(token) if self._tokens[-1].text == "(" else self._name(token)
        elif token.text == "(":
            (left,) = self._read_parts(token, several=False)
        else:
            raise self._misplaced(token)
        is_compared = False
        while _PRECEDENCE.get(self._tokens[-1].text, 0) > precedence:
            token = self._tokens.pop()
            if token.text == "not":
                raise self._misplaced(token)
            if token.text in COMPARISONS and is_compared:
                why = "it compares a third time"
                raise self._error(token.at, why, "join two comparisons with and")
            is_compared = token.text in COMPARISONS
            left = self._combine(token, left, self._read(_PRECEDENCE[token.text]))
        return left

    def _read_parts(self, opening: _Token, *, several: bool) -> list[_Meaning]:
        """What is between parentheses, of which the first has been read."""
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise self._error(opening.at + 1, f"parentheses go deeper than {_MAX_DEPTH} levels")
        parts = [self._read(0)]
        while several and self._tokens[-1].text == ",":
            self._tokens.pop()
            parts.append(self._read(0))
        self._require(")")
        self._depth -= 1
        return parts

    def _call(self, token: _Token) -> _Meaning:
        if token.text not in _MAX_PARTS:
            why = f"there is no function {token.text}"
            raise self._error(token.at, why, f"known are: {', '.join(_MAX_PARTS)}")
        max_parts = _MAX_PARTS[token.text]
        parts = self._read_parts(self._tokens.pop(), several=True)
        if len(parts) > max_parts:
            many = "one value" if max_parts == 1 else f"1 to {max_parts} values"
            raise self._error(token.at, f"{token.text} takes {many}")
        first = parts[0]
        if token.text == "known":
            if not first.name:
                raise self._error(first.at, "known takes a name", "as in known(volume_change)")
            self.tested.add(first.name)
            return _Meaning(TRUTH, lambda record: first.value(record) is not None, token.at)
        self._check_numbers(*parts)
        if token.text == "abs":
            return _Meaning(first.unit, _apply(abs, first.value), token.at)
        total = first._replace(at=token.at, name="")
        for part in parts[1:]:
            total = self._join_alike(token, total, part)
        return total

    def _number(self, token: _Token) -> _Meaning:
        number = float(token.text)
        if not math.isfinite(number):
            raise self._error(token.at, "the number is too large")
        unit = _LITERALS.get(token.unit, LENGTH)
        if token.unit not in _LITERALS:
            try:
                number = in_file_units(token.text, token.unit, self._file_unit)
            except UsageError as error:
                raise self._error(token.at, error.message, error.hint) from None
        return _Meaning(unit, lambda record: number, token.at)

    def _name(self, token: _Token) -> _Meaning:
        name = token.text
        if name in self._known:
            quantity = self.names[name] = self._known[name]
            # Counts, too, are floating numbers in computations.
            value: Callable[[Any], Value] = quantity.value_in
            if quantity.unit != TRUTH:
                value = _apply(float, value)
            return _Meaning(quantity.unit, value, token.at, name)
        close = difflib.get_close_matches(name, self._known, n=2, cutoff=0.6)
        inner = sorted(known for known in self._known if known.startswith(f"{name}."))
        short = ", ".join(known for known in SHORT_NAMES if known in self._known)
        hint = f"known are {short}, and all other numbers of the report"
        if close or inner:
            hint = f"did you mean {' or '.join(inner[:3] or close)}?"
        raise self._error(token.at, f"no record has a number {name!r}", hint)

    def _check_numbers(self, *parts: _Meaning) -> None:
        for part in parts:
            if part.unit == TRUTH:
                why = "this is true or false, and a number is needed here"
                raise self._error(part.at, why, "join comparisons with and, or, not")

    def _truth(self, part: _Meaning, sign: str) -> _Meaning:
        if part.unit != TRUTH:
            why = f"this is a number, and {sign} joins comparisons"
            raise self._error(part.at, why, "compare it, as in 'flipped_faces > 0'")
        return part

    def _combine(self, token: _Token, left: _Meaning, right: _Meaning) -> _Meaning:
        sign = token.text
        if sign in ("and", "or"):
            values = [self._truth(part, sign).value for part in (left, right)]
            return _Meaning(TRUTH, _decide(values, deciding=sign == "or"), token.at)
        self._check_numbers(left, right)
        if sign in COMPARISONS or sign in "+-":
            return self._join_alike(token, left, right)
        # Twice a percentage is a percentage, and a percentage of anything else is a part of it.
        is_multiple = left.unit in _BARE and sign == "*"
        first = left if right.unit in _BARE else _to_base_unit(left)
        second = right if is_multiple else _to_base_unit(right)
        effect = operator.mul if sign == "*" else lambda value, by: value / by if by else None
        unit = _unit_of_product(first.unit, second.unit, sign)
        return _Meaning(unit, _apply(effect, first.value, second.value), token.at)

    def _join_alike(self, token: _Token, left: _Meaning, right: _Meaning) -> _Meaning:
        """The effect of a comparison, sum, ``min`` or ``max`` on two values in one unit."""
        unit, first, second = right.unit, self._convert(token, left, right.unit), right.value
        if first is None and (converted := self._convert(token, right, left.unit)) is not None:
            unit, first, second = left.unit, left.value, converted
        if first is None:
            raise self._error(
                token.at,
                f"{left.unit} and {right.unit} do not go together",
                "% is for relative changes, e (mean edge lengths) for lengths",
            )
        is_compared = token.text in COMPARISONS
        effect = COMPARISONS[token.text] if is_compared else _JOINED[token.text]
        return _Meaning(TRUTH if is_compared else unit, _apply(effect, first, second), token.at)

    def _convert(self, token: _Token, part: _Meaning, unit: Unit) -> Callable[[Any], Value] | None:
        """A value in another unit; None if it cannot be converted."""
        if part.unit == CONSTANT and unit == RELATIVE and part.value(None) != 0.0:
            why = "a relative change is compared with a number without a unit"
            raise self._error(token.at, why, "write 1% for one part in a hundred")
        if part.unit == QUOTIENT and unit in _PERCENTS:
            return _apply(lambda value: 100.0 * value, part.value)
        if part.unit == EDGES and unit == LENGTH:
            return _apply(operator.mul, part.value, _edge_length)
        is_same = (
            part.unit in (unit, CONSTANT)
            or (part.unit in _PLAIN and unit in (NUMBER, QUOTIENT))
            or (part.unit in _PERCENTS and unit in _PERCENTS)
        )
        return part.value if is_same else None


def _to_base_unit(part: _Meaning) -> _Meaning:
    """A percentage as a number, mean edge lengths in file units, all else as it is."""
    if part.unit in _PERCENTS:
        return _Meaning(QUOTIENT, _apply(lambda value: value / 100.0, part.value), part.at)
    if part.unit == EDGES:
        return _Meaning(LENGTH, _apply(operator.mul, part.value, _edge_length), part.at)
    return part


def _unit_of_product(left: Unit, right: Unit, sign: str) -> Unit:
    if "length" in (left.kind, right.kind):
        power = left.power + (right.power if sign == "*" else -right.power)
        return Unit("length", power) if power else QUOTIENT
    for unit in (left, right):
        if unit not in _PLAIN:
            return unit
    if left == right:
        return QUOTIENT if (left, sign) == (NUMBER, "/") else left
    return NUMBER if NUMBER in (left, right) else QUOTIENT


def _apply(effect: Callable[..., Any], *inner: Callable[[Any], Value]) -> Callable[[Any], Value]:
    """``effect`` over several values; None if one is not known, or the result is not finite."""

    def value(record: Any) -> Value:
        found = [function(record) for function in inner]
        if None in found:
            return None
        result: Value = effect(*found)
        return result if result is not None and result - result == 0.0 else None

    return value


def _decide(inner: list[Callable[[Any], Value]], deciding: bool) -> Callable[[Any], Value]:
    """``or``, if True is deciding, or ``and``: one value that decides is enough."""

    def value(record: Any) -> Value:
        found = [function(record) for function in inner]
        if deciding in found:
            return deciding
        return None if None in found else not deciding

    return value


# Gates


@dataclass(frozen=True)
class Gate:
    """One expression, its value in a record, the quantities that it names, in the order in which
    it does, and the names of those of which it asks whether they are known."""

    expression: str
    verdict: Callable[[Any], Value]
    quantities: Mapping[str, Quantity]
    tested: frozenset[str]


def parse_gates(
    expressions: Sequence[str], kind: Hashable, file_unit: str | None = None
) -> tuple[Gate, ...]:
    """The gates of several expressions over records of one kind.

    ``file_unit`` is the unit of the files' lengths, such as ``mm``, where it is known.  UsageError
    for what is no comparison, a name that no such record has, or units that do not go together; it
    names the column.
    """
    gates = []
    for text in expressions:
        parser = _Parser(text, quantities(kind), file_unit)
        meaning = parser.parse()
        gates.append(Gate(text, meaning.value, parser.names, frozenset(parser.tested)))
    return tuple(gates)


def refuse_without_reference(gates: Sequence[Gate], remedy: str) -> None:
    """Refuse gates on what is measured against a reference, where there is none; UsageError.

    A gate that asks whether the value is known may stay.  ``remedy`` says how to get a reference.
    """
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
    paths = {path for gate in gates for item in gate.quantities.values() for path in item.fields}
    return any(path == field or path.startswith(f"{field}.") for path in paths)


def evaluate_gates(gates: Sequence[Gate], record: Any) -> tuple[GateResult, ...]:
    """What each gate says of one record.

    What is not known decides nothing: ``volume.valid and abs(volume_change) > 1%`` holds for an
    open mesh, and ``abs(volume_change) > 1%`` cannot be decided, which counts as broken.
    """
    results = []
    for gate in gates:
        verdict, items = gate.verdict(record), gate.quantities.values()
        known = {item.name: item.value_in(record) for item in items}
        reason = ", ".join(item.describe(record) for item in items)
        reason = reason or "it names nothing of the file"
        if verdict is None:
            unknown = [item.why_unknown(record) for item in items if known[item.name] is None]
            reason = "; ".join(unknown) or f"it cannot be computed: {reason}"
        # Of data, true is 1.
        values = {name: value if value is None else value + 0 for name, value in known.items()}
        is_broken, is_decided = verdict is not False, verdict is not None
        results.append(GateResult(gate.expression, is_broken, is_decided, values, reason))
    return tuple(results)


def with_gates(gates: Sequence[Gate], records: Sequence[Record]) -> list[Record]:
    """The records with the results of the gates, but for those of files that failed or were not
    dealt with: their status says enough."""
    if not gates:
        return list(records)
    return [
        record
        if record.error is not None or getattr(record, "status", "") == "planned"
        else replace(record, gates=evaluate_gates(gates, record))
        for record in records
    ]


def is_any_broken(records: Sequence[MeshRecord] | Sequence[ComparisonRecord]) -> bool:
    return any(gate.broken for record in records for gate in record.gates)
