"""Options of a command from ``msal.toml`` where the command line gives none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import click
from click.core import ParameterSource

from msal_cli.cli import config_file, console
from msal_cli.cli.config_file import CONFIG, NO_CONFIG, SHOW_CONFIG, Config
from msal_cli.errors import UsageError

_META = "msal_cli.config"

Parse = Callable[[click.Context, list[str]], list[str]]


def make_options() -> list[click.Option]:
    """The options of every command that may be configured."""
    return [
        click.Option(
            ["--config"],
            metavar="FILE",
            expose_value=False,
            help="Take options from FILE.  [default: msal.toml in the current folder, or in a "
            "parent within the repository]",
        ),
        click.Option(
            ["--no-config"], is_flag=True, expose_value=False, help="Read no configuration file."
        ),
        click.Option(
            ["--show-config"],
            is_flag=True,
            expose_value=False,
            help="Print the options that are in force, and where each comes from, and exit.",
        ),
    ]


def parse_args(
    command: click.Command, ctx: click.Context, args: list[str], parse: Parse
) -> list[str]:
    """Parse ``args`` with the values of the file that they name, or that is found.

    Raises
    ------
    UsageError
        if the file has what the command does not know, or cannot be read.
    """
    given, _, _ = command.make_parser(ctx).parse_args(list(args))
    help_option = command.get_help_option(ctx)
    if "help_all" in given or (help_option is not None and help_option.name in given):
        return parse(ctx, args)
    config = _load(command, ctx, given)
    if SHOW_CONFIG in given:
        _parse_whole(command, ctx, list(args), config, parse)
        rows = list(_rows(command, ctx, given, config))
        console.put(config_file.describe(str(command.name), rows, config))
        ctx.exit()
    ctx.meta[_META] = config
    if config is None:
        return parse(ctx, args)
    return _parse_with(command, ctx, args, config, parse)


def options_of_found_file(ctx: click.Context) -> frozenset[str]:
    """The parameters whose values are from a file that was found, and not named by --config."""
    config: Config | None = ctx.meta.get(_META)
    if config is None or config.is_named:
        return frozenset()
    return frozenset(
        name
        for name in config.values
        if ctx.get_parameter_source(name) is ParameterSource.DEFAULT_MAP
    )


def _load(command: click.Command, ctx: click.Context, given: dict[str, Any]) -> Config | None:
    path: str | None = given.get(CONFIG)
    if NO_CONFIG in given:
        if path is not None:
            raise UsageError(
                "--config and --no-config contradict each other", hint="give one of them"
            )
        return None
    is_named = path is not None
    path = path or config_file.find_file()
    if path is None:
        return None
    root = ctx.find_root()
    commands = root.command.list_commands(root) if isinstance(root.command, click.Group) else ()
    options = [one for one in command.get_params(ctx) if isinstance(one, click.Option)]
    name = str(command.name)
    return config_file.read_config(path, name, commands or (name,), options, is_named=is_named)


def _parse_with(
    command: click.Command, ctx: click.Context, args: list[str], config: Config, parse: Parse
) -> list[str]:
    """Parse twice: the second time without what contradicts the command line."""
    # The tables of conflicts are needed only where there is a file.
    from msal_cli.cli.conflicts import find_overruled

    ctx.default_map = dict(config.values)
    words = list(args)
    try:
        rest = parse(ctx, args)
    except click.BadParameter as error:
        option = error.param
        source = ctx.get_parameter_source(str(option.name)) if option is not None else None
        if source is not ParameterSource.DEFAULT_MAP or not isinstance(option, click.Option):
            raise
        place = f"{config.path}: [{command.name}] {config_file.key_of(option)}"
        raise UsageError(f"{place}: {error.message}".replace("\n\t", " ")) from None
    if not (overruled := find_overruled(ctx)):
        return rest
    ctx.default_map = {k: v for k, v in config.values.items() if k not in overruled}
    ctx.params.clear()
    return parse(ctx, words)


def _parse_whole(
    command: click.Command,
    ctx: click.Context,
    words: list[str],
    config: Config | None,
    parse: Parse,
) -> None:
    """Parse what may lack inputs or an output: something stands for them."""
    for _ in command.params:
        ctx.params.clear()
        try:
            if config is None:
                parse(ctx, list(words))
            else:
                _parse_with(command, ctx, list(words), config, parse)
            return
        except click.MissingParameter as missing:
            is_argument = isinstance(missing.param, click.Argument)
            option = missing.param.opts[0] if missing.param is not None else ""
            words = [*words, "MISSING"] if is_argument else [option, "MISSING", *words]


def _rows(
    command: click.Command, ctx: click.Context, given: dict[str, Any], config: Config | None
) -> Iterator[tuple[click.Option, Any, str]]:
    """The options in force: each with its value, and where that comes from."""
    hidden = (CONFIG, NO_CONFIG, SHOW_CONFIG)
    for option in command.params:
        name = str(option.name)
        if not isinstance(option, click.Option) or option.is_eager or name in hidden:
            continue
        in_force = ctx.default_map or {}
        if name in given:
            yield option, given[name], "command line"
        elif config is not None and name in in_force:
            yield option, in_force[name], config.path
        elif isinstance(option.default, str | int | float) and not (
            option.default is False or option.count
        ):
            yield option, option.default, "default"
