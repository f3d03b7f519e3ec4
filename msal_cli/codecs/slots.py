"""The places of an array of numbers in a file, and binary records that are overwritten in place.

An array of shape (n, k) is in binary records, whose numbers keep their places, or in text (see
``text_slots``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.errors import ContentError, InternalError
from msal_cli.light_dataclass import dataclass


class Slots:
    """An array (n, k) inside a file."""

    values: Floats  # (n, k) float64, exactly as stored
    # numpy's type of each column if it limits the numbers; empty if none does
    codes: tuple[str, ...] = ()
    whole_rows: bool = False  # if one number of a row changes, all of them are rewritten

    def rounded(self, values: Floats) -> Floats:
        """New values (n, k) rounded to the types of the columns; the same array if rounding changes
        nothing."""
        if len(set(self.codes)) == 1:
            return _round_to(values, self.codes[0])
        columns = zip(values.T, self.codes, strict=True)
        return np.stack([_round_to(column, code) for column, code in columns], axis=1)


def to_type(values: Floats, code: str) -> NDArray[np.generic]:
    """Values (n, k) converted to a file's number type, rounded to the nearest.

    A half is rounded to the even neighbour.  A value beyond the type's range becomes infinite
    (float) or wraps around (integer): ``require_range`` refuses it.
    """
    dtype = np.dtype(code)
    with np.errstate(over="ignore", invalid="ignore"):
        return (values if dtype.kind == "f" else np.rint(values)).astype(dtype)


def _round_to(values: Floats, code: str) -> Floats:
    """Values rounded as by ``to_type``; those beyond the range of an integer do not wrap around."""
    dtype = np.dtype(code)
    if dtype.kind != "f":
        return np.rint(values)
    return values if dtype.itemsize == 8 else to_type(values, code).astype(np.float64)


def as_float32(positions: Floats) -> NDArray[np.float32]:
    """Positions (m, 9) or (n, 3) as float32; ContentError (``E_RANGE``) beyond its range."""
    with np.errstate(over="ignore", under="ignore"):
        rounded = positions.astype(np.float32)
    is_beyond = np.isfinite(positions) & ~np.isfinite(rounded)
    if is_beyond.any():
        bad = int(np.argmax(is_beyond.reshape(len(rounded), -1).any(axis=1)))
        raise ContentError(
            "a position is too large for float32",
            code="E_RANGE",
            where=f"row {bad}",
            hint="scale the mesh, or write it to a format with float64",
        )
    return rounded


def require_range(values: Floats, is_changed: Flags, codes: Sequence[str]) -> None:
    """Raise ContentError (``E_RANGE``) if a changed number (n, k) does not fit its type; ``codes``
    are numpy's types of the columns."""
    dtypes = [np.dtype(code) for code in codes]
    # Fast path for floats: the extremes are enough; NaN fails the comparison.
    largest = max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
    if all(dtype.kind == "f" and largest <= float(np.finfo(dtype).max) for dtype in dtypes):
        return
    for k, dtype in enumerate(dtypes):
        limits = np.finfo(dtype) if dtype.kind == "f" else np.iinfo(dtype)
        low, high = float(limits.min), float(limits.max)
        if high > limits.max:
            high = float(np.nextafter(high, 0.0))
        column = values[:, k] if dtype.kind == "f" else np.rint(values[:, k])
        # Written so that NaN counts as outside.
        is_outside = is_changed[:, k] & ~((column >= low) & (column <= high))
        if is_outside.any():
            vertex = int(np.argmax(is_outside))
            raise ContentError(
                f"the new {'xyz'[k]} of vertex {vertex} does not fit the file's number type",
                where=f"vertex {vertex}",
                hint="write the positions as doubles (--precision float64, --to ply), or scale "
                "the mesh",
                code="E_RANGE",
            )


_RECORDS = 1 << 14  # records processed at a time, so that they stay in the cache
_PARTS = 8  # parts of an array that are worth a thread
_CHUNK = 1 << 20  # bytes compared at a time, so that no temporary is as large as the file


class RecordSlots(Slots):
    """An array in binary data, whose numbers have fixed places and sizes.

    ``write`` stores values (n, k) where a mask (n, k) is set, and ``restore`` the file's own bytes,
    because 64-bit whole numbers need not fit a double.  Both work on bytes that begin at ``origin``
    of the file.

    Attributes
    ----------
    data : (size,) uint8, the file.
    codes : numpy's type of each column, with byte order.
    span : the first byte of the first record, and the end of the last one.
    """

    data: Bytes

    def read(self, data: Bytes, origin: int = 0) -> Floats:
        """The numbers (n, k) in ``data``, which begins at byte ``origin`` of the file."""
        raise NotImplementedError

    def parts(self) -> Iterator[tuple[RecordSlots, slice]]:
        """Arrays of some of the records that together make up this one, and their rows."""
        yield self, slice(None)

    @property
    def values(self) -> Floats:  # type: ignore[override]
        """The numbers (n, k), read each time: that takes as long as a copy."""
        return self.read(self.data)


@dataclass(eq=False)
class Strided(RecordSlots):
    """Columns of records of one size: record i begins at byte ``start`` + i * ``stride``.

    ``places`` are the first bytes of the columns within a record.
    """

    data: Bytes
    start: int
    count: int
    stride: int
    places: tuple[int, ...]
    codes: tuple[str, ...]
    whole_rows: bool = False

    @property
    def span(self) -> tuple[int, int]:
        return self.start, self.start + self.count * self.stride

    def _views(self, data: Bytes, origin: int) -> Iterator[tuple[slice, NDArray[np.generic]]]:
        """Columns and views (n, k) of them in ``data``; a single view, which is much faster, if the
        records contain nothing else."""
        if not self.count:
            return
        dtypes = [np.dtype(code) for code in self.codes]
        first, size = self.start - origin, dtypes[0].itemsize
        if self.places == tuple(range(0, self.stride, size)) and len(set(dtypes)) == 1:
            yield slice(None), np.ndarray((self.count, len(dtypes)), dtypes[0], data, first)
            return
        for k, (place, dtype) in enumerate(zip(self.places, dtypes, strict=True)):
            strides = (self.stride, dtype.itemsize)
            view = np.ndarray((self.count, 1), dtype, data, first + place, strides)
            yield slice(k, k + 1), view

    def read(self, data: Bytes, origin: int = 0) -> Floats:
        values = np.empty((self.count, len(self.codes)))
        # A signalling NaN, which is reported elsewhere, must not cause a warning here.
        with np.errstate(invalid="ignore"):
            for columns, view in self._views(data, origin):
                values[:, columns] = view
        return values

    def write(self, out: Bytes, values: Floats, where: Flags, origin: int = 0) -> None:
        for columns, view in self._views(out, origin):
            np.copyto(view, to_type(values[:, columns], view.dtype.str), where=where[:, columns])

    def restore(self, out: Bytes, where: Flags, origin: int = 0) -> None:
        for (columns, view), (_, own) in zip(
            self._views(out, origin), self._views(self.data, 0), strict=True
        ):
            np.copyto(view, own, where=where[:, columns])

    def parts(self) -> Iterator[tuple[RecordSlots, slice]]:
        for low in range(0, self.count, _RECORDS):
            high = min(low + _RECORDS, self.count)
            part = replace(self, start=self.start + low * self.stride, count=high - low)
            yield part, slice(low, high)


@dataclass(eq=False)
class Scattered(RecordSlots):
    """Columns of records of different sizes; ``at`` has the first bytes (n,) of each column."""

    data: Bytes
    at: tuple[Longs, ...]
    codes: tuple[str, ...]
    whole_rows: bool = False

    @property
    def span(self) -> tuple[int, int]:
        sizes = [np.dtype(code).itemsize for code in self.codes]
        stop = max(int(at.max()) + size for at, size in zip(self.at, sizes, strict=True))
        return min(int(at.min()) for at in self.at), stop

    def _bytes(self) -> Iterator[tuple[int, str, Longs]]:
        """Columns, their types, and the places (n, size) of all bytes of their numbers."""
        for k, (at, code) in enumerate(zip(self.at, self.codes, strict=True)):
            yield k, code, at[:, None] + np.arange(np.dtype(code).itemsize)

    def read(self, data: Bytes, origin: int = 0) -> Floats:
        values = np.empty((len(self.at[0]), len(self.codes)))
        with np.errstate(invalid="ignore"):
            for k, code, places in self._bytes():
                values[:, k] = data[places - origin].view(code)[:, 0]
        return values

    def write(self, out: Bytes, values: Floats, where: Flags, origin: int = 0) -> None:
        for k, code, places in self._bytes():
            numbers = to_type(values[where[:, k], k], code)
            out[places[where[:, k]] - origin] = numbers[:, None].view(np.uint8)

    def restore(self, out: Bytes, where: Flags, origin: int = 0) -> None:
        for k, _, places in self._bytes():
            own = places[where[:, k]]
            out[own - origin] = self.data[own]


class Change(NamedTuple):
    """New ``values`` (n, k) of an array, and which of its numbers ``is_changed`` (n, k)."""

    slots: Any
    values: Floats
    is_changed: Flags

    def parts(self) -> list[Change]:
        """The change in parts of some records each, which fit the cache."""
        return [
            Change(slots, self.values[rows], self.is_changed[rows])
            for slots, rows in self.slots.parts()
        ]


def overwrite(data: Bytes, changes: Sequence[Change]) -> memoryview:
    """A copy of the file with the new numbers in its records."""
    from msal_cli.kernels.parallel import over_ranges

    # A numpy array is in large pages, if the system has them.
    copy = data.copy()

    def write(start: int, stop: int) -> None:
        for slots, values, is_changed in parts[start:stop]:
            slots.write(copy, values, is_changed)

    for change in changes:
        parts = change.parts()
        over_ranges(write, len(parts), smallest=_PARTS)
    return copy.data


def check_overwritten(data: Bytes, result: Bytes, changes: Sequence[Change]) -> None:
    """Raise InternalError unless ``result`` is ``data`` with only these numbers changed."""
    from msal_cli.kernels.parallel import over_ranges

    def require_same(start: int, stop: int, after: Bytes) -> None:
        if not is_same(data[start:stop], after):
            raise InternalError("the output differs from the input outside its positions")

    def check(start: int, stop: int) -> None:
        for group in groups[start:stop]:
            first, last = _span(group)
            restored = result[first:last].copy()
            for slots, values, is_changed in group:
                is_other = slots.read(restored, first) != slots.rounded(values)
                if (is_other & is_changed).any():
                    raise InternalError("a number of the output is not the computed one")
                slots.restore(restored, is_changed, first)
            require_same(first, last, restored)

    if len(data) != len(result):
        raise InternalError("the output is not as long as the input")
    done = 0
    for together in _overlapping(changes):
        groups: list[Sequence[Change]] = [together]
        if len({change.slots.span for change in together}) == 1:
            groups = list(zip(*(change.parts() for change in together), strict=True))
        over_ranges(check, len(groups), smallest=_PARTS)
        start, stop = _span(together)
        require_same(done, start, result[done:start])
        done = stop
    require_same(done, len(data), result[done:])


def _overlapping(changes: Sequence[Change]) -> Iterator[list[Change]]:
    """The changes in order, grouped if their arrays are in the same records."""
    group: list[Change] = []
    for change in sorted(changes, key=lambda change: change.slots.span):
        if group and change.slots.span[0] >= _span(group)[1]:
            yield group
            group = []
        group.append(change)
    if group:
        yield group


def _span(group: Sequence[Change]) -> tuple[int, int]:
    spans = [change.slots.span for change in group]
    return min(start for start, _ in spans), max(stop for _, stop in spans)


def is_same(a: Bytes, b: Bytes) -> bool:
    """Whether two byte strings are equal, without a temporary as large as they are."""
    from msal_cli.kernels.parallel import over_ranges

    def compare(first: int, last: int) -> bool:
        return all(
            np.array_equal(a[at : at + _CHUNK], b[at : at + _CHUNK])
            for at in range(first * _CHUNK, last * _CHUNK, _CHUNK)
        )

    return len(a) == len(b) and all(over_ranges(compare, -(-len(a) // _CHUNK), smallest=4))


def number_within(sizes: Longs) -> Longs:
    """0, 1, 2 ... within each group; ``sizes`` (n,) are those of the groups, the result (sum,)."""
    return np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
