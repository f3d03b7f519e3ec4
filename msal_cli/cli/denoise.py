"""``msal denoise``: from command-line options to a run, and from its records to text."""

from __future__ import annotations

import logging
import os
import re
import time
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING

from msal_cli.batch import interrupts
from msal_cli.cli import console, options
from msal_cli.cli.command import Request, grouped_command, is_from_found_file, name_file
from msal_cli.cli.options import STREAM, group
from msal_cli.errors import MsalError, OutputError, ResourceError, UsageError, install_hint
from msal_cli.job.settings import (
    AUTO,
    DEFAULT_BACKUP,
    SELF_INTERSECTIONS,
    Limits,
    Settings,
    Task,
    parse,
)
from msal_cli.machine import iso_timestamp, usable_cores
from msal_cli.storage import urls
from msal_cli.storage.urls import is_url
from msal_cli.version import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.batch.inputs import DiscoveredInput
    from msal_cli.batch.plan import Plan
    from msal_cli.batch.schedule import EngineFactory, Event
    from msal_cli.batch.workers import Denoise
    from msal_cli.job.records import MeshRecord, Run
    from msal_cli.report.gates import Gate

_log = logging.getLogger("msal.denoise")


# The options by topic, in two parts: common ones and more

_INPUT_AND_OUTPUT = group(
    "Input and output",
    f"""
-o, --output OUT
    File or folder to write; a folder gets the tree of the inputs. - is standard output, the
    default when INPUT is -.
--in-place
    Replace the inputs; originals are kept beside them.
more:
--backup SUFFIX
    With --in-place: what is added to the original's name. [default: {DEFAULT_BACKUP}]
--no-backup
    With --in-place: keep no originals.
--force
""",
)

HOW_TO_DENOISE = (
    group(
        "What to do",
        """
--method NAME
    How to denoise; `msal methods` lists them, and auto is --auto. [default: adaptive, which
    chooses the parameters of AL and MSAL for each mesh and leaves clean ones alone]
-n, --iterations N
    Sweeps of the method, of msal if none is named. So any number, 4 too, selects the paper's
    filter with its own parameters, and nothing is chosen for the mesh. More is smoother, but not
    for msal: its smoothing fades from sweep to sweep while the pull to the scan stays, so more
    than about 6 sweeps lead back to the input. [default: chosen for each mesh; 4 with --method
    msal]
-K K
    Factor on the smoothing per sweep, of msal if none is named. Greater is smoother, less keeps
    more texture; 0 < K <= 1, for --schedule multiscale or robust. A number selects msal, as with
    -n. [default: chosen for each mesh; 0.5 with --method msal]
more:
--set
--mollify N
    Passes that average the normals first; more gives flatter flats and softer edges, 0 suits
    lightly noisy scans. A number selects msal, as with -n. [default: chosen for each mesh; 1 with
    --method msal]
--schedule [plain|constant|multiscale|robust|wiener]
    How the sweeps of msal, al, umbrella and the like go on: alike, with a constant pull to the
    data, multiscale, robust beside spikes, or with what exceeds the noise restored at the end.
    It selects msal, as -n does. [default: chosen for each mesh; multiscale with --method msal,
    else plain]
--despike/--no-despike
    Bring vertices that lie far off the surface back to it before the method runs. [default: where
    a method is chosen and they are clearly outliers]
--weights PROPERTY
    PLY vertex property, such as confidence, as trust: the pull to the scanned position is scaled
    by it. For msal, and methods with a --schedule other than plain.
--min-noise LEVEL|auto
    Leave meshes as they are whose estimated noise is less everywhere: 0.03e is mean edge lengths,
    0.01 file units; auto where there is none to speak of. [default: none]
""",
        method={"shell_complete": options.complete_method},
        despike={"default": None},
    ),
    group(
        "Automatic choice",
        """
--auto
    Choose method and parameters for each mesh; from its noise and its surface. The report says
    what was chosen, and why. --keep edges or shape imply it.
--keep [texture|edges|shape]
    What must not suffer; fine relief, sharp edges, or the smooth shape beneath the noise.
    [default: as the surface looks]
--strength -2..2
    Greater is smoother, less keeps more; 0 is the automatic choice. [default: 0]
more:
--assume [noise|texture]
    What the roughness of a mesh is where the estimate cannot tell noise from texture; it changes
    nothing where it can. Also without --auto. [default: a mild filter that is not much worse
    either way]
""",
        strength=options.number(-2.0, 2.0),
    ),
    group(
        "Limits on movement",
        """
--max-move LENGTH
    Longest move of a vertex, such as 0.3e; that is mean edge lengths, 0.05 is file units.
    [default: none]
--lock EXPR ...
    Vertices that stay, such as 'boundary' or 'z < 0'; 'confidence < 0.2' compares a PLY vertex
    property with a number. Repeatable.
more:
--unit
""",
    ),
    group(
        "Formats",
        """
more:
--to FORMAT
    Write another format (ply, obj, stl, glb, 3mf, ...); what it cannot carry is a warning.
    [default: that of the input, or of OUT's suffix]
--encoding [same|ascii|binary] = same
    How the output stores numbers.
--precision [same|float32|float64] = same
    Bits of the output's positions.
--strict
    Fail where a conversion loses something.
--format
""",
    ),
)

_MANY_FILES = group(
    "Many files",
    """
--include
--exclude
--jobs
--dry-run
    List what would be written, and touch nothing.
--fresh
more:
--retry-failed
--tile-set
    The files are tiles that touch: denoise them as the one mesh that they are, so that vertices
    which they share stay the same.
--timeout
--memory-limit
--scratch FOLDER
    Folder for the arrays of meshes that exceed the memory. [default: that of the output]
--retries
--fail-fast
--max-failures
--shard K/N
    Take only the K-th of N parts of the files; N such runs do them all, on one machine or many.
--engine [workers|dask] = workers
    Who does the work: worker processes here, or a Dask cluster (msal-cli[dask]).
--scheduler ADDRESS
    With --engine dask: the scheduler, such as tcp://host:8786 or tls://host:8786.
""",
)

_REPORTS = group(
    "Reports",
    """
--report FILE ... -> reports
    Write a record of every file; .json, .jsonl, .csv, .md (Markdown), .xml (JUnit) or .html (a
    page with pictures) by suffix. Repeatable.
--fail-on EXPR ...
    Exit with 4 if this is so for any file; such as 'abs(volume_change) > 1%', 'max_displacement >
    0.5e' (mean edge lengths) or 'flipped_faces > 0'. Repeatable.
--json
more:
--csv-columns
--reference TRUTH
    Measure the outputs against the true mesh, as msal compare does: a file, or a folder whose
    files have the relative paths of the inputs.
--check
--fields
""",
)

MESSAGES_AND_HELP = group(
    options.MESSAGES,
    """
--quiet
-v, --verbose ...
    Show every file and step; -vv shows everything, with times.
""",
)

GROUPS = (_INPUT_AND_OUTPUT, *HOW_TO_DENOISE, _MANY_FILES, _REPORTS, MESSAGES_AND_HELP)


@grouped_command("denoise", *GROUPS, arguments=[options.INPUTS])
def command(request: Request) -> int:
    """Denoise mesh files; nothing but positions changes.

    INPUT is a file, a folder (with all its subfolders), a pattern such as 'scans/*.ply', a URL such
    as s3://bucket/scans, or - for standard input.

    The outputs are the inputs with their positions replaced. Faces, texture coordinates, colours,
    properties, comments and the order of everything stay as they are. What an earlier run has
    finished is not done again.
    """
    return _Session(request).run()


def read_limits(request: Request) -> Limits:
    """What one file may use; UsageError for a wrong number of threads or a missing folder."""
    options.check_threads_variable()
    # The machines of a cluster may have another disk.
    if request.scratch and request.engine != "dask" and not os.path.isdir(request.scratch):
        raise UsageError(f"--scratch {request.scratch}: there is no such folder")
    return Limits(request.timeout, request.memory_limit, request.scratch)


class _Session:
    """One call of the command: its request, and the references of its records."""

    def __init__(self, request: Request) -> None:
        self._request = request
        # For reports and manifests: passwords are removed.
        self._command = ("msal", *map(urls.redact, request.context.obj))
        self._started, self._begun = iso_timestamp(time.time_ns()), time.perf_counter()
        self._stream: Task | None = None
        if STREAM in (*request.inputs, request.output):
            from msal_cli.cli.streams import find_stream

            self._stream = find_stream(request.inputs, request.output)
        check_request(request, self._stream)
        self._limits = read_limits(request)
        self._gates: tuple[Gate, ...] = ()
        if request.fail_on:
            from msal_cli.job.records import MeshRecord
            from msal_cli.report import gates

            self._gates = gates.parse_gates(request.fail_on, MeshRecord, request.unit)
            if request.reference is None:
                gates.refuse_without_reference(self._gates, "give --reference TRUTH")
        # The path of the reference for each record, if there are any.
        self._references: tuple[str, ...] = ()
        # Folders that could not be listed.
        self._unlisted: list[MsalError] = []

    def run(self) -> int:
        """Check everything, then work; returns the exit status."""
        from msal_cli.batch.inputs import discover_inputs
        from msal_cli.batch.plan import Plan
        from msal_cli.job.pipeline import denoise_file

        request, shard = self._request, None
        settings = build_settings(request, self._gates)
        if self._stream is not None:
            from msal_cli.cli.streams import choose_format, denoise_stream

            settings = replace(settings, to=choose_format(self._stream.output, settings.to))
            return self._run_plan(Plan((self._stream,)), settings, denoise_stream)
        if request.shard is not None:
            from msal_cli.batch.lock import parse_shard

            shard = parse_shard(request.shard)
        patterns = request.include, request.exclude
        unlisted = None if request.tile_set or request.in_place else self._unlisted
        found = discover_inputs(request.inputs, *patterns, output=request.output, failures=unlisted)
        # Check all files, so that each shard refuses what a whole run would refuse.
        plan = plan_files(request, settings, found)
        plan = plan if shard is None else plan.select_shard(shard)
        return self._run_plan(plan, settings, denoise_file)

    def _run_plan(self, plan: Plan, settings: Settings, denoise: Denoise) -> int:
        from msal_cli.batch.run import run
        from msal_cli.batch.schedule import Finished
        from msal_cli.cli import progress

        request = self._request
        engine: EngineFactory | None = None
        if request.engine == "dask" and request.scheduler is not None:
            from msal_cli.batch.dask import DaskEngine

            engine = partial(DaskEngine, scheduler=request.scheduler)
        whole = plan.whole or plan
        tasks = whole.tasks
        # A msal.toml that was found may be another user's.
        is_found = not whole.folders() and is_from_found_file(request.context, "output")
        if is_found and os.path.lexists(tasks[0].output):
            raise UsageError(
                f"msal.toml names the output {tasks[0].output!r}, which is there already",
                hint="name it on the command line, or give --config msal.toml if you trust it",
            )
        if request.reports:
            from msal_cli.cli import report_files

            paths = [path for task in tasks for path in (task.input, task.output)]
            paths += [task.backup_path for task in tasks if task.in_place and task.backup]
            paths += [request.reference] if request.reference else []
            report_files.check(request.reports, paths)
        self._references = _find_references(request, [task.relative for task in plan.tasks])
        finished: dict[int, MeshRecord] = {}
        _log.info("files: %s, method %s %s", len(plan.tasks), settings.method, settings.parameters)
        if plan.shard is not None and not request.quiet:
            console.say(f"shard {plan.shard}: {len(plan.tasks):,} of {len(tasks):,} files")
        bar = progress.bar(plan.tasks, quiet=request.quiet or request.dry_run, is_set=plan.is_set)

        def on_event(event: Event) -> None:
            if isinstance(event, Finished):
                finished[event.index] = event.record
                log_record(event.record)
            bar.on_event(event)

        try:
            # The run handles signals itself, to end its workers properly.
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
                denoise=denoise,
                engine=engine,
            )
        except (KeyboardInterrupt, OutputError, ResourceError):
            bar.close()
            self._report_partly(settings, plan, finished)
            raise
        finally:
            bar.close()
        if plan.is_set and request.dry_run and not request.quiet:
            from msal_cli.batch.tile_set import memory_of_set
            from msal_cli.machine import megabytes

            needed = megabytes(memory_of_set(plan.tasks, settings))
            console.say(f"as one mesh they take up to {needed} of memory")
        with interrupts.catch_signals():
            return self._conclude(settings, records)

    def _report_partly(
        self, settings: Settings, plan: Plan, finished: dict[int, MeshRecord]
    ) -> None:
        """Report what was done before the run was ended; the rest is ``planned``.

        No error here hides why the run was ended.
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
        """Measure, print, write the reports, and return the exit status."""
        from msal_cli.job.records import Failure, MeshRecord, Run
        from msal_cli.report import facts

        request = self._request
        is_dry = request.dry_run
        n_left = 0 if is_dry else sum(record.status == "planned" for record in records)
        run = Run(
            version=__version__,
            command=self._command,
            settings=asdict(settings),
            started=self._started,
            finished=iso_timestamp(time.time_ns()),
            seconds=time.perf_counter() - self._begun,
            interrupted=interrupted or n_left > 0,
            machine=describe_machine() if request.reports or request.as_json else {},
        )
        is_broken = False
        if self._references and not is_dry and not interrupted:
            from msal_cli.job.comparison import with_references

            records = with_references(records, self._references, settings.format)
        if self._unlisted:
            unlisted = ((error.path, Failure.of(error)) for error in self._unlisted)
            records = [*records, *(MeshRecord(path, "failed", error=e) for path, e in unlisted)]
        if self._gates and not is_dry:
            from msal_cli.report.gates import with_gates

            records = with_gates(self._gates, records)
            is_broken = any(map(facts.list_broken, records))
        self._print(run, records)
        try:
            if is_dry and request.reports:
                console.say("dry run: no report is written")
            elif not is_dry and (request.reports or "GITHUB_ACTIONS" in os.environ):
                from msal_cli.cli import report_files

                report_files.annotate(records)
                report_files.write(
                    request.reports,
                    run,
                    records,
                    backup=request.backup,
                    csv_columns=request.csv_columns,
                    without_pictures=interrupted,
                    quiet=request.quiet,
                )
        finally:
            if request.as_json:
                from msal_cli.report import data

                console.put_bytes(data.render_json(run, records))
        n_failed = sum(record.status == "failed" for record in records)
        if n_left and not interrupted:
            failures = "1 failure" if n_failed == 1 else f"{n_failed:,} failures"
            console.say(f"stopped after {failures}; {n_left:,} files were not begun")
        return console.status_of_files(
            len(records), n_failed, is_gate_failed=is_broken, is_given_up=n_left > 0
        )

    def _print(self, run: Run, records: Sequence[MeshRecord]) -> None:
        from msal_cli.report import text

        request = self._request
        is_listing = request.dry_run and not request.as_json
        if is_listing:
            console.put_lines(text.listing(records))
            if not request.quiet and len(records) > 1:
                console.say_lines([text.outlook(records, request.jobs or usable_cores())])
        if len(records) == 1 and records[0].error is not None:
            console.say_failure(records[0].input, records[0].error)
            if records[0].remembered:
                console.say(f"it {text.remembered_text()}")
        elif request.quiet:
            console.say_lines(text.list_problems(records, False, "Failed", "Broken gates"))
        elif not is_listing:
            console.say_summary(run, records, verbose=request.verbose > 0)
        elif failed := [(record.input, record.error) for record in records if record.error]:
            count = f"{len(failed):,} of {len(records):,} files would fail"
            console.say_failure(f"{count}, the first is {failed[0][0]}", failed[0][1])


_ADDRESS = r"(?a)([a-z]+://)?(\[[0-9a-fA-F:]+\]|[^\s:/]+):\d+"


def check_request(request: Request, stream: Task | None) -> None:
    """Raise UsageError for options that contradict or need each other, or ``stream``."""
    given = options.find_given(request.context)
    if stream is not None:
        given["stream"] = STREAM
        if stream.output == STREAM:
            given["stdout"] = STREAM
    elif not {"output", "in_place"} & given.keys():
        raise UsageError(
            "there is no output",
            hint="name a file or a folder with -o OUT, or replace the inputs with --in-place",
        )
    options.refuse_conflicts(given)
    if "scheduler" in given and not re.fullmatch(_ADDRESS, str(request.scheduler)):
        raise UsageError(
            f"--scheduler {request.scheduler}: this is not an address",
            hint="such as tcp://host:8786 or tls://host:8786; to use the cores of this machine, "
            "leave --engine and --scheduler away",
        )
    if "dask" in given:
        import importlib.util

        if importlib.util.find_spec("distributed") is None:
            raise UsageError("Dask is not installed", hint=install_hint("dask"))


def _find_references(request: Request, names: Sequence[str]) -> tuple[str, ...]:
    """For each input, by its relative path, the path of its reference; () if there is none."""
    truth = request.reference
    if truth is None:
        return ()
    if is_url(truth):
        return tuple(truth + name if truth.endswith("/") else truth for name in names)
    if os.path.isdir(truth):
        if STREAM in request.inputs or request.output == STREAM:
            raise UsageError(
                "a stream has no name to look for in a folder", hint="name the reference's file"
            )
        return tuple(os.path.join(truth, name) for name in names)
    if not os.path.isfile(truth):
        raise UsageError(f"there is no file or folder {truth!r} to measure against")
    return (truth,) * len(names)


def build_settings(request: Request, gates: Sequence[Gate]) -> Settings:
    """The settings that decide the bytes of the outputs; UsageError for invalid ones."""
    given = {**vars(request), "method": AUTO if request.auto else request.method}
    given["parameters"] = [
        (f"{option} {given[name]}", name, given[name])
        for name, option in options.SHORTCUTS.items()
        if given[name] is not None
    ] + [options.parse_assignment(text) for text in request.assignments]
    given["intersections"] = SELF_INTERSECTIONS in request.checks
    if gates and not given["intersections"]:
        from msal_cli.report.gates import need_intersections

        given["intersections"] = need_intersections(gates)
    try:
        return parse(given, as_options=True)
    except UsageError as error:
        name_file(request.context, error, is_on_method=True)
        raise


def plan_files(request: Request, settings: Settings, found: Sequence[DiscoveredInput]) -> Plan:
    """Plan the outputs of these files; UsageError for outputs that are impossible."""
    from msal_cli.batch import plan

    backup = DEFAULT_BACKUP if request.backup is None else request.backup
    everything = plan.build_plan(
        found,
        request.output,
        to=settings.to,
        in_place=request.in_place,
        backup=None if request.no_backup else backup,
        force=request.force,
        fresh=request.fresh,
        retry_failed=request.retry_failed,
        is_set=request.tile_set,
    )
    if settings.fields:
        from msal_cli.job.fields import path_beside

        used = {path for task in everything.tasks for path in (task.input, task.output)}
        for task in everything.tasks:
            path = path_beside(task.output)
            if path in used:
                raise UsageError(
                    f"the fields of {task.input!r} would be written to {path!r}, which is taken",
                    hint="rename one of the files, or run them into two output folders",
                    path=task.input,
                )
            used.add(path)
    return everything


def log_record(record: MeshRecord) -> None:
    """Log one line for a file; a failure is printed elsewhere, so it is no warning here."""
    if _log.isEnabledFor(logging.INFO):
        from msal_cli.report.text import file_text

        _log.info("%s: %s", record.input, file_text(record))


def describe_machine() -> dict[str, str]:
    """System, cores and versions by name; nothing that identifies the user or the host."""
    import platform
    from importlib import metadata

    facts = {
        "system": f"{platform.system()} {platform.release()}".strip(),
        "processor": platform.machine(),
        "cores": f"{usable_cores()} of {os.cpu_count() or 1}",
        "python": platform.python_version(),
    }
    for name in ("numpy", "trimesh", "meshio"):
        with suppress(metadata.PackageNotFoundError):
            facts[name] = metadata.version(name)
    return {name: value for name, value in facts.items() if value}
