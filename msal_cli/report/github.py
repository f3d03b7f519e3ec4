"""Annotations for GitHub: what failed, as commands that its runner reads from the log.

A command is one line, ``::error file=NAME,title=TITLE::MESSAGE``.  In the message per cent signs
and line ends are escaped, in the properties colons and commas too: nothing that a name or a reason
holds can end the line, add a property or begin a command of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

from msal_cli.job.display_names import escape_for_display
from msal_cli.job.records import MeshRecord
from msal_cli.report.facts import problem_texts, worst_first

MAX_ANNOTATIONS = 10
"""GitHub shows no more errors of one step."""


def list_annotations(records: Sequence[MeshRecord], folder: str = "") -> list[str]:
    """The commands for the worst files that failed or broke a gate.

    ``folder`` is where relative names begin, as a path from the root of the repository; empty if
    that is where the program runs.
    """
    commands = []
    for record in worst_first(records):
        if texts := problem_texts(record):
            n_gates = len(texts) - 1
            title = "broken gate" if n_gates == 1 else f"{n_gates} broken gates"
            title = "failed" if record.error is not None else title
            properties = _properties(record.input, folder, f"msal: {title}")
            message = _message("\n".join(map(escape_for_display, texts)))
            commands.append(f"::error {properties}::{message}")
    return commands[:MAX_ANNOTATIONS]


def _properties(name: str, folder: str, title: str) -> str:
    properties = f"title={_property(title)}"
    if name == "-" or "://" in name:
        return properties
    if folder and not name.startswith("/"):
        name = f"{folder.rstrip('/')}/{name}"
    # Marks that a terminal obeys are escaped: better a name that leads nowhere.
    return f"file={_property(escape_for_display(name))},{properties}"


def _message(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _message(text).replace(":", "%3A").replace(",", "%2C")
