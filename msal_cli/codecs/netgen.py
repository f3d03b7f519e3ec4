"""Netgen's neutral volume files (``.vol``): points replaced inside the original bytes.

A file is a row of keywords, each with a count and as many lines below it; ``surfaceelements`` and
``points`` are read, everything else is kept without being looked into.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs.slot_file import Content, PatchedFile
from msal_cli.codecs.slots import TextNumbers
from msal_cli.codecs.surface_cells import SurfaceCells
from msal_cli.codecs.tokens import Words
from msal_cli.errors import EXPORT_AGAIN, FormatError, TruncatedError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_SURFACE = (b"surfaceelements", b"surfaceelementsgi", b"surfaceelementsuv")
_CORNERS_BEHIND = 5
"""Words in front of a surface element's corners: surface, condition, two domains, their number."""


def read(data: Buffer, format: str) -> PatchedFile:
    """Open the Netgen file ``data`` (its bytes).

    Raises
    ------
    FormatError, TruncatedError
        if the file is not what its format says.
    UnsupportedError
        for a mesh in the plane, and curved elements.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    return PatchedFile(data, format, _parse)


def _parse(data: Buffer) -> Content:
    words = Words(data, comment=b"#")
    keywords = words.keywords()
    if not keywords or words.word(keywords[0]) not in (b"mesh3d", b"dimension"):
        raise FormatError("the file does not begin with mesh3d", where="line 1", hint=EXPORT_AGAIN)
    lines = words.first_of_lines()
    lengths = np.diff(np.append(lines, len(words)))
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
            _require_length(words, rows, sizes, 3, "point")
            places = (rows[:, None] + np.arange(3)).reshape(-1)
            positions = TextNumbers(words.data, words.starts[places], words.stops[places])
        else:
            _add_surface(words, rows, sizes, cells)
    if positions is None:
        raise TruncatedError("there are no points", where=words.where(len(words)))
    return Content(
        "ascii",
        "text",
        (positions,),
        cells.corners() - 1,
        cells.sizes(),
        warnings=cells.warnings(),
        held=cells.held(),
    )


def _add_surface(words: Words, rows: Longs, lengths: Longs, cells: SurfaceCells) -> None:
    _require_length(words, rows, lengths, _CORNERS_BEHIND, "surface element")
    n_corners = words.integers(rows + 4)
    starts = np.flatnonzero(np.diff(n_corners, prepend=-1))
    for start, stop in zip(starts, [*starts[1:], len(rows)], strict=False):
        size = int(n_corners[start])
        if size not in (3, 4):
            cells.refuse_curved(f"of {size} points", int(stop - start))
        own = rows[start:stop]
        _require_length(words, own, lengths[start:stop], _CORNERS_BEHIND + size, "surface element")
        places = (own[:, None] + _CORNERS_BEHIND + np.arange(size)).reshape(-1)
        cells.add("triangle" if size == 3 else "quad", words.integers(places).reshape(-1, size))


def _require_length(words: Words, rows: Longs, lengths: Longs, least: int, what: str) -> None:
    if len(rows) and int(lengths.min()) < least:
        at = int(rows[int(np.argmin(lengths))])
        raise FormatError(f"a {what} is too short", where=words.where(at), hint=EXPORT_AGAIN)
