"""Netgen's neutral volume files (``.vol``): points replaced inside the original bytes.

A file is a row of keywords, each with a count and as many lines below it; ``surfaceelements`` and
``points`` are read, everything else is kept without being looked into.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.surface_cells import SurfaceCells, runs_of
from msal_cli.codecs.tokens import Words
from msal_cli.errors import EXPORT_AGAIN, FormatError, TruncatedError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_SURFACE = (b"surfaceelements", b"surfaceelementsgi", b"surfaceelementsuv")
_CORNERS_BEHIND = 5
"""Words in front of a surface element's corners: surface, condition, two domains, their number."""


def parse(data: Buffer) -> Layout:
    """Read a Netgen file; UnsupportedError for a mesh in the plane, and curved elements."""
    words = Words(data, comment=b"#")
    keywords = words.keywords()
    if not keywords or words.word(keywords[0]) not in (b"mesh3d", b"dimension"):
        raise FormatError("the file does not begin with mesh3d", where="line 1", hint=EXPORT_AGAIN)
    lines, lengths = words.lines_of_words()
    cells = SurfaceCells()
    positions = None
    for keyword in keywords:
        name = words.word(keyword)
        if name == b"dimension" and words.count(keyword + 1, "dimensions") != 3:
            raise UnsupportedError("the points have not three coordinates", hint="write a 3D mesh")
        if name not in (*_SURFACE, b"points", b"volumeelements"):
            continue
        count = words.count(keyword + 1, "lines")
        first = int(np.searchsorted(lines, keyword + 1)) + 1
        if first + count > len(lines):
            raise TruncatedError(
                f"the file ends before all {count} {name.decode()} are there",
                where=words.where(len(words)),
                hint=EXPORT_AGAIN,
            )
        rows, sizes = lines[first : first + count], lengths[first : first + count]
        if name == b"volumeelements":
            cells.count("volume", count)
        elif name == b"points":
            words.require_lengths(rows, sizes, 3, "point")
            positions = words.float_rows(rows)
        else:
            _add_surface(words, rows, sizes, cells)
    if positions is None:
        raise TruncatedError("there are no points", where=words.where(len(words)))
    return cells.content(positions, corners=cells.corners() - 1)


def _add_surface(words: Words, rows: Longs, lengths: Longs, cells: SurfaceCells) -> None:
    words.require_lengths(rows, lengths, _CORNERS_BEHIND, "surface element")
    n_corners = words.integers(rows + 4)
    for run in runs_of(n_corners):
        size, own = int(n_corners[run.start]), rows[run]
        if size not in (3, 4):
            cells.refuse_curved(f"of {size} points", len(own))
        words.require_lengths(own, lengths[run], _CORNERS_BEHIND + size, "surface element")
        kind = "triangle" if size == 3 else "quad"
        cells.add(kind, words.integer_rows(own + _CORNERS_BEHIND, size))
