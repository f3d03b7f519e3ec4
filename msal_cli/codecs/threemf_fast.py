"""Lists of vertices and triangles in the plain form that nearly all programs write in 3MF."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Longs

_NUMBER = rb'"([-+.0-9eE]++)"'
_VERTICES = re.compile(
    rb"(?:\s*+<vertex\s++x=" + _NUMBER + rb"\s++y=" + _NUMBER + rb"\s++z=" + _NUMBER
    + rb"\s*+/>)*+\s*+(?=</vertices)"
)  # fmt: skip
_INDEX = rb'"[0-9]++"'
_OTHERS = rb'(?:\s++(?!v[123]=)[\w:.-]++="[\x20\x21\x23-\x25\x27-\x3b\x3d-\x7e]*+")*+'
_TRIANGLES = re.compile(
    rb"(?:\s*+<triangle\s++v1=" + _INDEX + rb"\s++v2=" + _INDEX + rb"\s++v3=" + _INDEX + _OTHERS
    + rb"\s*+/>)*+\s*+(?=</triangles)"
)  # fmt: skip
_LIST = re.compile(rb"<(vertices|triangles)\s*>")
_QUOTE, _LESS = 34, 60


def find_plain_lists(text: bytes) -> Iterator[tuple[int, tuple[int, int]]]:
    """Lists of vertices and triangles in plain form: where the tag begins that opens each, where
    the list begins, and where it ends."""
    for tag in _LIST.finditer(text):
        pattern = _VERTICES if tag[1] == b"vertices" else _TRIANGLES
        if match := pattern.match(text, tag.end()):
            yield tag.start(), match.span()


def find_quoted(region: NDArray[np.uint8], offset: int) -> tuple[Longs, Longs]:
    """What stands between the first three pairs of quotes of each element, (n, 3) starts and stops;
    ``offset`` is added to all."""
    quotes = np.flatnonzero(region == _QUOTE)
    tags = np.flatnonzero(region == _LESS)
    if len(quotes) == 6 * len(tags):
        pairs = quotes.reshape(-1, 6)
    else:
        pairs = quotes[np.searchsorted(quotes, tags)[:, None] + np.arange(6)]
    return pairs[:, 0::2] + (1 + offset), pairs[:, 1::2] + offset
