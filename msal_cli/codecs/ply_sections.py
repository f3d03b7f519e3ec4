"""Where the values of a PLY file stand, and how they are read and overwritten in place.

Each element becomes a section: ``Fixed`` (binary records of one size, reached through strided
views, nothing is copied), ``Varied`` (binary records that differ in size because of their lists)
or ``Lines`` (ascii, in ``ply_ascii``).  No section is made before every byte
that its counts promise is known to be there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Longs
from msal_cli.codecs.ply_ascii import (
    CUT_HINT,
    Lines,
    find_lines,
    plain_lines,
    read_stream,
)
from msal_cli.codecs.ply_header import NORMAL, Element, Header, Property
from msal_cli.codecs.record_slots import Scattered, Strided
from msal_cli.errors import FormatError, TruncatedError

Wanted = Callable[[Element], Sequence[str]]
"""The properties of an element whose places are to be kept where that costs memory."""


@dataclass(frozen=True)
class Fixed:
    """Binary records of ``stride`` bytes each from byte ``start`` on.

    ``places`` gives, for each property, the byte within the record where its value (of a list:
    its first item) stands, and the number of items that every record has (1 for a scalar).
    """

    data: Bytes
    element: Element
    order: str
    start: int
    stop: int
    stride: int
    places: dict[str, tuple[int, int]]

    def where(self, record: int) -> str:
        """The record in words."""
        return f"{self.element.name} {record}"

    def column(self, name: str) -> NDArray[np.generic]:
        """The values of a scalar (count,) or of a list (count, k), a view into the file."""
        one = self.element.properties[self.element.index(name)]
        dtype = np.dtype(self.order + one.code)
        place, length = self.places[name]
        shape: tuple[int, ...] = (self.element.count,)
        strides: tuple[int, ...] = (self.stride,)
        if one.is_list:
            shape, strides = (*shape, length), (*strides, dtype.itemsize)
        if not self.element.count or not length:
            return np.empty(shape, dtype)
        return np.ndarray(shape, dtype, self.data, self.start + place, strides)

    def items(self, name: str) -> tuple[NDArray[np.generic], Longs]:
        """All items of a list, one record behind another, and each record's number (count,)."""
        column = self.column(name)
        return column.reshape(-1), np.full(len(column), column.shape[1], dtype=np.int64)

    def slots(self, names: Sequence[str]) -> Strided:
        """Where the scalars of ``names`` are."""
        places = tuple(self.places[name][0] for name in names)
        codes = _codes(self.element, self.order, names)
        count, is_normal = self.element.count, names == NORMAL
        return Strided(self.data, self.start, count, self.stride, places, codes, is_normal)


@dataclass(frozen=True)
class Varied:
    """Binary records of differing size; ``starts`` (count, c) and ``lengths`` (count, c) say where
    the values of the properties in ``columns`` begin and how many there are."""

    data: Bytes
    element: Element
    order: str
    start: int
    stop: int
    columns: dict[str, int]
    starts: Longs
    lengths: Longs

    def where(self, record: int) -> str:
        """The record in words."""
        return f"{self.element.name} {record}"

    def _pieces(self, name: str) -> tuple[np.dtype[np.generic], Longs, Longs]:
        """Type, first bytes (count,) and sizes in bytes (count,) of a property's values."""
        one = self.element.properties[self.element.index(name)]
        dtype = np.dtype(self.order + one.code)
        k = self.columns[name]
        return (
            dtype,
            np.ascontiguousarray(self.starts[:, k]),
            self.lengths[:, k] * dtype.itemsize,
        )

    def items(self, name: str) -> tuple[NDArray[np.generic], Longs]:
        """All values of a property, one record behind another, and each record's number."""
        from msal_cli.kernels.ply_scan import gather

        dtype, starts, sizes = self._pieces(name)
        packed = np.empty(int(sizes.sum()), dtype=np.uint8)
        gather(self.data, starts, sizes, packed)
        return packed.view(dtype), np.ascontiguousarray(self.lengths[:, self.columns[name]])

    def column(self, name: str) -> NDArray[np.generic]:
        """The values of a scalar (count,) as the file stores them, copied."""
        return self.items(name)[0]

    def slots(self, names: Sequence[str]) -> Scattered:
        """Where the scalars of ``names`` are."""
        at = tuple(np.ascontiguousarray(self.starts[:, self.columns[name]]) for name in names)
        return Scattered(self.data, at, _codes(self.element, self.order, names), names == NORMAL)


Section = Fixed | Varied | Lines


def _codes(element: Element, order: str, names: Sequence[str]) -> tuple[str, ...]:
    return tuple(order + one.code for one in element.find_all(names))


def located(
    data: Bytes, header: Header, wanted: Wanted, last: str = ""
) -> tuple[dict[str, Section], int]:
    """The sections of all elements by name, and the byte behind the last one.

    With ``last``, the search ends behind the element of that name.
    Ascii records that do not stand one to a line are read as a stream of words, if that leaves
    nothing over.  Raises TruncatedError and FormatError with the element, record and, in ascii,
    line.
    """
    try:
        return _in_turn(data, header, wanted, last)
    except (FormatError, TruncatedError):
        found = read_stream(data, header, wanted) if header.encoding == "ascii" else None
        if found is None:
            raise
        return dict(found[0]), found[1]


def _in_turn(
    data: Bytes, header: Header, wanted: Wanted, last: str
) -> tuple[dict[str, Section], int]:
    """What ``located`` returns for binary records, and for ascii ones that have lines."""
    sections: dict[str, Section] = {}
    at = header.size
    for element in header.elements:
        names = wanted(element)
        plain = (
            plain_lines(data, header, element, at, names) if header.encoding == "ascii" else None
        )
        sections[element.name] = plain or section_at(data, header, element, at, names)
        at = sections[element.name].stop
        if element.name == last:
            break
    return sections, at


def section_at(
    data: Bytes,
    header: Header,
    element: Element,
    at: int,
    names: Sequence[str],
    is_stream: bool = False,
) -> Section:
    """The section of one element that begins at byte ``at``; its ascii records are one to a line,
    unless ``is_stream``.

    ``names`` are the properties whose places are to be kept where that costs memory.
    Errors as in ``located``.
    """
    if header.encoding == "ascii":
        return find_lines(data, header, element, at, names, is_stream)
    return _records(data, header, element, at, names)


def _smallest(one: Property) -> int:
    """Bytes that a property takes at the least in a binary record."""
    return np.dtype(one.count_code or one.code).itemsize


def _records(
    data: Bytes, header: Header, element: Element, at: int, wanted: Sequence[str]
) -> Section:
    places: dict[str, tuple[int, int]] = {}
    counts: list[tuple[int, int, str]] = []
    stride = 0
    for one in element.properties:
        length = 1
        if one.is_list:
            dtype = np.dtype(header.byte_order + one.count_code)
            field = data[at + stride : at + stride + dtype.itemsize]
            # Without a first record there is nothing to measure the others by.
            length = int(field.view(dtype)[0]) if len(field) == dtype.itemsize else 0
            if length < 0 or not element.count:
                length = 0
            counts.append((stride, length, header.byte_order + one.count_code))
            stride += dtype.itemsize
        places[one.name] = (stride, length)
        stride += length * np.dtype(one.code).itemsize
    size = element.count * stride
    if size <= len(data) - at:
        fixed = Fixed(data, element, header.byte_order, at, at + size, stride, places)
        if not element.count or all(
            (np.ndarray((element.count,), code, data, at + place, (stride,)) == length).all()
            for place, length, code in counts
        ):
            return fixed
    elif not counts:
        raise cut_off(element, stride, len(data) - at)
    return _varied(data, header, element, at, wanted)


def _varied(
    data: Bytes, header: Header, element: Element, at: int, wanted: Sequence[str]
) -> Section:
    from msal_cli.kernels.ply_scan import BAD_COUNT, CUT, walk_binary

    listed = element.properties
    least = sum(_smallest(one) for one in listed)
    # When the count cannot be met the walk only finds where, and nothing is allocated for it.
    fits = element.count <= (len(data) - at) // least
    names = [one.name for one in listed if one.name in wanted] if fits else []
    columns = {name: k for k, name in enumerate(names)}
    shape = (element.count if names else 0, len(names))
    starts = np.empty(shape, dtype=np.int64)
    lengths = np.empty(shape, dtype=np.int64)
    records, stop, status, which, items, size = walk_binary(
        data,
        at,
        min(element.count, len(data) + 1),
        np.array([np.dtype(one.code).itemsize for one in listed]),
        np.array([np.dtype(one.count_code).itemsize if one.is_list else 0 for one in listed]),
        np.array([one.count_code.startswith("i") for one in listed]),
        header.byte_order == ">",
        np.array([columns.get(one.name, -1) for one in listed]),
        starts,
        lengths,
    )
    if status == BAD_COUNT:
        raise negative_count(element, records, which)
    if status == CUT:
        raise cut_within(element, records, int(items) * int(size) - (len(data) - int(stop)))
    return Varied(data, element, header.byte_order, at, stop, columns, starts, lengths)


def cut_off(element: Element, stride: int, n_bytes: int) -> TruncatedError:
    """The error for ``n_bytes`` of an element whose records have ``stride`` bytes each."""
    missing = element.count * stride - n_bytes
    return TruncatedError(
        f"the file ends within element '{element.name}': {missing} bytes are missing",
        where=f"{element.name} {n_bytes // stride}",
        hint=CUT_HINT,
    )


def cut_within(element: Element, record: int, missing: int) -> TruncatedError:
    """The error for a record of which at least ``missing`` bytes are not there."""
    place = f"{element.name} {record}"
    return TruncatedError(
        f"the file ends within element '{element.name}': {place} of {element.count} needs at "
        f"least {missing} more bytes",
        where=place,
        hint=CUT_HINT,
    )


def negative_count(element: Element, record: int, which: int) -> FormatError:
    """The error for a list, the property of that number, of fewer than no items."""
    place = f"{element.name} {record}"
    return FormatError(
        f"the list '{element.properties[which].name}' of {place} has a negative count",
        where=place,
        hint="the file is damaged, or an element before this one is not what the header says",
    )
