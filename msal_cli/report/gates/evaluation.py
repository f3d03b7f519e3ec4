"""What a gate expression means: units are compared with each other first, values put in afterwards.

A value that is not known, or cannot be computed, is None and stays so, except that ``and`` and
``or`` may be decided without it.
"""

from __future__ import annotations

import ast
import difflib
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from msal_cli.errors import UsageError
from msal_cli.job.units import COMPARISONS, in_file_units
from msal_cli.report.gates.grammar import Expression
from msal_cli.report.gates.quantities import (
    CONSTANT,
    EDGES,
    LENGTH,
    NUMBER,
    PERCENT,
    QUOTIENT,
    RELATIVE,
    SHORT_NAMES,
    TRUTH,
    Quantity,
    Unit,
)

Value = float | bool | None
Known = Mapping[str, Quantity]

_JOINED: dict[str, Callable[..., float]] = {
    "+": operator.add,
    "-": operator.sub,
    "min": min,
    "max": max,
}
_LITERALS = {"": CONSTANT, "%": PERCENT, "e": EDGES}
_PLAIN = (CONSTANT, NUMBER, QUOTIENT)
_BARE = (CONSTANT, QUOTIENT)
_PERCENTS = (PERCENT, RELATIVE)
# Constants ask for no values.
_NO_VALUES: Any = None


class Values:
    """The values of an expression's names in one record."""

    def __init__(self, record: Any, quantities: Known) -> None:
        self._record = record
        self._quantities = quantities
        edge = record.mean_edge_length
        self.mean_edge_length: float | None = edge if edge and edge - edge == 0.0 else None

    def raw(self, name: str) -> Value:
        """The value of a name in the unit of its field."""
        return self._quantities[name].value_in(self._record)

    def number(self, name: str) -> Value:
        """The value for computing: counts, too, are floating numbers then."""
        value = self.raw(name)
        return value if value is None or isinstance(value, bool) else float(value)

    def words(self, name: str) -> str:
        """The value in words, with its unit: ``max_displacement is 0.0123 (0.62e)``."""
        value, unit = self.raw(name), self._quantities[name].unit
        if value is None:
            return self.why_unknown(name)
        if isinstance(value, bool):
            return f"{name} is {'true' if value else 'false'}"
        end = {"percent": "%", "relative": "%", "edges": "e"}.get(unit.kind, "")
        if unit == LENGTH and self.mean_edge_length is not None and name != "mean_edge_length":
            end = f" ({value / self.mean_edge_length:.4g}e)"
        return f"{name} is {f'{value:,}' if isinstance(value, int) else f'{value:.6g}'}{end}"

    def why_unknown(self, name: str) -> str:
        """Why a name has no value."""
        return self._quantities[name].why_unknown(self._record)


@dataclass(frozen=True)
class Meaning:
    """A part of an expression: its unit, and its value for the values of the names in it."""

    unit: Unit
    value: Callable[[Values], Value]


def check_units(expression: Expression, known: Known, file_unit: str | None = None) -> Meaning:
    """What an expression means; it is true or false, or None where it cannot be decided.

    ``file_unit`` is the unit of the files' lengths, such as ``mm``, where it is known.

    Raises
    ------
    UsageError
        for names that are not known, and for units that do not go together, or cannot be converted.
    """
    root = expression.root
    meaning = _UnitCheck(expression, known, file_unit).meaning(root)
    if meaning.unit != TRUTH:
        why = "it is a number, and a gate is broken or not"
        raise expression.error(root, why, "compare it, as in 'max_displacement > 0.5e'")
    return meaning


class _UnitCheck:
    def __init__(self, expression: Expression, known: Known, file_unit: str | None) -> None:
        self._expression = expression
        self._error = expression.error
        self._known = known
        self._file_unit = file_unit

    def meaning(self, node: ast.expr) -> Meaning:
        """The meaning of a part; there are no other nodes than these."""
        sign = self._expression.token(node).text
        match node:
            case ast.Constant():
                return self._number(node)
            case ast.Name():
                return self._name(node)
            case ast.BoolOp(values=parts):
                values = [self._truth(one, sign).value for one in parts]
                return Meaning(TRUTH, _join(values, deciding=isinstance(node.op, ast.Or)))
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return Meaning(TRUTH, _apply(operator.not_, self._truth(inner, sign).value))
            case ast.UnaryOp(op=ast.UAdd(), operand=inner):
                return self.meaning(inner)
            case ast.UnaryOp(operand=inner):
                found = self._quantity(inner)
                return Meaning(found.unit, _apply(operator.neg, found.value))
            case ast.Compare(left=left, comparators=[right]):
                first, second = self._quantity(left), self._quantity(right)
                _, *values = self._in_common_unit(node, first, second)
                return Meaning(TRUTH, _apply(COMPARISONS[sign], *values))
            case ast.BinOp(left=left, right=right) if sign in "*/":
                return self._product(sign, self._quantity(left), self._quantity(right))
            case ast.BinOp(left=left, right=right):
                return self._join_alike(node, [left, right], _JOINED[sign])
            case ast.Call(args=[part]) if sign == "known":
                if not isinstance(part, ast.Name):
                    raise self._error(part, "known takes a name", "as in known(volume_change)")
                found = self._name(part)
                return Meaning(TRUTH, lambda values: found.value(values) is not None)
            case ast.Call(args=[part]) if sign == "abs":
                found = self._quantity(part)
                return Meaning(found.unit, _apply(abs, found.value))
            case ast.Call(args=parts):
                return self._join_alike(node, parts, _JOINED[sign])
        raise AssertionError(f"no gate has a node {type(node).__name__}")

    def _number(self, node: ast.Constant) -> Meaning:
        token = self._expression.token(node)
        number = float(token.text)
        if not math.isfinite(number):
            raise self._error(node, "the number is too large")
        if token.unit in _LITERALS:
            return Meaning(_LITERALS[token.unit], lambda values: number)
        try:
            length = in_file_units(token.text, token.unit, self._file_unit)
        except UsageError as error:
            raise self._error(node, error.message, error.hint) from None
        return Meaning(LENGTH, lambda values: length)

    def _name(self, node: ast.Name) -> Meaning:
        name = self._expression.token(node).text
        if name in self._known:
            return Meaning(self._known[name].unit, lambda values: values.number(name))
        close = difflib.get_close_matches(name, self._known, n=2, cutoff=0.6)
        inner = sorted(one for one in self._known if one.startswith(f"{name}."))
        short = ", ".join(one for one in SHORT_NAMES if one in self._known)
        hint = f"known are {short}, and all other numbers of the report"
        if close or inner:
            hint = f"did you mean {' or '.join(inner[:3] or close)}?"
        raise self._error(node, f"no record has a number {name!r}", hint)

    def _quantity(self, node: ast.expr) -> Meaning:
        """The meaning of a part that must be a number."""
        found = self.meaning(node)
        if found.unit == TRUTH:
            why = "this is true or false, and a number is needed here"
            raise self._error(node, why, "join comparisons with and, or, not")
        return found

    def _truth(self, node: ast.expr, sign: str) -> Meaning:
        """The meaning of a part that must be true or false."""
        found = self.meaning(node)
        if found.unit != TRUTH:
            why = f"this is a number, and {sign} joins comparisons"
            raise self._error(node, why, "compare it, as in 'flipped_faces > 0'")
        return found

    def _join_alike(
        self, node: ast.expr, parts: list[ast.expr], effect: Callable[..., float]
    ) -> Meaning:
        """Sums, and the least and greatest of several."""
        total = self._quantity(parts[0])
        for part in parts[1:]:
            unit, first, second = self._in_common_unit(node, total, self._quantity(part))
            total = Meaning(unit, _apply(effect, first, second))
        return total

    def _in_common_unit(
        self, node: ast.expr, left: Meaning, right: Meaning
    ) -> tuple[Unit, Callable[[Values], Value], Callable[[Values], Value]]:
        """One unit for two values, and both in it."""
        if (converted := self._convert(node, left, right.unit)) is not None:
            return right.unit, converted, right.value
        if (converted := self._convert(node, right, left.unit)) is not None:
            return left.unit, left.value, converted
        raise self._error(
            node,
            f"{_describe(left.unit)} and {_describe(right.unit)} do not go together",
            "% is for relative changes, e (mean edge lengths) for lengths",
        )

    def _convert(
        self, node: ast.expr, one: Meaning, unit: Unit
    ) -> Callable[[Values], Value] | None:
        """``one`` in another unit; None if it cannot be converted."""
        if one.unit == CONSTANT and unit == RELATIVE and one.value(_NO_VALUES) != 0.0:
            why = "a relative change is compared with a number without a unit"
            raise self._error(node, why, "write 1% for one part in a hundred")
        if one.unit == QUOTIENT and unit in _PERCENTS:
            return _apply(lambda value: 100.0 * value, one.value)
        if one.unit == EDGES and unit == LENGTH:
            return _to_file_units(one)
        is_same = (
            one.unit in (unit, CONSTANT)
            or (one.unit in _PLAIN and unit in (NUMBER, QUOTIENT))
            or (one.unit in _PERCENTS and unit in _PERCENTS)
        )
        return one.value if is_same else None

    def _product(self, sign: str, left: Meaning, right: Meaning) -> Meaning:
        # Twice a percentage is a percentage, and a percentage of anything else is a part of it.
        is_multiple = left.unit in _BARE and sign == "*"
        first = left if right.unit in _BARE else _to_base_unit(left)
        second = right if is_multiple else _to_base_unit(right)
        effect = operator.mul if sign == "*" else _divide
        unit = _unit_of_product(first.unit, second.unit, sign)
        return Meaning(unit, _apply(effect, first.value, second.value))


def _to_base_unit(one: Meaning) -> Meaning:
    """A percentage as a number, mean edge lengths in file units, all else as it is."""
    if one.unit in _PERCENTS:
        return Meaning(QUOTIENT, _apply(lambda value: value / 100.0, one.value))
    return Meaning(LENGTH, _to_file_units(one)) if one.unit == EDGES else one


def _to_file_units(one: Meaning) -> Callable[[Values], Value]:
    return _apply(operator.mul, one.value, lambda values: values.mean_edge_length)


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


def _apply(effect: Callable[..., Any], *inner: Callable[[Values], Value]) -> Callable[..., Value]:
    """``effect`` over several values; None if one is not known, or the result is not finite."""

    def value(values: Values) -> Value:
        found = [one(values) for one in inner]
        if any(one is None for one in found):
            return None
        result: Value = effect(*found)
        return result if result is not None and result - result == 0.0 else None

    return value


def _join(inner: list[Callable[[Values], Value]], deciding: bool) -> Callable[[Values], Value]:
    """``or``, if True is deciding, or ``and``: one value that decides is enough."""

    def value(values: Values) -> Value:
        found = [one(values) for one in inner]
        if deciding in found:
            return deciding
        return None if None in found else not deciding

    return value


def _divide(value: float, by: float) -> Value:
    return value / by if by else None


def _describe(unit: Unit) -> str:
    if unit.kind == "length":
        return {2: "an area", 3: "a volume"}.get(unit.power, "a length")
    words = {"percent": "a percentage", "relative": "a percentage", "edges": "a length"}
    return words.get(unit.kind, "a plain number")
