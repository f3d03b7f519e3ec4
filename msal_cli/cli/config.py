"""``msal.toml``: values of options from a file, by tables that are named as the commands.

A file gives what the command line may give, and no more: options by their long names without the
dashes.  The command line wins.
"""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from msal_cli.cli.options import BY_HAND, find_overruled, group
from msal_cli.errors import UsageError

FILE_NAME = "msal.toml"

_ROOT_MARKS = (".git", ".hg")
_NEVER = ("config", "no_config")

# A file that lies in a folder of scans from elsewhere must not replace the originals or other
# files, nor have another machine take part: this it may only when it is named.
_ONLY_NAMED = (
    *("in_place", "no_backup", "force", "engine", "scheduler", "scratch", "heatmap", "outputs"),
)
# Pictures, which are replaced.
_OUTPUTS_ONLY_NAMED = (("view", "output"), ("sweep", "output"))

_MAX_BYTES = 1_000_000


def _find_file() -> str | None:
    """The nearest ``msal.toml``: in the current folder, or in a parent within its repository."""
    if os.path.isfile(FILE_NAME):
        return FILE_NAME
    here = Path(os.path.realpath(os.curdir))
    folders = [here, *here.parents]
    are_roots = [any((folder / mark).exists() for mark in _ROOT_MARKS) for folder in folders]
    # Outside of a repository parents may be anyone's, such as /tmp.
    n_parents = are_roots.index(True) if True in are_roots else 0
    for folder in folders[1 : n_parents + 1]:
        if (folder / FILE_NAME).is_file():
            return os.path.relpath(folder / FILE_NAME)
    return None


def read_config(path: str, ctx: click.Context, *, is_named: bool) -> dict[str, Any]:
    """What a file that the user named, or that was found, gives for the command of ``ctx``:
    values as a command line would have them, by the names of parameters."""
    root, command = ctx.find_root(), str(ctx.command.name)
    names = root.command.list_commands(root) if isinstance(root.command, click.Group) else [command]
    tables = _read_tables(path)
    for table, content in tables.items():
        if table not in names:
            raise UsageError(
                f"{path}: there is no command for the table [{table}]",
                hint=_closest(table, names) or "tables are named as commands: [denoise]",
            )
        if not isinstance(content, dict):
            raise UsageError(
                f"{path}: {table} is not a table", hint=f"write [{table}] and options below it"
            )
    # Eager ones are --help and --help-all, whose names depend on the version of click.
    keys = {
        key_of(option): option
        for option in ctx.command.get_params(ctx)
        if isinstance(option, click.Option) and not (option.name in _NEVER or option.is_eager)
    }
    values: dict[str, Any] = {}
    for key, value in tables.get(command, {}).items():
        place = f"{path}: [{command}] {key}"
        option = keys.get(key)
        if option is None or option.name is None:
            raise UsageError(
                f"{place}: there is no such option",
                hint=_closest(key, list(keys)) or f"msal {command} --help-all lists the options",
            )
        is_refused = option.name in _ONLY_NAMED or (command, option.name) in _OUTPUTS_ONLY_NAMED
        if is_refused and not is_named:
            raise UsageError(
                f"{place}: this may stand only in a file that --config names",
                hint=f"give --config {path} if you trust it, or --no-config",
            )
        words = _to_words(option, value, place)
        if isinstance(option.type, click.Path):
            below = os.path.dirname(path)
            several = words if isinstance(words, list) else [words]
            top = os.path.realpath(below or os.curdir)
            for word in () if is_named else several:
                inside = os.path.realpath(os.path.join(top, word))
                if "://" in word or os.path.commonpath([top, inside]) != top:
                    raise UsageError(
                        f"{place}: {word!r} leads out of the folder of the file, which may stand "
                        "only in a file that --config names",
                        hint="give the file with --config if you trust it, or --no-config",
                    )
            # From the current folder; URLs and - stay.
            several = [
                word if "://" in word or word == "-" else os.path.join(below, word)
                for word in several
            ]
            words = several if option.multiple else several[0]
        values[option.name] = words
    return values


def key_of(option: click.Parameter) -> str:
    """The name of an option in a file: ``fail-on``, ``K``."""
    return max(option.opts, key=len).lstrip("-")


def _read_tables(path: str) -> dict[str, Any]:
    import tomllib

    try:
        with open(path, "rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
        if len(data) > _MAX_BYTES:
            raise UsageError(f"{path}: a configuration has at most {_MAX_BYTES:,} bytes")
        return tomllib.loads(data.decode("utf-8-sig").replace("\r\n", "\n"))
    except OSError as error:
        raise UsageError(f"--config {path}: the file cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: this is not UTF-8", hint="save it as UTF-8") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise UsageError(f"{path}: this is not TOML: {error or 'too deep'}") from None


def _closest(name: str, known: list[str]) -> str:
    import difflib

    close = difflib.get_close_matches(name.replace("_", "-"), known, n=1)
    return f"did you mean '{close[0]}'?" if close else ""


def _to_words(option: click.Option, value: Any, place: str) -> Any:
    """A value as a command line would give it."""
    if option.is_flag:
        if not isinstance(value, bool):
            raise UsageError(f"{place} is {value!r}", hint="write true or false")
        return value
    if option.count:
        if not isinstance(value, int) or not 0 <= value <= 9:
            raise UsageError(f"{place} is {value!r}", hint="write true, or a number such as 2")
        return int(value)
    if isinstance(value, dict) and option.multiple:
        # [denoise.set] iterations = 4
        value = [f"{name}={_to_word(word, f'{place}.{name}')}" for name, word in value.items()]
    several = value if isinstance(value, list) else [value]
    words = [_to_word(word, place) for word in several]
    return words if option.multiple else ",".join(words)


def _to_word(value: Any, place: str) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise UsageError(f"{place} is {value!r}", hint="write a text, a number or a list of these")
    if "\0" in str(value):
        # TOML allows it; the system ends every word there.
        raise UsageError(f"{place} is {value!r}", hint="leave the character \\u0000 out")
    return str(value)


_FOUND, _PATH = "msal_cli.config_was_found", "msal_cli.config_path"

Parse = Callable[[click.Context, list[str]], list[str]]

OPTIONS = group(
    "Configuration",
    """
more:
--config FILE
    Take options from FILE. [default: msal.toml in the current folder, or in a parent within the
    repository]
--no-config
    Read no configuration file.
""",
    config={"type": None, "expose_value": False},
    no_config={"expose_value": False},
)
"""The options of every command that may be configured."""


def parse_args(ctx: click.Context, args: list[str], parse: Parse) -> list[str]:
    """Parse ``args`` with the values of the file that they name, or that is found; a second time
    without what contradicts the command line."""
    given, _, _ = ctx.command.make_parser(ctx).parse_args(list(args))
    help_option = ctx.command.get_help_option(ctx)
    is_help = "help_all" in given or (help_option is not None and help_option.name in given)
    is_named, without = "config" in given, "no_config" in given
    if is_named and without:
        raise UsageError("--config and --no-config contradict each other", hint="give one of them")
    path: str | None = given["config"] if is_named else _find_file()
    if path is None or is_help or without:
        return parse(ctx, args)
    values = read_config(path, ctx, is_named=is_named)
    ctx.meta[_FOUND], ctx.meta[_PATH], ctx.default_map = not is_named, path, dict(values)
    words = list(args)
    try:
        rest = parse(ctx, args)
    except click.BadParameter as error:
        option = error.param
        source = ctx.get_parameter_source(str(option.name)) if option is not None else None
        if source is not ParameterSource.DEFAULT_MAP or not isinstance(option, click.Option):
            raise
        place = f"{path}: [{ctx.command.name}] {key_of(option)}"
        raise UsageError(f"{place}: {error.message}".replace("\n\t", " ")) from None
    if not (overruled := find_overruled(ctx)):
        return rest
    ctx.default_map = {k: v for k, v in values.items() if k not in overruled}
    ctx.params.clear()
    return parse(ctx, words)


def name_file(ctx: click.Context, error: UsageError, *, is_on_method: bool = False) -> None:
    """Say in an error which of the options that it is about, or may be, the file gives."""
    given = []
    for option in ctx.command.params:
        name = str(option.name)
        if ctx.get_parameter_source(name) is not ParameterSource.DEFAULT_MAP:
            continue
        key, value = key_of(option), ctx.params[name]
        is_named = re.search(rf"--{key}(?![\w-])", error.message)
        texts = value if isinstance(value, tuple) else (value,)
        is_quoted = any(repr(text) in error.message for text in texts if isinstance(text, str))
        if is_named or is_quoted or (is_on_method and name in BY_HAND):
            given.append(key)
    what = f" ({ctx.meta.get(_PATH)} gives "
    if given and what not in error.message:
        error.message += f"{what}{', '.join(given)})"


def is_from_found_file(ctx: click.Context, name: str) -> bool:
    """Whether the value of a parameter is from a file that was found, and not named by --config."""
    is_from_file = ctx.get_parameter_source(name) is ParameterSource.DEFAULT_MAP
    return is_from_file and bool(ctx.meta.get(_FOUND))
