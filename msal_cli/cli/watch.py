"""``msal watch``: denoise what arrives in a folder, batch by batch, as ``msal denoise`` does."""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console, denoise_request, exit_codes, options
from msal_cli.cli.command import command as grouped_command
from msal_cli.cli.configuration import options_of_found_file
from msal_cli.cli.conflicts import find_given
from msal_cli.cli.denoise_records import describe_run, judge, log_record
from msal_cli.cli.denoise_request import Request
from msal_cli.cli.watch_options import OF_FILES, OPTIONS
from msal_cli.errors import MsalError, OutputError, ResourceError, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.batch.events import Event
    from msal_cli.batch.inbox import Inbox
    from msal_cli.batch.inputs import DiscoveredInput
    from msal_cli.batch.manifest import Manifest
    from msal_cli.batch.plan import Plan
    from msal_cli.job.records import MeshRecord

# Writing reports takes no more than this part of the time.
_SHARE_OF_REPORTS = 0.1


@grouped_command("watch", epilog="Exit status: see msal --help.")
@click.argument("folder", metavar="FOLDER", type=options.PATH)
@OPTIONS
@click.pass_context
def command(context: click.Context, /, folder: str, **given: Any) -> int:
    """Denoise the mesh files of a folder, and then what arrives in it.

    A file is taken when it is complete: its size and its time have stood still for --settle, or it
    got its name from a temporary one (.part, .crdownload, ~, hidden), by which it is not taken. It
    is taken once; if it changes, it is denoised again.

    Outputs and records are those of msal denoise FOLDER -o OUT, so a watch that is started again
    does only what is left. Ctrl-C and SIGTERM end it.
    """
    from msal_cli.cli import logs

    found = options_of_found_file(context)
    request = Request(
        **(OF_FILES | given), inputs=(folder,), given=find_given(context), found=found
    )
    with logs.log_to_console(-1 if request.quiet else request.verbose, request.log_file):
        return _Session(request, context.obj).run()


class _Session:
    """One call of the command: its request, and what became of the files so far."""

    def __init__(self, request: Request, arguments: tuple[str, ...]) -> None:
        from msal_cli.batch.arrival_plan import ArrivalPlanner
        from msal_cli.cli import report_files
        from msal_cli.cli.environment import Clock
        from msal_cli.job.settings import Limits

        self._request = request
        self._command = ("msal", *arguments)
        self._clock = Clock()
        self._limits = Limits(request.timeout, request.memory_limit, request.max_faces)
        _check_folders(request.inputs[0], request.output)
        denoise_request.check_request(request, None)
        options.check_threads_variable()
        self._gates = denoise_request.parse_gates(request)
        self._settings = denoise_request.build_settings(request, self._gates)
        denoise_request.refuse_found_targets(request, None)
        report_files.check(
            request.reports, denoise_request.other_files(request), request.csv_columns
        )
        self._planner = ArrivalPlanner(
            lambda files: denoise_request.plan_files(self._request, self._settings, files)
        )
        # By input.  A watch may go on for years, so records are kept only for reports.
        self._records: dict[str, MeshRecord] = {}
        self._n_files = 0
        self._failed: set[str] = set()
        self._broken: set[str] = set()
        self._n_new_failures = 0
        self._manifests: dict[str, Manifest] = {}
        self._signals: list[int] = []
        self._next_report: float | None = None
        self._report_s = 0.0

    def run(self) -> int:
        """Watch until the end that was asked for; the exit status."""
        from msal_cli.batch import interrupts
        from msal_cli.batch.inbox import Inbox
        from msal_cli.batch.manifest_dirs import open_folder

        request = self._request
        with ExitStack() as stack:
            with interrupts.noticed(interrupts.raise_for):
                # From the start to the end, so that no other run works on the folder meanwhile.
                self._manifests[request.output] = open_folder(request.output, stack)
                inbox = Inbox(
                    request.inputs[0],
                    request.output,
                    request.include,
                    request.exclude,
                    settle_s=request.settle or 0.0,
                    is_polled=request.poll,
                )
            if not request.quiet:
                console.say(f"watching {request.inputs[0]}; Ctrl-C ends it")
            try:
                while not self._is_given_up() and (files := self._wait(inbox)):
                    self._denoise(files)
                    # Only what the first listing found is denoised again.
                    request.fresh = False
                if self._signals:
                    interrupts.raise_for(self._signals[0])
            except (KeyboardInterrupt, OutputError, ResourceError):
                self._write_reports_at_end()
                raise
            self._write_reports(interrupted=self._is_given_up())
        if self._is_given_up():
            console.say(f"stopped after {self._n_new_failures:,} failed")
        return exit_codes.of_files(
            self._n_files,
            len(self._failed),
            is_gate_failed=bool(self._broken),
            is_given_up=self._is_given_up(),
        )

    def _wait(self, inbox: Inbox) -> list[DiscoveredInput]:
        """The next files, in the order of their arrival; none if the watch is to end."""
        from msal_cli.batch import interrupts

        idle_s = self._request.idle_exit
        quiet_since = time.monotonic()
        with interrupts.noticed(self._signals.append):
            while not self._signals:
                if files := inbox.pop_complete():
                    return files
                now = time.monotonic()
                if not inbox.is_quiet():
                    quiet_since = now
                elif idle_s is not None and now - quiet_since >= idle_s:
                    return []
                if self._next_report is not None and now >= self._next_report:
                    self._write_reports()
                inbox.wait()
        return []

    def _denoise(self, files: Sequence[DiscoveredInput]) -> None:
        from msal_cli.batch import interrupts

        with interrupts.noticed(interrupts.raise_for):
            plans, refused = self._planner.plan(files)
            self._conclude([record for _, record in refused], [one.relative for one, _ in refused])
        for plan in plans:
            if not self._is_given_up():
                self._run(plan)

    def _run(self, plan: Plan) -> None:
        from msal_cli.batch import interrupts
        from msal_cli.batch.events import Finished
        from msal_cli.batch.run import run
        from msal_cli.batch.tile_options import TileOptions

        request = self._request
        finished: dict[int, MeshRecord] = {}

        def on_event(event: Event) -> None:
            if isinstance(event, Finished):
                finished[event.index] = event.record
                log_record(event.record)
                self._say(plan.tasks[event.index].relative, event.record)

        most = self._most_failures()
        try:
            run(
                plan,
                self._settings,
                jobs=request.jobs,
                on_event=on_event,
                limits=self._limits,
                retries=1 if request.retries is None else request.retries,
                stop_after_failures=None if most is None else most - self._n_new_failures,
                command=self._command,
                tiles=TileOptions(request.tiled, request.scratch),
                manifests=self._manifests,
            )
        except (KeyboardInterrupt, OutputError, ResourceError):
            self._keep(list(finished.values()))
            raise
        with interrupts.noticed(interrupts.raise_for):
            n_current = sum(one.status == "up-to-date" for one in finished.values())
            if n_current and not request.quiet:
                console.say(f"{n_current:,} up to date")
            indices = sorted(finished)
            names = [plan.tasks[index].relative for index in indices]
            self._conclude([finished[index] for index in indices], names, is_said=True)

    def _say(self, name: str, record: MeshRecord) -> None:
        """One line for one file, and a second one on what to do about a failure."""
        from msal_cli.job.display_names import escape_for_display

        if record.error is not None:
            console.say_failure(name, record.error)
        elif record.status != "up-to-date" and not self._request.quiet:
            seconds = record.seconds.total if record.seconds is not None else 0.0
            shown = escape_for_display(f"{name} -> {record.output}")
            left = f", left as it is: {record.left_alone}" if record.left_alone else ""
            console.say(f"{shown} ({seconds:.2f} s{left})")

    def _conclude(
        self, records: Sequence[MeshRecord], names: Sequence[str], *, is_said: bool = False
    ) -> None:
        """Measure and judge the records of a batch, and keep what is needed of them."""
        from msal_cli.report import text

        if not records:
            return
        if not is_said:
            for name, record in zip(names, records, strict=True):
                log_record(record)
                self._say(name, record)
        references = denoise_request.find_references(self._request, names)
        records, _ = judge(self._settings, records, references, self._gates)
        console.say_lines(text.broken_gates(records, verbose=True))
        self._keep(records)

    def _keep(self, records: Sequence[MeshRecord]) -> None:
        for record in records:
            self._n_files += 1
            self._failed.discard(record.input)
            self._broken.discard(record.input)
            if record.status == "failed":
                self._failed.add(record.input)
                self._n_new_failures += not record.remembered
            if any(gate.broken for gate in record.gates):
                self._broken.add(record.input)
            if self._request.reports:
                self._records.pop(record.input, None)
                self._records[record.input] = record
        if self._next_report is None:
            self._next_report = time.monotonic() + self._report_s / _SHARE_OF_REPORTS

    def _write_reports(self, *, interrupted: bool = False) -> None:
        from msal_cli.cli import report_files

        request = self._request
        start = time.monotonic()
        run = describe_run(
            request, self._settings, self._clock, self._command, interrupted=interrupted
        )
        report_files.write(
            request.reports,
            run,
            list(self._records.values()),
            csv_columns=request.csv_columns,
            without_pictures=interrupted,
            quiet=True,
        )
        self._report_s = time.monotonic() - start
        self._next_report = None

    def _write_reports_at_end(self) -> None:
        """Nothing that goes wrong here hides why the watch ends."""
        try:
            self._write_reports(interrupted=True)
        except MsalError as error:
            console.say_error(error)
        console.say("the same command again goes on from here")

    def _most_failures(self) -> int | None:
        most: int | None = self._request.max_failures
        return 1 if self._request.fail_fast else most

    def _is_given_up(self) -> bool:
        most = self._most_failures()
        return most is not None and self._n_new_failures >= most


def _check_folders(folder: str, output: str) -> None:
    """Refuse what cannot be watched or written by a watch; UsageError."""
    import os

    from msal_cli.storage.urls import is_url

    for name in (folder, output):
        if name == options.STREAM or is_url(name):
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
