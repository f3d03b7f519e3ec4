"""Options that contradict or need each other, as tables that one function reads."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import click
from click.core import ParameterSource

from msal_cli.cli.options import STREAM
from msal_cli.errors import UsageError

AUTOMATIC = ("auto", "keep", "strength", "prefer")
"""Options of which each implies ``--auto``."""

BY_HAND = ("method", "iterations", "K", "mollify", "schedule", "assignments")
"""Options that give a method and its parameters."""

_FOR_FILES = (
    *("in_place", "include", "exclude", "dry_run", "shard", "retry_failed", "dask"),
    *("fail_fast", "fields", "retries", "max_failures", "scratch", "tile_set"),
    *("timeout", "memory_limit"),
)

_AUTO_HINT = (
    "--keep, --strength and --prefer imply --auto: let it choose, or give method and parameters "
    "by hand"
)
_ASSUME_HINT = "--assume is for the choice of a method: leave it away, or the method"
_ROWS = """
quiet verbose
    give one of them
in_place output
    give one of them
in_place to: --in-place cannot change the format
    name an output with -o to use --to
backup no_backup
    give one of them
fail_fast max_failures
    give one of them
fields in_place: --fields writes a file beside each output, which the next run in place would take \
for an input
    name another folder with -o
dask in_place: --in-place cannot be used with Dask, which may do a file twice
    name an output folder with -o, or leave --engine dask away
tile_set in_place: --in-place cannot be used with --tile-set: once a file has changed, the set \
that it was part of is gone
    name an output folder with -o
tile_set shard: --shard deals out files, and the files of a tile set are one mesh
    run the set as a whole, or leave --tile-set away
tile_set timeout: --timeout is for one file, and the files of a tile set are one mesh
    leave --timeout away
tile_set dask: --engine dask deals out files, and the files of a tile set are one mesh
    leave --engine dask away, or leave --tile-set away
dask jobs: -j is for this machine; a Dask cluster has as many workers as it has
    leave -j away, or leave --engine dask away
stdout reference: --reference measures a file, and the mesh goes to standard output
    name a file with -o
stdout as_json: the mesh and --json cannot both go to standard output
    name a file with -o for the mesh, or with --report for the records
"""

# Two names of ``find_given`` that do not go together, a message in place of the usual one, a hint.
_CONFLICTS: tuple[tuple[str, str, str, str], ...] = (
    *re.findall(r"(\w+) (\w+)(?:: (.*))?\n    (.*)\n", _ROWS),
    *((first, other, "", _AUTO_HINT) for first in AUTOMATIC for other in ("adaptive", *BY_HAND)),
    *((first, other, "", _AUTO_HINT) for first in ("automatic", "adaptive") for other in BY_HAND),
    *(("assume", other, "", _ASSUME_HINT) for other in BY_HAND),
    *(
        ("stream", other, "{other} is for files, not for standard input or output", "")
        for other in _FOR_FILES
    ),
)

_DASK_HINT = "give --scheduler tcp://HOST:8786; on this machine alone, leave --engine dask away"

# A name that is of no use without the other, and a hint.
_NEEDS = (
    ("backup", "in_place", "other inputs are never replaced"),
    ("no_backup", "in_place", "other inputs are never replaced"),
    ("scheduler", "dask", "add --engine dask"),
    ("dask", "scheduler", _DASK_HINT),
    ("tolerance", "baseline", "name an earlier report with --baseline"),
)

# The parameters that ``find_given`` has by other names.
_PARAMETERS = {"automatic": "method", "adaptive": "method", "dask": "engine"}


def find_given(context: click.Context) -> dict[str, str]:
    """The options of a command line that have another value than without them, as users write them.

    Three values count as options of their own: ``automatic`` and ``adaptive`` for those words in
    place of a method, and ``dask``.
    """
    given = {}
    # The default of the program counts, whatever a configuration file gives.
    from_file, context.default_map = context.default_map, None
    for parameter in context.command.params:
        value: Any = context.params.get(str(parameter.name))
        # 0 is given, too.
        is_empty = value is None or value is False or value == ()
        if not is_empty and value != parameter.get_default(context):
            given[str(parameter.name)] = max(parameter.opts, key=len)
    context.default_map = from_file
    method = context.params.get("method")
    if method in ("auto", "adaptive"):
        del given["method"]
        given["automatic" if method == "auto" else method] = f"--method {method}"
    if given.pop("engine", None):
        given["dask"] = "--engine dask"
    return given


def find_overruled(context: click.Context) -> set[str]:
    """The parameters whose values from a configuration file give way to the command line: they
    contradict it, or need an option that is not given."""
    given = find_given(context)
    from_file = {
        name
        for name in given
        if context.get_parameter_source(_PARAMETERS.get(name, name)) is ParameterSource.DEFAULT_MAP
    }
    inputs, output = context.params.get("inputs") or (), context.params.get("output")
    by_hand = given.keys() - from_file
    if STREAM in (*inputs, output):
        by_hand |= {"stream"} | ({"stdout"} if output in (None, STREAM) else set())
    overruled = {
        loser
        for first, other, _, _ in _CONFLICTS
        for winner, loser in ((first, other), (other, first))
        if winner in by_hand and loser in from_file
    }
    left = given.keys() - overruled
    overruled |= {first for first, other, _ in _NEEDS if first in from_file and other not in left}
    return {_PARAMETERS.get(name, name) for name in overruled}


def refuse_conflicts(given: Mapping[str, str]) -> None:
    """Refuse the first two options of the tables that do not go together; UsageError."""
    for first, other, message, hint in _CONFLICTS:
        if first in given and other in given:
            message = message or "{one} and {other} contradict each other"
            raise UsageError(message.format(one=given[first], other=given[other]), hint=hint)
    for first, other, hint in _NEEDS:
        if first in given and other not in given:
            need = "--engine dask" if other == "dask" else f"--{other.replace('_', '-')}"
            raise UsageError(f"{given[first]} needs {need}", hint=hint)
