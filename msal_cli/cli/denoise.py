"""``msal denoise``: from the options of the command line to a run, and from its records to text."""

from __future__ import annotations

import logging
import sys
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console, denoise_request, exit_codes, options
from msal_cli.cli.command import command as grouped_command
from msal_cli.cli.configuration import options_of_found_file
from msal_cli.cli.conflicts import find_given
from msal_cli.cli.denoise_options import OPTIONS
from msal_cli.cli.denoise_records import describe_run, judge, log_record
from msal_cli.cli.denoise_request import Request
from msal_cli.cli.methods import list_defaults
from msal_cli.errors import MsalError, OutputError, ResourceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.batch.events import Event
    from msal_cli.batch.plan import Plan
    from msal_cli.cli.streams import Stream
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Settings
    from msal_cli.report.document import Run

_log = logging.getLogger("msal.denoise")


@grouped_command(
    "denoise",
    epilog="Exit status: see msal --help.",
)
@options.INPUTS
@OPTIONS
@click.pass_context
def command(context: click.Context, /, **given: Any) -> int:
    """Denoise mesh files; nothing but positions changes.

    INPUT is a file, a folder (with all its subfolders), a pattern such as 'scans/*.ply', a URL such
    as s3://bucket/scans, or - for standard input.

    The outputs are the inputs with their positions replaced. Faces, texture coordinates, colours,
    properties, comments and the order of everything stay as they are. What an earlier run has
    finished is not done again.
    """
    from msal_cli.cli import logs

    found = options_of_found_file(context)
    request = Request(**given, given=find_given(context), found=found)
    with logs.log_to_console(-1 if request.quiet else request.verbose, request.log_file):
        return _Session(request, context.obj).run()


class _Session:
    """One call of the command: its request, and what its records are measured against."""

    def __init__(self, request: Request, arguments: tuple[str, ...]) -> None:
        from msal_cli.cli.environment import Clock
        from msal_cli.job.settings import Limits
        from msal_cli.storage import urls

        self._request = request
        # For reports and manifests, without passwords.
        self._command = ("msal", *map(urls.redact, arguments))
        self._clock = Clock()
        self._limits = Limits(request.timeout, request.memory_limit, request.max_faces)
        self._stream: Stream | None = None
        if options.STREAM in (*request.inputs, request.output):
            from msal_cli.cli.streams import find_stream

            self._stream = find_stream(request.inputs, request.output)
        denoise_request.check_request(request, self._stream)
        options.check_threads_variable()
        self._gates = denoise_request.parse_gates(request)
        # For each record the path of its reference, where there are any.
        self._references: tuple[str, ...] = ()

    def run(self) -> int:
        """Check everything, then work; the exit status."""
        settings = denoise_request.build_settings(self._request, self._gates)
        if self._stream is not None:
            return self._run_stream(self._stream, settings)
        return self._run_files(denoise_request.build_plan(self._request, settings), settings)

    def _run_stream(self, stream: Stream, settings: Settings) -> int:
        from dataclasses import replace

        from msal_cli.cli import progress, report_files
        from msal_cli.cli.stream_denoise import denoise_stream
        from msal_cli.cli.streams import choose_format

        request = self._request
        self._references = denoise_request.find_references(request, ["-"])
        denoise_request.refuse_found_targets(request, stream.target)
        paths = [path for path in (stream.source, stream.target) if path != options.STREAM]
        report_files.check(
            request.reports, [*paths, *denoise_request.other_files(request)], request.csv_columns
        )
        settings = replace(settings, to=choose_format(stream, settings.to))
        bar = progress.stream_bar(stream.source, quiet=request.quiet)
        try:
            record = denoise_stream(stream, settings, bar.on_progress, self._limits)
        finally:
            bar.close()
        log_record(record)
        return self._conclude(settings, [record])

    def _run_files(self, plan: Plan, settings: Settings) -> int:
        from msal_cli.batch import interrupts
        from msal_cli.batch.events import Finished
        from msal_cli.batch.run import run
        from msal_cli.batch.tile_options import TileOptions
        from msal_cli.cli import progress, report_files

        request = self._request
        engine = denoise_request.build_engine(request)
        whole = plan.whole or plan
        tasks, is_file = whole.tasks, whole.homes[:1] == (None,)
        denoise_request.refuse_found_targets(request, tasks[0].output if is_file else None)
        paths = [path for task in tasks for path in (task.input, task.output)]
        paths += [task.input + task.backup for task in tasks if task.in_place and task.backup]
        report_files.check(
            request.reports, [*paths, *denoise_request.other_files(request)], request.csv_columns
        )
        names = [task.relative for task in plan.tasks]
        self._references = denoise_request.find_references(request, names)
        finished: dict[int, MeshRecord] = {}
        _log.info("%s files, method %s %s", len(plan.tasks), settings.method, settings.parameters)
        if plan.shard is not None and plan.whole is not None and not request.quiet:
            console.say(
                f"shard {plan.shard}: {len(plan.tasks):,} of {len(plan.whole.tasks):,} files"
            )
        bar = progress.bar(plan.tasks, quiet=request.quiet or request.dry_run, is_set=plan.is_set)

        def on_event(event: Event) -> None:
            if isinstance(event, Finished):
                finished[event.index] = event.record
                log_record(event.record)
            bar.on_event(event)

        try:
            # The run takes the signals itself, to end its workers in good order.
            records = run(
                plan,
                settings,
                jobs=request.jobs,
                on_event=on_event,
                dry_run=request.dry_run,
                limits=self._limits,
                retries=1 if request.retries is None else request.retries,
                stop_after_failures=1 if request.fail_fast else request.max_failures,
                command=self._command,
                engine=engine,
                tiles=TileOptions(request.tiled, request.scratch),
            )
        except (KeyboardInterrupt, OutputError, ResourceError):
            bar.close()
            self._report_partly(settings, plan, finished)
            raise
        finally:
            bar.close()
        if plan.is_set and request.dry_run and not request.quiet:
            console.say(_describe_set(plan, settings, records))
        with interrupts.noticed(interrupts.raise_for):
            return self._conclude(settings, records)

    def _report_partly(
        self, settings: Settings, plan: Plan, finished: dict[int, MeshRecord]
    ) -> None:
        """Report what was done before the run was ended; the rest is ``planned``.

        Nothing that goes wrong here hides why the run was ended.
        """
        from msal_cli.job.records import MeshRecord

        records = [
            finished.get(index) or MeshRecord(task.input, "planned", task.output)
            for index, task in enumerate(plan.tasks)
        ]
        try:
            self._conclude(settings, records, interrupted=True)
        except MsalError as error:
            console.say_error(error)
        except BrokenPipeError:
            return
        if len(records) > 1:
            console.say("the same command again goes on from here")

    def _conclude(
        self, settings: Settings, records: Sequence[MeshRecord], *, interrupted: bool = False
    ) -> int:
        """Measure, print, write the reports, and give the exit status."""
        from msal_cli.cli import report_files

        request = self._request
        is_dry = request.dry_run
        n_left = 0 if is_dry else sum(one.status == "planned" for one in records)
        is_over = interrupted or n_left > 0
        run = describe_run(request, settings, self._clock, self._command, interrupted=is_over)
        is_broken = False
        if not is_dry:
            references = () if interrupted else self._references
            records, is_broken = judge(settings, records, references, self._gates)
        self._print(run, records)
        try:
            if not is_dry:
                from msal_cli.cli import github

                github.annotate(records)
                report_files.write(
                    request.reports,
                    run,
                    records,
                    backup=request.backup,
                    csv_columns=request.csv_columns,
                    without_pictures=interrupted,
                    quiet=request.quiet,
                )
            elif request.reports:
                console.say("dry run: no report is written")
        finally:
            if request.as_json:
                from msal_cli.report import json_report

                console.put_bytes(json_report.render(run, records))
        n_failed = sum(record.status == "failed" for record in records)
        if n_left and not interrupted:
            failures = "1 failure" if n_failed == 1 else f"{n_failed:,} failures"
            console.say(f"stopped after {failures}; {n_left:,} files were not begun")
        return exit_codes.of_files(
            len(records), n_failed, is_gate_failed=is_broken, is_given_up=n_left > 0
        )

    def _print(self, run: Run, records: Sequence[MeshRecord]) -> None:
        from msal_cli.report import text

        request = self._request
        is_listing = request.dry_run and not request.as_json
        if is_listing:
            console.put_lines(text.listing(records))
            if not request.quiet and len(records) > 1:
                from msal_cli.machine import usable_cores

                console.say_lines([text.outlook(records, request.jobs or usable_cores())])
        if len(records) == 1 and records[0].error is not None:
            console.say_failure(records[0].input, records[0].error)
            if records[0].remembered:
                console.say(f"it {text.remembered_words()}")
        elif request.quiet:
            console.say_lines(text.failures(records, verbose=False))
            console.say_lines(text.broken_gates(records, verbose=False))
        elif not is_listing:
            console.say_lines(
                text.summary(
                    run,
                    records,
                    width=console.width(sys.stderr),
                    verbose=request.verbose > 0,
                    defaults=list_defaults(records),
                )
            )


def _describe_set(plan: Plan, settings: Settings, records: Sequence[MeshRecord]) -> str:
    """What the files of a tile set will take together."""
    from msal_cli.machine import megabytes
    from msal_cli.report.phrases import tiles_text
    from msal_cli.tiles.set_run import memory_of_set

    tiles = next((one.tiles for one in records if one.tiles is not None), None)
    if tiles is not None:
        return f"as one mesh they are denoised in {tiles_text(tiles)}"
    return f"as one mesh they take up to {megabytes(memory_of_set(plan.tasks, settings))} of memory"
