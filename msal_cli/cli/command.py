"""Commands whose help shows their options in groups: those that most people need, or all.

The groups are data: help, the man pages, the reference and shell completion read the same.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import click
from click.core import augment_usage_errors

from msal_cli.cli import config, console
from msal_cli.cli.options import MESSAGES, OptionGroup
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

_MAX_NAME_WIDTH = 26
# Of what a command does, in the short help.
_PARAGRAPHS = 2
# Longer ones are left to --help-all.
_MAX_DEFAULT_LENGTH = 20


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
            self.groups.insert(-1, config.OPTIONS)
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
        """Run the command with its ``Request``, as much of the log shown as it asks for."""
        assert self.callback is not None
        verbosity = -1 if ctx.params.get("quiet") else ctx.params.get("verbose", 0)
        with console.log_to_console(verbosity):
            try:
                return ctx.invoke(self.callback, Request(**ctx.params, context=ctx))
            except UsageError as error:
                config.name_file(ctx, error)
                raise

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command line, with values of a configuration file where it gives none."""
        if ctx.resilient_parsing or not self.configurable:
            return super().parse_args(ctx, args)
        # Click leaves out the command where an option has no value.
        with augment_usage_errors(ctx):
            rest = config.parse_args(ctx, args, super().parse_args)
        for parameter in self.params:
            value = ctx.params.get(str(parameter.name))
            # As of a variable of the shell that is not set; -o '' would be the current folder.
            if value == "" or (isinstance(value, tuple) and "" in value):
                raise click.BadParameter("it is empty", ctx, parameter)
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
        """The title and the options of each group, or only those that most people need."""
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
        """What the command does; without ``--help-all`` two paragraphs of it."""
        text = self.help
        if not ctx.meta.get(_META):
            self.help = "\n\n".join(str(text).split("\n\n")[:_PARAGRAPHS])
        try:
            super().format_help_text(ctx, formatter)
        finally:
            self.help = text

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The groups: of common options the first clause, with ``--help-all`` all there is."""
        everything = bool(ctx.meta.get(_META))
        sections = [
            (title, [option.get_help_record(ctx) or ("", "") for option in options])
            for title, options in self.grouped_options(ctx, everything=everything)
        ]
        widths = [len(name) for _, rows in sections for name, _ in rows]
        width = max(n for n in widths if n <= _MAX_NAME_WIDTH)
        for title, rows in sections:
            with formatter.section(title):
                # As wide as in the other groups.
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
        """What a shell may complete; of an option's help the first clause."""
        found = super().shell_complete(ctx, incomplete)
        for item in found:
            item.help = first_clause(item.help) if item.help else item.help
        return found


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
    """Make a command of a function, whose docstring is the help; ``settings`` as of ``Command``."""
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
    if kind is None:
        raise click.UsageError(f"there is no completion for {request.shell}")
    program = request.context.find_root().command
    console.put(kind(program, {}, "msal", COMPLETE_VARIABLE).source())
    return console.SUCCESS
