"""Options that several commands share, the types of their values, their completion, and tables of
options that contradict or need each other."""

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import click
from click.core import ParameterSource

from msal_cli.errors import UsageError
from msal_cli.job.settings import AXES, METRES, SELF_INTERSECTIONS, parse_input_format
from msal_cli.storage import urls

STREAM = "-"  # the name of standard input and standard output

_MAX_JOBS = 4096
_MAX_DIGITS = 15

_NUMBER_AND_UNIT = r"(?ai)(\d{1,15}(?:\.\d{0,9})?|\.\d{1,9})\s*([a-z]*)"
_SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_BYTES = {
    **{f"{letter}{end}": 1000**n for n, letter in enumerate("kmgt", 1) for end in ("", "b")},
    **{f"{letter}ib": 1024**n for n, letter in enumerate("kmgt", 1)},
}

SHORTCUTS = {"iterations": "-n", "K": "-K", "mollify": "--mollify", "schedule": "--schedule"}
"""Options of ``msal denoise`` that set a parameter of the method."""

# Types.  A function as a type gets the text of the option; its BadParameter names the option.


class PathOrUrl(click.Path):
    """A path, or a URL without ``file://``."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; UsageError for a URL that contains a secret."""
        return urls.normalize_url(str(super().convert(value, param, ctx)))


PATH = PathOrUrl(readable=False, allow_dash=True)


def parse_jobs(text: str) -> int | None:
    """A number of files at the same time; None for ``auto``."""
    if text == "auto":
        return None
    if not (text.isascii() and text.isdigit()) or not 1 <= int(text[:9]) <= _MAX_JOBS:
        raise click.BadParameter(
            f"{text!r} is neither auto nor a whole number from 1 to {_MAX_JOBS}"
        )
    return int(text[:9])


def number(
    low: float = -math.inf, high: float = math.inf, unit: str = ""
) -> Callable[[str], float]:
    """The type of finite numbers from ``low`` to ``high``; ``unit`` may follow the number."""
    limits = "" if low == -math.inf else f" from {low:g}" + (f" to {high:g}" * (high < math.inf))

    def parse(text: str) -> float:
        try:
            value = float(text.removesuffix(unit))
        except ValueError:
            value = math.nan
        if not low <= value <= high or math.isinf(value):
            raise click.BadParameter(f"{text!r} is not a number{limits}")
        # Adding 0.0 makes -0.0, which help would show, 0.0.
        return value + 0.0

    return parse


def parse_list(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(","))


def _parse_with_unit(text: str, units: dict[str, float] | dict[str, int]) -> float:
    """A number followed by one of ``units``, times that unit; 0 for anything else."""
    match = re.fullmatch(_NUMBER_AND_UNIT, text.strip())
    return float(match[1]) * units.get(match[2].lower(), 0) if match else 0.0


def parse_duration(text: str) -> float | None:
    """Seconds: ``90``, ``1.5m``, ``2h``; None for ``none``."""
    seconds = _parse_with_unit(text, _SECONDS)
    if text != "none" and not seconds > 0.0:
        raise click.BadParameter(f"{text!r} is not a time such as 90, 90s, 5m or 1h")
    return seconds or None


def parse_size(text: str) -> int | None:
    """Bytes: ``500MB`` is 500 million, ``500MiB`` is 500 * 1024 * 1024; None for ``none``.

    A number without a unit is refused: bytes are hardly meant.
    """
    size = _parse_with_unit(text, _BYTES)
    if text != "none" and not size >= 1.0:
        raise click.BadParameter(f"{text!r} is not a size such as 500M, 2G or 1.5GiB")
    return int(size) or None


def parse_percentage(text: str) -> float:
    """A share from a percentage such as ``2%``."""
    match = re.fullmatch(r"(?a)(\d{1,9}(?:\.\d{1,9})?)\s*%", text.strip())
    if match is None:
        raise click.BadParameter(f"{text!r} is not a percentage such as 2% or 0.5%")
    return float(match[1]) / 100.0


def parse_direction(text: str) -> tuple[float, float, float]:
    """Three numbers between commas, or an axis such as ``z`` or ``-z``."""
    axis = text.lower().removeprefix("-").removeprefix("+")
    if axis in AXES:
        sign = -1.0 if text.startswith("-") else 1.0
        # Adding 0.0 makes -0.0, which would be shown, 0.0.
        x, y, z = (sign * (axis == name) + 0.0 for name in AXES)
        return x, y, z
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not 1e-100 < math.hypot(x, y, z) < 1e100:
        raise click.BadParameter(
            f"{text!r} is neither an axis such as z or -z nor a direction such as 0,-1,0.5"
        )
    return x, y, z


# Values that are checked when the command runs, because the checks import more.


def resolve_format(text: str | None) -> str | None:
    """The format of ``--format`` without a leading dot; UsageError if it cannot be read."""
    return None if text is None else parse_input_format(text)


def parse_assignment(text: str) -> tuple[str, str, str]:
    """The label of a ``--set`` for messages, and its parts; UsageError without ``NAME=VALUE``."""
    name, sign, value = text.partition("=")
    if not sign or not name.strip() or not value.strip():
        raise UsageError(f"--set {text} is not NAME=VALUE", hint="for example: --set iterations=4")
    return f"--set {text}", name.strip(), value.strip()


def check_threads_variable() -> None:
    """Raise UsageError for an invalid value of ``MSAL_THREADS``."""
    value = os.environ.get("MSAL_THREADS", "")
    is_number = value.isascii() and value.isdigit() and len(value) <= _MAX_DIGITS
    if value and not (is_number and int(value) > 0):
        raise UsageError(
            f"MSAL_THREADS is {value!r}, which is not a whole number from 1 up",
            hint="set it to a number of threads, or unset it",
        )


def complete_method(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[str]:
    from msal_cli import methods

    return [name for name in methods.names() if name.startswith(incomplete)]


# Options.

_TYPES: dict[str, Any] = {
    **dict.fromkeys(("OUT", "OUT.png", "FILE", "FILE.ply", "FOLDER", "TRUTH", "REPORT.json"), PATH),
    "DEGREES": number(-360.0, 360.0),
    "N|auto": parse_jobs,
    "NAME,...": parse_list,
    "PERCENT": parse_percentage,
    "SIZE": parse_size,
    "TIME": parse_duration,
    "X,Y,Z": parse_direction,
}
"""The types of values, by the words for them in help."""

_HEAD = r"(-[^\s,]+(?:, -\S+)*)(?: (?!\.\.\.|=|->)(\S+))?( \.\.\.)?(?: = (\S+))?(?: -> (\w+))?"
"""Flags, the word for the value, whether the option is repeatable, its default, its parameter."""

MESSAGES = "Messages and help"  # the group that ``-h`` and ``--help-all`` belong to


class OptionGroup(NamedTuple):
    """Options that help shows together: the common ones, and those for ``--help-all`` only."""

    title: str
    common: tuple[click.Option, ...]
    more: tuple[click.Option, ...]


def group(title: str, text: str, **settings: Any) -> OptionGroup:
    """The options that ``text`` describes; those after a line ``more:`` are for --help-all."""
    common, _, more = text.partition("more:\n")
    return OptionGroup(
        title, tuple(parse_options(common, settings)), tuple(parse_options(more, settings))
    )


def parse_options(text: str, settings: Mapping[str, Any]) -> Iterator[click.Option]:
    """Parse options that are described as help shows them: a line each, and the help, indented.

    ``-o, --output OUT = DEFAULT -> name`` is an option whose parameter has another name; without
    ``OUT`` it is a flag.  ``[a|b]`` is one of these words, and with ``...`` the option may be
    repeated.  An option without help is one of ``SHARED``.  ``settings`` has a type for a
    parameter, or a mapping of what ``click.Option`` takes.
    """
    for entry in re.findall(r"^-.*\n(?: .*\n)*", text, re.MULTILINE):
        head, *lines = entry.splitlines()
        if not lines:
            yield SHARED[head]
            continue
        match = re.fullmatch(_HEAD, head)
        assert match is not None, head
        flags, metavar, repeats, default, name = match.groups()
        names = flags.split(", ")
        name = name or names[-1].partition("/")[0].lstrip("-").replace("-", "_")
        text = " ".join(line.strip() for line in lines)
        attributes: dict[str, Any] = {"help": re.sub(r" +\[default", "  [default", text)}
        if metavar is None:
            attributes["count" if repeats else "is_flag"] = True
        else:
            words = metavar[1:-1].split("|") if metavar.startswith("[") else []
            attributes["multiple"] = bool(repeats)
            attributes["metavar"] = None if words else metavar
            attributes["type"] = click.Choice(words) if words else _TYPES.get(metavar)
        if default is not None:
            attributes["default"] = int(default) if default.isdigit() else default
            attributes["show_default"] = True
        own = settings.get(name, {})
        attributes |= own if isinstance(own, dict) else {"type": own}
        yield click.Option([*names, name], **attributes)


_SHARED = f"""
--include PATTERN ...
    Take only files that match, such as '*.ply'; by path or name. Repeatable.
--exclude PATTERN ...
    Leave out files or folders that match. Repeatable; wins over --include.
--format FORMAT
    Format of the input files, where neither their names nor their content show it.
--unit UNIT
    What the numbers in the files are: mm, m, in, ... Then lengths may have a unit (0.01mm).
--check [{SELF_INTERSECTIONS}] ... -> checks
    Count the faces that intersect each other, too: a second for 100,000 faces.
--set NAME=VALUE ... -> assignments
    Any parameter of the method; `msal methods NAME` lists them. Repeatable.
--force
    Replace files in OUT that no msal denoise wrote; with msal noise, all.
--json -> as_json
    Print the JSON report to standard output.
--csv-columns [common|all]
    Columns of reports in .csv: those that people sort and filter by, or every figure.
    [default: common]
--fields NAME,...
    Write lambda, sigma, noise, displacement or curvature of every vertex to a PLY beside each
    output (scan.fields.ply): properties, and the first one as colours too.
-j, --jobs N|auto = auto
    Files at the same time; more is faster and takes more memory. auto is one per core, as far as
    memory allows. The results do not depend on it.
--fresh
    Denoise again what an earlier run has done already.
--retry-failed
    Try again what failed in an earlier run and would fail again.
--timeout TIME
    Most time for one file: seconds, or 90s, 5m, 1h. [default: none]
--memory-limit SIZE
    Most memory for one file and for each worker: 500M, 2G, 1.5GiB. [default: none]
--retries N
    How often a file is tried again, alone, that was lost to a crash, memory or time. [default: 1]
--fail-fast
    Begin no more files once one has failed in this run; a rerun goes on after it.
--max-failures N
    Begin no more files once N have failed in this run. [default: none]
-q, --quiet
    No progress and no summary; only errors.
-v, --verbose ...
    Show more of what is done; -vv shows everything, with times.
"""

_SHARED_TYPES = {
    "unit": click.Choice(tuple(METRES)),
    "retries": click.IntRange(min=0),
    "max_failures": click.IntRange(min=1),
}

SHARED = {option.opts[-1]: option for option in parse_options(_SHARED, _SHARED_TYPES)}
"""Options of several commands, by their names."""

QUIET_AND_VERBOSE = group(MESSAGES, "--quiet\n--verbose\n")

INPUTS = click.Argument(["inputs"], metavar="INPUT...", nargs=-1, required=True, type=PATH)

# Options that contradict or need each other, as tables that one function reads

AUTOMATIC = ("auto", "keep", "strength")  # options of the automatic choice

BY_HAND = ("method", "iterations", "K", "mollify", "schedule", "assignments")
"""Options that give a method and its parameters."""

_FOR_FILES = (
    *("in_place", "include", "exclude", "dry_run", "shard", "retry_failed", "dask"),
    *("fail_fast", "fields", "retries", "max_failures", "scratch", "tile_set"),
    *("timeout", "memory_limit"),
)

_AUTO_HINT = (
    "--keep and --strength are for the choice of a method: let it choose, or give method and "
    "parameters by hand"
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

# Two names of ``find_given`` that contradict each other, a message if not the usual one, a hint.
_CONFLICTS: tuple[tuple[str, str, str, str], ...] = (
    *re.findall(r"(\w+) (\w+)(?:: (.*))?\n    (.*)\n", _ROWS),
    *((first, other, "", _AUTO_HINT) for first in AUTOMATIC for other in BY_HAND),
    ("auto", "adaptive", "", _AUTO_HINT),
    *((first, other, "", _AUTO_HINT) for first in ("automatic", "adaptive") for other in BY_HAND),
    *(("assume", other, "", _ASSUME_HINT) for other in BY_HAND),
    *(
        ("stream", other, "{other} is for files, not for standard input or output", "")
        for other in _FOR_FILES
    ),
)

_DASK_HINT = "give --scheduler tcp://HOST:8786; on this machine alone, leave --engine dask away"

# A name that needs another one, words for that one, and a hint.
_NEEDS = (
    ("backup", "in_place", "--in-place", "other inputs are never replaced"),
    ("no_backup", "in_place", "--in-place", "other inputs are never replaced"),
    ("scheduler", "dask", "--engine dask", "add --engine dask"),
    ("dask", "scheduler", "--scheduler", _DASK_HINT),
    ("tolerance", "baseline", "--baseline", "name an earlier report with --baseline"),
    ("csv_columns", "csv_report", "a report in .csv", "name one, or leave --csv-columns away"),
)

# Parameters that have other names in ``find_given``.
_PARAMETERS = {"automatic": "method", "adaptive": "method", "dask": "engine"}


def find_given(context: click.Context) -> dict[str, str]:
    """The options of a command line whose values are not their defaults, as users write them.

    Four values count as options of their own: ``automatic`` and ``adaptive`` for those words in
    place of a method, ``dask``, and ``csv_report``.
    """
    given = {}
    # Compare with the defaults of the program, not with those from a configuration file.
    from_file, context.default_map = context.default_map, None
    for parameter in context.command.params:
        value: Any = context.params.get(str(parameter.name))
        # 0 is a value, too.
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
    reports = context.params.get("reports") or context.params.get("outputs") or ()
    if any(name.lower().endswith(".csv") for name in reports):
        given["csv_report"] = "a report in .csv"
    return given


def find_overruled(context: click.Context) -> set[str]:
    """The parameters with values from a configuration file that contradict the command line, or
    need an option that is not given: the command line wins."""
    from msal_cli.codecs.detection import format_of_name

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
    overruled |= {first for first, other, *_ in _NEEDS if first in from_file and other not in left}
    if "output" in by_hand and output and format_of_name(output) and not os.path.isdir(output):
        # The suffix of the output decides.
        overruled |= from_file & {"to"}
    return {_PARAMETERS.get(name, name) for name in overruled}


def refuse_conflicts(given: Mapping[str, str]) -> None:
    """Raise UsageError for the first options that contradict or need each other by the tables."""
    for first, other, message, hint in _CONFLICTS:
        if first in given and other in given:
            message = message or "{one} and {other} contradict each other"
            raise UsageError(message.format(one=given[first], other=given[other]), hint=hint)
    for first, other, need, hint in _NEEDS:
        if first in given and other not in given:
            raise UsageError(f"{given[first]} needs {need}", hint=hint)
