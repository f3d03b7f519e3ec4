"""AVS UCD files (``.avs``), ascii: nodes replaced inside the original bytes.

Comments, the data of nodes and of cells and all else is kept without being looked into.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs.slot_file import Content, PatchedFile
from msal_cli.codecs.slots import TextNumbers
from msal_cli.codecs.surface_cells import SurfaceCells
from msal_cli.codecs.tokens import Words, indices_of
from msal_cli.errors import EXPORT_AGAIN, FormatError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_FLAT = {b"tri": ("triangle", 3), b"quad": ("quad", 4)}
_OTHERS = {
    b"pt": "vertex",
    b"line": "line",
    b"tet": "tetra",
    b"pyr": "pyramid",
    b"prism": "wedge",
    b"hex": "hexahedron",
}


def read(data: Buffer, format: str) -> PatchedFile:
    """Open the AVS UCD file ``data`` (its bytes).

    Raises
    ------
    FormatError, TruncatedError
        if the file is not what its format says.
    UnsupportedError
        for a binary file.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    return PatchedFile(data, format, _parse)


def _parse(data: Buffer) -> Content:
    if bytes(memoryview(data)[:1]) == b"\7":
        raise UnsupportedError("binary AVS UCD is not read", hint="write it as ascii")
    words = Words(data, comment=b"#")
    lines = words.first_of_lines()
    n_nodes, n_cells = words.count(0, "nodes"), words.count(1, "cells")
    if len(lines) < 1 + n_nodes + n_cells:
        words.require(len(words) + 1, f"{n_nodes} nodes and {n_cells} cells")
    lengths = np.diff(np.append(lines, len(words)))
    nodes, of_cells = lines[1 : 1 + n_nodes], lines[1 + n_nodes : 1 + n_nodes + n_cells]
    if n_nodes and int(lengths[1 : 1 + n_nodes].min()) < 4:
        at = int(nodes[int(np.argmin(lengths[1 : 1 + n_nodes]))])
        raise FormatError("a node has no three coordinates", where=words.where(at))
    tags = words.integers(nodes)
    places = (nodes[:, None] + np.arange(1, 4)).reshape(-1)
    positions = TextNumbers(words.data, words.starts[places], words.stops[places])
    cells = _cells(words, of_cells, lengths[1 + n_nodes : 1 + n_nodes + n_cells])
    n_data = [int(words.word(k)) for k in (2, 3) if k < lengths[0] and words.word(k).isdigit()]
    names = ("data of nodes", "data of cells")
    return Content(
        "ascii",
        "text",
        (positions,),
        indices_of(tags, cells.corners()),
        cells.sizes(),
        properties=tuple(name for name, count in zip(names, n_data, strict=False) if count),
        warnings=cells.warnings(),
        held=cells.held(),
    )


def _cells(words: Words, first: Longs, lengths: Longs) -> SurfaceCells:
    """The cells whose lines begin with these words, of so many words each."""
    cells = SurfaceCells()
    if len(first) and int(lengths.min()) < 4:
        at = int(first[int(np.argmin(lengths))])
        raise FormatError("a cell is too short", where=words.where(at), hint=EXPORT_AGAIN)
    kinds = [words.word(at).lower() for at in (first + 2).tolist()]
    start = 0
    for stop in range(1, len(kinds) + 1):
        if stop < len(kinds) and kinds[stop] == kinds[start]:
            continue
        kind = kinds[start]
        if kind in _FLAT:
            name, size = _FLAT[kind]
            wrong = lengths[start:stop] != size + 3
            if wrong.any():
                at = int(first[start + int(np.argmax(wrong))])
                raise FormatError(
                    f"a {name} has {size} nodes", where=words.where(at), hint=EXPORT_AGAIN
                )
            places = (first[start:stop, None] + 3 + np.arange(size)).reshape(-1)
            cells.add(name, words.integers(places).reshape(-1, size))
        elif kind in _OTHERS:
            cells.count(_OTHERS[kind], stop - start)
        else:
            shown = kind[:40].decode("ascii", "backslashreplace")
            raise FormatError(
                f"{shown!r} is no kind of cell",
                where=words.where(int(first[start])),
                hint=EXPORT_AGAIN,
            )
        start = stop
    return cells
