"""3MF: positions replaced inside the XML of its model parts, inside the zip archive.

All else is kept byte for byte: the rest of the XML, every other member of the archive with its
compressed data, times, flags and place.  A mesh that several components or build items show is one
mesh, and is denoised once.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.codecs.frames import PLACEMENT, moved_by
from msal_cli.codecs.threemf_model import Model, Surface, parsed
from msal_cli.codecs.threemf_package import Package, Part
from msal_cli.codecs.zip_archive import Archive
from msal_cli.errors import ContentError, InternalError, MsalError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_SAME = "same"
_FINEST = 1e-7
"""Of the bounding box's diagonal: positions are written at least this finely."""

_MOST_DIGITS = 15
"""Digits in all that a new number has at the most: what float64 tells apart."""

_BLOCK = 1 << 16
"""Numbers of different decimals that are put in order at a time."""

SHORTEST_DOUBLE, SHORTEST_SINGLE = 255, 254
"""In place of a number of decimals: the shortest text that is read back as the same number."""


def read(data: Buffer, name: str) -> ThreeMfFile:
    """Read the meshes of a 3MF file.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError
        if the file is not what its format says, or expands beyond all meshes.
    UnsupportedError
        for encryption, a required extension that is not understood, and rare kinds of archives.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    return ThreeMfFile(data, Package(data))


@dataclass(frozen=True, eq=False)
class _Change:
    """Numbers of one model part to be written, in the order of its text: where the old ones lie,
    the new values, and the decimals of each, or ``SHORTEST_DOUBLE`` or ``SHORTEST_SINGLE``."""

    starts: Longs
    stops: Longs
    values: Floats
    decimals: NDArray[np.uint8]


@dataclass(eq=False)
class ThreeMfFile:
    """An opened 3MF file; see ``codecs.mesh_file.MeshFile``.

    ``vertices`` are those of every mesh, one behind the other.  With several meshes they stand in
    the frame of the build, since two may coincide in their own; with one, in its own.
    """

    data: Buffer = field(repr=False)
    package: Package = field(repr=False)
    vertices: Floats = field(init=False)
    faces: Ints = field(init=False)
    n_polygons: int = field(init=False)
    properties: tuple[str, ...] = field(init=False)
    warnings: tuple[str, ...] = ()
    format: str = "3mf"
    encoding: str = "binary"
    precision: str = "text"
    references: tuple[str, ...] = ()
    merged_vertices: int = 0

    def __post_init__(self) -> None:
        parts = self.package.parts
        self.vertices = np.concatenate(
            [moved_by(part.frame, part.surface.vertices) for part in parts]
        )
        self.faces = np.concatenate(
            [part.surface.faces + rows.start for part, rows in self._rows()]
        ).astype(np.int32)
        self.n_polygons = len(self.faces)
        self.properties = self._properties()

    def _rows(self) -> Iterator[tuple[Part, slice]]:
        """Each mesh and its rows of ``vertices``."""
        start = 0
        for part in self.package.parts:
            stop = start + len(part.surface.vertices)
            yield part, slice(start, stop)
            start = stop

    def _properties(self) -> tuple[str, ...]:
        package = self.package
        words = [f"{len(package.parts)} parts"] if len(package.parts) > 1 else []
        unit = next(iter(package.models.values())).unit
        if unit != "millimeter":
            words.append(f"unit {unit}")
        if package.has_instances:
            words.append("instances")
        if package.is_sole_part_placed:
            words.append(PLACEMENT)
        kept = (word for model in package.models.values() for word in model.words)
        return tuple(dict.fromkeys([*words, *kept]))

    def polygons(self) -> Ints:
        """The triangles (m, 3)."""
        return self.faces

    def forget_vertices(self) -> None:
        """Do nothing: to read them again takes long."""

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with the coordinates that differ from the stored ones replaced.

        New positions have as many decimals as those of their mesh usually have, as their own old
        number has, or as 1e-7 of the mesh's extent asks for, whichever is most.

        Raises
        ------
        UnsupportedError
            for a file with slices, a beam lattice or a signature, which would no longer fit.
        """
        if np.array_equal(vertices, self.vertices):
            return self.data
        return self._written(vertices, _SAME)

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3), all of them as the shortest text that is read back as
        the same float32 or float64, unless ``precision`` is ``same``.

        Raises
        ------
        UnsupportedError
            for an encoding other than ``same`` and ``binary``.
        ContentError
            with code ``E_RANGE`` for a position beyond float32.
        """
        if encoding == "ascii":
            raise UnsupportedError("3MF has no ascii encoding", hint="leave --encoding away")
        if precision == _SAME:
            return self.replaced(vertices)
        return self._written(vertices, precision)

    def _written(self, vertices: Floats, precision: str) -> bytes:
        self._require_free()
        texts: dict[str, Buffer] = {}
        for member, change in self._changes(vertices, precision):
            texts[member] = _patched(self.package.models[member].text, change)
        return self.package.archive.rewritten(texts)

    def _require_free(self) -> None:
        stale = [word for model in self.package.models.values() for word in model.stale]
        if self.package.is_signed:
            stale.append("a digital signature")
        if stale:
            raise UnsupportedError(
                f"the file has {stale[0]}, which would no longer fit a surface that moved",
                hint="export it as a plain mesh, or convert it with --to",
            )

    def _own(self, part: Part, rows: slice, vertices: Floats) -> Floats:
        """The new positions of a mesh in its own frame; unmoved ones exactly what the file has."""
        stored = part.surface.vertices
        moved = (vertices[rows] != self.vertices[rows]).any(axis=1)
        back = np.linalg.inv(part.frame).astype(np.float64)
        own = np.where(moved[:, None], moved_by(back, vertices[rows]), stored)
        finite = np.isfinite(own).all(axis=1)
        if not finite.all():
            raise ContentError(
                "a new position is too large for the frame of its mesh",
                code="E_RANGE",
                where=f"vertex {rows.start + int(np.argmin(finite))}",
                hint="scale the mesh down",
            )
        return own

    def _changes(self, vertices: Floats, precision: str) -> Iterator[tuple[str, _Change]]:
        """What is to be written, for each model part that changes."""
        by_member: dict[str, list[_Change]] = {}
        for part, rows in self._rows():
            own = self._own(part, rows, vertices)
            text = self.package.models[part.member].text
            change = _change(part.surface, own, text, precision, rows.start)
            if len(change.values):
                by_member.setdefault(part.member, []).append(change)
        for member, changes in by_member.items():
            yield member, _joined(changes)

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced."""
        expected = dict(self._changes(vertices, _SAME))
        _check_members(self.package, output, set(expected))
        with zipfile.ZipFile(io.BytesIO(output)) as archive:
            for member, change in expected.items():
                _check_text(self.package.models[member], archive.read(member), change)


def _change(surface: Surface, own: Floats, text: bytes, precision: str, first: int) -> _Change:
    """What is to be written for the new positions of a mesh, in its own frame.

    ``first`` is the number of its first vertex, for messages.
    """
    if precision == _SAME:
        is_new = own != surface.vertices
        starts, stops, values = surface.starts[is_new], surface.stops[is_new], own[is_new]
        decimals = _decimals(surface, values, text, starts, stops)
        return _Change(starts, stops, values, decimals)
    beyond = np.abs(own).max(axis=1) > float(np.finfo(np.float32).max)
    if precision == "float32" and beyond.any():
        raise ContentError(
            "a position is too large for float32",
            code="E_RANGE",
            where=f"vertex {first + int(np.argmax(beyond))}",
            hint="use --precision float64",
        )
    style = SHORTEST_SINGLE if precision == "float32" else SHORTEST_DOUBLE
    values = own.reshape(-1)
    decimals = np.full(len(values), style, dtype=np.uint8)
    return _Change(surface.starts.reshape(-1), surface.stops.reshape(-1), values, decimals)


def _decimals(
    surface: Surface, values: Floats, text: bytes, starts: Longs, stops: Longs
) -> NDArray[np.uint8]:
    """Decimals (k,) of the new numbers of a mesh; the old ones lie at these bytes."""
    from msal_cli.codecs.decimals import usual_decimals
    from msal_cli.kernels import text as texts
    from msal_cli.kernels.digits import MOST_DECIMALS

    if not len(values):
        return np.zeros(0, dtype=np.uint8)
    buffer = texts.as_bytes(text)
    used = texts.decimals_used(buffer, surface.starts.reshape(-1), surface.stops.reshape(-1))
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    step = 2.0 * math.hypot(*(high * 0.5 - low * 0.5).tolist()) * _FINEST
    needed = math.ceil(-math.log10(step)) if 0.0 < step < math.inf else 0
    largest = float(np.abs(values).max())
    whole = math.ceil(math.log10(largest)) if largest > 1.0 else 0
    most = min(_MOST_DIGITS - whole, MOST_DECIMALS)
    if needed > most or most < 0:
        return np.full(len(values), SHORTEST_DOUBLE, dtype=np.uint8)
    least = min(max(usual_decimals(used), needed), most)
    own = texts.decimals_used(buffer, starts, stops)
    return np.clip(own, least, most).astype(np.uint8)


def _joined(changes: list[_Change]) -> _Change:
    """The changes of one part as one, in the order of the text."""
    starts = np.concatenate([one.starts for one in changes])
    if len(changes) == 1 and (starts[:-1] < starts[1:]).all():
        return changes[0]
    order = np.argsort(starts, kind="stable")
    return _Change(
        starts[order],
        np.concatenate([one.stops for one in changes])[order],
        np.concatenate([one.values for one in changes])[order],
        np.concatenate([one.decimals for one in changes])[order],
    )


def _patched(text: bytes, change: _Change) -> memoryview:
    """A part's text with new numbers."""
    from msal_cli.kernels import text as texts

    numbers, ends = _printed(change)
    buffer = texts.as_bytes(text)
    return texts.spliced(buffer, change.starts, change.stops, numbers, ends).data


def _printed(change: _Change) -> tuple[NDArray[np.uint8], Longs]:
    """The texts of the new numbers, one behind the other, and where each ends."""
    if (change.decimals == change.decimals[0]).all():
        return _printed_alike(change.values, int(change.decimals[0]))
    pieces, ends, size = [], [], 0
    for at in range(0, len(change.values), _BLOCK):
        some = slice(at, at + _BLOCK)
        text, stops = _printed_mixed(change.values[some], change.decimals[some])
        pieces.append(text)
        ends.append(stops + size)
        size += len(text)
    return np.concatenate(pieces), np.concatenate(ends)


def _printed_mixed(values: Floats, decimals: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Longs]:
    """The same for numbers with different decimals, of which there are not too many."""
    lengths = np.zeros(len(values), dtype=np.int64)
    groups = []
    for one in np.unique(decimals):
        rows = np.flatnonzero(decimals == one)
        text, stops = _printed_alike(values[rows], int(one))
        lengths[rows] = np.diff(stops, prepend=0)
        groups.append((rows, text))
    ends = np.cumsum(lengths)
    out = np.empty(int(ends[-1]), dtype=np.uint8)
    for rows, text in groups:
        own = lengths[rows]
        shift = ends[rows] - np.cumsum(own)
        out[np.arange(len(text)) + np.repeat(shift, own)] = text
    return out, ends


def _printed_alike(values: Floats, decimals: int) -> tuple[NDArray[np.uint8], Longs]:
    from msal_cli.kernels import text

    if decimals in (SHORTEST_DOUBLE, SHORTEST_SINGLE):
        return text.printed_shortest(values, decimals == SHORTEST_SINGLE)
    return text.printed(values, decimals)


def _check_members(package: Package, output: Buffer, changed: set[str]) -> None:
    """Raise InternalError if more changed in the archive than the content of some members."""
    old = package.archive
    try:
        new = Archive(output)
    except MsalError as failure:
        raise InternalError(f"the 3MF file that was made cannot be read: {failure}") from None
    if [one.name for one in new.members] != [one.name for one in old.members]:
        raise InternalError("the 3MF file that was made has other members")
    for was, now in zip(old.members, new.members, strict=True):
        if was.name not in changed and (
            old.data[was.header_at : was.stop] != new.data[now.header_at : now.stop]
        ):
            raise InternalError(f"{was.name} changed in a 3MF file")
        if (was.flags, was.method) != (now.flags, now.method):
            raise InternalError(f"{was.name} was packed in another way")


def _check_text(model: Model, output: bytes, change: _Change) -> None:
    """Raise InternalError unless ``output`` is the text of ``model`` with just that replaced."""
    from msal_cli.kernels import text as texts

    try:
        starts, stops = _tokens(parsed(output, ""))
    except MsalError as failure:
        raise InternalError(f"the 3MF model that was made cannot be read: {failure}") from None
    before, _ = _tokens(model)
    if len(starts) != len(before):
        raise InternalError("the 3MF model that was made has other vertices")
    which = np.searchsorted(before, change.starts)
    starts, stops = starts[which], stops[which]
    a, b = texts.as_bytes(model.text), texts.as_bytes(output)
    if not texts.same_outside(a, change.starts, change.stops, b, starts, stops):
        raise InternalError("the 3MF model that was made differs in more than positions")
    values, bad = texts.numbers_at(b, starts, stops)
    wanted = change.values
    slack = 0.5 * 10.0 ** -change.decimals.astype(np.float64) * (1.0 + 1e-9)
    if bad >= 0 or (np.abs(values - wanted) > slack + 4.5e-16 * np.abs(wanted)).any():
        raise InternalError("a position of a 3MF file was not written right")


def _tokens(model: Model) -> tuple[Longs, Longs]:
    """Where all numbers of vertices lie in a part, in the order of its text."""
    surfaces = model.surfaces.values()
    starts = np.concatenate([one.starts.reshape(-1) for one in surfaces])
    stops = np.concatenate([one.stops.reshape(-1) for one in surfaces])
    order = np.argsort(starts)
    return starts[order], stops[order]
