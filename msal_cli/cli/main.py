"""The command ``msal``: find the subcommand; turn errors into messages and an exit status."""

import atexit
import contextlib
import errno
import os
import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

import click
from click.exceptions import Exit

from msal_cli.batch import interrupts as signals
from msal_cli.cli import console
from msal_cli.errors import MsalError, OutputError, UsageError
from msal_cli.job.display_names import escape_for_display
from msal_cli.machine import is_out_of_memory
from msal_cli.version import __version__

COMPLETE_VARIABLE = "_MSAL_COMPLETE"
"""The environment variable through which a shell requests completions."""

COMMANDS = {
    "denoise": "Denoise files, folders or a stream.",
    "watch": "Denoise what arrives in a folder.",
    "info": "Report what is in mesh files.",
    "compare": "Measure a mesh against another.",
    "view": "Make a picture, or a page, of one or two meshes.",
    "sweep": "Try many values of two parameters on one mesh.",
    "noise": "Add known noise to meshes.",
    "methods": "List the methods, or explain one.",
    "report": "Report on earlier runs.",
    "completion": "Print the completion script of a shell.",
}
"""The line of help for each command, so that help need not import its module of this folder."""


class Msal(click.Group):
    """A group whose commands are modules of this folder, imported when they are needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        is_completion = cmd_name == "completion"
        module = import_module(f"msal_cli.cli.{'command' if is_completion else cmd_name}")
        command: click.Command = module.completion if is_completion else module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that the first argument names; an unknown one gets a suggestion."""
        name = args[0]
        if name not in COMMANDS and not name.startswith("-"):
            import difflib

            close = difflib.get_close_matches(name, COMMANDS, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            hint = "; msal denoise FILE -o OUT denoises a file" if os.path.exists(name) else hint
            ctx.fail(f"there is no command '{name}'{hint}")
        return super().resolve_command(ctx, args)

    def main(  # type: ignore[override]
        self, args: Sequence[str] | None = None, prog_name: str | None = None, **extra: Any
    ) -> NoReturn:
        arguments = tuple(sys.argv[1:] if args is None else args)
        if arguments[:1] == ("help",):
            arguments = (*arguments[1:2], "--help")
        with signals.end_on_signal():
            status = _flush(_status(self, arguments))
        sys.exit(status)


@click.group(
    cls=Msal,
    no_args_is_help=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="""\b
Examples:
  msal denoise scans -o denoised            a folder, into a mirrored tree
  msal denoise scan.ply -o smooth.ply -n 3  one file
  msal denoise - < in.ply > out.ply         a stream
  msal info scan.ply                        what is in a file
  msal report denoised -o night.csv         what earlier runs did
\b
Exit status: 0 done, 1 all failed or fatal, 2 wrong use, 3 some files failed,
4 a gate failed, 5 nothing matched, 130 and 143 interrupted.
Completion: see msal completion --help.""",
)
@click.version_option(__version__, prog_name="msal", message="%(prog)s %(version)s")
def program() -> None:
    """Denoise triangle meshes and keep everything else in their files."""


def main() -> NoReturn:
    """The entry point of the program ``msal``: run the command line and end the process."""
    try:
        program.main()
    except SystemExit as end:
        _end(end.code)
        raise


def _end(status: object) -> None:
    """End the process if nothing waits for it, without freeing modules and arrays one by one, which
    takes a tenth of the time of a small mesh."""
    # A debugger or a profiler prints something at the end.
    is_observed = sys.gettrace() is not None or sys.getprofile() is not None
    others = (thread for thread in threading.enumerate() if thread is not threading.main_thread())
    if not isinstance(status, int) or is_observed or any(not thread.daemon for thread in others):
        return
    # If a stream cannot be flushed, Python reports it.
    with contextlib.suppress(OSError, ValueError):
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        atexit._run_exitfuncs()
        os._exit(status)


def _status(group: Msal, arguments: tuple[str, ...]) -> int:
    try:
        if instruction := os.environ.get(COMPLETE_VARIABLE):
            from click.shell_completion import shell_complete

            return shell_complete(group, {}, "msal", COMPLETE_VARIABLE, instruction)
        context = group.make_context("msal", list(arguments), obj=arguments)
        with context:
            if not arguments:
                console.say(context.get_help())
                return console.USAGE
            return int(group.invoke(context) or console.SUCCESS)
    except Exit as finish:
        return finish.exit_code
    except click.UsageError as error:
        # Click lists choices on lines of their own.
        message = escape_for_display(error.format_message().replace("\n\t", " "))
        command = error.ctx.command_path if error.ctx is not None else "msal"
        console.say(f"msal: error: {message}", "bad")
        console.say(f"hint: {command} --help shows how it is used")
        return console.USAGE
    except click.ClickException as error:
        console.say(f"msal: error: {error.format_message()}", "bad")
        return console.FATAL
    except MsalError as error:
        console.say_error(error)
        if error.code == "E_NOTHING_MATCHED":
            return console.NOTHING_MATCHED
        return console.USAGE if isinstance(error, UsageError) else console.FATAL
    except KeyboardInterrupt as interrupt:
        console.say("msal: interrupted")
        return int(getattr(interrupt, "exit_status", console.INTERRUPTED))
    except BrokenPipeError:
        _abandon_output()
        return console.READER_GONE
    except Exception as error:
        if is_out_of_memory(error):
            words = "msal: error: not enough memory (E_MEMORY)"
        elif isinstance(error, FileNotFoundError) and error.filename is None:
            # os.getcwd fails without a name.
            words = "msal: error: the current folder does not exist any more (E_READ)"
        elif isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
            words = f"msal: error: the output cannot be written: {error.strerror} (E_WRITE)"
        else:
            what = escape_for_display(f"{type(error).__name__}: {error}")
            words = f"msal: internal error: {what}; please report it (-v shows where)"
        console.say(words, "bad")
        return console.FATAL


def _flush(status: int) -> int:
    """``status``, or another one if standard output cannot be delivered."""
    try:
        console.flush()
    except BrokenPipeError:
        _abandon_output()
        return console.worst_status(status, console.READER_GONE)
    except OutputError as error:
        if status == console.SUCCESS:
            console.say_error(error)
        _abandon_output()
        return console.worst_status(status, console.FATAL)
    return status


def _abandon_output() -> None:
    """Redirect standard output to nothing, so that Python does not try to flush it at the end."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stdout.fileno())
        os.close(nothing)
