"""What a request of ``msal denoise`` means: its contradictions, its settings, its plan."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from msal_cli.cli import auto_options
from msal_cli.cli import option_types as words
from msal_cli.cli.stream_denoise import STREAM
from msal_cli.errors import UsageError
from msal_cli.job.settings import (
    ADAPTIVE,
    AUTO,
    DEFAULT_BACKUP,
    NEGLIGIBLE,
    SELF_INTERSECTIONS,
    Limits,
    Settings,
    writable_formats,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.batch.plan import Plan
    from msal_cli.cli.denoise_arguments import Request
    from msal_cli.cli.stream_denoise import Pipe
    from msal_cli.methods import Method
    from msal_cli.report.gates import Gate

_DEFAULT_METHOD = "msal"


def refuse_contradictions(request: Request) -> None:
    """Refuse options that contradict or need each other; UsageError."""
    from msal_cli.cli import engines

    auto_options.refuse_contradictions(request)
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
    if request.fields and request.in_place:
        raise UsageError(
            "--fields writes a file beside each output, which the next run in place would take for "
            "an input",
            hint="name another folder with -o",
        )
    if request.fail_fast and request.max_failures is not None:
        raise UsageError(
            "--fail-fast and --max-failures contradict each other", hint="give one of them"
        )


def refuse_for_streams(request: Request, one: Pipe) -> None:
    """Refuse what means nothing for a mesh from or to a standard stream; UsageError."""
    given = {
        "--in-place": request.in_place,
        "--include": request.include,
        "--exclude": request.exclude,
        "--dry-run": request.dry_run,
        "--shard": request.shard,
        "--retry-failed": request.retry_failed,
        "--engine dask": request.engine != "workers",
        "--fail-fast": request.fail_fast,
        "--fields": request.fields,
    }
    # 0 retries are given too.
    given |= {
        word: value is not None
        for word, value in (
            ("--retries", request.retries),
            ("--max-failures", request.max_failures),
        )
    }
    for word, value in given.items():
        if value:
            raise UsageError(f"{word} is for files, not for standard input or output")
    if request.reference is not None and one.target == STREAM:
        raise UsageError(
            "--reference measures a file, and the mesh goes to standard output",
            hint="name a file with -o",
        )
    if request.as_json and one.target == STREAM:
        raise UsageError(
            "the mesh and --json cannot both go to standard output",
            hint="name a file with -o for the mesh, or with --report for the records",
        )


def gates_of(request: Request) -> tuple[Gate, ...]:
    """What each file's record is held against; UsageError for an expression that means nothing."""
    if not request.fail_on:
        return ()
    from msal_cli.job.records import MeshRecord
    from msal_cli.report import gates

    found = gates.parsed(request.fail_on, MeshRecord, request.unit)
    if request.reference is None:
        gates.refuse_without_reference(found, "give --reference TRUTH")
    return found


def references_of(request: Request, names: Sequence[str]) -> tuple[str, ...]:
    """For each input, known by its relative path, the path of its reference; () if none is asked
    for.

    Raises
    ------
    UsageError
        if what --reference names is neither file nor folder, or a folder for a stream.
    """
    from msal_cli.codecs import is_url

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


def limits_of(request: Request) -> Limits:
    """What one file may take."""
    return Limits(request.timeout, request.memory_limit, request.max_faces)


def settings_of(request: Request) -> Settings:
    """What decides the bytes of the outputs; UsageError for what no method or format knows."""
    from msal_cli import codecs as files

    method, parameters = _method_of(request)
    max_move, lock = _moves_of(request)
    return Settings(
        method=method,
        parameters=parameters,
        to=words.settled_format(request.to, writable_formats, "--to"),
        encoding=request.encoding,
        precision=request.precision,
        strict=request.strict,
        format=words.settled_format(request.format, files.readable_suffixes, "--format"),
        max_move=max_move,
        lock=lock,
        weights=request.weights,
        fields=_fields_of(request),
        min_noise=_min_noise_of(request),
        checks=_checks_of(request),
        despike=request.despike,
    )


def _method_of(request: Request) -> tuple[str, dict[str, Any]]:
    """The method's name and its settled parameters; with --auto, what is wished for."""
    from msal_cli import methods
    from msal_cli.cli import method_parameters as parameters

    if auto_options.is_asked(request):
        return AUTO, auto_options.wishes_of(request)
    if not auto_options.is_by_hand(request):
        return ADAPTIVE, {}
    method = methods.find(request.method or _DEFAULT_METHOD)
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
    settled = parameters.settled(method, given)
    if request.weights is not None:
        _refuse_without_data_term(method, settled)
    return method.name, settled


def _refuse_without_data_term(method: Method, settled: dict[str, Any]) -> None:
    """Refuse trust where nothing pulls a vertex back to where it was scanned; UsageError."""
    if method.has_data_term(settled):
        return
    schedules = any(spec.name == "schedule" for spec in method.parameters)
    raise UsageError(
        f"--weights needs a pull to the scanned positions, and {method.name} has none"
        + (" with --schedule plain" if schedules else ""),
        hint="choose --schedule constant, multiscale, robust or wiener"
        if schedules
        else "choose msal",
    )


def _moves_of(request: Request) -> tuple[str | None, tuple[str, ...]]:
    """--max-move and --lock in one spelling each; UsageError for what means nothing."""
    if request.max_move is None and not request.lock:
        return None, ()
    from msal_cli.job import constraints

    max_move = None
    if request.max_move is not None:
        max_move = str(constraints.length(request.max_move, unit=request.unit))
    return max_move, tuple(
        str(constraints.lock(one) or constraints.BOUNDARY) for one in request.lock
    )


def _min_noise_of(request: Request) -> str | None:
    """--min-noise in one spelling; UsageError for what means nothing."""

    least = request.min_noise
    if least is None or least == NEGLIGIBLE:
        return least
    from msal_cli.job import constraints

    return str(constraints.length(least, "--min-noise", request.unit))


def _checks_of(request: Request) -> tuple[str, ...]:
    """What is counted for the options, or because a gate names it."""

    is_asked = SELF_INTERSECTIONS in request.checks
    if request.fail_on and not is_asked:
        from msal_cli.report import gates

        is_asked = gates.names_field(gates_of(request), "self_intersections")
    return (SELF_INTERSECTIONS,) if is_asked else ()


def _fields_of(request: Request) -> tuple[str, ...]:
    if not request.fields:
        return ()
    from msal_cli.job import fields

    return fields.checked(request.fields)


def _backup_suffix(request: Request) -> str | None:
    if request.no_backup:
        return None
    return DEFAULT_BACKUP if request.backup is None else request.backup


def _refuse_taken_names(plan: Plan) -> None:
    """Refuse files of fields that would replace each other, an input or an output; UsageError."""
    from msal_cli.job.fields import path_beside

    taken = {path for task in plan.tasks for path in (task.input, task.output)}
    for task in plan.tasks:
        path = path_beside(task.output)
        if path in taken:
            raise UsageError(
                f"the fields of {task.input!r} would be written to {path!r}, which is taken",
                hint="rename one of the files, or run them into two output folders",
                path=task.input,
            )
        taken.add(path)


def plan_of(request: Request, settings: Settings) -> Plan:
    """The files and what becomes of each; UsageError for inputs or outputs that cannot be."""
    from msal_cli.batch import inputs, plan
    from msal_cli.batch import shard as shards

    output = request.output
    shard = None if request.shard is None else shards.parse_shard(request.shard, os.environ)
    found = inputs.discover_inputs(request.inputs, request.include, request.exclude, output=output)
    everything = plan.build_plan(
        found,
        output,
        to=settings.to,
        in_place=request.in_place,
        backup=_backup_suffix(request),
        force=request.force,
        fresh=request.fresh,
        retry_failed=request.retry_failed,
    )
    if settings.fields:
        _refuse_taken_names(everything)
    # Everything is checked first, so that each shard refuses what a whole run would.
    return everything if shard is None else plan.select_shard(everything, shard)
