"""The man pages in ``man/``, made from the options of the commands and their groups.

    python docs/make_man_pages.py

``msal.1`` and a page for each command, such as ``msal-denoise.1``.  A wheel installs them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import click

from msal_cli.cli import console
from msal_cli.cli.command import Command
from msal_cli.cli.main import COMMANDS, program

FOLDER = Path(__file__).resolve().parent / "man"


def pages() -> dict[str, str]:
    """All pages by file name."""
    root = click.Context(program, info_name="msal", help_option_names=["-h", "--help"])
    made = {"msal.1": "\n".join(program_page(root)) + "\n"}
    for name, summary in COMMANDS.items():
        command = program.get_command(root, name)
        assert isinstance(command, Command)
        context = click.Context(command, root, info_name=name)
        made[f"msal-{name}.1"] = "\n".join(command_page(command, context, summary)) + "\n"
    return made


def committed() -> dict[str, str]:
    """The pages in ``man/`` as they are."""
    return {path.name: path.read_text("utf-8") for path in FOLDER.glob("*.1")}


def program_page(context: click.Context) -> Iterator[str]:
    """The lines of ``msal.1``."""
    yield from title("msal", str(program.help))
    yield ".SH SYNOPSIS"
    yield rf".B {escape('msal')}"
    yield escape("COMMAND [OPTIONS] ...")
    yield ".SH COMMANDS"
    for name, summary in COMMANDS.items():
        yield ".TP"
        yield rf"\fB{escape(f'msal-{name}')}\fR(1)"
        yield escape(summary)
    yield ".SH OPTIONS"
    for option in program.get_params(context):
        yield from describe_option(option, context)
    yield ".SH EXIT STATUS"
    yield from exit_statuses()
    yield from files_and_variables()
    yield ".SH SEE ALSO"
    yield from references([f"msal-{name}" for name in COMMANDS])


def command_page(command: Command, context: click.Context, summary: str) -> Iterator[str]:
    """The lines of the page of a command."""
    yield from title(f"msal-{command.name}", summary)
    yield ".SH SYNOPSIS"
    yield rf".B {escape(context.command_path)}"
    yield escape(" ".join(command.collect_usage_pieces(context)))
    yield ".SH DESCRIPTION"
    for number, paragraph in enumerate(str(command.help).split("\n\n")):
        if number:
            yield ".PP"
        yield escape(" ".join(paragraph.split()))
    yield ".SH OPTIONS"
    for group, options in command.grouped_options(context):
        yield f".SS {escape(group)}"
        for option in options:
            yield from describe_option(option, context)
    examples = [line for line in (command.epilog or "").splitlines() if line.startswith("  ")]
    if examples:
        yield ".SH EXAMPLES"
        yield ".nf"
        yield from map(escape, examples)
        yield ".fi"
    yield ".SH SEE ALSO"
    yield from references(["msal", *(f"msal-{name}" for name in COMMANDS if name != command.name)])


def title(name: str, summary: str) -> Iterator[str]:
    """The head of a page; without version or date, which would change every page."""
    yield rf'.TH {escape(name.upper())} 1 "" "msal" "User commands"'
    yield ".SH NAME"
    yield rf"{escape(name)} \- {escape(summary.rstrip('.'))}"


def describe_option(option: click.Parameter, context: click.Context) -> Iterator[str]:
    """An option with its names in bold, what it takes in italics, and its text."""
    names, text = option.get_help_record(context) or ("", "")
    words = re.split(r"((?<![\w-])--?[A-Za-z][\w-]*)", names)
    marked = "".join(
        rf"\fB{escape(word)}\fR"
        if at % 2
        else re.sub(r"[^\s,/]+", lambda value: rf"\fI{escape(value[0])}\fR", word)
        for at, word in enumerate(words)
    )
    yield ".TP"
    yield marked
    yield escape(" ".join(text.split()))


def exit_statuses() -> Iterator[str]:
    """The statuses of the table in ``console``."""
    rows = re.findall(r"^\| ([^|]+?) \| (.+?) \|$", str(console.__doc__), re.M | re.S)
    for status, meaning in rows:
        yield ".TP"
        yield rf"\fB{escape(status)}\fR"
        yield escape(" ".join(meaning.replace("`", "").split()))


def files_and_variables() -> Iterator[str]:
    """What the program reads beside the command line."""
    yield ".SH FILES"
    yield ".TP"
    yield r"\fImsal.toml\fR"
    yield "Options of a project, by tables that are named as the commands."
    yield ".SH ENVIRONMENT"
    for name, text in (
        ("MSAL_THREADS", "Most threads for one mesh."),
        ("NO_COLOR", "If set, no colours are printed."),
    ):
        yield ".TP"
        yield rf"\fB{escape(name)}\fR"
        yield escape(text)


def references(names: list[str]) -> Iterator[str]:
    """Other pages."""
    for at, name in enumerate(names):
        comma = "," if at < len(names) - 1 else ""
        yield rf".BR {escape(name)} (1){comma}"


def escape(text: str) -> str:
    """Plain text as roff: nothing in it is a request, and hyphens can be copied as they are."""
    text = text.replace("\\", r"\e").replace("-", r"\-").replace("'", r"\(aq").replace("`", r"\(ga")
    text = text.replace("^", r"\(ha").replace("~", r"\(ti")
    return r"\&" + text if text.startswith((".", "'")) else text


def main() -> None:
    """Write the pages that changed, and remove those of commands that are gone."""
    FOLDER.mkdir(exist_ok=True)
    made, before = pages(), committed()
    for name in before.keys() - made.keys():
        (FOLDER / name).unlink()
    for name, text in made.items():
        if before.get(name) != text:
            (FOLDER / name).write_text(text, encoding="utf-8", newline="\n")
            print(f"wrote docs/man/{name}")


if __name__ == "__main__":
    main()
