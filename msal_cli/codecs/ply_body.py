"""The places of values in a PLY file, and how they are read and overwritten in place.

Each element becomes a section: ``Fixed`` (binary records of one size, read through strided views
without copying), ``Varied`` (binary records whose sizes differ because of their lists) or ``Lines``
(ascii).  A section is made only if all bytes that its counts need are there.
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Ints, Longs
from msal_cli.codecs.ply_header import NORMAL, POSITION, Element, Header
from msal_cli.codecs.slots import Scattered, Strided
from msal_cli.codecs.text_slots import Statements, TextSlots, line_of, number_hint, skip_lines
from msal_cli.errors import FormatError, cut_short, format_count
from msal_cli.kernels.parallel import at_once, is_worth_it, threads
from msal_cli.light_dataclass import dataclass, field

_SAMPLE = 4_096  # bytes after an ascii header that are searched for binary data if a line is wrong

Wanted = Callable[[Element], Sequence[str]]
"""The properties of an element whose places are needed, where storing places costs memory."""

MAX_UNUSUAL = 5_000  # records with unusual numbers, up to which each line keeps its own decimals


class Places(NamedTuple):
    """Words of ascii records: ``starts`` and ``stops`` (count, c) of the properties in ``columns``
    (for a list, of its count), and ``lengths`` (count, c), their numbers of items."""

    columns: dict[str, int]
    starts: Longs
    stops: Longs
    lengths: Longs


@dataclass(frozen=True, eq=False)
class Part:
    """An element whose records begin at byte ``start``."""

    data: Bytes
    header: Header
    element: Element
    start: int

    def where(self, record: int) -> str:
        return f"{self.element.name} {record}"

    def can_hold(self) -> bool:
        """Whether the bytes from ``start`` on are enough for the element as text."""
        # A value is at least one digit and one separator; only the file's last one has none.
        n_values = len(self.element.properties) * self.element.count
        return 2 * n_values <= len(self.data) - self.start + 1

    def kept_names(self, wanted: Sequence[str]) -> tuple[str, ...]:
        """Those of the ``wanted`` properties that the element has, in file order."""
        return tuple(prop.name for prop in self.element.properties if prop.name in wanted)

    def codes(self, names: Sequence[str]) -> tuple[str, ...]:
        """Numpy's types of the properties in binary records."""
        order = self.header.byte_order
        return tuple(order + prop.code for prop in self.element.find_all(names))


@dataclass(frozen=True, eq=False)
class Lines(Part):
    """Ascii records, one per line."""

    stop: int
    kept: tuple[str, ...]  # the properties whose values or words are available, in file order
    # their values (count, len(kept)) if the records are plain; then the places of words are found
    # only on demand
    scalars: Floats | None = None
    # for positions and normals, if their three scalars are adjacent, the first byte of the three
    # in each record (count,), and their most decimals (count,)
    statements: dict[tuple[str, ...], tuple[Longs, Bytes]] = field(default_factory=dict)
    # for the only list kept, all its items, record by record, and their number in each record
    # (count,)
    plain_list: tuple[Ints, Ints] | None = None

    @functools.cached_property
    def tokens(self) -> Places:
        """The places of all words of the properties ``kept``."""
        return _find_tokens(self, self.kept)[0]

    def where(self, record: int) -> str:
        line = line_of(self.data, int(self.tokens.starts[record, 0]))
        return f"{self.element.name} {record}, line {line}"

    def spans(self, names: Sequence[str]) -> tuple[Longs, Longs]:
        """First bytes and ends (count * len(names),) of the tokens, record by record.

        They ascend when ``names`` are in file order.
        """
        columns, starts, stops, _ = self.tokens
        pick = [columns[name] for name in names]
        if pick == list(range(starts.shape[1])):
            return starts.reshape(-1), stops.reshape(-1)
        return starts[:, pick].reshape(-1), stops[:, pick].reshape(-1)

    def not_a_number(self, start: int, wanted: str) -> FormatError:
        """The error for the token at byte ``start``, which is not what was ``wanted``."""
        token = self.data[start : start + 40].tobytes().split(maxsplit=1)[0]
        return FormatError(
            f"{token.decode('latin-1')!r} in element '{self.element.name}' is not {wanted}",
            where=f"line {line_of(self.data, start)}",
            hint=number_hint(token),
        )

    def slots(self, names: tuple[str, ...]) -> TextSlots:
        """The slots of the scalars ``names``.

        Raises FormatError, with the line, for one that is not a number.
        """
        from msal_cli.kernels.text import read_numbers

        slots: TextSlots
        values = self.scalars
        if values is not None and names != self.kept:
            values = np.ascontiguousarray(values[:, [self.kept.index(name) for name in names]])
        if values is not None and names in self.statements:
            at, used = self.statements[names]
            slots = Statements(self.data, at, values=values)
            slots.used = used
        else:
            starts, stops = self.spans(names)
            if values is None:
                numbers, bad = read_numbers(self.data, starts, stops)
                if bad >= 0:
                    raise self.not_a_number(int(starts[bad]), "a number")
                values = numbers.reshape(self.element.count, len(names))
            slots = TextSlots(self.data, starts, values=values)
        slots.codes = tuple(prop.code for prop in self.element.find_all(names))
        slots.unit_length = slots.whole_rows = names == NORMAL
        slots.significant = math.inf  # written in fixed point
        return slots

    def items(self, name: str) -> tuple[NDArray[Any], Longs | Ints]:
        """All items of a list of whole numbers, and their number in each record (count,)."""
        from msal_cli.kernels.ply_scan import read_integers

        if self.plain_list is not None:
            return self.plain_list
        starts, stops, lengths = self.item_spans(name)
        items = np.empty(len(starts), dtype=np.int64)
        bad = int(read_integers(self.data, starts, stops, items))
        if bad >= 0:
            raise self.not_a_number(int(starts[bad]), "a whole number")
        return items, lengths

    def item_spans(self, name: str) -> tuple[Longs, Longs, Longs]:
        """First bytes and ends of all items of a list, and their number in each record (count,)."""
        from msal_cli.kernels.ply_scan import list_tokens

        k = self.tokens.columns[name]
        lengths = np.ascontiguousarray(self.tokens.lengths[:, k])
        starts = np.empty(int(lengths.sum()), dtype=np.int64)
        stops = np.empty_like(starts)
        counts = np.ascontiguousarray(self.tokens.stops[:, k])
        list_tokens(self.data, counts, lengths, starts, stops)
        return starts, stops, lengths


def _plain_lines(part: Part, wanted: Sequence[str]) -> Lines | None:
    """The section of an element if its records are plain, with scalars only, or one wanted list
    and unwanted properties; else None."""
    properties = part.element.properties
    if not properties or not part.element.count or not part.can_hold():
        return None
    read = _read_lists if any(prop.is_list for prop in properties) else _read_scalars
    return read(part, part.kept_names(wanted))


def _read_scalars(part: Part, kept: tuple[str, ...]) -> Lines | None:
    from msal_cli.kernels.ply_scan import WHOLE, read_scalars

    element = part.element
    names = [prop.name for prop in element.properties]
    together: list[tuple[str, ...]] = [
        group
        for group in (POSITION, NORMAL)
        if set(group) <= set(kept) and tuple(names[names.index(group[0]) :][:3]) == group
    ]
    group_of = {name: g for g, group in enumerate(together) for name in group}
    values = np.empty((element.count, len(kept)))
    first_at = np.empty((len(together), element.count), dtype=np.int64)
    decimals = np.empty((len(together), element.count), dtype=np.uint8)
    columns = np.array([kept.index(name) if name in kept else -1 for name in names])
    groups = np.array([group_of.get(name, -1) for name in names])

    def read(at: int, start: int, stop: int) -> tuple[int, int, int]:
        made = columns, groups, values, first_at, decimals
        return cast(tuple[int, int, int], read_scalars(part.data, at, start, stop, *made))

    pieces = _read_pieces(part, read) or [read(part.start, 0, element.count)]
    n_unusual, stops, statuses = zip(*pieces, strict=True)
    if statuses[-1] != WHOLE or sum(n_unusual) > MAX_UNUSUAL:
        return None
    statements = dict(zip(together, zip(first_at, decimals, strict=True), strict=True))
    return Lines(**vars(part), stop=stops[-1], kept=kept, scalars=values, statements=statements)


def _read_pieces(part: Part, read: Callable[[int, int, int], Any]) -> list[Any]:
    """Read pieces of the records in parallel: the results of ``read(at, start, stop)``, or an empty
    list if a piece is incomplete, or its records do not have a line each.

    The last two numbers of a result are the end of the records, and ``WHOLE``.
    """
    from msal_cli.kernels.ply_scan import WHOLE, next_record

    count = part.element.count
    if not is_worth_it(count):
        return []
    bounds = [count * piece // threads() for piece in range(threads() + 1)]
    places = [int(next_record(part.data, part.start))]
    for start, stop in itertools.pairwise(bounds[:-1]):
        places.append(skip_lines(part.data, places[-1], stop - start))
    spans = zip(places, bounds, bounds[1:], strict=False)
    pieces = at_once(count, *[functools.partial(read, *span) for span in spans])
    ends = [next_record(part.data, piece[-2]) for piece in pieces[:-1]]
    is_cut_well = ends == [next_record(part.data, at) for at in places[1:]]
    return pieces if is_cut_well and all(piece[-1] == WHOLE for piece in pieces) else []


def _read_lists(part: Part, kept: tuple[str, ...]) -> Lines | None:
    from msal_cli.kernels.ply_scan import FULL, ODD, WHOLE, read_lists

    data, element = part.data, part.element
    if len(kept) > 1 or not all(prop.is_list for prop in element.find_all(kept)):
        return None
    is_list = np.array([prop.is_list for prop in element.properties])
    which = element.index(kept[0]) if kept else -1
    # An item takes at least a digit and a blank.
    most = (len(data) - part.start) // 2 + 1
    items = np.empty(min(3 * element.count, most) if kept else 0, dtype=np.int32)
    lengths = np.empty(element.count if kept else 0, dtype=np.int32)

    def read(at: int, start: int, stop: int) -> tuple[int, int, int, int]:
        """Read records, assuming that all earlier ones are triangles."""
        of = is_list, which, items, 3 * start, lengths
        return cast(tuple[int, int, int, int], read_lists(data, at, start, stop, *of))

    pieces = _read_pieces(part, read)
    are_triangles = all(n_items == 3 * stop for stop, n_items, _, _ in pieces)
    done, n_items, at, status = pieces[-1] if pieces and are_triangles else (0, 0, part.start, FULL)
    while status != WHOLE:
        done, n_items, at, status = read_lists(
            data, at, done, element.count, is_list, which, items, n_items, lengths
        )
        if status == ODD or (status == FULL and len(items) >= most):
            return None
        if status == FULL:
            # Assume as many items per record as those so far have.
            alike = (n_items // max(done, 1) + 1) * element.count
            larger = np.empty(min(max(alike, len(items) * 3 // 2 + 64), most), dtype=np.int32)
            larger[:n_items] = items[:n_items]
            items = larger
    if len(lengths) and (lengths == lengths[0]).all():
        # One number instead of one for each record.
        lengths = np.broadcast_to(lengths[:1].copy(), lengths.shape)
    plain_list = items[:n_items], lengths
    return Lines(**vars(part), stop=int(at), kept=kept, plain_list=plain_list)


def _find_tokens(part: Part, kept: Sequence[str]) -> tuple[Places, int]:
    from msal_cli.kernels.ply_scan import BAD_COUNT, CUT, TOO_FEW, WHOLE, walk_text

    data, header, element = part.data, part.header, part.element
    names = kept if part.can_hold() else ()
    shape = (element.count if names else 0, len(names))
    columns = {name: k for k, name in enumerate(names)}
    starts, stops, lengths = (np.empty(shape, dtype=np.int64) for _ in range(3))
    tokens = Places(columns, starts, stops, lengths)
    listed = element.properties
    if not listed or not element.count:
        return tokens, part.start
    records, stop, status = walk_text(
        data,
        part.start,
        min(element.count, len(data) + 1),
        np.array([prop.is_list for prop in listed]),
        np.array([columns.get(prop.name, -1) for prop in listed]),
        *tokens[1:],
    )
    if status == WHOLE:
        return tokens, int(stop)
    if (data[header.size : header.size + _SAMPLE] == 0).any():
        raise FormatError(
            "the header says ascii, but binary data follow",
            where=f"line {header.format_line + 1}",
            hint="correct the format line, or export the file again",
        )
    place = f"{element.name} {records}, line {line_of(data, stop)}"
    if status == CUT or (status == TOO_FEW and stop == len(data)):
        raise cut_short(
            f"the file ends within element '{element.name}': {element.count - records:,} of "
            f"{element.count:,} lines are missing or not whole",
            place,
        )
    if status == BAD_COUNT:
        raise FormatError(
            f"the count of a list of {element.name} {records} is not a whole number from 0 up",
            where=place,
        )
    many = "fewer" if status == TOO_FEW else "more"
    raise FormatError(
        f"{element.name} {records} has {many} values than the header declares",
        where=place,
        hint="each record of an ascii PLY file stands on one line of its own; where this one is "
        "on others, MeshLab may read it and save it so",
    )


@dataclass(frozen=True, eq=False)
class Fixed(Part):
    """Binary records of ``stride`` bytes each.

    ``places`` gives, for each property, the byte within the record where its value (for a list:
    its first item) is, and the number of items in every record (1 for a scalar).
    """

    stop: int
    stride: int
    places: dict[str, tuple[int, int]]

    def items(self, name: str) -> tuple[NDArray[np.generic], Longs]:
        """The values of a property (count, k), a view, and their number in each record (count,)."""
        dtype = np.dtype(self.codes([name])[0])
        place, length = self.places[name]
        shape, strides = (self.element.count, length), (self.stride, dtype.itemsize)
        lengths = np.broadcast_to(np.int64(length), self.element.count)
        if not self.element.count or not length:
            return np.empty(shape, dtype), lengths
        return np.ndarray(shape, dtype, self.data, self.start + place, strides), lengths

    def slots(self, names: tuple[str, ...]) -> Strided:
        places = tuple(self.places[name][0] for name in names)
        count, codes = self.element.count, self.codes(names)
        return Strided(self.data, self.start, count, self.stride, places, codes, names == NORMAL)


@dataclass(frozen=True, eq=False)
class Varied(Part):
    """Binary records of different sizes; ``starts`` (count, c) and ``lengths`` (count, c) are the
    places and the numbers of values of the properties in ``columns``."""

    stop: int
    columns: dict[str, int]
    starts: Longs
    lengths: Longs

    def items(self, name: str) -> tuple[NDArray[np.generic], Longs]:
        """All values of a property, record by record, and their number in each record."""
        from msal_cli.kernels.ply_scan import gather

        dtype = np.dtype(self.codes([name])[0])
        k = self.columns[name]
        sizes = self.lengths[:, k] * dtype.itemsize
        packed = np.empty(int(sizes.sum()), dtype=np.uint8)
        gather(self.data, np.ascontiguousarray(self.starts[:, k]), sizes, packed)
        return packed.view(dtype), np.ascontiguousarray(self.lengths[:, k])

    def slots(self, names: tuple[str, ...]) -> Scattered:
        at = tuple(np.ascontiguousarray(self.starts[:, self.columns[name]]) for name in names)
        return Scattered(self.data, at, self.codes(names), names == NORMAL)


Section = Fixed | Varied | Lines


def find_sections(
    data: Bytes, header: Header, wanted: Wanted, last: str = ""
) -> tuple[dict[str, Section], int]:
    """The sections of all elements by name, and the byte after the last one.

    With ``last``, the search ends after the element of that name.  Raises TruncatedError and
    FormatError with the element, record and, in ascii, line.
    """
    is_text = header.encoding == "ascii"
    sections: dict[str, Section] = {}
    at = header.size
    for element in header.elements:
        part, names = Part(data, header, element, at), wanted(element)
        plain = _plain_lines(part, names) if is_text else None
        section = sections[element.name] = plain or section_at(part, names)
        at = section.stop
        if element.name == last:
            break
    return sections, at


def section_at(part: Part, names: Sequence[str]) -> Section:
    """The section of one element; ``names`` are as of ``Wanted``.  Raises as ``find_sections``."""
    if part.header.encoding != "ascii":
        return _records(part, names)
    kept = part.kept_names(names)
    tokens, stop = _find_tokens(part, kept)
    lines = Lines(**vars(part), stop=stop, kept=kept)
    lines.__dict__["tokens"] = tokens
    return lines


def _records(part: Part, wanted: Sequence[str]) -> Section:
    data, element, at = part.data, part.element, part.start
    order = part.header.byte_order
    places: dict[str, tuple[int, int]] = {}
    counts: list[tuple[int, int, str]] = []
    stride = 0
    for prop in element.properties:
        length = 1
        if prop.is_list:
            dtype = np.dtype(order + prop.count_code)
            stored = data[at + stride : at + stride + dtype.itemsize]
            # Without records there are no lists to measure.
            length = int(stored.view(dtype)[0]) if len(stored) == dtype.itemsize else 0
            if length < 0 or not element.count:
                length = 0
            counts.append((stride, length, order + prop.count_code))
            stride += dtype.itemsize
        places[prop.name] = (stride, length)
        stride += length * np.dtype(prop.code).itemsize
    size = element.count * stride
    if size <= len(data) - at:
        fixed = Fixed(**vars(part), stop=at + size, stride=stride, places=places)
        if not element.count or all(
            (np.ndarray((element.count,), code, data, at + place, (stride,)) == length).all()
            for place, length, code in counts
        ):
            return fixed
    elif not counts:
        n_bytes = len(data) - at
        raise cut_short(
            f"the file ends within element '{element.name}': {size - n_bytes:,} bytes are missing",
            part.where(n_bytes // stride),
        )
    return _varied(part, wanted)


def _varied(part: Part, wanted: Sequence[str]) -> Section:
    from msal_cli.kernels.ply_scan import BAD_COUNT, CUT, walk_binary

    data, element, listed = part.data, part.element, part.element.properties
    least = sum(prop.byte_range()[0] for prop in listed)
    # If the bytes are not enough for the count, the walk only finds the place of the error.
    fits = element.count <= (len(data) - part.start) // least
    names = part.kept_names(wanted) if fits else ()
    columns = {name: k for k, name in enumerate(names)}
    shape = (element.count if names else 0, len(names))
    starts = np.empty(shape, dtype=np.int64)
    lengths = np.empty(shape, dtype=np.int64)
    records, stop, status, which, items, size = walk_binary(
        data,
        part.start,
        min(element.count, len(data) + 1),
        np.array([np.dtype(prop.code).itemsize for prop in listed]),
        np.array([np.dtype(prop.count_code).itemsize if prop.is_list else 0 for prop in listed]),
        np.array([prop.count_code.startswith("i") for prop in listed]),
        part.header.byte_order == ">",
        np.array([columns.get(prop.name, -1) for prop in listed]),
        starts,
        lengths,
    )
    place = part.where(records)
    if status == BAD_COUNT:
        raise FormatError(
            f"the list '{element.properties[which].name}' of {place} has a negative count",
            where=place,
            hint="the file is damaged, or an element before this one is not what the header says",
        )
    if status == CUT:
        missing = int(items) * int(size) - (len(data) - int(stop))
        raise cut_short(
            f"the file ends within element '{element.name}': {place} of {element.count:,} needs at "
            f"least {format_count(missing, 'more byte')}",
            place,
        )
    return Varied(**vars(part), stop=stop, columns=columns, starts=starts, lengths=lengths)
