"""The log on standard error: warnings, the steps with ``-v``, everything with ``-vv``."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from msal_cli.cli import console
from msal_cli.errors import MsalError
from msal_cli.job.display_names import escape_for_display

logger = logging.getLogger("msal")

_LEVELS = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO}
_TRACE = "Traceback (most recent call last)"


@contextmanager
def log_to_console(verbosity: int) -> Iterator[None]:
    """Send the log to standard error while the block runs.

    ``verbosity`` is -1 for errors only, 0 for warnings, 1 for the steps, 2 for everything, with
    times.
    """
    handler = _ConsoleHandler(verbosity)
    logger.setLevel(handler.level)
    logger.propagate = False
    logger.addHandler(handler)
    try:
        yield
    except (MsalError, click.ClickException, click.exceptions.Exit, BrokenPipeError):
        raise
    except Exception:
        # Only here is the handler still in place; ``main`` prints the one line for users.
        logger.exception("internal error")
        raise
    finally:
        logger.removeHandler(handler)


class _ConsoleHandler(logging.Handler):
    """Log records as lines on standard error."""

    def __init__(self, verbosity: int) -> None:
        super().__init__(_LEVELS.get(verbosity, logging.DEBUG))
        self._with_traces = verbosity > 0
        time = "%(asctime)s " if verbosity > 1 else ""
        self.setFormatter(_SafeFormatter(f"{time}msal: %(level)s: %(message)s"))

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        # The failure itself is reported with the file that it belongs to.
        if self._with_traces or _TRACE not in text:
            console.say(text)


class _SafeFormatter(logging.Formatter):
    """No name of a file breaks a line, reaches the terminal or makes an entry of its own."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - Python's name
        record.message = _escape(record.message)
        record.level = record.levelname.lower()
        return super().formatMessage(record)

    def formatException(self, ei: Any) -> str:  # noqa: N802 - Python's name
        return _escape(super().formatException(ei))


def _escape(text: str) -> str:
    # Traces, also those that workers send, are the only messages of several lines.
    lines = text.split("\n") if _TRACE in text else [text]
    return "\n".join(map(escape_for_display, lines))
