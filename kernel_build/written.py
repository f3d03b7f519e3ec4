"""Which array arguments a kernel writes to, read from its source."""

from __future__ import annotations

import ast
import functools
import inspect
import textwrap
import types
from typing import Any

from kernel_build.sources import is_kernel_module
from msal_cli.kernels.lanes import WRITTEN
from msal_cli.kernels.library import Kernel

_WRITING_METHODS = {"fill", "sort", "partition"}


@functools.cache
def written_arguments(kernel: Kernel) -> frozenset[int]:
    """The positions of the array arguments that a kernel, or a kernel that it calls, writes to.

    All others are compiled as read-only, so that an array may be either; numba refuses to write
    to them, should this ever miss one.
    """
    tree = ast.parse(textwrap.dedent(inspect.getsource(kernel.function))).body[0]
    assert isinstance(tree, ast.FunctionDef)
    names = [one.arg for one in tree.args.args]
    walk = _Writes(names, kernel.function.__globals__)
    # A second name may be used above the line that makes it, in a loop.
    while True:
        before = (set(walk.written), {name: set(roots) for name, roots in walk.roots.items()})
        walk.visit(tree)
        if before == (walk.written, walk.roots):
            return frozenset(names.index(name) for name in walk.written)


class _Writes(ast.NodeVisitor):
    """Which arguments are written to, also by other names and through views.

    Attributes
    ----------
    roots : for each name the arguments whose memory it may be.
    written : arguments that are written to.
    """

    def __init__(self, arguments: list[str], known: dict[str, Any]) -> None:
        self.known = known
        self.roots = {name: {name} for name in arguments}
        self.written: set[str] = set()

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            self._assign(target, node.value)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        if isinstance(node.target, ast.Subscript):
            self.written |= self._roots_of(node.target)
        self.generic_visit(node)

    def visit_For(self, node: ast.For) -> None:
        self._assign(node.target, node.iter)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        callee = self._callee(node.func)
        if callee is not None:
            if isinstance(callee, Kernel):
                for at in written_arguments(callee):
                    self.written |= self._roots_of(node.args[at])
            elif isinstance(callee, types.FunctionType):
                for at in WRITTEN.get(callee, ()):
                    self.written |= self._roots_of(node.args[at])
        elif isinstance(node.func, ast.Attribute) and node.func.attr in _WRITING_METHODS:
            self.written |= self._roots_of(node.func.value)
        self.generic_visit(node)

    def _callee(self, node: ast.expr) -> Any:
        """The kernel or function that is called, by its name or that of its module."""
        if isinstance(node, ast.Name):
            return self.known.get(node.id)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = self.known.get(node.value.id)
            return vars(module).get(node.attr) if is_kernel_module(module) else None
        return None

    def _assign(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Subscript):
            self.written |= self._roots_of(target)
        elif isinstance(target, ast.Name):
            self.roots.setdefault(target.id, set()).update(self._roots_of(value))
        elif isinstance(target, ast.Tuple):
            values = [value] * len(target.elts)
            if isinstance(value, ast.Tuple) and len(value.elts) == len(target.elts):
                values = value.elts
            for one, its_value in zip(target.elts, values, strict=True):
                self._assign(one, its_value)

    def _roots_of(self, node: ast.expr) -> set[str]:
        if isinstance(node, ast.Name):
            return self.roots.get(node.id, set())
        if isinstance(node, ast.Attribute | ast.Subscript | ast.Starred):
            return self._roots_of(node.value)
        if isinstance(node, ast.Call):
            # A method such as view gives the same memory; so may a function of numpy's.
            parts = [node.func, *node.args] if isinstance(node.func, ast.Attribute) else []
            return set().union(*map(self._roots_of, parts))
        if isinstance(node, ast.IfExp):
            return self._roots_of(node.body) | self._roots_of(node.orelse)
        if isinstance(node, ast.Tuple | ast.List):
            return set().union(*map(self._roots_of, node.elts))
        return set()
