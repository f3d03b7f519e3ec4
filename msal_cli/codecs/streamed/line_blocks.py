"""A text read from its beginning in blocks of whole lines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Bytes
from msal_cli.codecs.streamed.byte_ranges import read_range
from msal_cli.errors import UnsupportedError
from msal_cli.storage.gzip_streams import OnBytes

BLOCK_BYTES = 4 << 20
"""Bytes of a block, about."""

_LONGEST_LINE = 1 << 28


class LineBlocks:
    """The text of a file from byte ``at`` on.

    Attributes
    ----------
    at : the next byte.
    lines : line ends before it.
    """

    def __init__(
        self,
        path: str,
        size: int,
        at: int,
        count_lines: Callable[[bytes], int],
        on_bytes: OnBytes | None = None,
        *,
        are_continued: bool = False,
    ) -> None:
        """``at`` is the first byte that is read, ``count_lines`` counts the line ends in a text;
        with ``are_continued`` a line end behind a backslash is none."""
        self.path, self.size, self.at = path, size, at
        self._count_lines, self._on_bytes = count_lines, on_bytes
        self._are_continued = are_continued
        self.lines = count_lines(read_range(path, 0, at).tobytes()) if at else 0
        self._data = np.empty(0, dtype=np.uint8)
        self._origin = at

    @property
    def is_last(self) -> bool:
        """Whether the block ends where the file does."""
        return self._origin + len(self._data) == self.size

    def peek(self) -> Bytes:
        """The block that begins at ``at``; empty at the end of the file."""
        left = self._data[self.at - self._origin :]
        if len(left) and (self.is_last or len(left) > BLOCK_BYTES // 2):
            return left
        return self._read(BLOCK_BYTES)

    def peek_more(self) -> Bytes:
        """A longer block than the last one, for what does not end in that."""
        return self._read(2 * max(BLOCK_BYTES, len(self._data)))

    def take(self, n_bytes: int) -> None:
        """Go on by so many bytes of the block."""
        first = self.at - self._origin
        self.lines += self._count_lines(self._data[first : first + n_bytes].tobytes())
        self.at += n_bytes
        if self._on_bytes is not None:
            self._on_bytes(self.at, self.size)

    def _read(self, n_bytes: int) -> Bytes:
        self._origin = self.at
        while True:
            stop = min(self.at + n_bytes, self.size)
            data = read_range(self.path, self.at, stop)
            if stop < self.size:
                data = data[: _end_of_last_line(data.tobytes(), self._are_continued)]
            if len(data) or stop == self.size:
                break
            # One line is longer than a block.
            n_bytes *= 2
            if n_bytes > _LONGEST_LINE:
                raise UnsupportedError(
                    f"a line of more than {_LONGEST_LINE:,} bytes cannot be read in pieces",
                    where=f"byte {self.at}",
                    hint="write the text with line ends, or run on a machine with more memory",
                )
        self._data = data
        return data


def _end_of_last_line(text: bytes, are_continued: bool) -> int:
    """The byte behind the last line end; 0 where there is none."""
    for ending in (b"\n", b"\r"):
        # A CR in the last place may have its LF in the next block.
        at = len(text) - (ending == b"\r")
        while (at := text.rfind(ending, 0, at)) >= 0:
            if not are_continued or not text[max(at - 2, 0) : at].rstrip(b"\r").endswith(b"\\"):
                return at + 1
    return 0
