"""The grammar of gate expressions: text in, tree out.

or       and { "or" and }
and      not { "and" not }
not      { "not" } comparison
compared sum [ ("<" | "<=" | ">" | ">=" | "==" | "!=") sum ]
sum      product { ("+" | "-") product }
product  signed { ("*" | "/") signed }
signed   { "+" | "-" } atom
atom     number [ "%" | "e" | unit of length ] | name | function "(" or { "," or } ")" | "(" or ")"
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from msal_cli.errors import UsageError
from msal_cli.job.units import UNIT_PATTERN

LONGEST = 300
"""Characters of an expression; a tree is at most half as high."""

_DEEPEST = 20
_FUNCTIONS = {"abs": (1, 1), "min": (1, 9), "max": (1, 9), "known": (1, 1)}
_WORDS = ("and", "or", "not")
_COMPARISONS = ("<=", ">=", "==", "!=", "<", ">")
_HINT = "write what breaks the gate, such as 'abs(volume_change) > 1%'; see docs/gates.md"

# An e that no digits follow is the unit of mean edge lengths, else an exponent.
_TOKEN = re.compile(
    rf"(?a)\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?P<unit>%|(?:e|{UNIT_PATTERN})\b)?"
    r"|(?P<name>[A-Za-z_][\w.]*)|(?P<sign><=|>=|==|!=|[<>()+\-*/,]))"
)


@dataclass(frozen=True)
class Tree:
    """A part of an expression.

    Attributes
    ----------
    sign : ``number``, ``name``, an operator, ``negative`` or the name of a function.
    at : its column, from 1.
    parts : what the operator or function applies to.
    text : of a name or a number.
    unit : of a number: ``%``, ``e``, a unit of length or none.
    """

    sign: str
    at: int
    parts: tuple[Tree, ...] = ()
    text: str = ""
    unit: str = ""


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    at: int
    unit: str = ""


def refused(text: str, at: int, why: str, hint: str = _HINT) -> UsageError:
    """The error for an expression that means nothing, at a column from 1."""
    return UsageError(f"the gate {text!r}, column {at}: {why}", hint=hint)


def tree(text: str) -> Tree:
    """The tree of an expression; UsageError if it is none."""
    if len(text) > LONGEST:
        raise refused(text[:40] + "...", LONGEST, f"it is longer than {LONGEST} characters")
    reader = _Reader(text)
    found = reader.either()
    reader.end()
    return found


def names_in(part: Tree) -> list[str]:
    """The names in an expression, each once, in the order in which it has them."""
    found = [part.text] if part.sign == "name" else []
    for inner in part.parts:
        found += names_in(inner)
    return list(dict.fromkeys(found))


def names_tested(part: Tree) -> set[str]:
    """The names of which an expression asks whether they are known."""
    if part.sign == "known":
        return set(names_in(part))
    return set().union(*map(names_tested, part.parts))


def _tokens(text: str) -> Iterator[_Token]:
    at = 0
    while text[at:].strip():
        match = _TOKEN.match(text, at)
        if match is None:
            at += len(text[at:]) - len(text[at:].lstrip())
            raise refused(text, at + 1, f"{text[at]!r} means nothing here", _hint_for(text[at]))
        kind = str(match.lastgroup if match.lastgroup != "unit" else "number")
        yield _Token(kind, match[kind], match.start(kind) + 1, match["unit"] or "")
        at = match.end()
    yield _Token("end", "", len(text) + 1)


def _hint_for(sign: str) -> str:
    others = {"=": "equal is ==", "&": "write and", "|": "write or", "!": "write not, or != "}
    return others.get(sign, _HINT)


class _Reader:
    """One pass over the tokens, one method for each line of the grammar."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._tokens = list(_tokens(text))
        self._next = 0
        self._depth = 0

    def either(self) -> Tree:
        return self._chained(("or",), lambda: self._chained(("and",), self._negated))

    def end(self) -> None:
        token = self._token()
        if token.kind != "end":
            raise self._surprised(token)

    def _negated(self) -> Tree:
        signs = []
        while self._is_next("not"):
            signs.append(self._taken().at)
        found = self._compared()
        return Tree("not", signs[0], (found,)) if len(signs) % 2 else found

    def _compared(self) -> Tree:
        left = self._sum()
        if not self._is_next(*_COMPARISONS):
            return left
        sign = self._taken()
        right = self._sum()
        if self._is_next(*_COMPARISONS):
            at = self._token().at
            raise refused(
                self._text, at, "it compares a third time", "join two comparisons with and"
            )
        return Tree(sign.text, sign.at, (left, right))

    def _sum(self) -> Tree:
        return self._chained(("+", "-"), lambda: self._chained(("*", "/"), self._signed))

    def _signed(self) -> Tree:
        signs = []
        while self._is_next("+", "-"):
            signs.append(self._taken())
        found = self._atom()
        is_negative = sum(one.text == "-" for one in signs) % 2
        return Tree("negative", signs[0].at, (found,)) if is_negative else found

    def _atom(self) -> Tree:
        token = self._taken()
        if token.kind == "number":
            return Tree("number", token.at, text=token.text, unit=token.unit)
        if token.text == "(":
            found = self._inside()
            self._expect(")")
            return found
        if token.kind != "name" or token.text in _WORDS:
            raise self._surprised(token)
        if not self._is_next("("):
            return Tree("name", token.at, text=token.text)
        return self._called(token)

    def _called(self, function: _Token) -> Tree:
        if function.text not in _FUNCTIONS:
            known = ", ".join(_FUNCTIONS)
            why = f"there is no function {function.text}"
            raise refused(self._text, function.at, why, f"known are: {known}")
        self._expect("(")
        parts = [self._inside()]
        while self._is_next(","):
            self._taken()
            parts.append(self._inside())
        self._expect(")")
        least, most = _FUNCTIONS[function.text]
        if not least <= len(parts) <= most:
            many = "one value" if most == 1 else f"{least} to {most} values"
            raise refused(self._text, function.at, f"{function.text} takes {many}")
        return Tree(function.text, function.at, tuple(parts))

    def _inside(self) -> Tree:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise refused(
                self._text, self._token().at, f"parentheses go deeper than {_DEEPEST} levels"
            )
        found = self.either()
        self._depth -= 1
        return found

    def _chained(self, signs: tuple[str, ...], part: Callable[[], Tree]) -> Tree:
        found = part()
        while self._is_next(*signs):
            sign = self._taken()
            found = Tree(sign.text, sign.at, (found, part()))
        return found

    def _token(self) -> _Token:
        return self._tokens[self._next]

    def _taken(self) -> _Token:
        token = self._token()
        self._next = min(self._next + 1, len(self._tokens) - 1)
        return token

    def _is_next(self, *texts: str) -> bool:
        token = self._token()
        return token.kind in ("sign", "name") and token.text in texts

    def _expect(self, text: str) -> None:
        token = self._taken()
        if token.text != text:
            raise self._surprised(token, f"{text!r} is missing")

    def _surprised(self, token: _Token, why: str = "") -> UsageError:
        what = "it ends too early" if token.kind == "end" else f"{token.text!r} is out of place"
        return refused(self._text, token.at, ", ".join(filter(None, (why, what))))
