"""One pass over binary PLY records that have lists, a block of bytes at a time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from msal_cli.arrays import Bytes
from msal_cli.codecs.ply_header import Element
from msal_cli.codecs.ply_sections import cut_off, cut_within, negative_count
from msal_cli.codecs.streamed.byte_ranges import BLOCK_BYTES, read_range


class Run(NamedTuple):
    """Consecutive records of an element.

    Attributes
    ----------
    first, stop : numbers of the first record and of the one behind the last.
    place : first byte and the one behind the last.
    n_triangles : triangles that the polygons are cut into.
    n_few : polygons of fewer than three corners.
    """

    first: int
    stop: int
    place: tuple[int, int]
    n_triangles: int
    n_few: int


def fixed_stride(element: Element) -> int | None:
    """Bytes of each record; None where lists make them differ."""
    if any(one.is_list for one in element.properties):
        return None
    return sum(one.least_bytes() for one in element.properties)


def walk_element(
    path: str, size: int, element: Element, order: str, at: int, corners: str = "", most: int = 0
) -> Iterator[Run]:
    """All records of an element that begins at byte ``at``, in runs of ``most`` records (0: of as
    many as there are); ``corners`` is the list whose items are the corners of polygons.

    Raises TruncatedError and FormatError with the record.
    """
    stride = fixed_stride(element)
    if stride is not None:
        if element.count * stride > size - at:
            raise cut_off(element, stride, size - at)
        yield Run(0, element.count, (at, at + element.count * stride), 0, 0)
        return
    walk = _Walk(path, size, element, order, at, corners)
    most = most or element.count
    for first in range(0, element.count, most):
        yield walk.next_run(first, min(first + most, element.count))


class _Walk:
    """The block that was read last, and the place in it."""

    def __init__(
        self, path: str, size: int, element: Element, order: str, at: int, corners: str
    ) -> None:
        self.path, self.size, self.element, self.order = path, size, element, order
        listed = element.properties
        self.wanted = element.index(corners) if corners else -1
        self.sizes = np.array([int(one.code[1]) for one in listed])
        self.count_sizes = np.array([int(one.count_code[1:] or 0) for one in listed])
        self.signed = np.array([one.count_code.startswith("i") for one in listed])
        self.at = self.origin = at
        self.block_bytes = BLOCK_BYTES
        self.data = np.empty(0, dtype=np.uint8)

    def next_run(self, first: int, stop: int) -> Run:
        """The records from ``first``, which is the next one, up to ``stop``."""
        start, record = self.at, first
        n_triangles = n_few = 0
        while record < stop:
            n_records, triangles, few = self._alike(stop - record) or self._any(
                record, stop - record
            )
            record += n_records
            n_triangles += triangles
            n_few += few
        return Run(first, stop, (start, self.at), n_triangles, n_few)

    def _alike(self, most: int) -> tuple[int, int, int] | None:
        """Records of the block whose lists are as long as those of the next one, which is how
        nearly all files are; None where not all of the block's are."""
        local = self.at - self.origin
        places, stride, length = [], 0, 0
        for p, one in enumerate(self.element.properties):
            n_items = 1
            if one.is_list:
                code = np.dtype(self.order + one.count_code)
                field = self.data[local + stride : local + stride + code.itemsize]
                n_items = int(field.view(code)[0]) if len(field) == code.itemsize else -1
                if n_items < 0:
                    return None
                places.append((stride, n_items, code))
                stride += code.itemsize
                length = n_items if p == self.wanted else length
            stride += n_items * int(self.sizes[p])
        count = min(most, (len(self.data) - local) // stride)
        if not count or not all(
            (np.ndarray((count,), code, self.data, local + place, (stride,)) == n_items).all()
            for place, n_items, code in places
        ):
            return None
        self.at += count * stride
        if self.wanted < 0:
            return count, 0, 0
        return count, count * max(length - 2, 0), count * (length < 3)

    def _any(self, record: int, most: int) -> tuple[int, int, int]:
        """Records of the block whatever their lists; the next block where there is none."""
        from msal_cli.kernels.ply_scan import BAD_COUNT, CUT, count_binary

        n_records, stop, n_triangles, n_few, status, reached, which, items, item_size = (
            count_binary(
                self.data,
                self.at - self.origin,
                most,
                self.sizes,
                self.count_sizes,
                self.signed,
                self.order == ">",
                self.wanted,
            )
        )
        self.at = self.origin + stop
        if status == BAD_COUNT:
            raise negative_count(self.element, record + n_records, which)
        if status == CUT:
            end = self.origin + len(self.data)
            if end == self.size:
                missing = int(items) * int(item_size) - (len(self.data) - int(reached))
                raise cut_within(self.element, record + n_records, missing)
            if not n_records and len(self.data) and self.at == self.origin:
                # One record is longer than a block.
                self.block_bytes *= 2
            self.origin = self.at
            self.data = self._block(self.at)
        return n_records, n_triangles, n_few

    def _block(self, at: int) -> Bytes:
        return read_range(self.path, at, min(at + self.block_bytes, self.size))
