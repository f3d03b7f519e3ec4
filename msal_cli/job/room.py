"""Open a mesh file, with room for it: memory, else files of a scratch folder, or a refusal.

Everything that loads a mesh calls this module first.  Arrays in files are ordinary arrays whose
pages the system moves in and out of memory (``kernels.array_files``).
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli import auto, codecs, machine, methods
from msal_cli.codecs import header
from msal_cli.codecs.detection import format_of_name, refuse_no_mesh
from msal_cli.codecs.header import BASE_BYTES, Forecast
from msal_cli.errors import InputError, InternalError, MsalError, OutputError, ResourceError
from msal_cli.job.records import Failure, MeshRecord, Planned
from msal_cli.job.settings import (
    ADAPTIVE,
    AUTO,
    CHOOSING,
    NO_LIMITS,
    SELF_INTERSECTIONS,
    Limits,
    Settings,
    Task,
)
from msal_cli.kernels import array_files
from msal_cli.light_dataclass import dataclass
from msal_cli.machine import megabytes
from msal_cli.storage import gzip_streams
from msal_cli.storage.regular import LOOKED_AT, Buffer, large_files_allowed, open_regular
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from msal_cli.codecs.mesh_file import MeshFile, Surface
    from msal_cli.mesh import PreparedMesh

log = logging.getLogger("msal")

_DENOISING = "denoising this file"

LARGE_BYTES = 4 << 20
"""Files of this size and more have their headers read; smaller ones always fit."""

_FOLDER_NAMES = "--scratch of msal denoise, by the output, or where there is none by TMPDIR"

_KEPT_SHARE = 0.04
"""The part of a mesh's memory that stays in memory, at most, when its arrays are in files."""

# Arrays stay in memory if they are smaller than this, and than one part in so many of a mesh.
_MAX_IN_MEMORY, _SMALL_SHARE = 2 << 20, 128

# Memory for mapped pages: this part of a small mesh, this many bytes of others.
_MAPPED_OF_SMALL, _MAPPED_BYTES = 0.3, 32_000_000

_FIELDS_BYTES_PER_FACE = 64
# A second set of positions stays until the output is built.
_OUTLIERS_BYTES_PER_FACE = 12
# Trees of boxes, with nine directions where faces that intersect are counted, filled up to a power
# of two; measured: 262 per triangle of the larger of two surfaces, and 1,060.
DISTANCES_BYTES_PER_FACE, INTERSECTIONS_BYTES_PER_FACE = 270, 1100

FORECAST = "forecast"
"""The ``where`` of an ``E_MEMORY`` by forecast: trying again would not help."""


@dataclass(frozen=True)
class Scratch:
    """The folder for files of arrays, the most bytes that these take there, and the bytes of
    memory that are available."""

    folder: str
    n_bytes: int
    room: int


def room_for_task(
    task: Task, settings: Settings, limits: Limits = NO_LIMITS
) -> AbstractContextManager[None]:
    """A context with room to denoise one file; raises as ``find_scratch`` does."""
    # A file that cannot be read counts as small: its reader reports the error.
    if limits.memory_bytes is None and (input_bytes(task) or 0) < LARGE_BYTES:
        return nullcontext()
    needed = forecast(task, settings).memory_bytes or 0
    return use_scratch(find_scratch(_DENOISING, needed, limits, task.output or None))


def room_for_files(
    paths: Sequence[str],
    format: str | None = None,
    output: str | None = None,
    settings: Settings | None = None,
    bytes_per_face: int = 0,
) -> AbstractContextManager[None]:
    """A context with room for files that are read together; raises as ``find_scratch`` does.

    ``settings`` are those by which the first file is denoised, if it is;
    ``bytes_per_face`` is what is needed beyond that for each triangle of the largest.
    """
    expected = [header.forecast(path, format=format) for path in paths]
    needs = [each.memory_bytes or BASE_BYTES for each in expected]
    words = "opening this file" if len(paths) == 1 else "opening these files"
    if settings is not None:
        task = Task(paths[0], output or "", paths[0])
        needs[0] = forecast(task, settings).memory_bytes or BASE_BYTES
        words = _DENOISING
    needed = BASE_BYTES + sum(need - BASE_BYTES for need in needs)
    needed += bytes_per_face * max(each.n_triangles for each in expected)
    return use_scratch(find_scratch(words, needed, output=output))


def find_scratch(
    work: str, needed: int, limits: Limits = NO_LIMITS, output: str | None = None
) -> Scratch | None:
    """Where arrays must live for work that needs so many bytes of memory; None if they fit.

    A limit set by the user replaces the memory that the machine has left.

    Raises ResourceError (``E_MEMORY`` with ``where`` ``FORECAST``) if they fit nowhere, and
    OutputError if the folder has no space for them.
    """
    limit = limits.memory_bytes
    room = machine.available_bytes() if limit is None else limit
    if room is None or needed <= room:
        return None
    n_bytes = max(0, needed - BASE_BYTES)

    kept = max(_KEPT_SHARE * n_bytes, min(_MAPPED_OF_SMALL * n_bytes, _MAPPED_BYTES))
    minimum = needed - n_bytes + kept if array_files.can_use_files() else needed
    if minimum > room:
        has = f"this machine has {megabytes(room, rounded_up=False)} left"
        hint = "use a machine with more memory, or cut the mesh into parts"
        if limit is not None:
            has = f"the limit is {megabytes(room)}"
            hint = f"raise --memory-limit to {megabytes(int(minimum))}, or cut the mesh into parts"
        raise ResourceError(
            f"{work} takes up to {megabytes(needed)}, and {has}",
            code="E_MEMORY",
            where=FORECAST,
            hint=hint,
        )
    folder = limits.scratch or _folder_of(output)
    if _is_in_memory(folder):
        raise ResourceError(
            f"{work} takes up to {megabytes(needed)}, there are "
            f"{megabytes(room, rounded_up=False)}, and the files of {folder!r} are in memory, too",
            code="E_MEMORY",
            where=FORECAST,
            hint=f"name a folder on a disk by {_FOLDER_NAMES}",
        )
    free = n_bytes
    with suppress(OSError):  # using the folder reports the error
        import shutil

        free = shutil.disk_usage(folder).free
    if free < n_bytes:
        raise OutputError(
            f"arrays that exceed the memory take up to {megabytes(n_bytes)} in {folder!r}, where "
            f"{megabytes(free, rounded_up=False)} are free",
            hint=f"name a folder with more space by {_FOLDER_NAMES}",
        )
    return Scratch(folder, n_bytes, room)


@contextmanager
def use_scratch(scratch: Scratch | None) -> Iterator[None]:
    """Within the block, keep large arrays in files of ``scratch``; None keeps them in memory.

    Raises OutputError if the folder cannot be used, or its disk is full.
    """
    if scratch is None:
        with array_files.kept_memory():
            yield
        return
    try:
        smallest = min(_MAX_IN_MEMORY, scratch.n_bytes // _SMALL_SHARE)
        with array_files.arrays_in_files(scratch.folder, max(1, smallest)), large_files_allowed():
            yield
    except (MsalError, BrokenPipeError):
        raise
    except (OSError, MemoryError, RuntimeError) as failure:
        error = failure.errno if isinstance(failure, OSError) else array_files.count_scratch().error
        if not error:
            raise
        raise OutputError(
            f"arrays that exceed the memory cannot be kept in {scratch.folder!r}: "
            f"{os.strerror(error)}",
            hint=f"name a folder with more space by {_FOLDER_NAMES}",
        ) from None


def _folder_of(output: str | None) -> str:
    """The folder of an output, or the nearest one above it; else that of temporary files."""
    if output is None or is_url(output):
        import tempfile

        return tempfile.gettempdir()
    folder = Path(output).absolute().parent
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    return str(folder)


def _is_in_memory(folder: str) -> bool:
    """Whether the files of a folder are in memory themselves (tmpfs, ramfs), as Linux reports."""
    try:
        device = os.stat(folder).st_dev
        lines = Path("/proc/self/mountinfo").read_text(errors="replace").splitlines()
    except OSError:
        return False
    name = f"{os.major(device)}:{os.minor(device)}"
    types = {line.partition(" - ")[2].split()[0] for line in lines if line.split()[2] == name}
    return bool(types & {"tmpfs", "ramfs"})


# Opening a file


def open_mesh(data: Buffer, name: str, format: str | None = None) -> MeshFile:
    """The mesh file in ``data``, which gzip may have compressed."""
    refuse_no_mesh(data)  # whatever the name says
    return codecs.open_mesh(gzip_streams.expand(data, name), name, format)


def check_unit(own: str | None, given: str | None) -> None:
    """Raise InputError if a file states another unit than the one that was given."""
    if own and given and own != given:
        raise InputError(
            f"the file says that its unit is {own}, and --unit says {given}",
            hint=f"give --unit {own}, or none, for this file",
        )


def prepare_mesh(surface: Surface, name: str = "") -> PreparedMesh:
    """Prepare a surface for computing; ContentError, with the path ``name``, if it is no mesh."""
    from msal_cli import mesh

    are_distinct = surface.merged_vertices > 0
    try:
        return mesh.prepare_mesh(surface.vertices, surface.faces, are_distinct=are_distinct)
    except MsalError as error:
        error.path = error.path or name
        raise


def to_known_error(error: Exception, name: str) -> MsalError:
    """Convert any error to one for a record; a defect of msal is logged with its traceback."""
    if machine.is_out_of_memory(error):
        return ResourceError(
            error.message if isinstance(error, MsalError) else "not enough memory",
            code="E_MEMORY",
            hint="run fewer jobs at once, or use a machine with more memory",
        )
    if isinstance(error, MsalError):
        return error
    log.exception("internal error at %r", name)
    return InternalError(
        f"{type(error).__name__}: {error}",
        hint="this is a defect of msal; please report it with the file",
    )


# Forecasts of the time and memory of a file, and whether it will fail.  Seconds are those of one
# idle core of a machine like that of docs/performance.md.  They were fitted to the sample meshes
# and to benchmarks/auto_seconds.py.

_SECONDS = {ADAPTIVE: (0.17, 1.6), AUTO: auto.SECONDS, "al": (0.05, 1.08), "msal": (0.05, 1.04)}
"""Seconds for any mesh, and per million vertices, from reading to writing."""

_IN_FILES_S_PER_MILLION = 1.0
"""Seconds that the disk adds if arrays are in files: about 2 kB are read for each vertex."""

_BYTES_PER_VERTEX, _STL_BYTES = 75, 520
"""For a text with twice as many triangles as vertices, and only positions; for one of STL."""

_PACKED = 3
"""Compression ratio of a text."""


def forecast(task: Task, settings: Settings) -> Forecast:
    """Forecast what a file needs, by its size and its first bytes; never raises for a bad file."""
    to = settings.to or format_of_name(task.output) or None
    is_same = to in (None, format_of_name(task.input))
    if is_same and settings.encoding == "same" and settings.precision == "same":
        to = None
    per_face = method_bytes_per_face(settings)
    expected = header.forecast(
        task.input, format=settings.format, to=to, method_bytes_per_face=per_face
    )
    if settings.method not in CHOOSING or expected.memory_bytes is None:
        return expected
    choosing = auto.BYTES if settings.method == AUTO else auto.FAMILY_BYTES
    return replace(expected, memory_bytes=expected.memory_bytes + choosing)


def method_bytes_per_face(settings: Settings) -> int:
    """Bytes of memory per triangle that the settings need beyond those of any method."""
    extra = _FIELDS_BYTES_PER_FACE if settings.fields else 0
    if settings.looks_for_outliers:
        extra += _OUTLIERS_BYTES_PER_FACE
    if SELF_INTERSECTIONS in settings.checks:
        extra += INTERSECTIONS_BYTES_PER_FACE
    if settings.method == AUTO:
        return extra + max(methods.find(name).bytes_per_face for name in auto.METHODS)
    name, parameters = settings.method, settings.parameters
    if name == ADAPTIVE:
        name, parameters = "al", auto.LARGEST_OF_FAMILY
    if name not in methods.names():
        return 0
    return methods.find(name).bytes_per_face_of(parameters) + extra


def foresee(record: MeshRecord, task: Task, settings: Settings, limits: Limits) -> MeshRecord:
    """Add a forecast to the record of a planned file: its size, and seconds if AL, MSAL or a choice
    does it.  The file has failed if its size and its first 64 KB show that it will."""
    expected = forecast(task, settings)
    size = input_bytes(task)
    n = expected.vertices
    if expected.format == "stl" and expected.faces is not None:
        # A closed surface has half as many vertices as facets, once its corners are welded.
        n = expected.faces // 2
    if n is None and size is not None:
        plain_size = size * (_PACKED if gzip_streams.is_gzip_name(task.input) else 1)
        each = _STL_BYTES if expected.format == "stl" else _BYTES_PER_VERTEX
        n = int(float(f"{plain_size / each:.2g}"))
    try:
        if not is_url(task.input):
            counted = _check_header(task.input, settings.format)
            n = n if counted is None else counted
        scratch = find_scratch(_DENOISING, expected.memory_bytes or 0, limits, task.output)
    except MsalError as error:
        return replace(record, status="failed", output=None, error=Failure.of(error))
    seconds = None
    if n is not None and settings.method in _SECONDS:
        any_s, s_per_million = _SECONDS[settings.method]
        seconds = any_s + (s_per_million + (_IN_FILES_S_PER_MILLION if scratch else 0.0)) * n / 1e6
    memory, in_files = expected.memory_bytes, None
    if scratch is not None:
        memory, in_files = scratch.room, scratch.n_bytes
    planned = Planned(size, n, seconds and round(seconds, 2), memory, in_files)
    return replace(record, format=expected.format or None, planned=planned)


def input_bytes(task: Task) -> int | None:
    """The size of an input in bytes, from the listing of a store or the system; None if unknown."""
    try:
        return task.input_mark.size if task.input_mark else os.stat(task.input).st_size
    except (OSError, ValueError):
        return None


def _check_header(path: str, format: str | None) -> int | None:
    """Raise what the reader of a local file would, as far as its beginning shows it; a file as
    small as a header is read as a whole, and the number of its vertices returned."""
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            header.check_beginning(file, size, path, format)
    except (OSError, ValueError):
        size = 0  # reading it reports the error
    if size > LOOKED_AT:
        return None
    return len(open_mesh(header.read_input(path, format), path, format).vertices)
