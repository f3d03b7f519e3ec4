"""What the options of ``msal denoise`` mean: its settings, its plan, and what it refuses."""

from __future__ import annotations

import os
import re
from types import SimpleNamespace
from typing import TYPE_CHECKING

from msal_cli.cli.conflicts import refuse_conflicts
from msal_cli.cli.options import SHORTCUTS, STREAM, parse_assignment
from msal_cli.errors import UsageError
from msal_cli.job.settings import AUTO, DEFAULT_BACKUP, SELF_INTERSECTIONS, Settings, parse

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.batch.engine import EngineFactory
    from msal_cli.batch.inputs import DiscoveredInput
    from msal_cli.batch.plan import Plan
    from msal_cli.cli.streams import Stream
    from msal_cli.report.gates import Gate

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

        from msal_cli.batch.dask import not_installed

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

    from msal_cli.batch.dask import DaskEngine

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
    given = {**vars(request), "method": AUTO if request.auto else request.method}
    given["parameters"] = [
        (f"{option} {given[name]}", name, given[name])
        for name, option in SHORTCUTS.items()
        if given[name] is not None
    ] + [parse_assignment(text) for text in request.assignments]
    given["intersections"] = SELF_INTERSECTIONS in request.checks
    if gates and not given["intersections"]:
        from msal_cli.report.gates import names_field

        given["intersections"] = names_field(gates, "self_intersections")
    return parse(given, as_options=True)


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
