"""``msal completion``: the script that teaches a shell to complete msal's words."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from msal_cli.cli import console, exit_codes
from msal_cli.cli.command import command as grouped_command
from msal_cli.cli.main import COMPLETE_VARIABLE


@grouped_command(
    "completion",
    configurable=False,
    epilog="""\b
bash:  msal completion bash > ~/.local/share/bash-completion/completions/msal
zsh:   msal completion zsh > ~/.zfunc/_msal     (a folder of your fpath)
fish:  msal completion fish > ~/.config/fish/completions/msal.fish""",
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def command(context: click.Context, shell: str) -> int:
    """Print a script that completes commands, options, methods and file names in SHELL."""
    kind = get_completion_class(shell)
    if kind is None:
        raise click.UsageError(f"there is no completion for {shell}")
    console.put(kind(context.find_root().command, {}, "msal", COMPLETE_VARIABLE).source())
    return exit_codes.SUCCESS
