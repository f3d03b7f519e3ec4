"""What the options of ``msal denoise`` mean: its settings, its plan, and what it refuses."""

from __future__ import annotations

import os
import re
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from msal_cli.cli.conflicts import AUTOMATIC, BY_HAND, refuse_conflicts
from msal_cli.cli.options import STREAM, resolve_format
from msal_cli.errors import UsageError
from msal_cli.job.settings import (
    ADAPTIVE,
    AUTO,
    DEFAULT_BACKUP,
    NEGLIGIBLE,
    SELF_INTERSECTIONS,
    Settings,
    writable_formats,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.batch.engine import EngineFactory
    from msal_cli.batch.inputs import DiscoveredInput
    from msal_cli.batch.plan import Plan
    from msal_cli.cli.streams import Stream
    from msal_cli.methods import Method
    from msal_cli.report.gates import Gate

_DEFAULT_METHOD = "msal"
_ADDRESS = r"(?a)([a-z]+://)?(\[[0-9a-fA-F:]+\]|[^\s:/]+):\d+"


class Request(SimpleNamespace):
    """The command line of ``msal denoise``: a field for each of ``denoise_options``, and ``given``,
    which is what ``conflicts.find_given`` found, and ``found``, of
    ``configuration.options_of_found_file``."""


def check_request(request: Request, stream: Stream | None) -> None:
    """Refuse options that do not go with each other, or with ``stream``; UsageError."""
    given = dict(request.given)
    if stream is not None:
        given["stream"] = STREAM
        if stream.target == STREAM:
            given["stdout"] = STREAM
    elif not {"output", "in_place"} & given.keys():
        raise UsageError(
            "there is no output",
            hint="name a file or a folder with -o OUT, or replace the inputs with --in-place",
        )
    refuse_conflicts(given)
    if "scheduler" in given and not re.fullmatch(_ADDRESS, str(request.scheduler)):
        raise UsageError(
            f"--scheduler {request.scheduler}: this is not an address",
            hint="such as tcp://host:8786 or tls://host:8786; to use the cores of this machine, "
            "leave --engine and --scheduler away",
        )
    if "dask" in given:
        import importlib.util

        from msal_cli.batch.dask_cluster import not_installed

        if importlib.util.find_spec("distributed") is None:
            raise not_installed()


def other_files(request: Request) -> list[str]:
    """Files that a report must not replace, beside the meshes."""
    return [path for path in (request.log_file, request.reference) if path is not None]


def refuse_found_targets(request: Request, output_file: str | None) -> None:
    """Refuse what a msal.toml that was found, and may be another person's, must not write.

    ``output_file`` is the output where that is one file, ``-`` for a stream.

    Raises
    ------
    UsageError
        for a file that is there already as the output, for a report outside the output folder or
        in the place of what is no report of msal.
    """
    from msal_cli.cli.side_files import REPORT, refuse_target

    is_stream = output_file == STREAM
    hint = "name it on the command line, or give --config msal.toml if you trust that file"
    is_file = output_file is not None and not is_stream
    if is_file and "output" in request.found and os.path.lexists(str(output_file)):
        raise UsageError(
            f"msal.toml names the output {output_file!r}, which is there already", hint=hint
        )
    if "reports" not in request.found:
        return
    folder = None if is_stream else request.output
    if is_file:
        folder = os.path.dirname(str(output_file)) or os.curdir
    for name in request.reports:
        top = None if folder is None else os.path.realpath(folder)
        if top is None or os.path.commonpath([top, os.path.realpath(name)]) != top:
            raise UsageError(
                f"msal.toml names the report {name!r}, which is outside the output folder",
                hint=hint,
            )
        refuse_target(name, "the report", replaces=REPORT)


def build_engine(request: Request) -> EngineFactory | None:
    """What makes the engine that hands out the files; None is that of worker processes."""
    if request.engine == "workers" or request.scheduler is None:
        return None
    from functools import partial

    from msal_cli.batch.dask_engine import DaskEngine

    return partial(DaskEngine, scheduler=request.scheduler)


def parse_gates(request: Request) -> tuple[Gate, ...]:
    """The gates of --fail-on; UsageError for an expression that means nothing."""
    if not request.fail_on:
        return ()
    from msal_cli.job.records import MeshRecord
    from msal_cli.report import gates

    found = gates.parse_gates(request.fail_on, MeshRecord, request.unit)
    if request.reference is None:
        gates.refuse_without_reference(found, "give --reference TRUTH")
    return found


def find_references(request: Request, names: Sequence[str]) -> tuple[str, ...]:
    """For each input, known by its relative path, the path of its reference; () if none is given
    for.

    Raises
    ------
    UsageError
        if what --reference names is neither file nor folder, or a folder for a stream.
    """
    from msal_cli.storage.urls import is_url

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


def _refuse_without_data_term(method: Method, parameters: dict[str, Any]) -> None:
    """Refuse trust where nothing pulls a vertex back to where it was scanned; UsageError."""
    if method.has_data_term(parameters):
        return
    schedules = any(spec.name == "schedule" for spec in method.parameters)
    raise UsageError(
        f"--weights needs a pull to the scanned positions, and {method.name} has none"
        + (" with --schedule plain" if schedules else ""),
        hint="choose --schedule constant, multiscale, robust or wiener"
        if schedules
        else "choose msal",
    )


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


def build_settings(request: Request, gates: Sequence[Gate]) -> Settings:
    """What decides the bytes of the outputs; UsageError for what no method or format knows."""
    method, parameters = _choose_method(request)
    max_move, lock, min_noise = request.max_move, request.lock, request.min_noise
    weld = request.weld
    if max_move is not None or lock or min_noise is not None or weld is not None:
        from msal_cli.job import constraints

        lock = tuple(str(constraints.parse_lock(one) or constraints.BOUNDARY) for one in lock)
        if max_move is not None:
            max_move = str(constraints.parse_length(max_move, "--max-move", request.unit))
        if weld is not None:
            weld = str(constraints.parse_length(weld, "--weld", request.unit))
        if min_noise is not None and min_noise != NEGLIGIBLE:
            min_noise = str(constraints.parse_length(min_noise, "--min-noise", request.unit))
    fields: tuple[str, ...] = ()
    if request.fields is not None:
        from msal_cli.job.fields import check_names

        fields = check_names(request.fields)
    is_checked = SELF_INTERSECTIONS in request.checks
    if gates and not is_checked:
        from msal_cli.report.gates import names_field

        is_checked = names_field(gates, "self_intersections")
    return Settings(
        method=method,
        parameters=parameters,
        to=resolve_format(request.to, writable_formats, "--to"),
        encoding=request.encoding,
        precision=request.precision,
        strict=request.strict,
        format=resolve_format(request.format),
        max_move=max_move,
        lock=lock,
        weights=request.weights,
        fields=fields,
        min_noise=min_noise,
        checks=(SELF_INTERSECTIONS,) if is_checked else (),
        despike=request.despike,
        tile_set=request.tile_set,
        weld=weld,
    )


def _choose_method(request: Request) -> tuple[str, dict[str, Any]]:
    """The method's name and all its parameters; for ``AUTO`` the wishes."""
    if request.method == AUTO or request.given.keys() & set(AUTOMATIC):
        from dataclasses import asdict

        from msal_cli.auto import Wishes

        wishes = {
            "prefer": request.prefer,
            "keep": request.keep,
            "strength": request.strength,
            "budget": request.auto_budget,
            "assume": request.assume,
        }
        given = {name: value for name, value in wishes.items() if value is not None}
        return AUTO, asdict(Wishes()) | given
    if not request.given.keys() & set(BY_HAND):
        return ADAPTIVE, {} if request.assume is None else {"assume": request.assume}
    from msal_cli import methods
    from msal_cli.cli import method_parameters

    method = methods.find(request.method or _DEFAULT_METHOD)
    shortcuts = (
        ("-n", "iterations", request.iterations),
        ("-K", "K", request.factor),
        ("--mollify", "mollify", request.mollify),
        ("--schedule", "schedule", request.schedule),
    )
    assignments = [
        (f"{option} {value}", name, value) for option, name, value in shortcuts if value is not None
    ]
    assignments += [method_parameters.parse_assignment(text) for text in request.assignments]
    parameters = method_parameters.resolve(method, assignments)
    if request.weights is not None:
        _refuse_without_data_term(method, parameters)
    return method.name, parameters


def build_plan(request: Request, settings: Settings) -> Plan:
    """The files and what becomes of each; UsageError for inputs or outputs that cannot be."""
    from msal_cli.batch import inputs, plan
    from msal_cli.batch import shard as shards

    shard = None if request.shard is None else shards.parse_shard(request.shard, os.environ)
    everything = plan_files(
        request,
        settings,
        inputs.discover_inputs(
            request.inputs, request.include, request.exclude, output=request.output
        ),
    )
    # Everything is checked first, so that each shard refuses what a whole run would.
    return everything if shard is None else plan.select_shard(everything, shard)


def plan_files(request: Request, settings: Settings, found: Sequence[DiscoveredInput]) -> Plan:
    """What becomes of each of these files; UsageError for outputs that cannot be."""
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
        _refuse_taken_names(everything)
    return everything
