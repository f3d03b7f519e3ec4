"""Annotations for GitHub: what failed, as commands that its runner reads from the log.

A command is one line, ``::error file=NAME,title=TITLE::MESSAGE``.  In the message per cent signs
and line ends are escaped, in the properties colons and commas too: nothing that a name or a reason
holds can end the line, add a property or begin a command of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msal_cli.job.display_names import escape_for_display
from msal_cli.job.records import MeshRecord
from msal_cli.report.phrases import failure_texts, file_name
from msal_cli.report.ranking import broken_gates, worst_first

MOST = 10
"""Annotations of a run: GitHub shows no more errors of one step."""


def commands(records: Sequence[MeshRecord], folder: str = "") -> list[str]:
    """The commands for the worst files that failed or broke a gate, at most ``MOST``.

    ``folder`` is where relative names begin, as a path from the root of the repository; empty if
    that is where the program runs.
    """
    messages = [
        (record, title, message)
        for record in worst_first(records)
        for title, message in _messages(record)
    ]
    return [
        f"::error {_properties(record.input, folder, title)}::{_message(message)}"
        for record, title, message in messages[:MOST]
    ]


def _messages(record: MeshRecord) -> Iterator[tuple[str, str]]:
    """The title and the message of a file, if it failed or broke a gate."""
    name = file_name(record.input)
    if record.error is not None:
        yield "msal: failed", "\n".join(failure_texts(name, record.error))
    elif gates := broken_gates(record):
        title = "msal: broken gate" if len(gates) == 1 else f"msal: {len(gates)} broken gates"
        yield title, "\n".join([f"{name}:", *map(escape_for_display, gates)])


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
