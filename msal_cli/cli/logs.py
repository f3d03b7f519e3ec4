"""Where the log goes: warnings to standard error, more of it with ``-v``, all of it to a file."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

import click

from msal_cli.cli import console
from msal_cli.errors import MsalError, UsageError
from msal_cli.job.display_names import escape_for_display

logger = logging.getLogger("msal")

_TRACE = "Traceback (most recent call last)"


@contextmanager
def log_to_console(verbosity: int, log_file: str | None = None) -> Iterator[None]:
    """Send the log where it is wanted while the block runs.

    ``verbosity`` is -1 for errors only, 0 for warnings, 1 for the steps, 2 for everything.
    ``log_file`` is appended to and gets everything.
    """
    handlers: list[logging.Handler] = [_ConsoleHandler(verbosity)]
    if log_file is not None:
        handlers.append(_FileHandler(log_file))
    logger.setLevel(min(handler.level for handler in handlers))
    logger.propagate = False
    for handler in handlers:
        logger.addHandler(handler)
    try:
        yield
    except (MsalError, click.ClickException, click.exceptions.Exit, BrokenPipeError):
        raise
    except Exception:
        # Only here are the handlers still in place; ``main`` prints the one line for users.
        logger.exception("internal error")
        raise
    finally:
        for handler in handlers:
            logger.removeHandler(handler)
            handler.close()


def with_log(function: Callable[[Any], int]) -> Callable[[Any], int]:
    """A command that sends the log to the console and to the file of ``--log-file``, if it has
    these options, as much of it as ``-v`` or ``-q`` asks for."""

    @functools.wraps(function)
    def run(request: Any) -> int:
        given = vars(request)
        verbosity = -1 if given.get("quiet") else request.verbose
        with log_to_console(verbosity, given.get("log_file")):
            return function(request)

    return run


class _ConsoleHandler(logging.Handler):
    """Log records as lines on standard error."""

    def __init__(self, verbosity: int) -> None:
        levels = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO}
        super().__init__(levels.get(verbosity, logging.DEBUG))
        self._with_traces = verbosity > 0
        self.setFormatter(_SafeFormatter())

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        # The failure itself is reported with the file that it belongs to.
        if self._with_traces or _TRACE not in text:
            console.say(f"msal: {record.levelname.lower()}: {text}")


class _FileHandler(logging.StreamHandler[TextIO]):
    """All log records in a file that is appended to; UsageError if it cannot be opened."""

    def __init__(self, name: str) -> None:
        from msal_cli.cli.report_files import open_log

        try:
            super().__init__(open_log(name))
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise UsageError(f"the log file {name!r} cannot be opened: {why}") from None
        columns = "%(asctime)s %(process)d %(levelname)s %(name)s: %(message)s"
        self.setFormatter(_SafeFormatter(columns))
        self.setLevel(logging.DEBUG)

    def close(self) -> None:
        super().close()
        self.stream.close()


class _SafeFormatter(logging.Formatter):
    """No name of a file breaks a line, reaches the terminal or makes an entry of its own."""

    def format(self, record: logging.LogRecord) -> str:
        # Another handler may have left its own words for the exception here.
        record.exc_text = None
        return super().format(record)

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - Python's name
        record.message = _escape(record.message)
        return super().formatMessage(record)

    def formatException(self, ei: Any) -> str:  # noqa: N802 - Python's name
        return _escape(super().formatException(ei))


def _escape(text: str) -> str:
    # Traces, also those that workers send, are the only messages of several lines.
    lines = text.split("\n") if _TRACE in text else [text]
    return "\n".join(map(escape_for_display, lines))
