"""Make commands.md, the reference of all commands and options, from the program itself.

    python docs/make_command_page.py

It reads the commands as click knows them, with the groups that help shows.
"""

from __future__ import annotations

import re
from pathlib import Path

import click

from msal_cli.cli.main import COMMANDS, program

PAGE = Path(__file__).resolve().parent / "commands.md"

HEAD = """<!-- made by docs/make_command_page.py: change the options and run it again -->

# All commands and options

What each option does, its direction and its default; `--help-all` and the manual pages say more,
and [usage.md](usage.md) has examples. An option that means the same in several commands is
explained once. Every command has `--help`.

"""


def inline(text: str) -> str:
    """A text of help as Markdown, in one line; code is between backticks there, too."""
    parts = re.split(r"`([^`]+)`", " ".join(text.split()))
    for at, part in enumerate(parts):
        if at % 2:
            parts[at] = f"`{part}`"
        else:
            escaped = re.sub(r"([*_\\|]|<(?=[A-Za-z/!]))", r"\\\1", part)
            parts[at] = re.sub(
                r"(?<![\w-])(?:msal )?--[a-z][a-z-]*[a-z](?![\w=-])", r"`\g<0>`", escaped
            )
    return "".join(parts)


KEPT = ("More ", "Greater ", "Less ", "Repeatable", "It selects ", "A number selects ")
"""How sentences begin that are kept beside the first one of a help text."""


def shorten(text: str) -> str:
    """The first sentence of a help text, and those on directions."""
    text = " ".join(text.split())
    first, *others = re.split(r"(?<=[\w)%'`]\.) +(?=[A-Z`-])", text)
    return " ".join([first, *(sentence for sentence in others if sentence.startswith(KEPT))])


def line(option: click.Option, context: click.Context) -> str:
    """The line of an option in a list."""
    names, text = option.get_help_record(context) or ("", "")
    # click writes the default and the range behind the text.
    text, _, extra = text.partition("  [")
    parts = re.split(r"; |\] +\[", extra.removesuffix("]")) if extra else []
    allowed = [part for part in parts if re.search(r"x[<>]=?|[<>]=?x", part)]
    default = "; ".join(part for part in parts if part not in allowed).removeprefix("default: ")
    words = re.search(r" \[(\w[\w|-]*)\]$", names)
    if words and "|-" in words[1]:
        # Not to be taken for options.
        names = names[: words.start()] + " WORD"
        text += " WORD is one of " + words[1].replace("|", ", ") + "."
    elif words:
        names = f"{names[: words.start()]} {words[1]}"
    text = inline(shorten(text))
    if allowed:
        text += f" Allowed: `{allowed[0]}`."
    if default:
        text += f" *Default:* {default_text(default)}"
    return f"- {code(re.split(r', (?=-)', names))}: {text}\n"


def code(names: list[str]) -> str:
    """Names as code, with commas between them."""
    return ", ".join(f"`{name}`" for name in names)


def default_text(text: str) -> str:
    """A default: a value as code, or words that describe it, without what follows from them."""
    text = text.partition(", which ")[0]
    return inline(text) if " " in text else f"`{text}`"


def section(name: str, seen: set[str]) -> str:
    """All about one command but the options that are ``seen``, which it adds to."""
    top = click.Context(program, info_name="msal", terminal_width=1000, **program.context_settings)
    command = program.get_command(top, name)
    assert command is not None
    context = click.Context(command, info_name=name, parent=top, **command.context_settings)
    usage = command.get_usage(context).removeprefix("Usage: ")
    text = f"## msal {name}\n\n{COMMANDS[name]}\n\n```\n{usage}\n```\n\n"
    shared: list[str] = []
    for title, options in groups(command, context):
        found = {option.opts[-1]: line(option, context) for option in options}
        items = [item for item in found.values() if item not in seen]
        shared += [name for name, item in found.items() if item in seen and "--help" not in name]
        seen.update(items)
        if items:
            text += f"**{title}**\n\n{''.join(items)}\n"
    if shared:
        text += f"As above: {code(shared)}.\n\n"
    return text


def groups(command: click.Command, context: click.Context) -> list[tuple[str, list[click.Option]]]:
    """The options by the groups of help, or in one group where there are none."""
    if hasattr(command, "grouped_options"):
        return list(command.grouped_options(context))
    found = [one for one in command.get_params(context) if isinstance(one, click.Option)]
    return [("Options", [one for one in found if not one.hidden])]


def page() -> str:
    """The whole page."""
    seen: set[str] = set()
    return HEAD + "".join(section(name, seen) for name in COMMANDS).rstrip("\n") + "\n"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
