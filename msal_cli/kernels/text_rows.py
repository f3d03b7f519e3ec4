"""Rows of numbers as lines of text, for the plain writers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.text import as_bytes


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
