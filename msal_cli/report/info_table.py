"""What ``msal info`` prints for people about many files: a table, one line a file."""

from __future__ import annotations

from collections.abc import Sequence

from msal_cli.job.display_names import columns, escape_for_display, figure, pad_name, shorten_name
from msal_cli.job.info_record import InfoRecord
from msal_cli.report.phrases import Line, defects_text, file_name, format_count

# Heads and their widths, left to right; a file is printed before the next is read.
_COLUMNS = (("format", 7), ("vertices", 10), ("faces", 10), ("noise", 6), ("surface", 7))
_LAST = "problems"
_NARROWEST_NAME = 16
_ROOM_FOR_PROBLEMS = 12


class InfoTable:
    """The lines of a table for files whose paths are known beforehand; ``width`` in columns."""

    def __init__(self, paths: Sequence[str], width: int) -> None:
        taken = sum(size + 2 for _, size in _COLUMNS) + 2 + _ROOM_FOR_PROBLEMS
        longest = max((columns(file_name(path)) for path in paths), default=0)
        self._name_width = max(4, min(longest, max(_NARROWEST_NAME, width - taken)))

    def head(self) -> Line:
        """The names of the columns."""
        return Line(self._join("file", [name for name, _ in _COLUMNS], _LAST), "faint")

    def row(self, record: InfoRecord) -> Line:
        """The line on a file that could be read."""
        noise = record.noise_estimate
        cells = [
            escape_for_display(record.format or "-") + (".gz" if record.compressed else ""),
            figure(record.vertices, ",", unknown="-"),
            figure(record.faces, ",", unknown="-"),
            "-" if noise is None else "none" if noise.negligible else f"{noise.mean_edges:.2g}",
            "-" if record.closed is None else "closed" if record.closed else "open",
        ]
        return Line(self._join(file_name(record.input), cells, _problems(record)))

    def foot(self) -> Line:
        """What the figures mean."""
        return Line(
            "(noise in mean edge lengths; -v shows all that is known of each file)", "faint"
        )

    def _join(self, name: str, cells: Sequence[str], last: str) -> str:
        parts = [pad_name(shorten_name(name, self._name_width), self._name_width)]
        for cell, (head, size) in zip(cells, _COLUMNS, strict=True):
            parts.append(pad_name(cell, size, right=head not in ("format", "surface")))
        return "  ".join([*parts, last]).rstrip()


def _problems(record: InfoRecord) -> str:
    """Defects and warnings as counts; empty if there are none."""
    counts = (
        defects_text(record),
        format_count(record.self_intersections or None, "pair of faces that intersect",
                "pairs of faces that intersect"),
        format_count(len(record.warnings) or None, "warning"),
    )  # fmt: skip
    return ", ".join(filter(None, counts))
