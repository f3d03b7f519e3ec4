"""``denoise_file`` and ``denoise_folder``."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Generator, Mapping, Sequence
from functools import partial
from typing import Any, Unpack

from msal_cli.api.denoise import parse_arguments
from msal_cli.api.mesh_objects import explained_errors
from msal_cli.api.method_list import MethodName, MethodParameters
from msal_cli.batch.inputs import discover_inputs
from msal_cli.batch.interrupts import Cancellation
from msal_cli.batch.plan import build_plan
from msal_cli.batch.run import check_options, run
from msal_cli.batch.schedule import Event, Finished
from msal_cli.errors import UsageError
from msal_cli.job.pipeline import FileRun
from msal_cli.job.records import MeshRecord
from msal_cli.job.settings import (
    DEFAULT_BACKUP,
    Assumption,
    Encoding,
    Keep,
    Limits,
    Precision,
    Preference,
    Settings,
    to_texts,
)
from msal_cli.report.gates import (
    Gate,
    names_field,
    parse_gates,
    refuse_without_reference,
    with_gates,
)

Path = str | os.PathLike[str]


def denoise_file(
    input: Path,
    output: Path,
    method: MethodName | None = None,
    *,
    prefer: Preference | None = None,
    keep: Keep | None = None,
    strength: float | None = None,
    assume: Assumption | None = None,
    max_move: str | float | None = None,
    lock: str | Sequence[str] = (),
    weights: str | None = None,
    despike: bool | None = None,
    min_noise: str | float | None = None,
    unit: str | None = None,
    intersections: bool = False,
    to: str | None = None,
    encoding: Encoding = "same",
    precision: Precision = "same",
    strict: bool = False,
    format: str | None = None,
    fail_on: str | Sequence[str] = (),
    parameters: Mapping[str, Any] | None = None,
    **more: Unpack[MethodParameters],
) -> MeshRecord:
    """Denoise one mesh file; the output is the input with its positions replaced.

    The same bytes as ``msal denoise INPUT -o OUTPUT``.  The output appears whole or not at all.

    Parameters
    ----------
    input : a mesh file of any format that msal reads (docs/formats.md), or a URL.
    output : the file to write; one that is there is replaced.  Its suffix decides the format.
    method, prefer, keep, strength, assume, max_move, despike, min_noise, unit, parameters,
    more : as for ``denoise``.
    lock : ``"boundary"``, or a PLY vertex property compared with a number, such as
        ``"confidence < 0.2"``; several in a list add up.
    weights : a PLY vertex property, such as ``"confidence"``, as trust.
    intersections : also count the pairs of faces that intersect each other, which takes longer.
    to, encoding, precision : the output's format where its suffix does not say it; ``"ascii"`` or
        ``"binary"``; ``"float32"`` or ``"float64"``.  ``"same"`` keeps what the input has.
    strict : raise LossError where another format would lose something, instead of a warning.
    format : the input's format where its name does not show it.
    fail_on : gates such as ``"abs(volume_change) > 1%"`` (docs/gates.md); what became of each is in
        ``record.gates``.  A broken gate raises nothing.

    Returns
    -------
    MeshRecord: what was read, done, measured and written; docs/report.md explains all fields.

    Raises
    ------
    UsageError
        for arguments that mean nothing or exclude each other, and an output that cannot be.
    InputError
        where the input is at fault; ``error.code`` says how (docs/formats.md lists the codes).
    LossError, OutputError, ResourceError, InternalError
        as in ``msal_cli.errors``.
    """
    given = locals()
    source, target = os.fsdecode(input), os.fsdecode(output)
    with explained_errors(path=source):
        gates, settings = _parse(denoise_file, given)
        plan = build_plan(discover_inputs([source], output=target), target, to=settings.to)
        if len(plan.tasks) != 1 or plan.folders():
            raise UsageError(
                f"{source!r} into {target!r} is not one file into one file",
                hint="denoise_folder takes folders",
            )
        task = plan.tasks[0]
        file = FileRun(task.input, settings)
        data = file.read(task)
        record = file.write(task, data, file.denoise(data, task.output))
        return with_gates(gates, [record])[0]


def denoise_folder(
    inputs: Path | Sequence[Path],
    output: Path | None = None,
    method: MethodName | None = None,
    *,
    prefer: Preference | None = None,
    keep: Keep | None = None,
    strength: float | None = None,
    assume: Assumption | None = None,
    max_move: str | float | None = None,
    lock: str | Sequence[str] = (),
    weights: str | None = None,
    despike: bool | None = None,
    min_noise: str | float | None = None,
    unit: str | None = None,
    intersections: bool = False,
    to: str | None = None,
    encoding: Encoding = "same",
    precision: Precision = "same",
    strict: bool = False,
    format: str | None = None,
    fail_on: str | Sequence[str] = (),
    include: str | Sequence[str] = (),
    exclude: str | Sequence[str] = (),
    in_place: bool = False,
    backup: str | None = DEFAULT_BACKUP,
    jobs: int | None = None,
    timeout: float | None = None,
    memory_limit: int | None = None,
    retries: int = 1,
    max_failures: int | None = None,
    force: bool = False,
    fresh: bool = False,
    retry_failed: bool = False,
    parameters: Mapping[str, Any] | None = None,
    **more: Unpack[MethodParameters],
) -> Generator[MeshRecord, None, None]:
    """Denoise all mesh files of a folder; iterate the records as files finish.

    Arguments are checked and files are found at once; the work begins with the first record that
    is asked for, so ``list(...)`` does it all.  A file that fails is a record with ``status``
    ``"failed"`` and an ``error``, and the others go on.  What an earlier run has finished is not
    done again (``"up-to-date"``).  Outputs and manifest are those of ``msal denoise``, which can
    continue such a run, and the other way round.

    Files are done by worker processes; no signal is taken, so that it works in notebooks and in any
    thread.  Leaving the loop early, by ``break``, Ctrl-C or ``close()``, ends the run: finished
    files are whole and recorded, and the same call goes on from there.

    Parameters
    ----------
    inputs : a folder with its subfolders, a file, a pattern such as ``"scans/*.ply"``, a URL; or
        several of them.
    output : the folder to write, which gets the tree of the inputs; not with ``in_place``.
    method to fail_on, parameters, more : as for ``denoise_file``.
    include, exclude : patterns of files to take or to leave out, such as ``"*.ply"``.
    in_place : replace the inputs.
    backup : with ``in_place``, what is added to the names of the originals, which are kept beside
        them; None keeps none.
    jobs : files at the same time: more is faster and takes more memory.  None is one per core, as
        far as memory allows.  The results do not depend on it.
    timeout, memory_limit : seconds and bytes that one file may take; None is no limit.
    retries : how often a file is tried again that was lost to a crash, memory or time.
    max_failures : begin no more files once so many have failed.
    force : replace files in the output folder that no run of msal put there.
    fresh : do again what an earlier run has finished.
    retry_failed : try again what failed in an earlier run and would fail again.

    Returns
    -------
    A generator of MeshRecord, one per file, in the order in which they finish.

    Raises
    ------
    UsageError
        for arguments that mean nothing or exclude each other, inputs or outputs that cannot be;
        with the first record also ``E_LOCKED``, where another run works on the output.
    NothingMatched
        where the inputs hold no mesh file.
    OutputError, ResourceError
        while iterating, where the output cannot be written, or no worker can be started.
    """
    given = locals()
    paths = [inputs] if isinstance(inputs, str | os.PathLike) else inputs
    sources = [os.fsdecode(path) for path in paths]
    with explained_errors(", ".join(sources)):
        limits = Limits(timeout, memory_limit)
        check_options(limits, jobs, retries, max_failures)
        gates, settings = _parse(denoise_folder, given)
        target = None if output is None else os.fsdecode(output)
        plan = build_plan(
            discover_inputs(sources, to_texts(include), to_texts(exclude), output=target),
            target,
            to=settings.to,
            in_place=in_place,
            backup=backup,
            force=force,
            fresh=fresh,
            retry_failed=retry_failed,
        )
        work = partial(
            run,
            plan,
            settings,
            jobs=jobs,
            limits=limits,
            retries=retries,
            stop_after_failures=max_failures,
            command=("msal_cli.denoise_folder", *sources),
        )
        return _iterate_records(work, gates)


def _parse(
    function: Callable[..., Any], given: Mapping[str, Any]
) -> tuple[tuple[Gate, ...], Settings]:
    """The gates and the settings of a call; gates may need intersections to be counted."""
    gates = parse_gates(to_texts(given["fail_on"]), MeshRecord, given["unit"])
    refuse_without_reference(gates, "measure it with msal_cli.compare")
    is_checked = given["intersections"] or names_field(gates, "self_intersections")
    return gates, parse_arguments(function, {**given, "intersections": is_checked})


def _iterate_records(
    work: Callable[..., Any], gates: Sequence[Gate]
) -> Generator[MeshRecord, None, None]:
    """The records of ``work``, a ``batch.run.run``, in the order in which files finish, with the
    results of the gates; what it raises is raised here, and explained.

    The run has a thread of its own and takes no signals, since Python gives these to the main
    thread only; files are done in worker processes that can be ended at any time.
    Where the iteration is left early, by ``close`` or an exception such as Ctrl-C's, the run is
    ended first: its workers are gone, and finished files are whole and recorded.
    """
    cancellation = Cancellation()
    messages: queue.SimpleQueue[MeshRecord | BaseException | None] = queue.SimpleQueue()

    def on_event(event: Event) -> None:
        cancellation.check()
        if isinstance(event, Finished):
            messages.put(event.record)

    def run_in_thread() -> None:
        try:
            work(on_event=on_event, cancellation=cancellation)
            messages.put(None)
        except BaseException as error:
            messages.put(error)

    thread = threading.Thread(target=run_in_thread, name="msal", daemon=True)
    thread.start()
    with explained_errors("the run"):
        try:
            while True:
                try:
                    # Windows delivers Ctrl-C to a waiting thread only between two waits.
                    message = messages.get(timeout=0.2 if os.name == "nt" else None)
                except queue.Empty:
                    continue
                if message is None:
                    return
                if isinstance(message, BaseException):
                    raise message
                yield with_gates(gates, [message])[0]
        finally:
            cancellation.request()
            thread.join()
