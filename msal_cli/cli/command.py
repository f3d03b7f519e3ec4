"""Commands whose help shows options in groups, the common ones or all, and which also take options
from a file.

The groups are data: help, man pages, the reference and shell completion are made from the same.

``msal.toml`` can give what the command line can give, and no more: options by their long names
without the dashes, in tables named like the commands.  The command line wins.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource, augment_usage_errors

from msal_cli.cli import console
from msal_cli.cli.options import BY_HAND, MESSAGES, OptionGroup, find_overruled, group
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

# Paragraphs of the docstring that the short help shows.
_PARAGRAPHS = 2
_MAX_DEFAULT_LENGTH = 20  # longer defaults are shown only by --help-all


_CONFIGURATION = group(
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
"""The options of every configurable command."""


class Request(SimpleNamespace):
    """The values of a command line by the names of its parameters, and the click ``context``."""


class Command(click.Command):
    """A command with groups of options, ``--help`` for the common ones and ``--help-all``.

    If ``configurable``, its options may come from a configuration file, too.
    """

    def __init__(
        self,
        function: Callable[[Request], int],
        name: str,
        groups: Sequence[OptionGroup],
        *,
        arguments: Sequence[click.Argument] = (),
        configurable: bool = True,
        examples: str = "",
        epilog: str = "Exit status: see msal --help.",
    ) -> None:
        self.configurable = configurable
        self.groups = list(groups)
        if not groups or groups[-1].title != MESSAGES:
            self.groups.append(OptionGroup(MESSAGES, (), ()))
        if configurable:
            self.groups.insert(-1, _CONFIGURATION)
        options = [option for group in self.groups for option in group.common + group.more]
        super().__init__(
            name,
            callback=function,
            params=[*arguments, *options],
            help=function.__doc__,
            epilog=f"\b\nExamples:{examples}\b\n{epilog}" if examples else epilog,
        )
        self._help_all = click.Option(
            ["--help-all"],
            is_flag=True,
            is_eager=True,
            expose_value=False,
            hidden=not self._has_more(),
            callback=_show_all,
            help="Show every option, in full, and exit.",
        )

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command with its ``Request`` and the log level that the options ask for."""
        assert self.callback is not None
        verbosity = -1 if ctx.params.get("quiet") else ctx.params.get("verbose", 0)
        with console.log_to_console(verbosity):
            try:
                return ctx.invoke(self.callback, Request(**ctx.params, context=ctx))
            except UsageError as error:
                name_file(ctx, error)
                raise

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command line, with values of a configuration file where it gives none."""
        if ctx.resilient_parsing or not self.configurable:
            return super().parse_args(ctx, args)
        # Click does not name the command where an option has no value.
        with augment_usage_errors(ctx):
            rest = _parse_with_file(ctx, args, super().parse_args)
        for parameter in self.params:
            given = ctx.params.get(str(parameter.name))
            values = given if isinstance(given, tuple) else (given,)
            # Such as a shell variable that is not set; -o '' would be the current folder.
            if "" in values:
                raise click.BadParameter("it is empty", ctx, parameter)
            # Click takes everything after the letter of -o=OUT as the value.
            for name in map(str, values if "-o" in parameter.opts else ()):
                if name.startswith("="):
                    reason = f"{name!r} begins with '=': write -o OUT, or ./{name} for this name"
                    raise click.BadParameter(reason, ctx, parameter)
        return rest

    def _has_more(self) -> bool:
        """Whether ``--help-all`` shows more than ``--help``."""
        n_paragraphs = str(self.help).count("\n\n") + 1
        return any(group.more for group in self.groups) or n_paragraphs > _PARAGRAPHS

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The parameters; ``--help-all`` comes last, after click's own ``--help``."""
        return [*super().get_params(ctx), self._help_all]

    def grouped_options(
        self, ctx: click.Context, *, everything: bool = True
    ) -> Iterator[tuple[str, list[click.Option]]]:
        """The title and the options of each group; without ``everything`` only the common ones."""
        for title, common, more in self.groups:
            options = [*common, *more] if everything else [*common]
            if title == MESSAGES:
                own = (self.get_help_option(ctx), self._help_all)
                options[len(common) : len(common)] = [
                    option for option in own if option is not None and not option.hidden
                ]
            if options:
                yield title, options

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The description of the command; two paragraphs of it without ``--help-all``."""
        text = self.help
        if not ctx.meta.get(_META):
            self.help = "\n\n".join(str(text).split("\n\n")[:_PARAGRAPHS])
        try:
            super().format_help_text(ctx, formatter)
        finally:
            self.help = text

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The groups: common options with their first clause, or all in full (``--help-all``)."""
        everything = bool(ctx.meta.get(_META))
        sections = [
            (title, [option.get_help_record(ctx) or ("", "") for option in options])
            for title, options in self.grouped_options(ctx, everything=everything)
        ]
        widths = [len(name) for _, rows in sections for name, _ in rows]
        width = max(n for n in widths if n <= 26)
        for title, rows in sections:
            with formatter.section(title):
                # All groups have columns of the same width.
                formatter.write_dl(
                    [
                        (name.ljust(width), text if everything else first_clause(text))
                        for name, text in rows
                    ],
                    col_max=width,
                )
        n_more = sum(len(group.more) for group in self.groups)
        if not everything and self._has_more():
            more = f"{n_more} more options" if n_more else "More"
            formatter.write_paragraph()
            formatter.write_text(f"{more}: {ctx.command_path} --help-all")

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Completions for a shell, with the first clause of an option's help."""
        items = super().shell_complete(ctx, incomplete)
        for item in items:
            item.help = first_clause(item.help) if item.help else item.help
        return items


_META = "msal_cli.help_all"


def _show_all(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        ctx.meta[_META] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


def first_clause(text: str) -> str:
    """An option's help up to the first full stop or semicolon, and a short default."""
    text = " ".join(text.split())
    words, bracket, default = text.partition(" [default: ")
    end = re.search(r"(?<![.\s])(?:\.(?= [A-Z0-9`'-])|;(?= ))", words)
    words = words[: end.start()] + "." if end else words
    is_short = bracket and len(default) <= _MAX_DEFAULT_LENGTH
    return f"{words}  [default: {default}" if is_short else words


def grouped_command(
    name: str, *groups: OptionGroup, **settings: Any
) -> Callable[[Callable[[Request], int]], Command]:
    """Make a command of a function; its docstring is the help, ``settings`` are of ``Command``."""
    return lambda function: Command(function, name, groups, **settings)


@grouped_command(
    "completion",
    arguments=[click.Argument(["shell"], type=click.Choice(["bash", "zsh", "fish"]))],
    configurable=False,
    epilog="""\b
bash:  msal completion bash > ~/.local/share/bash-completion/completions/msal
zsh:   msal completion zsh > ~/.zfunc/_msal     (a folder of your fpath)
fish:  msal completion fish > ~/.config/fish/completions/msal.fish""",
)
def completion(request: Request) -> int:
    """Print a script that completes commands, options, methods and file names in SHELL."""
    from click.shell_completion import get_completion_class

    from msal_cli.cli.main import COMPLETE_VARIABLE

    kind = get_completion_class(request.shell)
    assert kind is not None  # for each of the choices
    program = request.context.find_root().command
    console.put(kind(program, {}, "msal", COMPLETE_VARIABLE).source())
    return console.SUCCESS


# Values of options from a file

_FILE_NAME = "msal.toml"

# A file found in a folder of scans from elsewhere must not replace originals or other files, nor
# involve another machine: only a file that is named may do so.
_ONLY_NAMED = (
    *("in_place", "no_backup", "force", "engine", "scheduler", "scratch", "heatmap", "outputs"),
)
# Pictures, which replace earlier ones.
_OUTPUTS_ONLY_NAMED = (("view", "output"), ("sweep", "output"))

_MAX_BYTES = 1_000_000


def _find_file() -> str | None:
    """The nearest ``msal.toml``: in the current folder, or in a parent within its repository."""
    if os.path.isfile(_FILE_NAME):
        return _FILE_NAME
    here = Path(os.path.realpath(os.curdir))
    folders = [here, *here.parents]
    are_roots = [any((folder / mark).exists() for mark in (".git", ".hg")) for folder in folders]
    # Outside of a repository, parents may belong to anyone, such as /tmp.
    n_parents = are_roots.index(True) if True in are_roots else 0
    for folder in folders[1 : n_parents + 1]:
        if (folder / _FILE_NAME).is_file():
            return os.path.relpath(folder / _FILE_NAME)
    return None


def read_config(path: str, ctx: click.Context, *, is_named: bool) -> dict[str, Any]:
    """The values that a file, named by the user or found, gives for the command of ``ctx``: as a
    command line would have them, by the names of parameters."""
    root, command = ctx.find_root(), str(ctx.command.name)
    names = root.command.list_commands(root) if isinstance(root.command, click.Group) else [command]
    tables = _read_tables(path)
    for table, content in tables.items():
        if not isinstance(content, dict):
            is_command = table in names
            hint = f"[{table}] and options below it" if is_command else "it below [denoise], say"
            raise UsageError(f"{path}: {table} is not a table", hint=f"write {hint}")
        if table not in names:
            raise UsageError(
                f"{path}: there is no command for the table [{table}]",
                hint=_closest(table, names) or "tables are named as commands: [denoise]",
            )
    # Leave out --help and --help-all, whose names depend on the version of click.
    keys = {
        key_of(option): option
        for option in ctx.command.get_params(ctx)
        if isinstance(option, click.Option)
        and not option.is_eager
        and option.name not in ("config", "no_config")
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
            # Make paths relative to the current folder; URLs and - stay.
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
    """Convert a value of a file to what a command line would give."""
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
        # TOML allows NUL characters; the system ends every argument there.
        raise UsageError(f"{place} is {value!r}", hint="leave the character \\u0000 out")
    return str(value)


_FOUND, _PATH = "msal_cli.config_was_found", "msal_cli.config_path"


def _parse_with_file(
    ctx: click.Context, args: list[str], parse: Callable[[click.Context, list[str]], list[str]]
) -> list[str]:
    """Parse ``args`` with the values of the configuration file that they name, or that is found; if
    the command line contradicts some of these, parse again without them."""
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
    """Add to an error which of the options that it is about, or may be about, the file gives."""
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
    """Whether the value of a parameter is from a file that was found, not named by --config."""
    is_from_file = ctx.get_parameter_source(name) is ParameterSource.DEFAULT_MAP
    return is_from_file and bool(ctx.meta.get(_FOUND))
