"""Rows of numbers as lines of text, for new files."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Longs


def float_lines(values: Floats, *, single: bool, prefix: bytes = b"") -> bytes:
    """Numbers (n, k), a line for each row, as the shortest text that is read back as the same
    number, of float32 where they are ``single``."""
    from msal_cli.kernels import text

    digits, stops = text.printed_shortest(values.reshape(-1), single)
    ends = values.shape[1] * np.arange(1, len(values) + 1, dtype=np.int64)
    return text.lines(digits, stops, ends, prefix).tobytes()


def integer_lines(
    values: Longs, sizes: Longs, prefix: bytes = b"", *, doubled: bool = False
) -> bytes:
    """Whole numbers (c,) in lines of ``sizes`` (p,); ``doubled`` as of ``text.lines``."""
    from msal_cli.kernels import text

    digits, stops = text.printed(values.astype(np.float64), 0)
    return text.lines(digits, stops, np.cumsum(sizes), prefix, doubled).tobytes()
