"""Commands whose help shows their options in groups: those that most people need, or all.

The groups are data: help, the man pages, the reference and shell completion read the same.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from msal_cli.cli import config, console

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

Decorator = Callable[[Any], Any]

_ATTRIBUTE = "option_groups"
_MAX_NAME_WIDTH = 26
# Of what a command does, in the short help.
_PARAGRAPHS = 2
# Longer ones are left to --help-all.
_MAX_DEFAULT_LENGTH = 20

MESSAGES = "Messages and help"
"""The group that ``-h`` and ``--help-all`` belong to."""


class OptionGroup(NamedTuple):
    """Options that help shows together, by the names of their parameters.

    ``common`` are those that most people need; ``more`` are shown by ``--help-all`` only.
    """

    title: str
    common: tuple[str, ...]
    more: tuple[str, ...]


def _more(function: Any) -> Any:
    return function


MORE: Decorator = _more
"""In a group: the options behind it are shown by ``--help-all`` only."""


def group(title: str, *options: Decorator) -> Decorator:
    """A decorator for the options of one group; each is a decorator as ``click.option`` makes."""

    def decorate(function: Any) -> Any:
        n_before = n_more = len(_parameters(function))
        # The last option first: click shows them in the order in which they are read.
        for option in reversed(options):
            function = option(function)
            if option is MORE:
                n_more = len(_parameters(function))
        names = [str(parameter.name) for parameter in _parameters(function)]
        added = OptionGroup(
            title, tuple(reversed(names[n_more:])), tuple(reversed(names[n_before:n_more]))
        )
        # A new tuple, because wrapped functions share the attributes of what they wrap.
        setattr(function, _ATTRIBUTE, (added, *getattr(function, _ATTRIBUTE, ())))
        return function

    return decorate


def _parameters(function: Any) -> list[click.Parameter]:
    # Where click keeps what decorates a function that is no command yet.
    kept: list[click.Parameter] = getattr(function, "__click_params__", [])
    return kept


class Command(click.Command):
    """A command with groups of options, ``--help`` for the common ones and ``--help-all``.

    If ``configurable``, its options may come from a configuration file, too.
    """

    def __init__(self, *given: Any, configurable: bool = True, **settings: Any) -> None:
        super().__init__(*given, **settings)
        self.configurable = configurable
        groups: list[OptionGroup] = list(getattr(self.callback, _ATTRIBUTE, ()))
        if configurable:
            options = config.make_options()
            self.params += options
            names = tuple(str(option.name) for option in options)
            groups.append(OptionGroup("Configuration", (), names))
        everything = _help_all()
        self.params.append(everything)
        at = next((k for k, group in enumerate(groups) if group.title == MESSAGES), None)
        own = OptionGroup(MESSAGES, (), ()) if at is None else groups.pop(at)
        self.groups = (*groups, own._replace(common=(*own.common, "help", "help_all")))
        everything.hidden = not self._has_more()

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command line, with values of a configuration file where it gives none."""
        if ctx.resilient_parsing or not self.configurable:
            return super().parse_args(ctx, args)
        return config.parse_args(self, ctx, args, super().parse_args)

    def _has_more(self) -> bool:
        """Whether ``--help-all`` shows more than ``--help``."""
        n_paragraphs = str(self.help).count("\n\n") + 1
        return any(group.more for group in self.groups) or n_paragraphs > _PARAGRAPHS

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The parameters; ``--help-all`` comes last, after click's own ``--help``."""
        found = super().get_params(ctx)
        return sorted(found, key=lambda parameter: parameter.name == "help_all")

    def grouped_options(
        self, ctx: click.Context, *, everything: bool = True
    ) -> Iterator[tuple[str, list[click.Option]]]:
        """The title and the options of each group, or only those that most people need."""
        options = {
            # The name of click's own option depends on its version.
            "help" if parameter is self.get_help_option(ctx) else parameter.name: parameter
            for parameter in self.get_params(ctx)
            if isinstance(parameter, click.Option) and not parameter.hidden
        }
        for title, common, more in self.groups:
            names = common + more if everything else common
            if names:
                yield title, [options[name] for name in names if name in options]

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
            (title, [_record(option, ctx, everything=everything) for option in options])
            for title, options in self.grouped_options(ctx, everything=everything)
        ]
        widths = [len(name) for _, rows in sections for name, _ in rows]
        width = max(n for n in widths if n <= _MAX_NAME_WIDTH)
        for title, rows in sections:
            with formatter.section(title):
                # As wide as in the other groups.
                formatter.write_dl(
                    [(name.ljust(width), text) for name, text in rows], col_max=width
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


def _help_all() -> click.Option:
    def show(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
        if value and not ctx.resilient_parsing:
            ctx.meta[_META] = True
            click.echo(ctx.get_help(), color=ctx.color)
            ctx.exit()

    return click.Option(
        ["--help-all"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=show,
        help="Show every option, in full, and exit.",
    )


def _record(option: click.Option, ctx: click.Context, *, everything: bool) -> tuple[str, str]:
    """What help shows of an option: its names and its text."""
    names, text = option.get_help_record(ctx) or ("", "")
    return names, text if everything else first_clause(text)


def first_clause(text: str) -> str:
    """An option's help up to the first full stop or semicolon, and a short default."""
    text = " ".join(text.split())
    words, bracket, default = text.partition(" [default: ")
    end = re.search(r"(?<![.\s])(?:\.(?= [A-Z0-9`'-])|;(?= ))", words)
    words = words[: end.start()] + "." if end else words
    is_short = bracket and len(default) <= _MAX_DEFAULT_LENGTH
    return f"{words}  [default: {default}" if is_short else words


def command(name: str, **settings: Any) -> Callable[[Callable[..., Any]], Command]:
    """``click.command`` with the groups of its options."""
    return click.command(name, cls=Command, **settings)


@command(
    "completion",
    configurable=False,
    epilog="""\b
bash:  msal completion bash > ~/.local/share/bash-completion/completions/msal
zsh:   msal completion zsh > ~/.zfunc/_msal     (a folder of your fpath)
fish:  msal completion fish > ~/.config/fish/completions/msal.fish""",
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> int:
    """Print a script that completes commands, options, methods and file names in SHELL."""
    from click.shell_completion import get_completion_class

    from msal_cli.cli.main import COMPLETE_VARIABLE

    kind = get_completion_class(shell)
    if kind is None:
        raise click.UsageError(f"there is no completion for {shell}")
    console.put(kind(context.find_root().command, {}, "msal", COMPLETE_VARIABLE).source())
    return console.SUCCESS
