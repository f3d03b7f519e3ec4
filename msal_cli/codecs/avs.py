"""AVS UCD files (``.avs``), ascii: nodes replaced inside the original bytes.

Comments, the data of nodes and of cells and all else is kept without being looked into.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.surface_cells import SurfaceCells
from msal_cli.codecs.tokens import Words, indices_of
from msal_cli.errors import EXPORT_AGAIN, FormatError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_KINDS = {
    b"tri": "triangle",
    b"quad": "quad",
    b"pt": "vertex",
    b"line": "line",
    b"tet": "tetra",
    b"pyr": "pyramid",
    b"prism": "wedge",
    b"hex": "hexahedron",
}


def parse(data: Buffer) -> Layout:
    """Read an AVS UCD file; UnsupportedError for a binary one."""
    if bytes(memoryview(data)[:1]) == b"\7":
        raise UnsupportedError("binary AVS UCD is not read", hint="write it as ascii")
    words = Words(data, comment=b"#")
    lines, lengths = words.lines_of_words()
    n_nodes, n_cells = words.count(0, "nodes"), words.count(1, "cells")
    if len(lines) < 1 + n_nodes + n_cells:
        words.require(len(words) + 1, f"{n_nodes} nodes and {n_cells} cells")
    nodes = slice(1, 1 + n_nodes)
    words.require_lengths(lines[nodes], lengths[nodes], 4, "node")
    tags = words.integers(lines[nodes])
    positions = words.float_rows(lines[nodes] + 1)
    behind = slice(1 + n_nodes, 1 + n_nodes + n_cells)
    cells = _cells(words, lines[behind], lengths[behind])
    n_data = [int(words.word(k)) for k in (2, 3) if k < lengths[0] and words.word(k).isdigit()]
    names = ("data of nodes", "data of cells")
    return cells.content(
        positions,
        corners=indices_of(tags, cells.corners()),
        properties=tuple(name for name, count in zip(names, n_data, strict=False) if count),
    )


def _cells(words: Words, first: Longs, lengths: Longs) -> SurfaceCells:
    """The cells whose lines begin with these words, of so many words each."""
    cells = SurfaceCells()
    words.require_lengths(first, lengths, 4, "cell")
    names = [words.word(at).lower() for at in (first + 2).tolist()]
    start = 0
    for stop in range(1, len(names) + 1):
        if stop < len(names) and names[stop] == names[start]:
            continue
        kind = _KINDS.get(names[start], "")
        if not kind:
            shown = names[start][:40].decode("ascii", "backslashreplace")
            raise FormatError(
                f"{shown!r} is no kind of cell",
                where=words.where(int(first[start])),
                hint=EXPORT_AGAIN,
            )
        if size := cells.sort(kind, stop - start):
            wrong = lengths[start:stop] != size + 3
            if wrong.any():
                at = int(first[start + int(np.argmax(wrong))])
                raise FormatError(
                    f"a {kind} has {size} nodes", where=words.where(at), hint=EXPORT_AGAIN
                )
            cells.add(kind, words.integer_rows(first[start:stop] + 3, size))
        start = stop
    return cells
