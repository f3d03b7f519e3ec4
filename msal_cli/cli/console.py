"""What msal prints: data to standard output, messages and the log to standard error; and its exit
statuses.

| 0 | every selected file is written or up to date |
| 1 | fatal: the only file failed, all failed, given up after --max-failures, the output cannot be
      written, an internal error |
| 2 | wrong use or configuration; nothing was touched |
| 3 | some files failed; the others are written and valid |
| 4 | all were processed, but a gate failed |
| 5 | nothing matched |
| 128 + n | ended by signal n: 130 for Ctrl-C, 143 for SIGTERM; finished files are whole |
| 141 | the reader of standard output went away, as `| head` does; no message |

2 and 5 come before any work.  After it, of several that apply, a signal wins over 1, then 3, then
4, then 0; of folders that are compared, a file without a partner (3) does not hide 4.
"""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING, Any, TextIO

import click

from msal_cli.errors import MsalError, OutputError, UsageError
from msal_cli.job.display_names import escape_for_display
from msal_cli.version import __version__

if TYPE_CHECKING:
    from msal_cli.job.records import Failure, MeshRecord, Run
    from msal_cli.report.facts import Line

_STYLES: dict[str, dict[str, Any]] = {
    "good": {"fg": "green"},
    "bad": {"fg": "red"},
    "faint": {"dim": True},
}


def say(text: str, tone: str = "plain") -> None:
    """Print a line to standard error, above a progress bar if there is one."""
    stream, bars = sys.stderr, sys.modules.get("tqdm")
    if stream is None:
        return
    text = _colour(text, tone, stream)
    bar = bars.tqdm.external_write_mode(file=stream) if bars else nullcontext()
    # If the terminal is gone, that cannot be reported either.
    with bar, suppress(OSError, ValueError):
        stream.write(text + "\n")
        stream.flush()


def say_lines(lines: Iterable[Line]) -> None:
    """Print lines to standard error, with colours if they are wanted."""
    for line in lines:
        say(line.text, line.tone)


def say_error(error: MsalError) -> None:
    """Print an error, ``msal: error: scan.ply: vertex 17: ... (E_NONFINITE)``, and its hint."""
    from msal_cli.report.facts import failure_text, file_name

    words = failure_text(error, with_code=error.code != "E_USAGE")
    # Most messages about paths name the path themselves.
    if error.path and repr(error.path) not in error.message:
        words = f"{file_name(error.path)}: {words}"
    _say_error_words(words, error.hint)


def say_failure(name: str, failure: Failure) -> None:
    from msal_cli.report.facts import failure_text, file_name

    _say_error_words(f"{file_name(name)}: {failure_text(failure)}", failure.hint)


def _say_error_words(words: str, hint: str) -> None:
    say(f"msal: error: {escape_for_display(words)}", "bad")
    if hint:
        say(f"hint: {escape_for_display(hint)}")


def say_written(path: str) -> None:
    say(f"wrote {escape_for_display(path)}", "good")


def say_summary(run: Run, records: Sequence[MeshRecord], *, verbose: bool) -> None:
    """Print the summary of a run to standard error; for a single file with the parameters that
    differ from the defaults of its method, if this version of msal has that method."""
    from msal_cli import methods
    from msal_cli.report import text

    defaults: dict[str, Any] = {}
    if len(records) == 1 and records[0].method is not None:
        with suppress(UsageError):
            defaults = methods.find(records[0].method.name).validate({})
    columns = width(sys.stderr)
    say_lines(text.summary(run, records, width=columns, verbose=verbose, defaults=defaults))


def put(text: str) -> None:
    """Write text to standard output; characters that its encoding lacks are escaped.

    Raises OutputError if it is closed or its disk is full, BrokenPipeError if its reader is gone.
    """
    with _open_output() as stream:
        encoding = stream.encoding or "ascii"
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))


def put_lines(lines: Iterable[Line]) -> None:
    """Write lines to standard output, in colours if it is a terminal and they are wanted."""
    for line in lines:
        put(_colour(line.text, line.tone, sys.stdout) + "\n")


def put_bytes(data: bytes | bytearray | memoryview) -> None:
    """Write bytes to standard output, unbuffered; raises as ``put`` does."""
    rest = memoryview(data).cast("B")
    with _open_output() as stream:
        stream.flush()
        while len(rest):
            # With PYTHONUNBUFFERED this is a raw stream, which may write only a part: less than
            # 2 GB at once, and no more than a pipe has room for.
            taken = stream.buffer.write(rest)
            if not taken:
                # A non-blocking stream has no room now.
                time.sleep(0.01)
            rest = rest[taken or 0 :]
        stream.buffer.flush()


def put_json(schema: str, **data: Any) -> None:
    """Write a JSON document to standard output: schema, version of msal, and plain ``data``."""
    from msal_cli.report.data import json_bytes, plain

    put_bytes(json_bytes(plain({"schema": schema, "version": __version__, **data})))


def flush() -> None:
    """Flush standard output; raises as ``put`` does."""
    if sys.stdout is not None:
        with _open_output() as stream:
            stream.flush()


@contextmanager
def _open_output() -> Iterator[TextIO]:
    """Standard output; OutputError if it cannot be written, but a BrokenPipeError stays."""
    if sys.stdout is None:
        raise OutputError("standard output is closed", hint="redirect it, or name a file")
    try:
        yield sys.stdout
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(f"standard output cannot be written: {error.strerror}") from None


def width(stream: TextIO | None) -> int:
    """Columns for a table on ``stream``; unlimited if it is no terminal, because names are cut for
    people and never in a log."""
    import shutil

    if not is_terminal(stream):
        return sys.maxsize
    return max(60, shutil.get_terminal_size((100, 24)).columns)


def is_terminal(stream: TextIO | None) -> bool:
    try:
        return stream is not None and stream.isatty()
    except ValueError:
        return False


def _colour(text: str, tone: str, stream: TextIO | None) -> str:
    is_plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    if tone not in _STYLES or is_plain or not is_terminal(stream):
        return text
    return click.style(text, **_STYLES[tone])


# The log: warnings, the steps with -v, everything with -vv

_logger = logging.getLogger("msal")
_LEVELS = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO}
_TRACE = "Traceback (most recent call last)"


@contextmanager
def log_to_console(verbosity: int) -> Iterator[None]:
    """Send the log to standard error while the block runs.

    ``verbosity`` is -1 for errors only, 0 for warnings, 1 for steps, 2 for everything, with times.
    """
    handler = _ConsoleHandler(verbosity)
    _logger.setLevel(handler.level)
    _logger.propagate = False
    _logger.addHandler(handler)
    try:
        yield
    except (MsalError, click.ClickException, click.exceptions.Exit, BrokenPipeError):
        raise
    except Exception:
        # The handler is gone when ``main`` prints its one line for users.
        _logger.exception("internal error")
        raise
    finally:
        _logger.removeHandler(handler)


class _ConsoleHandler(logging.Handler):
    """Log records as lines on standard error; the name of a file cannot break a line, control the
    terminal or look like another entry."""

    def __init__(self, verbosity: int) -> None:
        super().__init__(_LEVELS.get(verbosity, logging.DEBUG))
        self._verbosity = verbosity

    def emit(self, record: logging.LogRecord) -> None:
        formatter = logging.Formatter()
        text = f"msal: {record.levelname.lower()}: {_escape(record.getMessage())}"
        if self._verbosity > 1:
            text = f"{formatter.formatTime(record)} {text}"
        if record.exc_info:
            text += "\n" + _escape(formatter.formatException(record.exc_info))
        # Without -v a failure is reported only with the file that it belongs to.
        if self._verbosity > 0 or _TRACE not in text:
            say(text)


def _escape(text: str) -> str:
    # Only tracebacks, also those from workers, have several lines.
    lines = text.split("\n") if _TRACE in text else [text]
    return "\n".join(map(escape_for_display, lines))


# Exit statuses

SUCCESS = 0
FATAL = 1
USAGE = 2
SOME_FAILED = 3
GATE_FAILED = 4
NOTHING_MATCHED = 5
INTERRUPTED = 130
# As after SIGPIPE, which ends `cat` and `git`, too: not a success, but no failure of msal.
READER_GONE = 141

_RISING = (SUCCESS, GATE_FAILED, SOME_FAILED, FATAL)


def worst_status(first: int, second: int) -> int:
    """Of two statuses the one that wins."""
    if first not in _RISING or second not in _RISING:
        # Signals, and refusals before any work, matter more than results of the work.
        return second if first in _RISING else first
    return max(first, second, key=_RISING.index)


def status_of_files(
    n_files: int, n_failed: int, *, is_gate_failed: bool = False, is_given_up: bool = False
) -> int:
    """The status of a run over ``n_files`` files that has ended, or was given up."""
    if is_given_up:
        return FATAL
    if n_failed:
        return FATAL if n_failed == n_files else SOME_FAILED
    return GATE_FAILED if is_gate_failed else SUCCESS
