"""Show progress: a bar over files or a line for one mesh on a terminal, lines in a log."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from msal_cli.batch.schedule import Finished, Progress, Started
from msal_cli.cli import console
from msal_cli.job.display_names import escape_for_display, pad_name, shorten_name
from msal_cli.report.facts import seconds_text

if TYPE_CHECKING:
    from msal_cli.batch.schedule import Event
    from msal_cli.job.settings import Task

_log = logging.getLogger("msal.denoise")

_NAME_WIDTH = 32
_FORMAT = "{desc} {percentage:3.0f} %|{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}{postfix}]"

# No bar is shown before this time.
_DELAY_S = 0.4
_BETWEEN_S = 0.1

_LOG_EVERY_S = 5.0  # seconds between two lines in a log of many files

_SILENT_S = 15.0
"""Seconds without a line in a log after which the stage of the current file is printed."""

_MAX_LINES = 200  # with more files than this, a log does not have a line for each

_COUNTED = ("choose", "sweeps")


class Silent:
    """No bar; the base class of those that show one."""

    _bar: Any = None

    def on_event(self, event: Event) -> None:
        """Show what happened to a file of a run."""

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


class StageLine(Silent):
    """A line for one mesh: its stage, and how many sweeps are done."""

    def __init__(self, name: str) -> None:
        self._name = _shorten(name)
        self._wakes = time.monotonic() + _DELAY_S
        self._bar = _make_bar(total=1, bar_format="{desc}", delay=_DELAY_S)

    def on_event(self, event: Event) -> None:
        if isinstance(event, Progress):
            self._bar.set_description_str(f"{self._name}: {_stage_text(event)}", refresh=False)
            if time.monotonic() >= self._wakes:
                self._bar.refresh()


class FileBar(Silent):
    """A bar over many files, with the current file and how many have failed."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._tasks = tasks
        self._n_failed = 0
        self._bar = _make_bar(total=len(tasks), bar_format=_FORMAT)
        self._shown = 0.0

    def on_event(self, event: Event) -> None:
        if isinstance(event, Started):
            name = pad_name(_shorten(self._tasks[event.index].relative), _NAME_WIDTH // 2)
            self._bar.set_description_str(name, refresh=False)
        elif isinstance(event, Finished):
            self._n_failed += event.record.status == "failed"
            if self._n_failed:
                self._bar.set_postfix_str(f"{self._n_failed:,} failed", refresh=False)
            self._bar.update(1)
        # Drawing the bar for each of many small files would take too long.
        if time.monotonic() >= self._shown + _BETWEEN_S:
            self._shown = time.monotonic()
            self._bar.refresh()


class Log(Silent):
    """Lines where no terminal shows a bar: one for each finished file or, for more than
    ``_MAX_LINES`` files, one every ``_LOG_EVERY_S`` seconds; and the stage of a slow file."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._tasks = tasks
        self._n_done = self._n_current = self._n_failed = self._n_unsaid = 0
        self._begun = self._said = time.monotonic()

    def on_event(self, event: Event) -> None:
        now, name = time.monotonic(), escape_for_display(self._tasks[event.index].relative)
        if isinstance(event, Progress) and now >= self._said + _SILENT_S:
            console.say(f"{name}: {_stage_text(event)}")
            self._said = now
        if not isinstance(event, Finished):
            return
        self._n_done += 1
        self._n_failed += event.record.status == "failed"
        is_current = event.record.status == "up-to-date"
        self._n_current += is_current
        n_files = len(self._tasks)
        # A summary follows for a single file, and counts files that are up to date; with -v the
        # log has a line for each file.
        if n_files == 1 or is_current or _log.isEnabledFor(logging.INFO):
            return
        self._n_unsaid += 1
        if n_files > _MAX_LINES and now < self._said + _LOG_EVERY_S:
            return
        if self._n_unsaid == 1:
            from msal_cli.report.text import file_text

            text = f"{name}: {file_text(event.record)}"
        else:
            n_worked = self._n_done - self._n_current
            left_s = (now - self._begun) / n_worked * (n_files - self._n_done)
            text = f"{self._n_failed:,} failed; about {seconds_text(left_s)} left"
        console.say(f"[{self._n_done:,}/{n_files:,}] {text}")
        self._n_unsaid, self._said = 0, now


def bar(tasks: Sequence[Task], *, quiet: bool, is_set: bool = False) -> Silent:
    """The bar for a run; lines if standard error is no terminal; Silent with ``quiet``.

    A tile set has one line, like a single mesh.
    """
    if quiet or not tasks:
        return Silent()
    if not console.is_terminal(sys.stderr):
        return Log(tasks)
    if is_set:
        return StageLine(f"{len(tasks):,} files as one")
    return FileBar(tasks) if len(tasks) > 1 else StageLine(tasks[0].relative)


@contextmanager
def picture_bar(*, quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """A bar for the pictures of a report, as a function of pictures done and their total."""
    if quiet or not console.is_terminal(sys.stderr):
        yield lambda done, total: None
        return
    with _make_bar(desc="pictures", bar_format=_FORMAT, delay=_DELAY_S) as shown:

        def show(done: int, total: int) -> None:
            shown.total = total
            shown.update(done - shown.n)

        yield show


def _stage_text(event: Progress) -> str:
    is_counted = event.stage in _COUNTED and event.total > 1
    return f"{event.stage} {event.done:,} of {event.total:,}" if is_counted else event.stage


def _shorten(name: str) -> str:
    return shorten_name(escape_for_display(name), _NAME_WIDTH)


def _make_bar(**options: Any) -> Any:
    import threading

    from tqdm import tqdm

    # tqdm's own lock and monitor would create a system semaphore and a thread.
    tqdm.set_lock(threading.RLock())
    tqdm.monitor_interval = 0
    return tqdm(file=sys.stderr, leave=False, dynamic_ncols=True, mininterval=_BETWEEN_S, **options)
