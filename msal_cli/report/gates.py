"""Gates: expressions that say when a file's record is not good enough, and their results.

A file whose volume changed by more than 1 % breaks the gate ``abs(volume_change) > 1%``.  Names are
the numbers of a record, with the units of its fields; units are checked while the text is parsed,
before any file is read.  A value that is not known, or cannot be computed, is None.  A result that
depends on it is None, too, but ``and`` and ``or`` may be decided without it.
"""

import ast
import difflib
import functools
import math
import operator
import re
import typing
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

from msal_cli.errors import UsageError
from msal_cli.job.records import ComparisonRecord, GateResult, MeshRecord, value_at
from msal_cli.job.settings import COMPARISONS, UNIT_PATTERN, in_file_units
from msal_cli.light_dataclass import dataclass
from msal_cli.report.data import leaf_fields

Value = float | bool | None
Record = TypeVar("Record", MeshRecord, ComparisonRecord)

MAX_LENGTH = 300
"""Characters of an expression, which also limits how deeply it can be nested."""

# Quantities


Unit = str
"""The unit of a number.

``constant`` is a number in the expression; ``number`` is a count, or has a unit that its name gives
(degrees, seconds); ``quotient`` is one of two values in the same unit.  ``percent`` and
``relative`` are in percent; a number without a unit means percent if compared with the first, and
is refused with the second.  ``edges`` is in mean edge lengths, and ``length``, ``area`` and
``volume`` are in file units."""

TRUTH, CONSTANT, NUMBER, QUOTIENT = "truth", "constant", "number", "quotient"
PERCENT, RELATIVE, EDGES, LENGTH = "percent", "relative", "edges", "length"
_WORDS = {PERCENT: "a percentage", RELATIVE: "a percentage", EDGES: "a length"}
_WORDS |= {LENGTH: "a length", "area": "an area", "volume": "a volume"}

SHORT_NAMES = {
    "volume_change": "volume.change_percent",
    "area_change": "area.change_percent",
    "mean_displacement": "displacement.mean",
    "rms_displacement": "displacement.rms",
    "p95_displacement": "displacement.p95",
    "max_displacement": "displacement.max",
    "moved_vertices": "displacement.moved_vertices",
    "mean_angular_error_deg": "reference.mean_angular_error_deg",
    "max_angular_error_deg": "reference.max_angular_error_deg",
    "vertex_error_percent": "reference.vertex_error_percent",
    "hausdorff": "reference.hausdorff",
    "self_intersections": "self_intersections.created",
    "fixed_border_vertices": "tile_set.fixed_border_vertices",
    "noise": "noise_estimate.file_units",
    "risk": "choice.risk_edges",
    "seconds": "seconds.total",
}
"""Short names and the fields that they stand for, if a record has them; ``_change`` is relative."""

_LENGTHS = {"hausdorff", "seam_gap", "tile_gap", "largest_weld", "mean_edge_length", "file_units"}
_STATISTICS = {"mean", "rms", "p95", "max"}
_AGAINST_INPUT = {
    "mean_angular_error_deg": "normal_change.mean_deg",
    "max_angular_error_deg": "normal_change.max_deg",
}


@dataclass(frozen=True)
class Quantity:
    """A field of a record, by its dotted path, with a name and a unit."""

    name: str
    path: str
    unit: Unit

    def value_in(self, record: Any) -> Any:
        """The value in a record; None if it is not known."""
        value = value_at(record, self.path)
        return value if value is not None and value - value == 0.0 else None

    def describe(self, record: Any) -> str:
        """The value with its unit: ``max_displacement is 0.0123 (0.62e)``."""
        value, edge = self.value_in(record), _edge_length(record)
        if value is None:
            return self.why_unknown(record)
        if isinstance(value, bool):
            return f"{self.name} is {'true' if value else 'false'}"
        end = {PERCENT: "%", RELATIVE: "%", EDGES: "e"}.get(self.unit, "")
        if self.unit == LENGTH and edge is not None and self.name != "mean_edge_length":
            end = f" ({value / edge:.4g}e)"
        return f"{self.name} is {f'{value:,}' if isinstance(value, int) else f'{value:.6g}'}{end}"

    @property
    def part(self) -> str:
        """The part of the record that the field is in, such as ``reference``."""
        return self.path.partition(".")[0]

    def why_unknown(self, record: Any) -> str:
        """Why a record has no value, as text."""
        volume, why = record.volume, ""
        compared = record.reference if self.part == "reference" else record
        if volume is not None and not volume.valid and "volume" in self.path:
            why = volume.reason or "the volume means nothing"
        elif self.part == "reference" and record.reference is None:
            why = "nothing was measured against a reference"
        elif self.part == "reference" and record.reference.error is not None:
            why = record.reference.error.message
        elif self.part == "self_intersections" and record.self_intersections is None:
            why = "count them with --check self-intersections"
        elif getattr(compared, "correspondence", None) == "surface":
            why = "the faces are not the same"
        elif self.part in ("tile_gap", "tile_set"):
            why = "files are denoised as one with --tile-set"
        elif self.part == "choice":
            why = "the choice has none for this file"
            why = "the method was named, and none was chosen" if record.choice is None else why
        elif self.name in ("clamped_vertices", "locked_vertices"):
            why = f"without {'--max-move' if self.name[0] == 'c' else '--lock'} none is"
        elif self.name == "despiked":
            why = "outliers were not looked for, as --despike does"
        return f"{self.name} is not known{f': {why}' if why else ' for this file'}"


@functools.cache
def quantities(kind: Hashable) -> Mapping[str, Quantity]:
    """Every quantity of a kind of record that a gate can name, short names first."""
    fields = {
        path: TRUTH if part is bool else _unit(path)
        for path, parts in leaf_fields(typing.cast("type[Any]", kind))
        for part in parts
        if part in (bool, int, float)
    }
    short = {
        name: Quantity(name, path, RELATIVE if name.endswith("_change") else fields[path])
        for name, path in SHORT_NAMES.items()
        if path in fields
    }
    return short | {path: Quantity(path, path, unit) for path, unit in fields.items()}


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
    return group if group in ("area", "volume") else NUMBER


def _edge_length(record: Any) -> float | None:
    edge: float | None = record.mean_edge_length
    return edge if edge and edge - edge == 0.0 else None


# Expressions have Python's syntax, of which only the following is allowed

_HINT = "write what breaks the gate, such as 'abs(volume_change) > 1%'; see docs/gates.md"
_HINTS = {"=": "equal is ==", "&": "write and", "|": "write or", "!": "write not, or != "}
_MAX_PARTS = {"abs": 1, "known": 1, "min": 9, "max": 9}
_SIGNS: dict[type[ast.AST], str]
_SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.And: "and", ast.Or: "or"}
_SIGNS |= {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_JOINED: dict[str, Callable[..., float | None]]
_JOINED = {"+": operator.add, "-": operator.sub, "min": min, "max": max}
_JOINED["/"] = lambda value, by: value / by if by else None
_LITERALS = {"": CONSTANT, "%": PERCENT, "e": EDGES}
_PLAIN = (CONSTANT, NUMBER, QUOTIENT)
_PERCENTS = (PERCENT, RELATIVE)
_FACTORS = (CONSTANT, QUOTIENT, *_PERCENTS)

# An e without digits after it is the unit of mean edge lengths, else an exponent.
_TOKEN = re.compile(
    rf"(?a)(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?P<unit>%|(?:e|{UNIT_PATTERN})\b)?"
    r"(?![\w.])|[A-Za-z_][\w.]*|<=|>=|==|!=|[<>()+\-*/,\s]|(?P<other>[\w.]+|.)"
)


class _Meaning(NamedTuple):
    """A part of an expression: its unit, its value in a record, its column from 1, and its name if
    it is only a name."""

    unit: Unit
    value: Callable[[Any], Value]
    at: int
    name: str = ""


class Gate:
    """One expression, parsed; every error names the column."""

    def __init__(
        self, expression: str, known: Mapping[str, Quantity], file_unit: str | None
    ) -> None:
        self.expression = expression
        self.quantities: dict[str, Quantity] = {}  # that it names, in order
        self.tested: set[str] = set()  # names that it tests with ``known``
        self._text = expression.strip()
        self._known = known
        self._file_unit = file_unit
        # By column.  For Python's parser, numbers are replaced by underscores.
        self._numbers: dict[int, _Meaning] = {}
        self._verdict = self._parse()

    def evaluate(self, record: Any) -> GateResult:
        """The result for one record.

        Unknown values decide nothing: ``volume.valid and abs(volume_change) > 1%`` is false for an
        open mesh, and ``abs(volume_change) > 1%`` cannot be decided, which counts as broken.
        """
        verdict, items = self._verdict(record), self.quantities.values()
        known = {item.name: item.value_in(record) for item in items}
        reason = ", ".join(item.describe(record) for item in items)
        reason = reason or "it names nothing of the file"
        if verdict is None:
            unknown = [item.why_unknown(record) for item in items if known[item.name] is None]
            reason = "; ".join(unknown) or f"it cannot be computed: {reason}"
        # In the values, true becomes 1.
        values = {name: value if value is None else value + 0 for name, value in known.items()}
        is_broken, is_decided = verdict is not False, verdict is not None
        return GateResult(self.expression, is_broken, is_decided, values, reason)

    def _parse(self) -> Callable[[Any], Value]:
        if len(self._text) > MAX_LENGTH:
            raise self._error(MAX_LENGTH, f"it is longer than {MAX_LENGTH} characters")
        code = _TOKEN.sub(self._replace_number, self._text)
        try:
            tree = ast.parse(code, mode="eval").body
        except (SyntaxError, MemoryError, RecursionError) as error:
            at = getattr(error, "offset", None) or 1
            rest = self._text[at - 1 :]
            raise self._error(at, f"{rest!r} cannot be read" if rest else "it ends early") from None
        return self._truth(self._read(tree), "a gate compares").value

    def _error(self, at: int, why: str, hint: str = _HINT) -> UsageError:
        return UsageError(f"the gate {self._text!r}, column {at}: {why}", hint=hint)

    def _replace_number(self, token: re.Match[str]) -> str:
        word, at = token[0], token.start() + 1
        if token["other"]:
            raise self._error(at, f"{word!r} means nothing here", _HINTS.get(word[0], _HINT))
        if not token["number"]:
            return " " if word.isspace() else word
        number, suffix = float(token["number"]), token["unit"] or ""
        if not math.isfinite(number):
            raise self._error(at, "the number is too large")
        if suffix not in _LITERALS:
            try:
                number = in_file_units(token["number"], suffix, self._file_unit)
            except UsageError as error:
                raise self._error(at, error.message, error.hint) from None
        unit = _LITERALS.get(suffix, LENGTH)
        self._numbers[at] = _Meaning(unit, lambda record: number, at)
        return "_" * len(word)

    def _read(self, node: ast.AST) -> _Meaning:
        at = getattr(node, "col_offset", 0) + 1
        match node:
            case ast.Name() if at in self._numbers:
                return self._numbers[at]
            case ast.Name() | ast.Attribute():
                return self._name(ast.unparse(node), at)
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                value = self._truth(self._read(inner), "not joins comparisons").value
                return _Meaning(TRUTH, _apply(operator.not_, value), at)
            case ast.UnaryOp(op=ast.UAdd(), operand=inner):
                return self._read(inner)
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                part = self._number(self._read(inner))
                return _Meaning(part.unit, _apply(operator.neg, part.value), at)
            case ast.BoolOp(op=sign, values=parts):
                word = _SIGNS[type(sign)]
                why = f"{word} joins comparisons"
                values = [self._truth(self._read(part), why).value for part in parts]
                return _Meaning(TRUTH, _decide(values, deciding=word == "or"), at)
            case (
                ast.BinOp(left=left, op=sign, right=right)
                | ast.Compare(left=left, ops=[sign], comparators=[right])
            ) if type(sign) in _SIGNS:
                return self._compute(at, _SIGNS[type(sign)], self._read(left), self._read(right))
            case ast.Compare(comparators=[_, third, *_]):
                why, hint = "it compares a third time", "join two comparisons with and"
                raise self._error(third.col_offset + 1, why, hint)
            case ast.Call(func=function, args=parts, keywords=[]):
                return self._call(ast.unparse(function), at, parts)
        source = ast.get_source_segment(self._text, node)
        raise self._error(at, f"{source!r} means nothing here")

    def _call(self, word: str, at: int, arguments: Sequence[ast.AST]) -> _Meaning:
        if word not in _MAX_PARTS:
            why = f"there is no function {word}"
            raise self._error(at, why, f"known are: {', '.join(_MAX_PARTS)}")
        max_parts = _MAX_PARTS[word]
        if not 1 <= len(arguments) <= max_parts:
            many = "one value" if max_parts == 1 else f"1 to {max_parts} values"
            raise self._error(at, f"{word} takes {many}")
        parts = [self._read(argument) for argument in arguments]
        first = parts[0]
        if word == "known":
            if not first.name:
                raise self._error(first.at, "known takes a name", "as in known(volume_change)")
            self.tested.add(first.name)
            return _Meaning(TRUTH, lambda record: first.value(record) is not None, at)
        parts = [self._number(part) for part in parts]
        if word == "abs":
            return _Meaning(first.unit, _apply(abs, first.value), at)
        total = first._replace(at=at, name="")
        for part in parts[1:]:
            total = self._join_alike(at, word, total, part)
        return total

    def _name(self, name: str, at: int) -> _Meaning:
        if name in self._known:
            quantity = self.quantities[name] = self._known[name]
            # Counts, too, are floats in computations.
            value: Callable[[Any], Value] = quantity.value_in
            if quantity.unit != TRUTH:
                value = _apply(float, value)
            return _Meaning(quantity.unit, value, at, name)
        close = difflib.get_close_matches(name, self._known, n=2, cutoff=0.6)
        inner = sorted(known for known in self._known if known.startswith(f"{name}."))
        short = ", ".join(known for known in SHORT_NAMES if known in self._known)
        hint = f"known are {short}, and all other numbers of the report"
        if close or inner:
            hint = f"did you mean {' or '.join(inner[:3] or close)}?"
        raise self._error(at, f"no record has a number {name!r}", hint)

    def _number(self, part: _Meaning) -> _Meaning:
        if part.unit == TRUTH:
            why = "this is true or false, and a number is needed here"
            raise self._error(part.at, why, "join comparisons with and, or, not")
        return part

    def _truth(self, part: _Meaning, why: str) -> _Meaning:
        if part.unit != TRUTH:
            hint = "compare it, as in 'flipped_faces > 0'"
            raise self._error(part.at, f"this is a number, and {why}", hint)
        return part

    def _compute(self, at: int, sign: str, left: _Meaning, right: _Meaning) -> _Meaning:
        left, right = self._number(left), self._number(right)
        if sign == "*":
            # Twice a percentage is a percentage, and a percentage of anything else is a part of it.
            pairs = {left.unit: (left, right), right.unit: (right, left)}
            unit = next((unit for unit in _FACTORS if unit in pairs), None)
            if unit is None:
                hint = "multiply by a number, a percentage or a quotient"
                raise self._mismatch(at, left, right, hint=hint)
            factor, other = pairs[unit]
            share = 100.0 if factor.unit in _PERCENTS else 1.0
            value = _apply(lambda a, b: a / share * b, factor.value, other.value)
            return _Meaning(other.unit, value, at)
        if sign == "/" and right.unit in (CONSTANT, QUOTIENT):
            unit = right.unit if left.unit == CONSTANT else left.unit
            return _Meaning(unit, _apply(_JOINED["/"], left.value, right.value), at)
        return self._join_alike(at, sign, left, right)

    def _join_alike(self, at: int, sign: str, left: _Meaning, right: _Meaning) -> _Meaning:
        """A comparison, sum, quotient, ``min`` or ``max`` of two values in one unit."""
        unit, first, second = right.unit, self._convert(at, left, right.unit), right.value
        if first is None and (converted := self._convert(at, right, left.unit)) is not None:
            unit, first, second = left.unit, left.value, converted
        if first is None:
            raise self._mismatch(at, left, right)
        unit = TRUTH if sign in COMPARISONS else QUOTIENT if sign == "/" else unit
        effect = COMPARISONS.get(sign) or _JOINED[sign]
        return _Meaning(unit, _apply(effect, first, second), at)

    def _mismatch(
        self,
        at: int,
        *parts: _Meaning,
        hint: str = "% is for relative changes, e (mean edge lengths) for lengths",
    ) -> UsageError:
        words = (_WORDS.get(part.unit, "a plain number") for part in parts)
        return self._error(at, f"{' and '.join(words)} do not go together", hint)

    def _convert(self, at: int, part: _Meaning, unit: Unit) -> Callable[[Any], Value] | None:
        """A value in another unit; None if it cannot be converted."""
        if part.unit == CONSTANT and unit == RELATIVE and part.value(None) != 0.0:
            why = "a relative change is compared with a number without a unit"
            raise self._error(at, why, "write 1% for one part in a hundred")
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


def _apply(effect: Callable[..., Any], *inner: Callable[[Any], Value]) -> Callable[[Any], Value]:
    """Apply ``effect`` to several values; None if one is not known, or the result is not finite."""

    def value(record: Any) -> Value:
        found = [function(record) for function in inner]
        if None in found:
            return None
        result: Value = effect(*found)
        return result if result is not None and result - result == 0.0 else None

    return value


def _decide(inner: list[Callable[[Any], Value]], deciding: bool) -> Callable[[Any], Value]:
    """``or`` if ``deciding`` is True, else ``and``: one value equal to it decides."""

    def value(record: Any) -> Value:
        found = [function(record) for function in inner]
        if deciding in found:
            return deciding
        return None if None in found else not deciding

    return value


# Gates


def parse_gates(
    expressions: Sequence[str], kind: Hashable, file_unit: str | None = None
) -> tuple[Gate, ...]:
    """Parse several expressions for records of one kind.

    ``file_unit`` is the unit of the files' lengths, such as ``mm``, if it is known.  Raises
    UsageError, which names the column, for an expression that is no comparison, a name that no such
    record has, or units that do not fit each other.
    """
    return tuple(Gate(text, quantities(kind), file_unit) for text in expressions)


def refuse_without_reference(gates: Sequence[Gate], remedy: str) -> None:
    """Raise UsageError for gates on values against a reference, because there is no reference.

    A gate that tests whether the value is known is allowed.  ``remedy`` is the hint.
    """
    for gate in gates:
        for name, quantity in gate.quantities.items():
            if quantity.part == "reference" and name not in gate.tested:
                own = _AGAINST_INPUT.get(name)
                instead = f", or write {own}: the angle to the input's normals" if own else ""
                raise UsageError(
                    f"the gate {gate.expression!r}: {name} is measured against a reference, and "
                    "there is none",
                    hint=remedy + instead,
                )


def need_intersections(gates: Sequence[Gate]) -> bool:
    """Whether any gate depends on ``self_intersections``, which are counted only on request."""
    items = (item for gate in gates for item in gate.quantities.values())
    return any(item.part == "self_intersections" for item in items)


def with_gates(gates: Sequence[Gate], records: Sequence[Record]) -> list[Record]:
    """The records with the results of the gates; files that failed or were not processed get none,
    because their status is enough."""
    if not gates:
        return list(records)
    return [
        record
        if record.error is not None or getattr(record, "status", "") == "planned"
        else replace(record, gates=tuple(gate.evaluate(record) for gate in gates))
        for record in records
    ]
