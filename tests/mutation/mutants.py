"""Small faults planted in a module, one at a time, by its syntax tree.

Each is a change that a good test notices: a comparison off by one or turned round, another
operator, a constant changed, a condition negated, a result, a call or an error left out.  Texts,
annotations, messages of errors and log lines stay as they are: no behaviour hangs on them.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import CodeType

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
SWAPPED = {"min": "max", "max": "min", "any": "all", "all": "any"}
TOLERANCE = 0.1
"""Positive constants below this are tolerances: they become their reciprocals."""

SILENT = {"debug", "info", "warning", "log"}
"""Calls that only write a log line."""


@dataclass(frozen=True)
class Mutant:
    """A fault that can be planted: its ``line``, the ``lines`` of the statement (first and last),
    the ``function`` around it, what it changes, and where: the number of the node among
    ``ast.walk`` of the module, and how to change that node.  ``lines`` is None for what runs when
    the module is imported."""

    line: int
    lines: tuple[int, int] | None
    function: str
    words: str
    node: int
    change: Callable[[ast.AST], None]

    def compile(self, source: str, file: str) -> CodeType:
        """The code of the module ``source`` with this fault."""
        tree = ast.parse(source)
        self.change(list(ast.walk(tree))[self.node])
        return compile(ast.fix_missing_locations(tree), file, "exec")


def find_mutants(source: str) -> list[Mutant]:
    """Every fault that can be planted in a module, in the order of its lines."""
    tree = ast.parse(source)
    numbers = {id(node): number for number, node in enumerate(ast.walk(tree))}
    found = [
        Mutant(node.lineno, lines, function, words, numbers[id(node)], change)
        for node, lines, function in _nodes(tree, None, "")
        for words, change in _changes(node)
    ]
    return sorted(found, key=lambda mutant: (mutant.line, mutant.node))


def _nodes(
    node: ast.AST, lines: tuple[int, int] | None, function: str
) -> Iterator[tuple[ast.expr | ast.stmt, tuple[int, int] | None, str]]:
    """The nodes below ``node`` that count, with the lines of the statement that each belongs to
    and the qualified name of the function around it."""
    for child in _children(node):
        around, span = function, lines
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            around = f"{function}.{child.name}".lstrip(".")
        if (isinstance(child, ast.stmt) and isinstance(node, ast.FunctionDef)) or lines is not None:
            span = _lines_of(child) if isinstance(child, ast.stmt) else lines
        if isinstance(child, ast.expr | ast.stmt):
            yield child, span, around or "<module>"
        yield from _nodes(child, span, around)


def _lines_of(statement: ast.stmt) -> tuple[int, int]:
    """First and last line of a statement, of a compound one without its body."""
    body = getattr(statement, "body", None)
    last = max(statement.lineno, body[0].lineno - 1) if body else statement.end_lineno
    return statement.lineno, last or statement.lineno


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """The parts of a node but for annotations, docstrings, messages and log lines."""
    if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return
    if isinstance(node, ast.Expr) and (isinstance(node.value, ast.Constant) or _is_log(node.value)):
        return
    skipped = {"annotation", "returns", "decorator_list", "type_comment"}
    for name, value in ast.iter_fields(node):
        if name not in skipped:
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and not _is_for_types(child):
                    yield child


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def _is_log(node: ast.AST) -> bool:
    is_method = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
    return is_method and node.func.attr in SILENT  # type: ignore[attr-defined]


def _changes(node: ast.AST) -> Iterator[tuple[str, Callable[[ast.AST], None]]]:
    """What can be changed in one node: in words, and the function that changes it."""
    text = ast.unparse(node).partition("\n")[0]
    if isinstance(node, ast.Compare):
        for k, operator in enumerate(node.ops):
            for new in COMPARISONS[type(operator)]:
                yield (
                    f"{text}: {_sign(operator)} becomes {_sign(new())}",
                    _set_item("ops", k, new()),
                )
    elif isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield f"{text}: and/or swapped", _set("op", other)
    elif isinstance(node, ast.BinOp | ast.AugAssign):
        is_text = any(isinstance(n, ast.JoinedStr) or _is_str(n) for n in ast.walk(node))
        if type(node.op) in OPERATORS and not is_text:
            new_op = OPERATORS[type(node.op)]()
            yield f"{text}: {_sign(node.op)} becomes {_sign(new_op)}", _set("op", new_op)
    elif isinstance(node, ast.If | ast.While | ast.IfExp):
        yield f"{text}: condition negated", _negate("test")
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield f"{text}: not dropped", _negate("operand")
    elif isinstance(node, ast.Return) and node.value is not None:
        if not (isinstance(node.value, ast.Constant) and node.value.value is None):
            yield f"{text}: returns None", _set("value", ast.Constant(None))
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        if not _is_log(node.value):
            yield f"{text}: left out", _set("value", ast.Constant(None))
    elif isinstance(node, ast.Raise) and node.exc is not None:
        yield f"{text}: left out", _turn_into_pass
    elif isinstance(node, ast.Call):
        if isinstance(node.func, ast.Name) and node.func.id in SWAPPED:
            new_name = ast.Name(SWAPPED[node.func.id], ast.Load())
            yield f"{text}: becomes {new_name.id}", _set("func", new_name)
    elif isinstance(node, ast.Constant):
        for value in _other_values(node.value):
            yield f"{text} becomes {value!r}", _set("value", value)


def _other_values(value: object) -> tuple[object, ...]:
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int):
        return (value + 1,)
    if isinstance(value, float):
        if 0.0 < value < TOLERANCE:
            return (1.0 / value,)
        return (2.0 * value if value else 1.0,)
    return ()


def _is_str(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _sign(operator: ast.AST) -> str:
    return type(operator).__name__


def _set(field: str, value: object) -> Callable[[ast.AST], None]:
    return lambda node: setattr(node, field, value)


def _set_item(field: str, place: int, value: object) -> Callable[[ast.AST], None]:
    return lambda node: getattr(node, field).__setitem__(place, value)


def _negate(field: str) -> Callable[[ast.AST], None]:
    return lambda node: setattr(node, field, ast.UnaryOp(ast.Not(), getattr(node, field)))


def _turn_into_pass(node: ast.AST) -> None:
    # A statement that does nothing, in the place of ``raise``: its fields are not looked at.
    node.__class__ = ast.Pass  # type: ignore[assignment]
