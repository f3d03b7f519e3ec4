"""Rows of numbers as lines of text, for the plain writers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.text import as_bytes, spliced

_BLOCK = 1 << 14
"""Rows that are made at a time."""


@compiled
def _lines(text, stops, row_stops, prefix, doubled, out):  # type: ignore[no-untyped-def]
    to = 0
    start = 0
    token = 0
    for row_stop in row_stops:
        for k in range(len(prefix)):
            out[to] = prefix[k]
            to += 1
        while token < row_stop:
            for copy in range(2 if doubled else 1):
                for k in range(2 * copy):
                    out[to + k] = 47
                to += 2 * copy
                for k in range(start, stops[token]):
                    out[to] = text[k]
                    to += 1
            start = stops[token]
            token += 1
            out[to] = 32 if token < row_stop else 10
            to += 1
    return to


def lines(
    text: Bytes,
    stops: NDArray[np.int64],
    row_stops: NDArray[np.int64],
    prefix: bytes = b"",
    doubled: bool = False,
) -> Bytes:
    """One line for each row: ``prefix``, then the row's tokens with a blank between.

    Parameters
    ----------
    text, stops : (size,) and (k,), k tokens one behind the other, as ``text.printed`` gives them.
    row_stops : (r,), ascending, the tokens up to and with each row; no row is empty.
    doubled : write each token as ``t//t``, as OBJ names a corner with a normal.
    """
    size = len(text) * (2 if doubled else 1) + len(stops) * (3 if doubled else 1)
    out = np.empty(size + len(row_stops) * len(prefix), dtype=np.uint8)
    fixed = np.frombuffer(prefix, dtype=np.uint8)
    return out[: _lines(as_bytes(text), stops, row_stops, as_bytes(fixed), doubled, out)]


def fill_rows(
    pieces: Sequence[bytes], text: Bytes, stops: NDArray[np.int64]
) -> Iterator[memoryview]:
    """Rows of tokens between ``pieces``, of which there is one more than tokens in a row.

    ``text`` (size,) and ``stops`` (k,) are the tokens of all rows one behind the other, as
    ``text.printed`` gives them.
    """
    row = b"".join(pieces)
    places = np.cumsum([len(piece) for piece in pieces[:-1]])
    begin = 0
    for first in range(0, len(stops), _BLOCK * len(places)):
        ends = stops[first : first + _BLOCK * len(places)]
        count = len(ends) // len(places)
        at = (len(row) * np.arange(count)[:, None] + places).reshape(-1)
        tokens = text[begin : ends[-1]]
        yield spliced(as_bytes(row * count), at, at, tokens, ends - begin).data
        begin = int(ends[-1])
