"""``denoise`` for vertices and faces or a mesh object of another library, ``denoise_file`` and
``denoise_folder``; and ``list_methods``, which these can use."""

from __future__ import annotations

import difflib
import logging
import os
import queue
import threading
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypedDict, TypeVar, Unpack, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from msal_cli.api import mesh_objects
from msal_cli.api.mesh_objects import explained_errors, name_arguments
from msal_cli.batch.inputs import discover_inputs
from msal_cli.batch.interrupts import Cancellation
from msal_cli.batch.plan import build_plan
from msal_cli.batch.run import check_options, run
from msal_cli.batch.schedule import Event, Finished
from msal_cli.errors import UsageError
from msal_cli.job.pipeline import FileRun
from msal_cli.job.records import Displacement, MeshRecord, NoiseEstimate
from msal_cli.job.settings import (
    DEFAULT_BACKUP,
    METRES,
    Assumption,
    Encoding,
    Keep,
    Limits,
    Precision,
    Settings,
    parse,
    to_texts,
)
from msal_cli.light_dataclass import screen_repr
from msal_cli.report.gates import (
    Gate,
    need_intersections,
    parse_gates,
    refuse_without_reference,
    with_gates,
)

MeshObject = TypeVar("MeshObject")
Path = str | os.PathLike[str]

_log = logging.getLogger("msal.api")

_MASK, _TRUST = "(lock)", "(weights)"
"""Properties for arrays that are given as these arguments; no library has such names."""

MethodName = Literal[
    "adaptive", "auto", "al", "anisotropic_diffusion", "bilateral", "bilateral_non_iterative",
    "bilateral_normal", "blend", "guided_normal", "hc", "hybrid", "l0", "learned",
    "mean_curvature_flow", "msal", "normal_diffusion", "normal_threshold",
    "scale_dependent_umbrella", "static_dynamic", "taubin", "umbrella", "wiener", "windowed_sinc",
]  # fmt: skip
"""``adaptive`` and ``auto`` stand for a choice; the others are methods (``list_methods``)."""

MethodParameters = TypedDict("MethodParameters", {  # noqa: UP013 - a class needs a line for each
    "alpha": float, "areas": str, "beta": float, "boundary": str, "c": float, "caution": float,
    "closeness": float, "clusters": int, "crease_angle_deg": float, "deviation": str, "eta": float,
    "falloff": float, "fidelity": float, "guidance": float, "inflate": float, "iterations": int,
    "K": float, "k_PB": float, "levels": str, "line": str, "members": str, "mollify": int,
    "mu": float, "n": int, "neighbours": str, "noise": float, "normal_iterations": int,
    "normals": str, "nu": float, "pass_band": float, "presmooth": int, "q": float,
    "quantile": float, "r": float, "radius": float, "regularity": float, "regularize": float,
    "relax": int, "rho": float, "scaled_step": float, "scaling": str, "scan_share": float,
    "schedule": str, "shape": str, "share": float, "shrink": float, "sigma_c": float,
    "sigma_f": float, "sigma_g": float, "sigma_r": float, "sigma_s": float, "similarity": float,
    "sliding": str, "sparsity": float, "T": float, "tau": float, "texture": str, "threshold": float,
    "time_step": float, "tolerance_deg": float, "variant": str, "vertex_iterations": int,
    "volume": str,
}, total=False)  # fmt: skip
"""Parameters of methods by name or symbol; ``list_methods`` says which method has which.

Names that Python or the functions use themselves, such as ``lambda`` and ``weights``, are missing:
give them in ``parameters``."""


@dataclass(frozen=True, eq=False, repr=False)
class DenoiseResult:
    """Denoised positions, and a record of what was done.

    Attributes
    ----------
    vertices : (n, 3) new positions in the order and the number type of the given ones (float64 for
        whole numbers).  The array is new; the given one is not changed.
    record : all figures, as in the reports of the command.  Lengths are in the unit of the
        vertices, or in mean edge lengths if the name ends in ``_edges``.
    """

    vertices: mesh_objects.Array
    record: MeshRecord

    @property
    def method(self) -> str:
        """Name of the method that ran; ``none`` if the mesh was left unchanged."""
        return "none" if self.record.method is None else self.record.method.name

    @property
    def parameters(self) -> dict[str, Any]:
        """Every parameter of the method, defaults included."""
        return {} if self.record.method is None else dict(self.record.method.parameters)

    @property
    def reason(self) -> str:
        """Why this method was chosen, or why nothing was done; empty if you named the method."""
        choice = self.record.choice
        reason = self.record.left_alone or ("" if choice is None else choice.reason)
        return name_arguments(reason)

    @property
    def noise(self) -> NoiseEstimate:
        """The noise of the given mesh."""
        assert self.record.noise_estimate is not None
        return self.record.noise_estimate

    @property
    def displacement(self) -> Displacement:
        """How far vertices moved."""
        assert self.record.displacement is not None
        return self.record.displacement

    @property
    def warnings(self) -> tuple[str, ...]:
        """Problems that did not prevent denoising."""
        return tuple(map(name_arguments, self.record.warnings))

    def __repr__(self) -> str:
        moved = self.record.displacement
        facts = {
            "vertices": f"{self.vertices.dtype}{list(self.vertices.shape)}",
            "method": self.method,
            "parameters": self.parameters,
            "reason": self.reason,
            "noise": self.noise.words,
            "displacement": moved and f"mean {moved.mean_edges:.3g} e, max {moved.max_edges:.3g} e",
            "warnings": self.warnings,
        }
        return screen_repr("DenoiseResult", facts)


class _Options(MethodParameters, total=False):
    """The keyword arguments of ``denoise``, for type checkers."""

    keep: Keep | None
    strength: float | None
    assume: Assumption | None
    max_move: str | float | None
    lock: str | Sequence[str] | ArrayLike | None
    weights: str | ArrayLike | None
    despike: bool | None
    min_noise: str | float | None
    unit: str | None
    parameters: Mapping[str, Any] | None


@overload
def denoise(
    vertices: ArrayLike,
    faces: ArrayLike,
    method: MethodName | None = None,
    **options: Unpack[_Options],
) -> DenoiseResult: ...


@overload
def denoise(
    vertices: MeshObject, *, method: MethodName | None = None, **options: Unpack[_Options]
) -> MeshObject: ...


def denoise(
    vertices: Any,
    faces: Any = None,
    method: MethodName | None = None,
    *,
    keep: Keep | None = None,
    strength: float | None = None,
    assume: Assumption | None = None,
    max_move: str | float | None = None,
    lock: str | Sequence[str] | ArrayLike | None = None,
    weights: str | ArrayLike | None = None,
    despike: bool | None = None,
    min_noise: str | float | None = None,
    unit: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    **more: Unpack[MethodParameters],
) -> Any:
    """Remove the noise of a triangle mesh; vertices and faces keep their number and order.

    Without a method the result is that of ``msal denoise``, bit for bit: the noise is estimated,
    parameters of AL and MSAL are chosen for it, and a mesh without noise stays unchanged.  Vertices
    at one position move together, so seams stay closed.  No argument is modified.

    Parameters
    ----------
    vertices : (n, 3) real numbers, positions in any unit of length; or a mesh object in place of
        vertices and faces: trimesh.Trimesh, pyvista.PolyData, meshio.Mesh, or a TriangleMesh of
        open3d.  Quads and polygons are cut into triangles for the computation only.
    faces : (m, 3) integers, the vertices of each triangle, counted from 0.
    method : name of a method (``msal methods`` lists them).  None, which is ``"adaptive"``, chooses
        parameters of AL and MSAL; ``"auto"`` chooses among all methods and their mixtures, which
        takes longer and comes closer to the true surface.  With parameters, None is ``"msal"``.
    keep : what must be preserved: ``"texture"`` (fine relief), ``"edges"`` (sharp ones) or
        ``"shape"`` (the smooth shape beneath the noise); the last two imply ``method="auto"``.
    strength : -2 to 2, relative to the choice: greater is smoother, less keeps more.
    assume : ``"noise"`` or ``"texture"``: what the roughness of the mesh is if the estimate cannot
        tell (``noise.unsure``); else it has no effect.  None takes a mild filter that is not much
        worse either way.  For every choice, also without ``"auto"``.
    max_move : longest move of a vertex: ``"0.3e"`` is in mean edge lengths, a number in the unit of
        the vertices, ``"0.1mm"`` a length if ``unit`` is given.  Less stays closer to the input.
    lock : vertices that stay where they are: a mask (n,), indices (k,), ``"boundary"``,
        ``"z < 0"``, or (for a mesh object with such an array) ``"confidence < 0.2"``; a list of
        texts locks what any of them selects.
    weights : (n,) trust in each scanned position, or the name of such an array of a mesh object: a
        greater trust pulls more towards that position, 0 does not.  Values are relative to the
        largest.  For methods with a pull to the data: msal, and schedules other than plain.
    despike : True brings outlier vertices back to the surface first, False does not; None does so
        if a method is chosen and they are clearly outliers.
    min_noise : leave the mesh unchanged if its estimated noise is less: a length as ``max_move``,
        or ``"auto"`` for no noise to speak of.
    unit : unit of the vertices, such as ``"mm"``, for lengths with a unit.
    parameters, more : parameters of the method by name or symbol, such as ``K=0.5`` (greater is
        smoother) or ``iterations=4``; ``msal methods NAME`` explains them.  ``parameters`` is for
        names that Python or this function uses itself: ``parameters={"lambda": 0.1}``.

    Returns
    -------
    DenoiseResult for vertices and faces: new positions and figures.  For a mesh object a copy of
    the same type with colours, texture coordinates, data, metadata, and updated normals.

    Raises
    ------
    UsageError
        for arguments that are invalid, unknown, or exclude each other.
    ContentError, InputError, UnsupportedError
        for data that are not a mesh, lack a named array, or have cells that are not polygons;
        ``error.code`` says which (docs/formats.md lists the codes).
    ResourceError
        if there is not enough memory.

    Notes
    -----
    Positions are computed in float64.  The default methods are those of H. Huang and U. Ascher,
    Fast denoising of surface meshes with intrinsic texture, Inverse Problems 24 (2008): AL is eq.
    (5), MSAL Algorithm 1, with

        x_i <- x_i + tau d_i n_i + lambda_i (v_i - x_i)     eq. (2)

    tau = K^j (6) and lambda_i = sigma_i / max sigma (7); ``weights`` scale lambda.  ``"adaptive"``
    and ``"auto"`` take the candidate with the least estimated error (docs/auto.md).

    Examples
    --------
    >>> import msal_cli as msal
    >>> result = msal.denoise(vertices, faces, "msal", K=0.4, max_move="0.5e")  # doctest: +SKIP
    >>> result.vertices.shape, result.displacement.max_edges  # doctest: +SKIP
    """
    given = locals()
    with explained_errors():
        mesh = mesh_objects.read_mesh(vertices, faces)
        is_text = isinstance(lock, list | tuple) and lock and all(isinstance(k, str) for k in lock)
        if not (lock is None or isinstance(lock, str) or is_text):
            mesh.properties[_MASK] = _as_mask(lock, len(mesh.vertices))
            given["lock"] = f"{_MASK} != 0"
        if not (weights is None or isinstance(weights, str)):
            values = mesh_objects.as_array(weights, "weights", UsageError)
            if values.shape != (len(mesh.vertices),) or values.dtype.kind not in "fiub":
                raise UsageError(
                    f"weights: {values.dtype} of shape {values.shape}",
                    hint=f"give {len(mesh.vertices):,} numbers, one for each vertex",
                )
            mesh.properties[_TRUST] = values
            given["weights"] = _TRUST
        # The same steps as for files.
        _, settings = _parse(denoise, given)
        job = FileRun(mesh.name, settings)
        positions = job.move_vertices(mesh)
        n_faces = len(mesh.faces)
        job.know(
            precision=str(mesh.dtype), vertices=len(mesh.vertices), faces=n_faces, triangles=n_faces
        )
        is_moved = not np.array_equal(positions, mesh.vertices)
        record = replace(job.finish(None), status="written" if is_moved else "unchanged")
        result = DenoiseResult(mesh.to_given_type(positions), record)
        _log.info("%s: %s; %s", mesh.name, result.method, result.reason or result.parameters)
        for warning in result.warnings:
            _log.info("%s: %s", mesh.name, warning)
        return mesh.to_result(result.vertices) if faces is None else result


def _parse(
    function: Callable[..., Any], given: Mapping[str, Any]
) -> tuple[tuple[Gate, ...], Settings]:
    """The gates and the settings for the arguments of a function of the API; UsageError also for a
    parameter that is given twice, and for an unknown keyword."""
    parameters, more, unit = given["parameters"] or {}, given["more"], given["unit"]
    if not isinstance(parameters, Mapping):
        raise UsageError(f"parameters = {parameters!r} is not allowed", hint='give {"K": 0.5}')
    if unit not in (None, *METRES):
        raise UsageError(f"there is no unit {unit!r}", hint=f"give one of {', '.join(METRES)}")
    known = {name.casefold(): name for name in (*given, *MethodParameters.__annotations__)}
    for name in more:
        if name not in known.values():
            close = difflib.get_close_matches(name.casefold(), known, n=1)
            likely = 'method="auto"' if name == "auto" else known[close[0]] if close else ""
            pages = f"help(msal_cli.{function.__name__}), and msal_cli.list_methods()"
            raise UsageError(
                f"{function.__name__} has no argument {name!r}",
                hint=f"did you mean {likely}?" if likely else f"see {pages} for other parameters",
            )
    if twice := sorted(parameters.keys() & more.keys()):
        raise UsageError(f"{twice[0]} is given twice", hint="give it once")
    assignments = [(name, name, value) for name, value in {**parameters, **more}.items()]
    gates = parse_gates(to_texts(given.get("fail_on", ()), "fail_on"), MeshRecord, unit)
    refuse_without_reference(gates, "measure it with msal_cli.compare")
    is_checked = given.get("intersections") or need_intersections(gates)
    return gates, parse({**given, "parameters": assignments, "intersections": is_checked})


def _as_mask(lock: Any, n: int) -> mesh_objects.Array:
    """A mask (n,) from a mask or from indices; UsageError for anything else."""
    values = mesh_objects.as_array(lock, "lock", UsageError)
    if values.dtype == np.bool_ and values.shape == (n,):
        return values
    mask = np.zeros(n, dtype=np.bool_)
    if not values.size:
        return mask
    if values.dtype.kind not in "iu" or values.ndim != 1:
        raise UsageError(
            f"lock is {values.dtype} of shape {values.shape}",
            hint=f"give a mask of {n:,} booleans, or indices of vertices (k,)",
        )
    if values.min() < 0 or values.max() >= n:
        raise UsageError(f"lock names a vertex that is not there, of {n:,}")
    if len(values) == n and values.max() <= 1:
        raise UsageError("lock is a mask of whole numbers", hint="give lock.astype(bool)")
    mask[values] = True
    return mask


# Files


def _to_path(value: Any, name: str) -> str:
    try:
        return os.fsdecode(value)
    except TypeError:
        raise UsageError(f"{name} is {value!r}, and must be a path", hint="give a text") from None


def denoise_file(
    input: Path,
    output: Path,
    method: MethodName | None = None,
    *,
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

    Its bytes are those of ``msal denoise INPUT -o OUTPUT``.  It appears whole or not at all.

    Parameters
    ----------
    input : a mesh file of any format that msal reads (docs/formats.md), or a URL.
    output : the file to write; an existing one is replaced.  Its suffix decides the format.
    method, keep, strength, assume, max_move, despike, min_noise, unit, parameters,
    more : as for ``denoise``.
    lock : ``"boundary"``, or a PLY vertex property compared with a number, such as
        ``"confidence < 0.2"``; or a list of these.
    weights : a PLY vertex property, such as ``"confidence"``, as trust.
    intersections : also count the pairs of faces that intersect each other, which takes longer.
    to, encoding, precision : the output's format if its suffix does not show it; ``"ascii"`` or
        ``"binary"``; ``"float32"`` or ``"float64"``.  ``"same"`` keeps those of the input.
    strict : raise LossError, instead of a warning, if another format would lose something.
    format : the input's format if its name does not show it.
    fail_on : gates such as ``"abs(volume_change) > 1%"`` (docs/gates.md); their results are in
        ``record.gates``.  A broken gate raises nothing.

    Returns
    -------
    MeshRecord: what was read, done, measured and written; docs/report.md explains all fields.

    Raises
    ------
    UsageError
        for arguments that are invalid or exclude each other, and an impossible output.
    InputError
        if the input is at fault; ``error.code`` is the fault (docs/formats.md lists the codes).
    LossError, OutputError, ResourceError, InternalError
        as in ``msal_cli.errors``.
    """
    given = locals()
    with explained_errors():
        source, target = _to_path(input, "input"), _to_path(output, "output")
    with explained_errors(path=source):
        gates, settings = _parse(denoise_file, given)
        plan = build_plan(discover_inputs([source], output=target), target, to=settings.to)
        if len(plan.tasks) != 1 or plan.folders():
            raise UsageError(
                f"{source!r} into {target!r} is not one file into one file",
                hint="denoise_folder takes folders",
            )
        task = plan.tasks[0]
        record = FileRun(task.input, settings).run_task(task)
        return with_gates(gates, [record])[0]


def denoise_folder(
    inputs: Path | Sequence[Path],
    output: Path | None = None,
    method: MethodName | None = None,
    *,
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

    Arguments are checked and files are found at once; the work starts when the first record is
    requested, so ``list(...)`` does all of it.  A file that fails gives a record with ``status``
    ``"failed"`` and an ``error``, and the others continue.  What an earlier run has finished is not
    done again (``"up-to-date"``).  Outputs and manifest are those of ``msal denoise``, which can
    continue such a run, and vice versa.

    Worker processes denoise the files.  No signal handler is installed, so this works in notebooks
    and in any thread.  Leaving the loop early, by ``break``, Ctrl-C or ``close()``, ends the run:
    finished files are whole and recorded, and the same call continues from there.

    Parameters
    ----------
    inputs : a folder with its subfolders, a file, a pattern such as ``"scans/*.ply"``, a URL; or
        several of them.
    output : the folder to write, which gets the tree of the inputs; not with ``in_place``.
    method to fail_on, parameters, more : as for ``denoise_file``.
    include, exclude : patterns of files to include or exclude, such as ``"*.ply"``.
    in_place : replace the inputs.
    backup : with ``in_place``, the suffix under which the originals are kept; None keeps none.
    jobs : files at the same time; more is faster and takes more memory.  None is one per core, as
        far as memory allows.  The results do not depend on it.
    timeout, memory_limit : seconds and bytes that one file may use; None is unlimited.
    retries : how often a file is tried again after a crash, or when memory or time ran out.
    max_failures : start no more files after so many failures.
    force : replace files in the output folder that no run of msal wrote.
    fresh : do again what an earlier run has finished.
    retry_failed : try again what failed in an earlier run and would fail again.

    Returns
    -------
    A generator of MeshRecord, one per file, in the order in which they finish.

    Raises
    ------
    UsageError
        for arguments that are invalid or exclude each other, and impossible inputs or outputs;
        with the first record also ``E_LOCKED``, if another run works on the output.
    NothingMatched
        if the inputs contain no mesh file.
    OutputError, ResourceError
        while iterating, if the output cannot be written, or no worker can be started.
    """
    given = locals()
    with explained_errors():
        is_one = isinstance(inputs, str | bytes) or not isinstance(inputs, Iterable)
        paths: Any = [inputs] if is_one else inputs
        sources = [_to_path(path, "an input") for path in paths]
        target = None if output is None else _to_path(output, "output")
    with explained_errors(", ".join(sources)):
        limits = Limits(timeout, memory_limit)
        check_options(limits, jobs, retries, max_failures)
        gates, settings = _parse(denoise_folder, given)
        patterns = to_texts(include, "include"), to_texts(exclude, "exclude")
        plan = build_plan(
            discover_inputs(sources, *patterns, output=target),
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


def _iterate_records(
    work: Callable[..., Any], gates: Sequence[Gate]
) -> Generator[MeshRecord, None, None]:
    """The records of ``work``, a ``batch.run.run``, in the order in which files finish, with the
    results of the gates; its errors are raised here, with explanations.

    The run has a thread of its own and handles no signals, since Python delivers these only to the
    main thread; its worker processes can be ended at any time.  If the iteration is left early, by
    ``close`` or an exception such as Ctrl-C's, the run is ended first: its workers are gone, and
    finished files are whole and recorded.
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
                if (failed := message.error) is not None:
                    hint = name_arguments(failed.hint)
                    message = replace(message, error=replace(failed, hint=hint))
                yield with_gates(gates, [message])[0]
        finally:
            cancellation.request()
            thread.join()


# Methods


@dataclass(frozen=True)
class MethodInfo:
    """A method for ``denoise``.

    Attributes
    ----------
    name : the name for ``method=``.
    summary : what it does, in one line.
    parameters : for each parameter by name its meaning, range and default, and the effect of more.
    """

    name: MethodName
    summary: str
    parameters: Mapping[str, str]


def list_methods() -> tuple[MethodInfo, ...]:
    """All methods with their parameters, as ``msal methods`` shows them.

    Returns
    -------
    A MethodInfo for each, in alphabetical order, without the choices ``"adaptive"`` and ``"auto"``.
    """
    from msal_cli import methods

    found = []
    for name in methods.names():
        method = methods.find(name)
        parameters = {
            spec.name: f"{spec.help} {spec.range_text}; default {spec.default}"
            + (f"; more is {spec.more}" if spec.more else "")
            for spec in method.parameters
        }
        found.append(MethodInfo(cast(MethodName, name), method.summary, parameters))
    return tuple(found)
