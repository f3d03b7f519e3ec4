"""One file from start to end: read, check, denoise, measure, verify, write, and the record.

``denoise_file`` is what the batch runs for every file.  It never raises for a bad file: any error
becomes a failed record, and the output appears whole or not at all.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from msal_cli import machine
from msal_cli.codecs import header
from msal_cli.errors import InternalError, format_count
from msal_cli.job import changes, choice, output, records, room
from msal_cli.job.records import MeshRecord
from msal_cli.job.settings import CHOOSING, NO_LIMITS, SELF_INTERSECTIONS, Limits, Settings, Task
from msal_cli.kernels import array_files
from msal_cli.kernels.geometry import distances
from msal_cli.kernels.parallel import is_worth_it
from msal_cli.storage import gzip_streams
from msal_cli.version import __version__

if TYPE_CHECKING:
    from msal_cli.arrays import Flags, Floats
    from msal_cli.codecs.mesh_file import MeshFile, Surface
    from msal_cli.job.constraints import Constraints
    from msal_cli.mesh import PreparedMesh
    from msal_cli.storage.regular import Buffer

OnProgress = Callable[[str, int, int], None]
"""Called as ``on_progress(stage, done, total)``; the stages are those of ``records.Seconds``."""


# Fields of the record that describe an output; a failed file has none of them.
_OF_OUTPUT = (
    *("volume", "area", "displacement", "normal_change", "flipped_faces", "seam_gap"),
    *("clamped_vertices", "locked_vertices", "despiked", "self_intersections", "fields"),
)


def start_record(name: str, settings: Settings, **values: Any) -> MeshRecord:
    """The record of a file at its start; its status is failed until the file is finished."""
    method = records.MethodUsed(settings.method, dict(settings.parameters))
    values = {"status": "failed", "version": __version__, "method": method, **values}
    return MeshRecord(input=name, **values)


def denoise_file(
    task: Task,
    settings: Settings,
    on_progress: OnProgress | None = None,
    limits: Limits = NO_LIMITS,
) -> MeshRecord:
    """Denoise one file and return its record; raises only KeyboardInterrupt and SystemExit.

    A file whose header shows that it exceeds ``limits`` is refused before it is loaded
    (``E_MEMORY``).
    """
    run = FileRun(task.input, settings, on_progress)
    try:
        return run.run_task(task, limits)
    except Exception as error:
        return run.fail(error)


class FileRun:
    """The steps of one file, with its record so far and the seconds of its stages.

    A tile set takes its files through the same steps, but moves the vertices of all at once.
    """

    def __init__(
        self, name: str, settings: Settings, on_progress: OnProgress | None = None
    ) -> None:
        self._settings = settings
        self._on_progress = on_progress or (lambda stage, done, total: None)
        self._started = self._counted = time.perf_counter()
        self._stage = "read"
        self._seconds: dict[str, float] = {}
        self.record = start_record(name, settings)  # what is known so far
        self._is_changed = False
        # For each field of --fields the values (n,) at the file's vertices.
        self.field_values: dict[str, Floats] = {}
        self._fields_file: tuple[Buffer, records.FieldsFile] | None = None
        self._output_digest: Callable[[], str] | None = None

    # The record

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time from the last stage to the end of this one as this one's.

        The time between two stages, mostly imports, counts for the second one, so that the seconds
        of all stages add up to the total.
        """
        self._stage = name
        self._on_progress(name, 0, 1)
        try:
            yield
        finally:
            self._count()

    def _count(self) -> None:
        """Add the time since the last count to the current stage."""
        now = time.perf_counter()
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._counted
        self._counted = now

    def know(self, **values: Any) -> None:
        """Set fields of the record."""
        self.record = replace(self.record, **values)

    def warn(self, *warnings: str) -> None:
        self.know(warnings=self.record.warnings + warnings)

    def _close_record(self, **values: Any) -> MeshRecord:
        """The record with these fields, the seconds until now, and the peak of memory."""
        self._count()
        seconds = records.Seconds(**self._seconds, total=self._counted - self._started)
        # With arrays in files the peak would include their pages, which the system can reclaim.
        peak = None if array_files.are_used() else machine.peak_bytes()
        self.know(seconds=seconds, peak_memory_bytes=peak, **values)
        return self.record

    def finish(self, output_path: str | None, sidecars: tuple[str, ...] = ()) -> MeshRecord:
        """The record of a file that was written."""
        if self._output_digest is not None:
            self.know(output_sha256=self._output_digest())
        status = "written" if self._is_changed else "unchanged"
        return self._close_record(status=status, output=output_path, sidecars=sidecars)

    def fail(self, error: Exception) -> MeshRecord:
        """The record of a file that was not written, for any error."""
        failure = records.Failure.of(room.to_known_error(error, self.record.input))
        unknown = {**dict.fromkeys(_OF_OUTPUT), "warning_codes": ()}
        return self._close_record(status="failed", error=failure, **unknown)

    # The way of a file

    def run_task(self, task: Task, limits: Limits = NO_LIMITS) -> MeshRecord:
        """Read, denoise and write one file, with room for it."""
        # The mark is older than the bytes, so that an object that changes in between is done again.
        self.know(input_object=task.input_mark)
        with room.room_for_task(task, self._settings, limits):
            data = self.read(task)
            return self.write(task, data, self.denoise(data, task.output))

    def read(self, task: Task) -> Buffer:
        """The bytes of the input; an error if its header shows that it is no mesh."""
        with self.stage("read"):
            size = task.input_mark.size if task.input_mark is not None else None
            return header.read_input(task.input, self._settings.format, size)

    def denoise(self, data: Buffer, output_path: str | None) -> output.Output:
        """The output file for the bytes of the input file; ``output_path`` is None for a pipe."""
        mesh_file = self.open(data)
        store = functools.partial(output.as_stored, mesh_file, self._settings, output_path)
        vertices = self.move_vertices(mesh_file, store=store)
        return self.build(mesh_file, vertices, output_path, data)

    def open(self, data: Buffer) -> MeshFile:
        """The mesh file in ``data``, which gzip may have compressed."""
        from msal_cli.codecs.mesh_file import PLACEMENT

        with self.stage("read"):
            digest = gzip_streams.sha256_meanwhile(data)
            try:
                name, format = self.record.input, self._settings.format
                mesh_file = room.open_mesh(data, name, format)
            finally:
                # A file that cannot be read has its hash in the record, too.
                self.know(input_sha256=digest())
            self.know(**changes.file_fields(mesh_file))
            self.warn(*mesh_file.warnings)
            given = self._settings.unit
            room.check_unit(mesh_file.unit, given)
            if given and PLACEMENT in mesh_file.properties:
                self.warn("--unit applies to the numbers in the file, which the scene may scale")
        return mesh_file

    def build(
        self, mesh_file: MeshFile, vertices: Floats, output_path: str | None, data: Buffer
    ) -> output.Output:
        """Build the output file with new positions (n, 3); ``data`` are the bytes of the input."""
        with self.stage("write"):
            made = output.build_output(mesh_file, vertices, self._settings, output_path, data)
            valid = [text for text in self.record.warnings if text not in made.stale]
            self.know(warnings=(*valid, *made.losses))
            if self.field_values and output_path is not None:
                from msal_cli.job import fields

                self._fields_file = fields.build_file(
                    mesh_file, vertices, self.field_values, fields.path_beside(output_path)
                )
            self._is_changed = made.data is not data
            self._output_digest = gzip_streams.sha256_meanwhile(made.data)
        return made

    def write(self, task: Task, data: Buffer, made: output.Output) -> MeshRecord:
        """Write the output and the files beside it; ``data`` are the bytes of the input."""
        with self.stage("write"):
            array_files.release_kept()
            if task.in_place and task.backup:
                output.keep_backup(task, data)
            output.make_folder_of(task.output)
            sources = [task.input, *made.sources]
            # These come before the output: once that exists, all that belongs to it exists.
            if self._fields_file is not None:
                from msal_cli.job import fields

                fields.write_file(*self._fields_file, sources)
                self.know(fields=self._fields_file[1])
            notes: tuple[str, ...] = ()
            if made.references and not task.in_place:
                notes, warnings = output.carry_references(made, task)
                self.warn(*warnings)
            written, mark = output.write_output(task.output, made.data, made.companions, sources)
            self.know(output_object=mark)
        return self.finish(task.output, sidecars=notes + written)

    def prepare_mesh(self, mesh_file: Surface) -> PreparedMesh:
        """The mesh of a file, fit for computing; adds its defects to the record."""
        ready = room.prepare_mesh(mesh_file)
        self.know(**changes.defect_fields(ready, mesh_file.merged_vertices))
        if n_edges := ready.defects.inconsistent_edges:
            self.warn(
                f"inconsistent winding at {format_count(n_edges, 'edge')}; "
                f"{format_count(ready.defects.turned_faces, 'face is', 'faces are')} turned for "
                "the computation only"
            )
        return ready

    def move_vertices(
        self,
        mesh_file: Surface,
        pinned: Flags | None = None,
        store: Callable[[Floats], Floats] | None = None,
    ) -> Floats:
        """The new positions of a file's vertices (n, 3), of which those ``pinned`` (n,) stay.

        They are returned, and measured, as the output stores them: ``store`` rounds positions
        (n, 3); None rounds to the number type of the input.  All arrays of this step are freed
        before the output is built, which takes as much memory again.
        """
        from msal_cli.analysis.noise_estimate import estimate_noise, lend_estimate

        settings = self._settings
        with self.stage("connectivity"):
            ready = self.prepare_mesh(mesh_file)
            constraints = None
            if settings.max_move or settings.lock or settings.weights or pinned is not None:
                from msal_cli.job.constraints import build_constraints

                constraints = build_constraints(ready, mesh_file, settings, pinned)
                if constraints.held is not None and settings.lock:
                    self.know(locked_vertices=int(constraints.held.sum()))
                    if constraints.held[ready.mesh.topology.has_ring].all():
                        self.warn("--lock holds every vertex of the mesh, so none moves")
            mesh_file.forget_vertices()
        given_mesh = ready.mesh if constraints is None else constraints.mesh
        mesh = ready.outward(given_mesh)
        # Without a look at the mesh, choosing takes no time.
        with self.stage("choose") if choice.looks_at_mesh(settings) else nullcontext():
            chosen = first = choice.prepare(
                mesh, settings, functools.partial(self._on_progress, "choose")
            )
        self.know(**chosen.known)
        self.warn(*chosen.warnings)
        choice_made = self.record.choice
        estimate = functools.partial(estimate_noise, chosen.mesh)
        # A choice has estimated the noise; else one core does it while the others smooth.
        in_background = (
            choice_made is None and is_worth_it(len(mesh.vertices)) and not array_files.are_used()
        )
        wait_for_noise = machine.in_background(estimate) if in_background else estimate
        milder = iter(choice.MILDER)
        while True:
            result, fidelity, is_ruled = self._run_method(chosen, ready, constraints)
            with self.stage("measure"):
                wait_for_noise()
                # The measures do not need them, and they take memory.
                chosen.mesh.release_normals()
                limit = None if constraints is None else constraints.limit
                vertices, moved = _store_positions(
                    ready, result, mesh_file, store or mesh_file.as_stored, limit
                )
                whole, given = None, chosen.mesh
                start = given.vertices
                if mesh is not given_mesh:
                    given = ready.mesh.with_vertices(start)
                    lend_estimate(estimate_noise(chosen.mesh), given)
                if constraints is not None and chosen.known.get("despiked"):
                    # Outliers come back only as far as other vertices may go.
                    given = given.with_vertices(constraints.apply(start)[0])
                    lend_estimate(estimate_noise(chosen.mesh), given)
                if chosen.share < 1.0:
                    # A part of the displacement is accepted only if all of it would be.
                    whole = start + (result - start) / chosen.share
                del result
                measured = changes.measure(ready, moved, given, is_named=choice_made is None)
                harm = measured.harm
                if whole is not None:
                    harm = changes.measure(ready, whole, given, is_named=False).harm
            if harm is None or choice_made is None:
                break
            weaker = choice.choose_weaker(mesh, settings, choice_made, harm)
            if weaker is not None:
                settings, chosen = weaker
                choice_made = chosen.known["choice"]
            elif (share := next(milder, None)) is not None:
                chosen = choice.soften_choice(mesh, chosen, choice_made, harm, share)
            else:
                break
            self.know(**chosen.known)
        self.warn(*(text for text in chosen.warnings if text not in first.warnings))
        with self.stage("measure"):
            self.know_changes(measured, ready, moved)
            noise, displacement = self.record.noise_estimate, self.record.displacement
            if choice_made is None and chosen.method is not None and noise and displacement:
                # The user named the method, which may harm the mesh.
                used = (chosen.method, chosen.parameters)
                self.warn(*changes.method_warnings(*used, noise, displacement, is_ruled))
            if settings.fields:
                from msal_cli.job import fields

                self.field_values = fields.compute(
                    settings.fields, ready, moved, fidelity, chosen.parameters
                )
            ready.mesh.release_normals()
            self.know(seam_gap=ready.seam_gap(vertices))
        return vertices

    def _run_method(
        self, chosen: choice.Preparation, ready: PreparedMesh, constraints: Constraints | None
    ) -> tuple[Floats, Floats | None, bool]:
        """Run the method: new positions (n, 3), lambda of the first sweep (n,) where fields need
        it, and whether one spike rules it."""
        settings = self._settings
        fidelity, is_ruled = None, False
        moved, normals_s = chosen.mesh.vertices, 0.0
        with self.stage("sweeps"):
            if chosen.method is not None:
                on_step = functools.partial(self._on_progress, "sweeps")
                result = chosen.method.denoise(chosen.mesh, chosen.parameters, on_step)
                name = chosen.method.name
                if result.vertices.shape != ready.mesh.vertices.shape:
                    raise InternalError(f"{name} changed the number of vertices")
                if not np.isfinite(result.vertices).all():
                    bad = int(np.argmin(np.isfinite(result.vertices).all(axis=1)))
                    raise InternalError(
                        f"{name} made a position that is not finite", where=f"vertex {bad}"
                    )
                moved, normals_s = result.vertices, result.seconds.get("normals", 0.0)
                fidelity = result.fields.get("fidelity")
                is_ruled = settings.method not in CHOOSING and changes.is_ruled_by_spike(fidelity)
                # Free its other arrays.
                del result
            if constraints is not None:
                moved, n_clamped = constraints.apply(moved)
                if constraints.limit is not None:
                    self.know(clamped_vertices=n_clamped)
        if chosen.method is not None:
            # The method itself measures how much of its time went into normals.
            self._seconds["sweeps"] -= normals_s
            self._seconds["normals"] = self._seconds.get("normals", 0.0) + normals_s
        return moved, fidelity if settings.fields else None, is_ruled

    def know_changes(self, measured: changes.Measured, ready: PreparedMesh, moved: Floats) -> None:
        """Set the fields of what changed, and the warnings about it; count faces that intersect
        each other, if that was requested.  ``moved`` are the positions (n, 3) of the mesh."""
        self.know(**measured.fields)
        self.warn(*(f"{text} ({code})" for code, text in measured.warnings))
        codes = tuple(code for code, _ in measured.warnings)
        self.know(warning_codes=self.record.warning_codes + codes)
        if SELF_INTERSECTIONS in self._settings.checks:
            from msal_cli.analysis.measures import self_intersection_change

            counts = self_intersection_change(ready.mesh, ready.mesh.with_vertices(moved))
            self.know(self_intersections=records.SelfIntersections(*counts))


_SHARES = (0.999, 0.9, 0.75, 0.5, 0.25, 0.0)
"""Parts of its displacement that are tried for a vertex that rounding moves beyond a limit."""


def _store_positions(
    ready: PreparedMesh,
    result: Floats,
    mesh_file: Surface,
    store: Callable[[Floats], Floats],
    limit: float | None,
) -> tuple[Floats, Floats]:
    """File positions (n_file, 3) for a method's result (n, 3), rounded by ``store``, and the mesh's
    positions (n, 3) after that; vertices within ``limit`` stay within it."""
    from msal_cli.analysis.measures import at_other_positions

    start, wanted = ready.mesh.vertices, result
    for share in (*_SHARES, None):
        vertices = ready.to_file_vertices(wanted, mesh_file.vertices)
        mesh_file.forget_vertices()
        exact, vertices = vertices, store(vertices)
        if vertices is exact:
            return vertices, result
        del exact
        moved = at_other_positions(ready, vertices).vertices
        if share is None or limit is None:
            break
        is_beyond = distances(start, moved) > limit
        if not is_beyond.any():
            break
        wanted = np.where(is_beyond[:, None], start + share * (result - start), wanted)
    return vertices, moved
