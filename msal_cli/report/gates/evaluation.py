"""What a gate expression means: units held against each other first, values put in afterwards.

A value that is not known, or cannot be computed, is None and stays so, except that ``and`` and
``or`` may be decided without it.
"""

from __future__ import annotations

import difflib
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from msal_cli.errors import UsageError
from msal_cli.job.units import COMPARISONS, in_file_units
from msal_cli.report.gates.grammar import Tree, refused
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

_ADDED: dict[str, Callable[[float, float], float]] = {"+": operator.add, "-": operator.sub}
_JOINED: dict[str, Callable[..., float]] = {"min": min, "max": max}
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
        return self._quantities[name].of(self._record)

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


def meaning(text: str, part: Tree, known: Known, file_unit: str | None = None) -> Meaning:
    """What an expression means; it is true or false, or None where it cannot be decided.

    ``file_unit`` is the unit of the files' lengths, such as ``mm``, where it is known.

    Raises
    ------
    UsageError
        for names that are not known, and for units that do not go together, or cannot be converted.
    """
    found = _Check(text, known, file_unit).of(part)
    if found.unit != TRUTH:
        why = "it is a number, and a gate is broken or not"
        raise refused(text, part.at, why, "compare it, as in 'max_displacement > 0.5e'")
    return found


class _Check:
    def __init__(self, text: str, known: Known, file_unit: str | None) -> None:
        self._text = text
        self._known = known
        self._file_unit = file_unit

    def of(self, part: Tree) -> Meaning:
        """The meaning of a part, by its operator."""
        sign = part.sign
        if sign == "number":
            number = float(part.text)
            if not math.isfinite(number):
                raise refused(self._text, part.at, "the number is too large")
            if part.unit not in _LITERALS:
                return self._length(part)
            return Meaning(_LITERALS[part.unit], lambda values: number)
        if sign in ("name", "known"):
            return self._name(part) if sign == "name" else self._is_known(part)
        if sign in ("and", "or", "not"):
            return self._logic(part)
        if sign in COMPARISONS:
            return self._comparison(part)
        if sign in ("*", "/"):
            return self._product(part)
        if sign in ("negative", "abs"):
            inner = self._number(part.parts[0])
            effect: Callable[[float], float] = operator.neg if sign == "negative" else abs
            return Meaning(inner.unit, _applied(effect, inner.value))
        return self._alike(part, _ADDED.get(sign) or _JOINED[sign])

    def _name(self, part: Tree) -> Meaning:
        name = part.text
        if name not in self._known:
            raise self._unknown(part)
        return Meaning(self._known[name].unit, lambda values: values.number(name))

    def _length(self, part: Tree) -> Meaning:
        try:
            length = in_file_units(part.text, part.unit, self._file_unit)
        except UsageError as error:
            raise refused(self._text, part.at, error.message, error.hint) from None
        return Meaning(LENGTH, lambda values: length)

    def _unknown(self, part: Tree) -> UsageError:
        close = difflib.get_close_matches(part.text, self._known, n=2, cutoff=0.6)
        inner = sorted(name for name in self._known if name.startswith(part.text + "."))
        short = ", ".join(name for name in SHORT_NAMES if name in self._known)
        hint = f"known are {short}, and all other numbers of the report"
        if close or inner:
            hint = f"did you mean {' or '.join(inner[:3] or close)}?"
        return refused(self._text, part.at, f"no record has a number {part.text!r}", hint)

    def _is_known(self, part: Tree) -> Meaning:
        (inner,) = part.parts
        if inner.sign != "name":
            raise refused(self._text, inner.at, "known takes a name", "as in known(volume_change)")
        found = self._name(inner)
        return Meaning(TRUTH, lambda values: found.value(values) is not None)

    def _number(self, part: Tree) -> Meaning:
        found = self.of(part)
        if found.unit == TRUTH:
            raise refused(
                self._text, part.at, "this is true or false, and a number is needed here",
                "join comparisons with and, or, not",
            )  # fmt: skip
        return found

    def _logic(self, part: Tree) -> Meaning:
        inner = [self.of(one) for one in part.parts]
        for one, found in zip(part.parts, inner, strict=True):
            if found.unit != TRUTH:
                why = f"this is a number, and {part.sign} joins comparisons"
                raise refused(self._text, one.at, why, "compare it, as in 'flipped_faces > 0'")
        if part.sign == "not":
            return Meaning(TRUTH, _applied(operator.not_, inner[0].value))
        deciding = part.sign == "or"
        return Meaning(TRUTH, _either(inner[0].value, inner[1].value, deciding))

    def _comparison(self, part: Tree) -> Meaning:
        left, right = self._number(part.parts[0]), self._number(part.parts[1])
        _, first, second = self._common(part, left, right)
        return Meaning(TRUTH, _applied(COMPARISONS[part.sign], first, second))

    def _alike(self, part: Tree, effect: Callable[..., float]) -> Meaning:
        """Sums, and the least and greatest of several."""
        total = self._number(part.parts[0])
        for one in part.parts[1:]:
            unit, first, second = self._common(part, total, self._number(one))
            total = Meaning(unit, _applied(effect, first, second))
        return total

    def _common(
        self, part: Tree, left: Meaning, right: Meaning
    ) -> tuple[Unit, Callable[[Values], Value], Callable[[Values], Value]]:
        """One unit for two values, and both in it."""
        for one, other, is_turned in ((left, right, False), (right, left, True)):
            way = self._way(part, one, other.unit)
            if way is not None:
                pair = (other.value, way) if is_turned else (way, other.value)
                return other.unit, *pair
        raise refused(
            self._text,
            part.at,
            f"{_said(left.unit)} and {_said(right.unit)} do not go together",
            "% is for relative changes, e (mean edge lengths) for lengths",
        )

    def _way(self, part: Tree, one: Meaning, unit: Unit) -> Callable[[Values], Value] | None:
        """``one`` in another unit; None if there is no way."""
        if one.unit == unit:
            return one.value
        if one.unit == CONSTANT and unit == RELATIVE and one.value(_NO_VALUES) != 0.0:
            raise refused(
                self._text, part.at, "a relative change is compared with a number without a unit",
                "write 1% for one part in a hundred",
            )  # fmt: skip
        if one.unit == CONSTANT or (one.unit in _PLAIN and unit in (NUMBER, QUOTIENT)):
            return one.value
        if one.unit in _PERCENTS and unit in _PERCENTS:
            return one.value
        if one.unit == QUOTIENT and unit in _PERCENTS:
            return _applied(lambda value: 100.0 * value, one.value)
        if one.unit == EDGES and unit == LENGTH:
            return _applied(operator.mul, one.value, _mean_edge_length)
        return None

    def _product(self, part: Tree) -> Meaning:
        left, right = self._number(part.parts[0]), self._number(part.parts[1])
        # Twice a percentage is a percentage, and a percentage of anything else is a part of it.
        is_kept = left.unit in _BARE and part.sign == "*"
        first = left if right.unit in _BARE else _reduced(left)
        second = right if is_kept else _reduced(right)
        effect = operator.mul if part.sign == "*" else _divided
        unit = _of_product(first.unit, second.unit, part.sign)
        return Meaning(unit, _applied(effect, first.value, second.value))


def _reduced(one: Meaning) -> Meaning:
    """A percentage as a number, mean edge lengths in file units, all else as it is."""
    if one.unit in _PERCENTS:
        return Meaning(QUOTIENT, _applied(lambda value: value / 100.0, one.value))
    if one.unit == EDGES:
        return Meaning(LENGTH, _applied(operator.mul, one.value, _mean_edge_length))
    return one


def _of_product(left: Unit, right: Unit, sign: str) -> Unit:
    """The unit of a product or quotient."""
    if "length" in (left.kind, right.kind):
        power = left.power + (right.power if sign == "*" else -right.power)
        return Unit("length", power) if power else QUOTIENT
    for unit in (left, right):
        if unit not in _PLAIN:
            return unit
    if left == right:
        return QUOTIENT if (left, sign) == (NUMBER, "/") else left
    return NUMBER if NUMBER in (left, right) else QUOTIENT


def _applied(effect: Callable[..., Any], *inner: Callable[[Values], Value]) -> Callable[..., Value]:
    """``effect`` over several values; None if one is not known, or the result is not finite."""

    def value(values: Values) -> Value:
        found = [one(values) for one in inner]
        if any(one is None for one in found):
            return None
        result: Value = effect(*found)
        return result if result is not None and result - result == 0.0 else None

    return value


def _either(
    first: Callable[[Values], Value], second: Callable[[Values], Value], deciding: bool
) -> Callable[[Values], Value]:
    """``or``, if True is deciding, or ``and``: one value that decides is enough."""

    def value(values: Values) -> Value:
        found = (first(values), second(values))
        if deciding in found:
            return deciding
        return None if None in found else not deciding

    return value


def _divided(value: float, by: float) -> Value:
    return value / by if by else None


def _mean_edge_length(values: Values) -> Value:
    return values.mean_edge_length


def _said(unit: Unit) -> str:
    powers = {2: "an area", 3: "a volume"}
    words = {"percent": "a percentage", "relative": "a percentage", "edges": "a length"}
    if unit.kind == "length":
        return powers.get(unit.power, "a length")
    return words.get(unit.kind, "a plain number")
