"""``msal watch``: denoise files that arrive in a folder, batch by batch, as ``msal denoise`` does.

The folder is listed again and again, which works on all disks, also on network disks.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

import click

from msal_cli.batch import interrupts
from msal_cli.batch.inputs import DiscoveredInput, NothingMatched, discover_inputs
from msal_cli.batch.manifest import FileStat, Manifest
from msal_cli.cli import console, denoise
from msal_cli.cli.command import Request, grouped_command
from msal_cli.cli.options import PATH, STREAM, group
from msal_cli.codecs.detection import output_name
from msal_cli.errors import MsalError, OutputError, ResourceError, UsageError
from msal_cli.job.display_names import escape_for_display
from msal_cli.light_dataclass import dataclass
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from collections.abc import Iterator

    from msal_cli.batch.plan import Plan
    from msal_cli.batch.schedule import Event
    from msal_cli.job.records import MeshRecord

_UNFINISHED_ENDS = (".part", ".partial", ".filepart", ".crdownload", ".download", ".tmp", "~")
_LISTED_EVERY_S = 2.0

_SHARE_OF_LISTING = 0.1  # listing takes at most this part of the time, however many files there are

_log = logging.getLogger("msal.batch")

_NOT_GIVEN = {
    **dict.fromkeys(("in_place", "no_backup", "dry_run", "tile_set", "as_json"), False),
    **dict.fromkeys(("backup", "shard", "scheduler", "scratch", "reference")),
    **dict.fromkeys(("reports", "fail_on"), ()),
    "engine": "workers",
}
"""The options of ``msal denoise`` that a watch does not have, with their defaults."""


@grouped_command(
    "watch",
    group(
        "Watching",
        """
--settle TIME = 2s
    How long size and time of a file must stand still before it is taken; longer is safer where
    programs pause while they write.
--idle-exit TIME
    End after so long without a new file. [default: never]
""",
    ),
    group(
        "Input and output",
        """
-o, --output OUT
    Folder to write; it gets the tree of the input.
more:
--force
""",
        output={"required": True},
    ),
    *denoise.HOW_TO_DENOISE,
    group(
        "Many files",
        """
--include
--exclude
--jobs
--fresh
more:
--retry-failed
--timeout
--memory-limit
--retries
--fail-fast
--max-failures
--check
--fields
""",
    ),
    denoise.MESSAGES_AND_HELP,
    arguments=[click.Argument(["folder"], metavar="FOLDER", type=PATH)],
)
def command(request: Request) -> int:
    """Denoise the mesh files of a folder, and then what arrives in it.

    A file is taken when its size and its time have stood still for --settle. Unfinished names
    (.part, .crdownload, ~, hidden) are passed over. A file is taken once; if it changes, it is
    denoised again.

    Outputs and records are those of msal denoise FOLDER -o OUT, so a watch that is started again
    does only what is left, and msal report OUT writes reports. Ctrl-C and SIGTERM end it.
    """
    request = Request(**_NOT_GIVEN | vars(request), inputs=(request.folder,))
    return _Watch(request).run()


class _Watch:
    """One call of the command: its request, and the results of the files so far."""

    def __init__(self, request: Request) -> None:
        self._request = request
        _check_folders(request.folder, request.output)
        denoise.check_request(request, None)
        self._limits = denoise.read_limits(request)
        self._settings = denoise.build_settings(request, ())
        self._max_failures: int | None = 1 if request.fail_fast else request.max_failures
        # The input of each output, by the output's path.
        self._sources: dict[str, str] = {}
        self._failed: set[str] = set()
        self._n_files = self._n_new_failures = 0
        self._manifests: dict[str, Manifest] = {}
        self._signals: list[int] = []

    def run(self) -> int:
        """Watch until the requested end; returns the exit status."""
        from msal_cli.batch.manifest import open_folder

        request = self._request
        with ExitStack() as stack:
            with interrupts.catch_signals():
                # Keep the folder locked until the end, so that no other run works on it.
                self._manifests[request.output] = open_folder(request.output, stack)
            patterns = request.include, request.exclude
            inbox = Inbox(request.folder, request.output, request.settle or 0.0, patterns)
            if not request.quiet:
                console.say(f"watching {request.folder}; Ctrl-C ends it")
            try:
                while not self._is_given_up() and (files := self._wait(inbox)):
                    with interrupts.catch_signals():
                        plans = list(self._plan(files))
                    for plan in plans:
                        if not self._is_given_up():
                            self._run(plan)
                    # Only files that are there at the start are denoised again.
                    request.fresh = False
                if self._signals:
                    interrupts.raise_for(self._signals[0])
            except (KeyboardInterrupt, OutputError, ResourceError):
                console.say("the same command again goes on from here")
                raise
        if self._is_given_up():
            console.say(f"stopped after {self._n_new_failures:,} failed")
        return console.status_of_files(
            self._n_files, len(self._failed), is_given_up=self._is_given_up()
        )

    def _wait(self, inbox: Inbox) -> list[DiscoveredInput]:
        """Wait for the next files, in the order of their times; none if the watch is to end."""
        idle_s = self._request.idle_exit
        quiet_since = time.monotonic()
        with interrupts.catch_signals(self._signals.append):
            while not self._signals:
                if files := inbox.take_complete():
                    return files
                if not inbox.is_quiet:
                    quiet_since = time.monotonic()
                elif idle_s is not None and time.monotonic() - quiet_since >= idle_s:
                    return []
                time.sleep(0.1)
        return []

    def _plan(self, files: Sequence[DiscoveredInput]) -> Iterator[Plan]:
        """One plan for all files; if some cannot be planned, one for each that can."""
        try:
            plan = denoise.plan_files(self._request, self._settings, files)
            for task in plan.tasks:
                source = self._sources.setdefault(os.path.normcase(task.output), task.input)
                if source != task.input and os.path.lexists(source):
                    raise UsageError(
                        f"its output would replace that of {source!r}",
                        hint="rename one of the two, or remove the earlier one",
                        path=task.input,
                    )
                self._sources[os.path.normcase(task.output)] = task.input
        except UsageError as error:
            if len(files) > 1:
                for file in files:
                    yield from self._plan([file])
                return
            self._refuse(files[0], error)
        else:
            yield plan

    def _refuse(self, file: DiscoveredInput, error: UsageError) -> None:
        """Record a file that has no plan in the manifest, once for its content, and count it."""
        from msal_cli.batch.manifest import done_line
        from msal_cli.batch.resume import hash_file
        from msal_cli.job.records import Failure, MeshRecord

        output = self._request.output
        manifest = self._manifests[output]
        # The entry of the output may be another file's; no output can have this name.
        name = f"/{file.relative}"
        earlier, sha256 = manifest.get(name), hash_file(file.path)
        is_known = earlier is not None and earlier.input_sha256 == sha256
        failure = Failure.of(error)
        record = MeshRecord(
            file.path, "failed", input_sha256=sha256, error=failure, remembered=is_known
        )
        if not is_known:
            target = os.path.join(output, output_name(file.relative, self._settings.to))
            manifest.open()
            manifest.append([done_line(name, "", record, file.path, target)])
        self._count(file.relative, record)

    def _run(self, plan: Plan) -> None:
        from msal_cli.batch.run import run
        from msal_cli.batch.schedule import Finished

        request = self._request
        n_current = 0

        def on_event(event: Event) -> None:
            nonlocal n_current
            if isinstance(event, Finished):
                n_current += event.record.status == "up-to-date"
                self._count(plan.tasks[event.index].relative, event.record)

        left = None if self._max_failures is None else self._max_failures - self._n_new_failures
        run(
            plan,
            self._settings,
            jobs=request.jobs,
            on_event=on_event,
            limits=self._limits,
            retries=1 if request.retries is None else request.retries,
            stop_after_failures=left,
            command=("msal", *request.context.obj),
            manifests=self._manifests,
        )
        if n_current and not request.quiet:
            console.say(f"{n_current:,} up to date")

    def _count(self, name: str, record: MeshRecord) -> None:
        """Count a file and print a line about it, for a failure with its hint."""
        self._n_files += 1
        self._failed.discard(record.input)
        if record.error is not None:
            self._failed.add(record.input)
            self._n_new_failures += not record.remembered
            console.say_failure(name, record.error)
        elif record.status != "up-to-date" and not self._request.quiet:
            from msal_cli.report.text import file_text

            shown = escape_for_display(f"{name} -> {record.output}")
            console.say(f"{shown}: {file_text(record)}")
        else:
            denoise.log_record(record)

    def _is_given_up(self) -> bool:
        return self._max_failures is not None and self._n_new_failures >= self._max_failures


def _check_folders(folder: str, output: str) -> None:
    """Raise UsageError for folders that cannot be watched or written to."""
    for name in (folder, output):
        if name == STREAM or is_url(name):
            raise UsageError(
                f"msal watch is for folders of this machine, and {name!r} is none",
                hint="start msal denoise at fixed times: it does only what is new",
            )
    if not os.path.isdir(folder):
        raise UsageError(f"there is no folder {folder!r} to watch", path=folder)
    if os.path.lexists(output) and not os.path.isdir(output):
        raise UsageError(f"the output {output!r} is no folder", path=output)
    if os.path.isdir(output) and os.path.samefile(folder, output):
        raise UsageError(
            f"the output {output!r} is the folder that is watched", hint="choose another folder"
        )


@dataclass(eq=False)
class Inbox:
    """The mesh files of a folder and its subfolders, as ``discover_inputs`` finds them, each once
    per content; files with names of unfinished files are skipped."""

    folder: str
    output: str  # the folder for the outputs; files below it are skipped
    settle_s: float  # seconds for which size and time of a file must not change
    patterns: tuple[Sequence[str], Sequence[str]] = ((), ())  # to include, and to exclude

    def __post_init__(self) -> None:
        # When (monotonic s) size and time of a file were first as now; None once it is taken.
        self._known: dict[str, tuple[FileStat, float | None]] = {}
        self._is_listable = True
        self._warnings: set[str] = set()
        self._next_listing = 0.0

    @property
    def is_quiet(self) -> bool:
        """Whether no file is still being written."""
        return all(since is None for _, since in self._known.values())

    def take_complete(self) -> list[DiscoveredInput]:
        """The files that have become complete, in the order of their modification times.

        Between two listings it returns an empty list at once.
        """
        now = time.monotonic()
        if now < self._next_listing:
            return []
        files = self._list()
        known: dict[str, tuple[FileStat, float | None]] = {}
        complete: list[tuple[int, DiscoveredInput]] = []
        for file in files:
            stat = FileStat.of(file.path)
            name = os.path.basename(file.path).lower()
            # Programs give such names to files that they are still writing.
            if stat is None or name.startswith("~") or name.endswith(_UNFINISHED_ENDS):
                continue
            before, since = self._known.get(file.path, (None, now))
            if before != stat:
                since = now
            elif since is not None and now - since >= self.settle_s:
                complete.append((stat.mtime_ns, file))
                since = None
            known[file.path] = stat, since
        # A folder that cannot be listed now may come back with its files.
        self._known = known if self._is_listable else self._known | known
        wait_s = min(_LISTED_EVERY_S, max(self.settle_s, 0.1))
        spent = time.monotonic() - now
        self._next_listing = now + spent + max(wait_s, spent / _SHARE_OF_LISTING)
        return [file for _, file in sorted(complete, key=lambda item: (item[0], item[1].path))]

    def _list(self) -> Sequence[DiscoveredInput]:
        earlier, self._warnings = self._warnings, set()
        unlisted: list[MsalError] = []

        def warn(words: str) -> None:
            """Log a warning that the previous listing did not give."""
            self._warnings.add(words)
            if words not in earlier:
                _log.warning("%s", words)

        try:
            found = discover_inputs(
                [self.folder], *self.patterns, output=self.output, failures=unlisted, warn=warn
            )
        except NothingMatched:
            found = ()
        except UsageError as error:
            unlisted, found = [error], ()
        for failure in unlisted:
            warn(f"{failure.message}; msal waits for it")
        self._is_listable = not unlisted
        return found
