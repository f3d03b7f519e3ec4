"""``msal denoise``: from the words of the command line to a run, and from its records to words."""

from __future__ import annotations

import logging
import os
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import exit_codes, talk, words
from msal_cli.cli.pipe import STREAM
from msal_cli.dataclass import dataclass
from msal_cli.errors import MsalError, OutputError, ResourceError, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.batch.engine import EngineFor
    from msal_cli.batch.events import Event
    from msal_cli.batch.plan import Plan
    from msal_cli.cli.pipe import Pipe
    from msal_cli.pipeline import Limits, Settings
    from msal_cli.records import MeshRecord
    from msal_cli.report.document import Run

_log = logging.getLogger("msal.denoise")

_DEFAULT_BACKUP = ".orig"


@dataclass(frozen=True)
class Request:
    """The command line of ``msal denoise``, as click has read it."""

    inputs: tuple[str, ...]
    output: str | None
    method: str
    iterations: str | None
    factor: str | None
    mollify: str | None
    schedule: str | None
    assignments: tuple[str, ...]
    include: tuple[str, ...]
    exclude: tuple[str, ...]
    in_place: bool
    backup: str | None
    no_backup: bool
    to: str | None
    encoding: str
    precision: str
    strict: bool
    format: str | None
    jobs: int | None
    timeout: float | None
    memory_limit: int | None
    max_faces: int | None
    retries: int | None
    fail_fast: bool
    max_failures: int | None
    engine: str
    scheduler: str | None
    dry_run: bool
    force: bool
    fresh: bool
    retry_failed: bool
    shard: str | None
    reports: tuple[str, ...]
    as_json: bool
    quiet: bool
    verbose: int
    log_file: str | None


_PATH = click.Path(readable=False, allow_dash=True)


@click.command(
    "denoise",
    short_help="Denoise files, folders or a stream.",
    epilog="Exit status: see msal --help.",
)
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=_PATH)
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    type=_PATH,
    help="File or folder to write; a folder gets the tree of the inputs. "
    "- is standard output, the default when INPUT is -.",
)
@click.option(
    "--method",
    metavar="NAME",
    default="msal",
    show_default=True,
    shell_complete=words.completed_method,
    help="How to denoise; `msal methods` lists them.",
)
@click.option(
    "-n",
    "--iterations",
    metavar="N",
    help="Sweeps over the mesh; more is smoother, while msal comes back to the input after many. "
    "Other methods may have other defaults.  [default: 4]",
)
@click.option(
    "-K",
    "factor",
    metavar="K",
    help="msal, or --schedule multiscale: factor by which the smoothing shrinks from sweep to "
    "sweep, 0 < K <= 1; greater is smoother, less keeps more texture.  [default: 0.5]",
)
@click.option(
    "--mollify",
    metavar="N",
    help="Passes that average the normals first; more gives flatter flats and softer edges, "
    "0 suits lightly noisy scans.  [default: 1]",
)
@click.option(
    "--schedule",
    type=click.Choice(["plain", "constant", "multiscale"]),
    help="How the sweeps of al, umbrella and the like go on: alike, with a constant pull to the "
    "data, or multiscale as in msal.  [default: plain]",
)
@click.option(
    "--set",
    "assignments",
    metavar="NAME=VALUE",
    multiple=True,
    help="Any parameter of the method; `msal methods NAME` lists them. Repeatable.",
)
@click.option(
    "--include",
    metavar="PATTERN",
    multiple=True,
    help="Take only files whose path or name matches, such as '*.ply'. Repeatable.",
)
@click.option(
    "--exclude",
    metavar="PATTERN",
    multiple=True,
    help="Leave out files or folders that match. Repeatable; wins over --include.",
)
@click.option(
    "--in-place", is_flag=True, help="Replace the inputs; originals are kept beside them."
)
@click.option(
    "--backup",
    metavar="SUFFIX",
    help=f"With --in-place: what is added to the original's name.  [default: {_DEFAULT_BACKUP}]",
)
@click.option("--no-backup", is_flag=True, help="With --in-place: keep no originals.")
@click.option(
    "--to",
    metavar="FORMAT",
    help="Write another format (ply, obj, stl, off, glb, ...); what it cannot carry is a warning."
    "  [default: that of the input, or of OUT's suffix]",
)
@click.option(
    "--encoding",
    type=click.Choice(["same", "ascii", "binary"]),
    default="same",
    show_default=True,
    help="How the output stores numbers.",
)
@click.option(
    "--precision",
    type=click.Choice(["same", "float32", "float64"]),
    default="same",
    show_default=True,
    help="Bits of the output's positions.",
)
@click.option("--strict", is_flag=True, help="Fail where a conversion loses something.")
@click.option(
    "--format",
    "format",
    metavar="FORMAT",
    help="The inputs' format, where neither their name nor their content tells.",
)
@click.option(
    "-j",
    "--jobs",
    metavar="N|auto",
    default="auto",
    show_default=True,
    callback=words.jobs,
    help="Files at the same time; more is faster and takes more memory. auto is one per core, as "
    "far as memory allows. The results do not depend on it.",
)
@click.option(
    "--timeout",
    metavar="TIME",
    callback=words.duration,
    help="Most time for one file: seconds, or 90s, 5m, 1h.  [default: none]",
)
@click.option(
    "--memory-limit",
    metavar="SIZE",
    callback=words.size,
    help="Most memory for one file and for each worker: 500M, 2G, 1.5GiB.  [default: none]",
)
@click.option(
    "--max-faces",
    metavar="N",
    callback=words.count_from(1),
    help="Refuse files with more faces.  [default: none]",
)
@click.option(
    "--retries",
    metavar="N",
    callback=words.count_from(0),
    help="How often a file is tried again, alone, that was lost to a crash, memory or time.  "
    "[default: 1]",
)
@click.option("--fail-fast", is_flag=True, help="Begin no more files once one has failed.")
@click.option(
    "--max-failures",
    metavar="N",
    callback=words.count_from(1),
    help="Begin no more files once N have failed.  [default: none]",
)
@click.option(
    "--engine",
    type=click.Choice(["workers", "dask"]),
    default="workers",
    show_default=True,
    help="Who does the work: worker processes here, or a Dask cluster (msal-cli[dask]).",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS|local",
    help="With --engine dask: the scheduler, such as tcp://host:8786; local starts a cluster of "
    "-j processes here.",
)
@click.option("--dry-run", is_flag=True, help="List what would be written, and touch nothing.")
@click.option(
    "--force",
    is_flag=True,
    help="Replace files in OUT that msal did not write.",
)
@click.option("--fresh", is_flag=True, help="Denoise again what an earlier run has done already.")
@click.option(
    "--retry-failed",
    is_flag=True,
    help="Try again what failed in an earlier run and would fail again.",
)
@click.option(
    "--shard",
    metavar="K/N|auto",
    help="Take only the K-th of N parts of the files; N such runs do them all, on one machine or "
    "many. auto asks Slurm, AWS Batch or Kubernetes; auto/N gives N where they do not.",
)
@click.option(
    "--report",
    "reports",
    metavar="FILE",
    multiple=True,
    type=_PATH,
    help="Write a record of every file: .json, .jsonl or .csv by suffix. Repeatable.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the JSON report to standard output.")
@click.option("-q", "--quiet", is_flag=True, help="No bar, no summary; only errors.")
@click.option(
    "-v", "--verbose", count=True, help="Tell more: every file and step; -vv tells everything."
)
@click.option(
    "--log-file", metavar="FILE", type=_PATH, help="Append everything, with times, to a file."
)
@click.pass_obj
def command(arguments: tuple[str, ...], /, **options: Any) -> int:
    """Denoise mesh files; the outputs are the inputs with their positions replaced.

    INPUT is a file, a folder (with all its subfolders), a pattern such as 'scans/*.ply', a URL such
    as s3://bucket/scans, or - for standard input. Faces, texture coordinates, colours, properties,
    comments and the order of everything stay as they are. What an earlier run has finished is not
    done again.
    """
    from msal_cli.cli import logs
    from msal_cli.files import urls

    request = Request(**urls.settled_in(options, "inputs", "output", "reports"))
    if request.quiet and request.verbose:
        raise UsageError("--quiet and --verbose contradict each other", hint="give one of them")
    with logs.configured(-1 if request.quiet else request.verbose, request.log_file):
        return _Session(request, arguments).done()


class _Session:
    """One call of the command: what was asked, and what came of it."""

    def __init__(self, request: Request, arguments: tuple[str, ...]) -> None:
        from msal_cli.cli.clock import Clock

        self._request = request
        self._arguments = arguments
        self._clock = Clock()

    def done(self) -> int:
        """Check everything, then work; the exit status."""
        from msal_cli.cli import engines
        from msal_cli.cli.pipe import pipe

        request = self._request
        _refuse_contradictions(request)
        words.check_threads_variable()
        one = pipe(request.inputs, request.output)
        settings = _settings(request)
        if one is not None:
            return self._piped(one, settings)
        plan = _plan(request, settings)
        engine = engines.chosen(request.engine, request.scheduler)
        # The run takes the signals itself, to end its workers in good order.
        return self._run(plan, settings, engine)

    # Streams

    def _piped(self, one: Pipe, settings: Settings) -> int:
        from dataclasses import replace

        from msal_cli.cli import pipe, progress, reports

        request = self._request
        _refuse_for_streams(request, one)
        reports.check(request.reports, [path for path in (one.source, one.target) if path != "-"])
        settings = replace(settings, to=pipe.target_format(one, settings.to))
        bar = progress.stream_bar(one.source, quiet=request.quiet)
        try:
            record = pipe.denoised(one, settings, bar.on_progress, _limits(request))
        finally:
            bar.close()
        _log_record(record)
        return self._concluded(settings, [record])

    # Files

    def _run(self, plan: Plan, settings: Settings, engine: EngineFor | None) -> int:
        from msal_cli.batch import signals
        from msal_cli.batch.events import Finished
        from msal_cli.batch.run import run
        from msal_cli.cli import progress, reports

        request = self._request
        paths = [path for task in (plan.whole or plan).tasks for path in (task.input, task.output)]
        reports.check(request.reports, paths)
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
                limits=_limits(request),
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
        from msal_cli.records import MeshRecord

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
        from msal_cli.cli import reports
        from msal_cli.report import as_json

        request = self._request
        is_given_up = not request.dry_run and any(one.status == "planned" for one in records)
        run = self._described(settings, interrupted or is_given_up)
        self._tell(run, records)
        try:
            if not request.dry_run:
                reports.write(request.reports, run, records)
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
        return exit_codes.of_files(len(records), n_failed, is_given_up=n_left > 0)

    def _tell(self, run: Run, records: Sequence[MeshRecord]) -> None:
        from msal_cli.report import as_text

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
        elif not is_listing:
            talk.say_lines(
                as_text.summary(run, records, width=talk.width(), verbose=request.verbose > 0)
            )

    def _command(self) -> tuple[str, ...]:
        """The command as it was given, for reports and manifests, without passwords."""
        from msal_cli.files import urls

        return ("msal", *map(urls.redacted, self._arguments))

    def _described(self, settings: Settings, interrupted: bool) -> Run:
        from dataclasses import asdict

        from msal_cli import __version__
        from msal_cli.report.document import Run

        return Run(
            version=__version__,
            command=self._command(),
            settings=asdict(settings),
            started=self._clock.started,
            finished=self._clock.now(),
            seconds=self._clock.seconds(),
            interrupted=interrupted,
        )


def _refuse_contradictions(request: Request) -> None:
    from msal_cli.cli import engines

    if request.output is None and not request.in_place and STREAM not in request.inputs:
        raise UsageError(
            "there is no output",
            hint="name a file or a folder with -o OUT, or replace the inputs with --in-place",
        )
    if request.in_place and request.output is not None:
        raise UsageError("--in-place and --output contradict each other", hint="give one of them")
    if request.in_place and request.to is not None:
        raise UsageError(
            "--in-place cannot change the format", hint="name an output with -o to use --to"
        )
    if request.backup is not None and request.no_backup:
        raise UsageError("--backup and --no-backup contradict each other", hint="give one of them")
    engines.refuse_contradictions(
        request.engine, request.scheduler, request.jobs, in_place=request.in_place
    )
    if (request.backup is not None or request.no_backup) and not request.in_place:
        word = "--no-backup" if request.no_backup else "--backup"
        raise UsageError(f"{word} needs --in-place", hint="other inputs are never replaced")
    if request.fail_fast and request.max_failures is not None:
        raise UsageError(
            "--fail-fast and --max-failures contradict each other", hint="give one of them"
        )


def _limits(request: Request) -> Limits:
    from msal_cli.pipeline import Limits

    return Limits(request.timeout, request.memory_limit, request.max_faces)


def _refuse_for_streams(request: Request, one: Pipe) -> None:
    given = {
        "--in-place": request.in_place,
        "--include": request.include,
        "--exclude": request.exclude,
        "--dry-run": request.dry_run,
        "--shard": request.shard,
        "--retry-failed": request.retry_failed,
        "--engine dask": request.engine != "workers",
        "--fail-fast": request.fail_fast,
    }
    # 0 retries are given too.
    given |= {
        word: value is not None
        for word, value in (
            ("--timeout", request.timeout),
            ("--memory-limit", request.memory_limit),
            ("--retries", request.retries),
            ("--max-failures", request.max_failures),
        )
    }
    for word, value in given.items():
        if value:
            raise UsageError(f"{word} is for files, not for standard input or output")
    if request.as_json and one.target == STREAM:
        raise UsageError(
            "the mesh and --json cannot both go to standard output",
            hint="name a file with -o for the mesh, or with --report for the records",
        )


def _settings(request: Request) -> Settings:
    from msal_cli import files, methods, pipeline
    from msal_cli.cli import parameters

    method = methods.find(request.method)
    shortcuts = (
        ("-n", "iterations", request.iterations),
        ("-K", "K", request.factor),
        ("--mollify", "mollify", request.mollify),
        ("--schedule", "schedule", request.schedule),
    )
    given = [
        (f"{option} {value}", name, value) for option, name, value in shortcuts if value is not None
    ]
    given += [parameters.assignment(text) for text in request.assignments]
    return pipeline.Settings(
        method=method.name,
        parameters=parameters.settled(method, given),
        to=words.settled_format(request.to, pipeline.writable_formats, "--to"),
        encoding=request.encoding,
        precision=request.precision,
        strict=request.strict,
        format=words.settled_format(request.format, files.readable_suffixes, "--format"),
    )


def _log_record(record: MeshRecord) -> None:
    """One line of the log per file; a failure is told elsewhere too, so it is no warning here."""
    if record.error is not None:
        why = f"{record.error.code}: {record.error.where}: {record.error.message}"
        _log.info("%s: failed: %s", record.input, why)
        return
    seconds = record.seconds.total if record.seconds is not None else 0.0
    _log.info("%s: %s in %.3f s -> %s", record.input, record.status, seconds, record.output)
    for warning in record.warnings:
        _log.info("%s: %s", record.input, warning)


def _backup_suffix(request: Request) -> str | None:
    if request.no_backup:
        return None
    return _DEFAULT_BACKUP if request.backup is None else request.backup


def _plan(request: Request, settings: Settings) -> Plan:
    from msal_cli.batch import inputs, plan, shards

    output = request.output
    shard = None if request.shard is None else shards.settled(request.shard, os.environ)
    found = inputs.found(request.inputs, request.include, request.exclude, output=output)
    everything = plan.built(
        found,
        output,
        to=settings.to,
        in_place=request.in_place,
        backup=_backup_suffix(request),
        force=request.force,
        fresh=request.fresh,
        retry_failed=request.retry_failed,
    )
    # Everything is checked first, so that each shard refuses what a whole run would.
    return everything if shard is None else shards.part(everything, shard)
