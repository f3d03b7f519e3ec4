"""``msal methods``: what the methods do, their parameters and where they come from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from msal_cli.cli import console
from msal_cli.cli.command import Request, grouped_command
from msal_cli.cli.options import SHORTCUTS, complete_method, group

if TYPE_CHECKING:
    from msal_cli.methods import Method

SCHEMA = "msal.methods/1"


@grouped_command(
    "methods",
    group("Reports", "--json -> as_json\n    Print everything as one JSON document.\n"),
    arguments=[
        click.Argument(["name"], metavar="[NAME]", required=False, shell_complete=complete_method)
    ],
    configurable=False,
    epilog="",
)
def command(request: Request) -> int:
    """List the methods, or explain the one called NAME."""
    from msal_cli import methods

    names = (request.name,) if request.name else methods.names()
    chosen = [methods.find(name) for name in names]
    if request.as_json:
        _print_json(chosen)
        return console.SUCCESS
    lines = _page(chosen[0]) if request.name else _table(chosen)
    console.put("\n".join(lines) + "\n")
    return console.SUCCESS


def _table(chosen: list[Method]) -> Iterator[str]:
    widest = max(len(method.name) for method in chosen)
    for method in chosen:
        yield f"{method.name:<{widest}}  {method.summary}"
    yield ""
    yield "`msal methods NAME` shows what one does, its parameters and their ranges."
    yield "`msal denoise --auto` chooses one for each mesh."


def _page(method: Method) -> Iterator[str]:
    yield f"{method.name}: {method.description}"
    yield ""
    yield "Parameters (--set NAME=VALUE):"
    for spec in method.parameters:
        symbol = f"--set {spec.symbol}=" if spec.symbol not in ("", spec.name) else ""
        also = ", ".join(filter(None, (SHORTCUTS.get(spec.name), symbol)))
        yield ""
        yield f"  {spec.name} = {spec.default}" + (f"   (also {also})" if also else "")
        yield f"      {spec.help}"
        yield f"      allowed: {spec.range_text}" + (f"; unit: {spec.unit}" if spec.unit else "")
        if spec.more:
            yield f"      more is {spec.more}"


def _print_json(chosen: list[Method]) -> None:
    of_method = ("name", "summary", "description", "source")
    of_range = ("low", "high", "low_open", "high_open", "choices", "unit")
    of_parameter = ("name", "symbol", "kind", "default", *of_range, "help", "more")
    methods = []
    for method in chosen:
        data = {name: getattr(method, name) for name in of_method}
        data["parameters"] = [
            {name: getattr(spec, name) for name in of_parameter} | {"kind": spec.kind.__name__}
            for spec in method.parameters
        ]
        methods.append(data)
    console.put_json(SCHEMA, methods=methods)
