"""``msal denoise``: from the words of the command line to a run, and from its records to words."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console as talk
from msal_cli.cli import denoise_request, exit_codes
from msal_cli.cli import option_types as words
from msal_cli.cli.denoise_arguments import Request
from msal_cli.cli.denoise_options import PATH, options
from msal_cli.errors import MsalError, OutputError, ResourceError, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.batch.engine import EngineFactory
    from msal_cli.batch.events import Event
    from msal_cli.batch.plan import Plan
    from msal_cli.cli.stream_denoise import Pipe
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Settings
    from msal_cli.report.document import Run
    from msal_cli.report.gates import Gate

_log = logging.getLogger("msal.denoise")


@click.command(
    "denoise",
    short_help="Denoise files, folders or a stream.",
    epilog="Exit status: see msal --help.",
)
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=PATH)
@options
@click.pass_obj
def command(arguments: tuple[str, ...], /, **given: Any) -> int:
    """Denoise mesh files; the outputs are the inputs with their positions replaced.

    INPUT is a file, a folder (with all its subfolders), a pattern such as 'scans/*.ply', a URL such
    as s3://bucket/scans, or - for standard input. Faces, texture coordinates, colours, properties,
    comments and the order of everything stay as they are. What an earlier run has finished is not
    done again.
    """
    from msal_cli.cli import logs
    from msal_cli.storage import urls

    request = Request(**urls.settled_in(given, "inputs", "output", "reports", "reference"))
    if request.quiet and request.verbose:
        raise UsageError("--quiet and --verbose contradict each other", hint="give one of them")
    with logs.configured(-1 if request.quiet else request.verbose, request.log_file):
        return _Session(request, arguments).done()


class _Session:
    """One call of the command: what was asked, and what came of it."""

    def __init__(self, request: Request, arguments: tuple[str, ...]) -> None:
        from msal_cli.cli.stopwatch import Clock

        self._request = request
        self._arguments = arguments
        self._clock = Clock()
        self._gates: tuple[Gate, ...] = ()
        # For each record the path of its reference, where there are any.
        self._references: tuple[str, ...] = ()

    def done(self) -> int:
        """Check everything, then work; the exit status."""
        from msal_cli.cli import engines
        from msal_cli.cli.stream_denoise import pipe

        request = self._request
        denoise_request.refuse_contradictions(request)
        words.check_threads_variable()
        self._gates = denoise_request.gates_of(request)
        one = pipe(request.inputs, request.output)
        settings = denoise_request.settings_of(request)
        if one is not None:
            return self._piped(one, settings)
        plan = denoise_request.plan_of(request, settings)
        engine = engines.chosen(request.engine, request.scheduler)
        # The run takes the signals itself, to end its workers in good order.
        return self._run(plan, settings, engine)

    # Streams

    def _piped(self, one: Pipe, settings: Settings) -> int:
        from dataclasses import replace

        from msal_cli.cli import progress
        from msal_cli.cli import report_files as reports
        from msal_cli.cli import stream_denoise as pipe

        request = self._request
        denoise_request.refuse_for_streams(request, one)
        self._references = denoise_request.references_of(request, ["-"])
        reports.check(request.reports, [path for path in (one.source, one.target) if path != "-"])
        settings = replace(settings, to=pipe.target_format(one, settings.to))
        bar = progress.stream_bar(one.source, quiet=request.quiet)
        try:
            record = pipe.denoised(
                one, settings, bar.on_progress, denoise_request.limits_of(request)
            )
        finally:
            bar.close()
        _log_record(record)
        return self._concluded(settings, [record])

    # Files

    def _run(self, plan: Plan, settings: Settings, engine: EngineFactory | None) -> int:
        from msal_cli.batch import interrupts as signals
        from msal_cli.batch.events import Finished
        from msal_cli.batch.run import run
        from msal_cli.cli import progress
        from msal_cli.cli import report_files as reports

        request = self._request
        paths = [path for task in (plan.whole or plan).tasks for path in (task.input, task.output)]
        reports.check(request.reports, paths)
        names = [task.relative for task in plan.tasks]
        self._references = denoise_request.references_of(request, names)
        finished: dict[int, MeshRecord] = {}

        def keep(event: Event) -> None:
            if isinstance(event, Finished):
                finished[event.index] = event.record
                _log_record(event.record)

        _log.info("%s files, method %s %s", len(plan.tasks), settings.method, settings.parameters)
        if plan.shard is not None and plan.whole is not None and not request.quiet:
            talk.say(f"shard {plan.shard}: {len(plan.tasks):,} of {len(plan.whole.tasks):,} files")
        bar = progress.bar(plan.tasks, quiet=request.quiet or request.dry_run)
        try:
            records = run(
                plan,
                settings,
                jobs=request.jobs,
                on_event=progress.heard_by(keep, bar.on_event),
                dry_run=request.dry_run,
                limits=denoise_request.limits_of(request),
                retries=1 if request.retries is None else request.retries,
                stop_after_failures=1 if request.fail_fast else request.max_failures,
                command=self._command(),
                engine=engine,
            )
        except (KeyboardInterrupt, OutputError, ResourceError):
            bar.close()
            self._cut_short(settings, plan, finished)
            raise
        finally:
            bar.close()
        with signals.noticed(signals.raise_for):
            return self._concluded(settings, records)

    def _cut_short(self, settings: Settings, plan: Plan, finished: dict[int, MeshRecord]) -> None:
        """Report what was done before the run was ended; what was not is ``planned``.

        Nothing that goes wrong here hides why the run was ended.
        """
        from msal_cli.job.records import MeshRecord

        records = [
            finished.get(index) or MeshRecord(task.input, "planned", task.output)
            for index, task in enumerate(plan.tasks)
        ]
        try:
            self._concluded(settings, records, interrupted=True)
        except MsalError as error:
            talk.say_error(error)
        except BrokenPipeError:
            return
        if len(records) > 1:
            talk.say("the same command again goes on from here")

    # What came of it

    def _concluded(
        self, settings: Settings, records: Sequence[MeshRecord], *, interrupted: bool = False
    ) -> int:
        """Tell, report, and give the exit status."""
        from msal_cli.cli import github
        from msal_cli.cli import report_files as reports
        from msal_cli.report import json_report as as_json

        request = self._request
        is_given_up = not request.dry_run and any(one.status == "planned" for one in records)
        run = self._described(settings, interrupted or is_given_up)
        if self._references and not request.dry_run and not interrupted:
            from msal_cli.job.comparison import with_references

            records = with_references(records, self._references, settings.format)
        is_broken = False
        if self._gates and not request.dry_run:
            from msal_cli.report.gates import is_any_broken, with_gates

            records = with_gates(self._gates, records)
            is_broken = is_any_broken(records)
            _log_gates(records)
        self._tell(run, records)
        try:
            if not request.dry_run:
                github.annotate(records)
                reports.write(
                    request.reports,
                    run,
                    records,
                    backup=request.backup,
                    is_in_haste=interrupted,
                    is_quiet=request.quiet,
                )
            elif request.reports:
                talk.say("dry run: no report is written")
        finally:
            if request.as_json:
                talk.put_bytes(as_json.encoded(run, records))
        n_failed = sum(record.status == "failed" for record in records)
        n_left = 0 if request.dry_run else sum(one.status == "planned" for one in records)
        if n_left and not interrupted:
            failures = "1 failure" if n_failed == 1 else f"{n_failed:,} failures"
            talk.say(f"stopped after {failures}; {n_left:,} files were not begun")
        return exit_codes.of_files(
            len(records),
            n_failed,
            is_gate_failed=is_broken,
            is_given_up=n_left > 0,
        )

    def _tell(self, run: Run, records: Sequence[MeshRecord]) -> None:
        from msal_cli.report import text as as_text

        request = self._request
        is_listing = request.dry_run and not request.as_json
        if is_listing:
            talk.put_lines(as_text.listing(records))
        if len(records) == 1 and records[0].error is not None:
            talk.say_failure(records[0].input, records[0].error)
            if records[0].remembered:
                talk.say(f"it {as_text.remembered_words()}")
        elif request.quiet:
            talk.say_lines(as_text.failures(records, verbose=False))
            talk.say_lines(as_text.broken_gates(records, verbose=False))
        elif not is_listing:
            talk.say_lines(
                as_text.summary(run, records, width=talk.width(), verbose=request.verbose > 0)
            )

    def _command(self) -> tuple[str, ...]:
        """The command as it was given, for reports and manifests, without passwords."""
        from msal_cli.storage import urls

        return ("msal", *map(urls.redacted, self._arguments))

    def _described(self, settings: Settings, interrupted: bool) -> Run:
        from dataclasses import asdict

        from msal_cli import __version__
        from msal_cli.cli import environment as machine
        from msal_cli.report.document import Run

        request = self._request
        return Run(
            version=__version__,
            command=self._command(),
            settings=asdict(settings),
            started=self._clock.started,
            finished=self._clock.now(),
            seconds=self._clock.seconds(),
            interrupted=interrupted,
            machine=machine.described() if request.reports or request.as_json else {},
        )


def _log_record(record: MeshRecord) -> None:
    """One line of the log per file; a failure is told elsewhere too, so it is no warning here."""
    if record.error is not None:
        place = f"{record.error.where}: " if record.error.where else ""
        why = f"{record.error.code}: {place}{record.error.message}"
        _log.info("%s: failed: %s", record.input, why)
        return
    seconds = record.seconds.total if record.seconds is not None else 0.0
    _log.info("%s: %s in %.3f s -> %s", record.input, record.status, seconds, record.output)
    if record.choice is not None:
        _log.info("%s: %s", record.input, record.choice.reason)
    if record.left_alone is not None:
        _log.info("%s: left as it is: %s", record.input, record.left_alone)
    for warning in record.warnings:
        _log.info("%s: %s", record.input, warning)


def _log_gates(records: Sequence[MeshRecord]) -> None:
    for record in records:
        for gate in record.gates:
            if gate.broken:
                _log.info("%s: broke %s: %s", record.input, gate.expression, gate.reason)
