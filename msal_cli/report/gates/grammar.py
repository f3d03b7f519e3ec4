"""Gate expressions: Python's operators over numbers with units, names of figures, four functions.

Text is cut into tokens, which are checked one after the other, so that an error names the column
of the first that is out of place.  ``ast`` then knows what binds how; it sees ``1`` for each
number and ``x`` for each name, and nothing of the text itself.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

from msal_cli.errors import UsageError
from msal_cli.job.units import UNIT_PATTERN

LONGEST = 300
"""Characters of an expression, which bounds how high its syntax tree can be."""

_DEEPEST = 20
_FUNCTIONS = {"abs": (1, 1), "min": (1, 9), "max": (1, 9), "known": (1, 1)}
_COMPARISONS = ("<=", ">=", "==", "!=", "<", ">")
_OPERATORS = (*_COMPARISONS, "+", "-", "*", "/", "and", "or")
_HINT = "write what breaks the gate, such as 'abs(volume_change) > 1%'; see docs/gates.md"
_HINTS = {"=": "equal is ==", "&": "write and", "|": "write or", "!": "write not, or != "}

# An e that no digits follow is the unit of mean edge lengths, else an exponent.
_TOKEN = re.compile(
    rf"(?a)\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?P<unit>%|(?:e|{UNIT_PATTERN})\b)?"
    r"|(?P<name>[A-Za-z_][\w.]*)|(?P<sign><=|>=|==|!=|[<>()+\-*/,]))"
)


@dataclass(frozen=True)
class Token:
    """A ``number``, a ``name``, a ``sign`` (and, or, not too), a ``function`` or the ``end``.

    ``at`` is its column, from 1; ``unit`` is that of a number: ``%``, ``e``, of length, or none.
    """

    kind: str
    text: str
    at: int
    unit: str = ""


class Expression:
    """The syntax tree of an expression, and the tokens behind its nodes.

    Raises
    ------
    UsageError
        for what is no expression; it names the column.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        if len(text) > LONGEST:
            why = f"it is longer than {LONGEST} characters"
            raise syntax_error(text[:40] + "...", LONGEST, why)
        tokens = list(_read_tokens(text))
        _check_order(text, tokens)
        self._tokens: dict[int, Token] = {}
        source = ""
        for token in tokens:
            self._tokens[len(source)] = token
            source += {"number": "1", "name": "x", "function": "x"}.get(
                token.kind, token.text
            ) + " "
        self.root = ast.parse(source.strip(), mode="eval").body

    def token(self, node: ast.expr) -> Token:
        """The token of a node: its number, name, function or (of several the last) operator."""
        match node:
            case (
                ast.BinOp(left=first, right=second)
                | ast.Compare(left=first, comparators=[*_, second])
            ):
                pass
            case ast.BoolOp(values=[*_, first, second]):
                pass
            case ast.UnaryOp(op=ast.UAdd(), operand=inner):
                return self.token(inner)
            case _:
                return self._tokens[node.col_offset]
        # Beside the operator there can be parentheses between the two.
        return next(
            token
            for place, token in self._tokens.items()
            if (first.end_col_offset or 0) <= place < second.col_offset and token.text not in "()"
        )

    def error(self, node: ast.expr, why: str, hint: str = _HINT) -> UsageError:
        """The error for a node that means nothing."""
        return syntax_error(self.text, self.token(node).at, why, hint)

    @property
    def names(self) -> list[str]:
        """The names in the expression, each once, in the order in which it has them."""
        return list(dict.fromkeys(one.text for one in self._tokens.values() if one.kind == "name"))

    @property
    def names_in_known(self) -> frozenset[str]:
        """The names of which the expression asks whether they are known."""
        return frozenset(
            self.token(node.args[0]).text
            for node in ast.walk(self.root)
            if isinstance(node, ast.Call) and self.token(node).text == "known"
        )


def syntax_error(text: str, at: int, why: str, hint: str = _HINT) -> UsageError:
    """The error for an expression that means nothing, at a column from 1."""
    return UsageError(f"the gate {text!r}, column {at}: {why}", hint=hint)


def _read_tokens(text: str) -> Iterator[Token]:
    at = 0
    while text[at:].strip():
        match = _TOKEN.match(text, at)
        if match is None:
            at += len(text[at:]) - len(text[at:].lstrip())
            why = f"{text[at]!r} means nothing here"
            raise syntax_error(text, at + 1, why, _HINTS.get(text[at], _HINT))
        at = match.end()
        kind = next(one for one in ("number", "name", "sign") if match[one])
        word, column = match[kind], match.start(kind) + 1
        if word in ("and", "or", "not"):
            kind = "sign"
        elif kind == "name" and text[at:].lstrip().startswith("("):
            kind = "function"
        yield Token(kind, word, column, match["unit"] or "")
    yield Token("end", "", len(text) + 1)


def _check_order(text: str, tokens: list[Token]) -> None:
    """Refuse tokens that cannot follow one another, unknown functions, parentheses that do not
    match, and chains of comparisons."""
    # For each open parenthesis: its function or None, values so far, whether values are compared.
    levels: list[tuple[Token | None, int, bool]] = [(None, 1, False)]
    before = Token("sign", "(", 0)
    for token in tokens:
        sign = token.text if token.kind == "sign" else ""
        is_after_value = before.kind in ("number", "name") or before.text == ")"
        function, count, is_compared = levels[-1]
        if is_after_value:
            fits = sign in _OPERATORS or (sign == ")" and len(levels) > 1)
            fits = fits or (sign == "," and function is not None)
            fits = fits or (token.kind == "end" and len(levels) == 1)
        elif before.kind == "function":
            fits = True
        else:
            fits = token.kind in ("number", "name", "function") or sign in ("(", "+", "-")
            fits = fits or (sign == "not" and before.text in ("(", ",", "and", "or", "not"))
        if not fits:
            what = "it ends too early" if token.kind == "end" else f"{token.text!r} is out of place"
            missing = "')' is missing, " if is_after_value and len(levels) > 1 else ""
            raise syntax_error(text, token.at, missing + what)
        if token.kind == "function" and token.text not in _FUNCTIONS:
            why = f"there is no function {token.text}"
            raise syntax_error(text, token.at, why, f"known are: {', '.join(_FUNCTIONS)}")
        if sign == "(":
            if len(levels) > _DEEPEST:
                why = f"parentheses go deeper than {_DEEPEST} levels"
                raise syntax_error(text, token.at + 1, why)
            levels.append((before if before.kind == "function" else None, 1, False))
        elif sign == ")":
            _check_count(text, *levels.pop()[:2])
        elif sign == ",":
            levels[-1] = function, count + 1, False
        elif sign in _COMPARISONS:
            if is_compared:
                hint = "join two comparisons with and"
                raise syntax_error(text, token.at, "it compares a third time", hint)
            levels[-1] = function, count, True
        elif sign in ("and", "or"):
            levels[-1] = function, count, False
        before = token


def _check_count(text: str, function: Token | None, count: int) -> None:
    if function is not None:
        least, most = _FUNCTIONS[function.text]
        if not least <= count <= most:
            many = "one value" if most == 1 else f"{least} to {most} values"
            raise syntax_error(text, function.at, f"{function.text} takes {many}")
