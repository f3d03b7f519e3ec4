"""Volumes out of files: NumPy's .npy, and raw numbers whose counts are given."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.simulation.marching import extract_surface
from msal_cli.analysis.simulation.settings import MOST_CELLS
from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ContentError, FormatError, TooLargeError, TruncatedError, UsageError

TYPES = {
    "uint8": "<u1",
    "int8": "<i1",
    "uint16": "<u2",
    "int16": "<i2",
    "uint32": "<u4",
    "int32": "<i4",
    "float32": "<f4",
    "float64": "<f8",
}
"""Types of the numbers of a raw file, little endian."""

MAGIC = b"\x93NUMPY"
"""First bytes of a .npy file."""

LEAST_SPACING, MOST_SPACING = 1e-30, 1e30
"""Of a voxel's edges, file units: so that areas of triangles are numbers above 0."""

_TRUNCATED_HINT = "copy or export it again"


@dataclass(frozen=True)
class VolumeSettings:
    """How a volume becomes a mesh.

    Attributes
    ----------
    iso : value at the surface, greater values are inside; None for the middle between the least
        and the greatest.
    spacing : (3,) from voxel to voxel along x, y and z, in the units that the mesh is to have.
    counts : (3,) voxels along x, y and z of a raw file; None for a .npy file, which has them.
    number_type : of a raw file, one of ``TYPES``.
    """

    iso: float | None = None
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    counts: tuple[int, int, int] | None = None
    number_type: str = "uint8"

    def __post_init__(self) -> None:
        if not all(LEAST_SPACING <= one <= MOST_SPACING for one in self.spacing):
            words = ",".join(f"{one:g}" for one in self.spacing)
            raise UsageError(
                f"the spacing is {words}; each of its lengths must be from {LEAST_SPACING:g} to "
                f"{MOST_SPACING:g}",
                hint="choose another unit of length",
            )
        if self.counts is not None and not all(one > 0 for one in self.counts):
            raise UsageError(f"the counts {self.counts} are not three numbers above 0")
        if self.number_type not in TYPES:
            raise UsageError(
                f"there is no type {self.number_type!r}", hint=f"known are: {', '.join(TYPES)}"
            )
        if self.iso is not None and not math.isfinite(self.iso):
            raise UsageError(f"the value at the surface is {self.iso}, not a number")


def mesh_volume(data: bytes | memoryview, settings: VolumeSettings) -> tuple[Floats, Ints, float]:
    """The surface in a volume file: vertices (n, 3), faces (m, 3), and the value that it has.

    The axes of a .npy array are z, y and x, as those of medical images are; raw numbers have x
    running fastest, which is the same.  The centre of the first voxel is the origin.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError, ContentError
        for a file that does not hold the volume that it, or the settings, say.
    """
    volume = read_raw(data, settings) if settings.counts is not None else read_npy(data)
    if min(volume.shape) < 2:
        counts = " x ".join(map(str, volume.shape[::-1]))
        raise ContentError(
            f"the volume has {counts} voxels, and a surface needs two and more along each axis",
            code="E_NO_FACES",
            hint="stack slices along the first axis",
        )
    with np.errstate(over="ignore"):
        values = volume.transpose(2, 1, 0).astype(np.float32)
    if not np.isfinite(values).all():
        raise ContentError(
            "the volume has values that are not finite, or too large for single precision",
            code="E_NONFINITE",
            hint="replace them by the value of the air",
        )
    least, greatest = float(values.min()), float(values.max())
    iso = settings.iso
    if iso is None:
        iso = (least + greatest) / 2.0
    if least == greatest:
        raise ContentError(
            f"every voxel has the value {least:g}: there is no surface",
            code="E_NO_FACES",
            hint="check the file, and the number type of a raw one (--type)",
        )
    if not least < iso < greatest:
        raise ContentError(
            f"there is no surface at the value {iso:g}: the voxels have values from {least:g} to "
            f"{greatest:g}",
            code="E_NO_FACES",
            hint="choose a value between these with --iso",
        )
    vertices, faces = extract_surface(values, iso, np.asarray(settings.spacing))
    return vertices, faces, iso


def read_raw(data: bytes | memoryview, settings: VolumeSettings) -> NDArray[np.generic]:
    """The numbers (nz, ny, nx) of a raw file, which has nothing else in it."""
    assert settings.counts is not None
    dtype = np.dtype(TYPES[settings.number_type])
    shape = settings.counts[::-1]
    _check_size(shape)
    wanted = math.prod(shape) * dtype.itemsize
    if len(data) != wanted:
        counts = " x ".join(map(str, settings.counts))
        message = (
            f"{counts} numbers of type {settings.number_type} take {wanted:,} bytes, and the file "
            f"has {len(data):,}"
        )
        error = TruncatedError if len(data) < wanted else FormatError
        hint = "check --dims and --type; a header must be cut off first"
        if bytes(data[: len(MAGIC)]) == MAGIC:
            hint = "this is a .npy file, which says its size itself: leave out --dims and --type"
        raise error(message, hint=hint)
    return np.frombuffer(data, dtype).reshape(shape)


def read_npy(data: bytes | memoryview) -> NDArray[np.generic]:
    """The array (nz, ny, nx) of a .npy file; its counts are checked before anything is read."""
    if bytes(data[: len(MAGIC)]) != MAGIC:
        raise FormatError(
            "the file does not begin as a .npy file does",
            hint="for a raw volume, give its size with --dims X,Y,Z and its numbers with --type",
        )
    # A header has ten thousand bytes at most.
    stream = io.BytesIO(bytes(data[: 1 << 16]))
    try:
        version = np.lib.format.read_magic(stream)
        read = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, is_fortran, dtype = read(stream)
    except (ValueError, SyntaxError, TypeError, KeyError, RecursionError) as error:
        words = str(error).split("\n")[0]
        if words.startswith("EOF"):
            raise TruncatedError(
                "the file ends within the header of the array", hint=_TRUNCATED_HINT
            ) from None
        raise FormatError(
            f"the header of the .npy file cannot be read: {words}",
            hint="save the array again, with numpy.save",
        ) from None
    if len(shape) != 3:
        raise ContentError(
            f"the array has {len(shape)} axes (shape {shape}), and a volume has three",
            hint="save an array with the axes z, y and x",
        )
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        raise ContentError(
            f"the numbers of the array are of type {dtype}, which a volume cannot have",
            hint="save whole or real numbers of at most 64 bits, such as uint16 or float32",
        )
    if min(shape) < 0:
        raise FormatError(f"the array has shape {shape}")
    _check_size(shape)
    count = math.prod(shape)
    start = stream.tell()
    if len(data) - start < count * dtype.itemsize:
        raise TruncatedError(
            f"the array has {count * dtype.itemsize:,} bytes, and the file has "
            f"{len(data) - start:,} of them",
            hint=_TRUNCATED_HINT,
        )
    values = np.frombuffer(data, dtype, count, start)
    return values.reshape(shape, order="F" if is_fortran else "C")


def _check_size(shape: tuple[int, ...]) -> None:
    if math.prod(shape) > MOST_CELLS:
        raise TooLargeError(
            f"the volume has {math.prod(shape):,} voxels, more than {MOST_CELLS:,}",
            hint="cut it into parts, or take every second voxel",
        )
