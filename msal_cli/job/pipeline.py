"""One file from start to end: read, check, denoise, measure, verify, write, and the record.

``denoise_file`` is the bracket that the batch runs for every file.  It never raises for a file's
fault: whatever goes wrong becomes a failed record, and the output appears whole or not at all.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from msal_cli import __version__, machine
from msal_cli.errors import InternalError, MsalError, ResourceError
from msal_cli.job import advice, changes, output
from msal_cli.job.preparation import looks_at_mesh, prepare, reject_choice
from msal_cli.job.records import Failure, FieldsFile, MeshRecord, MethodUsed, ObjectMark, Seconds
from msal_cli.job.settings import (
    NO_LIMITS,
    SELF_INTERSECTIONS,
    Limits,
    Settings,
    Task,
    forecast,
    refuse_faces,
    refuse_oversized,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msal_cli.analysis.noise_estimate import NoiseLevel
    from msal_cli.codecs.mesh_file import Companion, MeshFile
    from msal_cli.job.constraints import Constraints
    from msal_cli.job.preparation import Preparation
    from msal_cli.mesh import Mesh, PreparedMesh
    from msal_cli.methods import Method
    from msal_cli.storage.buffers import Buffer

    Floats = NDArray[np.float64]

OnProgress = Callable[[str, int, int], None]
"""Called as ``on_progress(stage, done, total)``; the stages are those of ``records.Seconds``."""

log = logging.getLogger("msal")


def denoise_file(
    task: Task,
    settings: Settings,
    on_progress: OnProgress | None = None,
    limits: Limits = NO_LIMITS,
) -> MeshRecord:
    """Denoise one file and tell what happened; only KeyboardInterrupt and SystemExit pass.

    A file beyond ``limits`` is refused before it is loaded, as far as its header tells:
    ``E_MEMORY`` or ``E_TOO_LARGE``.
    """
    run = _Run(task.input, settings, on_progress, limits)
    try:
        from msal_cli import codecs as files
        from msal_cli.storage import sidecars

        with run.stage("read"):
            # The mark is older than the bytes: an object that changes in between is done again.
            run.know(input_object=task.input_mark)
            if limits.memory_bytes is not None or limits.max_faces is not None:
                refuse_oversized(forecast(task, settings), limits)
            size = task.input_mark.size if task.input_mark is not None else None
            data = files.read_input(task.input, settings.format, size)
        denoised = run.denoise(data, task.output)
        with run.stage("write"):
            if task.in_place and task.backup:
                output.keep_backup(task, data)
            output.make_folder_of(task.output)
            # Before the output: what is there then has all that belongs to it.
            run.write_fields()
            notes: tuple[str, ...] = ()
            if run.references and not task.in_place:
                notes = tuple(sidecars.carried(run.references, task.input, task.output))
                marked = (note for note in notes if note.startswith("warning: "))
                run.warn(*(note.removeprefix("warning: ") for note in marked))
            if run.companions:
                from msal_cli.codecs.companions import write_companions

                notes += write_companions(run.companions, task.output)
            mark = files.write_whole(
                task.output, [denoised], mode_like=task.input if task.in_place else None
            )
            run.know(output_object=None if mark is None else ObjectMark(*mark))
        return run.finished(task.output, sidecars=notes)
    except Exception as error:
        return run.failed(error)


def denoise_bytes(
    data: Buffer,
    name: str,
    settings: Settings,
    on_progress: OnProgress | None = None,
    limits: Limits = NO_LIMITS,
) -> tuple[Buffer | None, MeshRecord]:
    """Denoise a file that came through a pipe; the output is None if the record is a failure.

    Of ``limits`` only ``max_faces`` counts: the file is in memory already.
    """
    run = _Run(name, settings, on_progress, limits)
    try:
        denoised = run.denoise(data, None)
        return denoised, run.finished(None)
    except Exception as error:
        return None, run.failed(error)


def denoise_copy(
    task: Task,
    settings: Settings,
    on_progress: OnProgress | None = None,
    limits: Limits = NO_LIMITS,
) -> MeshRecord:
    """Denoise a stream that was copied to a file, as ``denoise_bytes``, into another such file.

    The record knows the mesh as ``task.relative`` and has no output; nothing is read or written
    beside the two files.
    """
    run = _Run(task.relative, settings, on_progress, limits)
    try:
        from msal_cli import codecs as files

        with run.stage("read"):
            refuse_oversized(forecast(task, settings), limits)
            data = files.read_input(task.input, settings.format)
        denoised = run.denoise(data, None)
        with run.stage("write"):
            files.write_whole(task.output, [denoised])
        return run.finished(None)
    except Exception as error:
        return run.failed(error)


class _Run:
    """The state of one file on its way: what is known so far ends up in the record."""

    def __init__(
        self, name: str, settings: Settings, on_progress: OnProgress | None, limits: Limits
    ) -> None:
        self.settings = settings
        self._limits = limits
        # Files that the output names too; a conversion drops them.
        self.references: tuple[str, ...] = ()
        # Files beside the output that hold a part of it.
        self.companions: tuple[Companion, ...] = ()
        self._on_progress = on_progress or (lambda stage, done, total: None)
        self._started = self._counted = time.perf_counter()
        self._stage = "read"
        self._seconds: dict[str, float] = {}
        self._record = MeshRecord(
            input=name,
            status="failed",
            version=__version__,
            method=MethodUsed(settings.method, dict(settings.parameters)),
        )
        self._changed = False
        # What was estimated to choose a method.
        self._noise: NoiseLevel | None = None
        self._field_values: dict[str, Floats] = {}
        self._fields_file: tuple[Buffer, FieldsFile] | None = None
        self._output_digest: Callable[[], str] | None = None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time until the end of this stage as its own.

        What lies between two stages, imports mostly, prepares the second one: so the seconds of
        all stages add up to the whole.
        """
        self._stage = name
        self._on_progress(name, 0, 1)
        try:
            yield
        finally:
            self._count()

    def _count(self) -> None:
        """Count the time that no stage has yet as the present one's."""
        now = time.perf_counter()
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._counted
        self._counted = now

    def _spent(self) -> Seconds:
        """All seconds until now."""
        self._count()
        return Seconds(**self._seconds, total=self._counted - self._started)

    def know(self, **values: Any) -> None:
        """Set fields of the record."""
        self._record = replace(self._record, **values)

    def warn(self, *warnings: str) -> None:
        """Add warnings to the record."""
        self.know(warnings=self._record.warnings + warnings)

    def _warn_with_codes(self, warnings: tuple[tuple[str, str], ...]) -> None:
        """Add warnings, each as a code and a text, to the record."""
        self.warn(*(f"{text} ({code})" for code, text in warnings))
        codes = tuple(code for code, _ in warnings)
        self.know(warning_codes=self._record.warning_codes + codes)

    def denoise(self, data: Buffer, output_path: str | None) -> Buffer:
        """The bytes of the output file for the bytes of the input file."""
        from msal_cli import codecs as files

        settings = self.settings
        name = self._record.input
        with self.stage("read"):
            files.give_back_large_arrays()
            digest = files.sha256_meanwhile(data)
            try:
                plain, is_compressed = files.expanded(data, name)
                mesh_file = files.open_mesh(plain, name, settings.format)
            finally:
                # A file that cannot be read is known by its hash, too.
                self.know(input_sha256=digest())
            self.know(
                format=mesh_file.format,
                encoding=mesh_file.encoding,
                precision=mesh_file.precision,
                vertices=len(mesh_file.vertices),
                corners=files.corner_count(mesh_file),
                faces=mesh_file.n_polygons,
                triangles=len(mesh_file.faces),
            )
            self.warn(*mesh_file.warnings)
            refuse_faces(mesh_file.n_polygons, self._limits)
        vertices = self._denoised(mesh_file)
        with self.stage("write"):
            source = output.Source(data, name, is_compressed)
            built = output.built(mesh_file, vertices, settings, output_path, source)
            self.references = built.references
            self.companions = built.companions
            self.warn(*built.losses)
            if self._field_values and output_path is not None:
                from msal_cli.job import fields

                self._fields_file = fields.encoded(
                    mesh_file, vertices, self._field_values, fields.path_beside(output_path)
                )
            self._changed = built.data is not data
            self._output_digest = files.sha256_meanwhile(built.data)
        return built.data

    def _denoised(self, mesh_file: MeshFile) -> Floats:
        """The new positions of a file's vertices; what leads to them is let go of before the
        output is built, for that takes as much memory again."""
        from msal_cli.mesh import prepare_mesh

        settings = self.settings
        with self.stage("connectivity"):
            ready = prepare_mesh(
                mesh_file.vertices,
                mesh_file.faces,
                are_distinct=mesh_file.merged_vertices > 0,
            )
            self.know(**changes.defects_told(ready, mesh_file.merged_vertices))
            self.warn(*changes.warnings_of(ready.defects))
            constraints = self._constraints(ready, mesh_file)
            mesh_file.forget_vertices()
        given = ready.mesh if constraints is None else constraints.mesh
        preparation = self._prepare(given)
        mesh, method = preparation.mesh, preparation.method
        parameters = preparation.parameters
        fidelity = None
        with self.stage("sweeps"):
            moved = mesh.vertices
            if method is not None:
                result = method.denoise(
                    mesh,
                    parameters,
                    lambda done, total: self._on_progress("sweeps", done, total),
                )
                self._check_result(ready, result.vertices)
                moved = result.vertices
            if constraints is not None:
                moved, n_clamped = constraints.applied(moved)
                if constraints.limit is not None:
                    self.know(clamped_vertices=n_clamped)
        if method is not None:
            # The method's own account tells how much of its time went into normals.
            normals = result.seconds.get("normals", 0.0)
            self._seconds["sweeps"] -= normals
            self._seconds["normals"] = normals
            fidelity = result.fields.get("fidelity") if settings.fields else None
            is_ruled = self._record.choice is None and advice.is_ruled_by_spike(
                result.fields.get("fidelity")
            )
            # It may hold more arrays, which nothing needs here.
            del result
        with self.stage("measure"):
            measured = changes.measured(ready, moved, self._noise)
            if measured.harm is not None and self._record.choice is not None:
                if self._record.despiked:
                    # It was estimated without the outliers.
                    self._noise = None
                choice, despiked = self._record.choice, self._record.despiked
                self.know(**reject_choice(choice, despiked, measured.harm))
                moved, method, fidelity = given.vertices, None, None
                measured = changes.measured(ready, moved, self._noise)
            self.know(**measured.fields)
            self._warn_with_codes(measured.warnings)
            if self._record.choice is None and method is not None:
                self._advise(method, parameters, is_ruled)
            if settings.fields:
                from msal_cli.job import fields

                self._field_values = fields.computed(
                    settings.fields, ready, moved, fidelity, parameters
                )
            if SELF_INTERSECTIONS in settings.checks:
                self.know(self_intersections=changes.self_intersections(ready, moved))
            ready.mesh.release_normals()
            vertices = ready.to_file_vertices(moved, mesh_file.vertices)
            self.know(seam_gap=ready.seam_gap(vertices))
        return vertices

    def _advise(self, method: Method, parameters: dict[str, Any], is_ruled: bool) -> None:
        """Warn where a method that was asked for by name harms the mesh."""
        noise, moved = self._record.noise_estimate, self._record.displacement
        if noise is not None and moved is not None:
            self.warn(*advice.build_advice(method, parameters, noise, moved, is_ruled))

    def _prepare(self, given: Mesh) -> Preparation:
        """What is to be run on a mesh; the record and the noise are those of it."""
        settings = self.settings
        if not looks_at_mesh(settings):
            return prepare(given, settings)
        with self.stage("choose"):
            found = prepare(
                given, settings, lambda done, total: self._on_progress("choose", done, total)
            )
        self.know(**found.known)
        self.warn(*found.warnings)
        self._noise = found.noise
        return found

    def _constraints(self, ready: PreparedMesh, mesh_file: MeshFile) -> Constraints | None:
        """What keeps vertices of this file near their place; None if nothing was asked for."""
        settings = self.settings
        asked = (settings.max_move, settings.lock, settings.weights)
        if asked == (None, (), None):
            return None
        from msal_cli.job import constraints

        found = constraints.found(ready, mesh_file, *asked)
        if found.held is not None:
            self.know(locked_vertices=int(found.held.sum()))
        return found

    def write_fields(self) -> None:
        """Write the file of fields, if one was asked for, over nothing but its like."""
        if self._fields_file is None:
            return
        from msal_cli import codecs as files
        from msal_cli.job import fields

        data, told = self._fields_file
        if not files.is_url(told.path):
            fields.refuse_foreign(told.path)
        files.write_whole(told.path, [data])
        self.know(fields=told)

    def _check_result(self, ready: PreparedMesh, vertices: Floats) -> None:
        """A method must return finite positions for the same vertices."""
        import numpy as np

        if vertices.shape != ready.mesh.vertices.shape:
            raise InternalError(f"{self._method_name()} changed the number of vertices")
        if not np.isfinite(vertices).all():
            bad = int(np.argmin(np.isfinite(vertices).all(axis=1)))
            raise InternalError(
                f"{self._method_name()} made a position that is not finite", where=f"vertex {bad}"
            )

    def _method_name(self) -> str:
        return self.settings.method if self._record.method is None else self._record.method.name

    def finished(self, output_path: str | None, sidecars: tuple[str, ...] = ()) -> MeshRecord:
        """The record of a file that was written."""
        if self._output_digest is not None:
            self.know(output_sha256=self._output_digest())
        seconds = self._spent()
        n = self._record.vertices or 0
        self.know(
            status="written" if self._changed else "unchanged",
            output=output_path,
            sidecars=sidecars,
            seconds=seconds,
            vertices_per_second=n / seconds.total if seconds.total > 0.0 else None,
            peak_memory_bytes=machine.peak_bytes(),
        )
        return self._record

    def failed(self, error: Exception) -> MeshRecord:
        """The record of a file that was not written, for any error."""
        if machine.is_want_of_memory(error):
            known: MsalError = ResourceError(
                error.message if isinstance(error, MsalError) else "not enough memory",
                code="E_MEMORY",
                hint="run fewer jobs at once, or a machine with more memory",
            )
        elif isinstance(error, MsalError):
            known = error
        else:
            log.exception("internal error at %r", self._record.input)
            known = InternalError(
                f"{type(error).__name__}: {error}",
                hint="this is a defect of msal; please report it with the file",
            )
        self.know(
            status="failed",
            error=Failure(known.code, known.message, known.hint, known.where),
            seconds=self._spent(),
            peak_memory_bytes=machine.peak_bytes(),
        )
        return self._record
