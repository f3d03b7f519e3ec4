"""Options that say which files a command takes, for the commands that say it alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from msal_cli.job.settings import SELF_INTERSECTIONS
from msal_cli.job.units import METRES

UNIT = click.option(
    "--unit",
    type=click.Choice(tuple(METRES)),
    metavar="UNIT",
    help="What the numbers in the files are: mm, m, in, ... Then lengths may have a unit (0.01mm).",
)

CHECK = click.option(
    "--check",
    "checks",
    type=click.Choice((SELF_INTERSECTIONS,)),
    multiple=True,
    help="Count the faces that intersect each other, too: a second for 100,000 faces.",
)

_INCLUDE = click.option(
    "--include", metavar="PATTERN", multiple=True, help="Take only files that match. Repeatable."
)
_EXCLUDE = click.option(
    "--exclude", metavar="PATTERN", multiple=True, help="Leave out what matches. Repeatable."
)


def file_options(format_help: str) -> Callable[[Any], Any]:
    """--include, --exclude, and --format with its help."""
    format_option = click.option("--format", "format", metavar="FORMAT", help=format_help)

    def decorated(command: Any) -> Any:
        return _INCLUDE(_EXCLUDE(format_option(command)))

    return decorated
