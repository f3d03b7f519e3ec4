"""``msal methods``: what the methods do, their parameters and where they come from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console, options
from msal_cli.cli.command import command as grouped_command
from msal_cli.cli.command import group
from msal_cli.cli.options import SHORTCUTS
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.job.records import MeshRecord
    from msal_cli.methods import Method, ParameterSpec

SCHEMA = "msal.methods/1"


@grouped_command("methods", configurable=False)
@click.argument("name", metavar="[NAME]", required=False, shell_complete=options.complete_method)
@group(
    "Reports",
    click.option("--json", "as_json", is_flag=True, help="Print everything as one JSON document."),
)
def command(name: str | None, as_json: bool) -> int:
    """List the methods, or explain the one called NAME."""
    from msal_cli import methods

    chosen = [methods.find(word) for word in ((name,) if name else methods.names())]
    if as_json:
        _print_json(chosen)
    elif name:
        console.put("\n".join(_page(chosen[0])) + "\n")
    else:
        console.put("\n".join(_table(chosen)) + "\n")
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
    names = ("name", "summary", "description", "source")
    methods = [
        {name: getattr(method, name) for name in names}
        | {"parameters": [_describe_parameter(spec) for spec in method.parameters]}
        for method in chosen
    ]
    console.put_json(SCHEMA, methods=methods)


def _describe_parameter(spec: ParameterSpec) -> dict[str, Any]:
    names = ("name", "symbol", "kind", "default", "low", "high", "low_open", "high_open")
    data = {name: getattr(spec, name) for name in (*names, "choices", "unit", "help", "more")}
    return data | {"kind": spec.kind.__name__}


def list_defaults(records: Sequence[MeshRecord]) -> dict[str, Any]:
    """The default parameters of the method of a single record; none of a method of another
    version of msal, and none for several records."""
    if len(records) != 1 or records[0].method is None:
        return {}
    from msal_cli import methods

    try:
        return methods.find(records[0].method.name).validate({})
    except UsageError:
        return {}
