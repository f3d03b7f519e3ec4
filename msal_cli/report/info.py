"""What ``msal info`` prints for people: the facts of a file, or a line for each of many."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msal_cli.job.display_names import columns, figure, pad_name, shorten_name
from msal_cli.job.records import InfoRecord
from msal_cli.report.facts import (
    Fact,
    Line,
    defects_text,
    fact_lines,
    failure_lines,
    file_name,
    format_count,
    noise_texts,
)

_SHAPES = {"3": "triangle", "4": "quad"}

# Heads and their widths, left to right; a file is printed before the next is read.
_COLUMNS = (("format", 7), ("vertices", 10), ("faces", 10), ("noise", 6), ("surface", 7))
_LAST = "problems"
_MIN_NAME_WIDTH = 16
_ROOM_FOR_PROBLEMS = 12


def describe_info(record: InfoRecord) -> list[Line]:
    """The lines on one file: its name, then one line per fact."""
    name = file_name(record.input)
    if record.error is not None:
        return failure_lines(name, record.error)
    return [Line(name, "good"), *fact_lines(_facts(record), 15)]


def _facts(record: InfoRecord) -> Iterator[Fact]:
    storage = [part for part in (record.format, record.encoding, record.precision) if part]
    size = f"{record.bytes:,} bytes" if record.bytes is not None else ""
    yield Fact("format", ", ".join([*storage, *(["gzip"] if record.compressed else []), size]))
    beside = f" (of {record.corners:,} corners)" if record.corners is not None else ""
    yield Fact("vertices", _count(record.vertices) + beside)
    sizes = sorted(record.polygon_sizes.items(), key=lambda item: (len(item[0]), item[0]))
    parts = [
        format_count(count, _SHAPES[size]) if size in _SHAPES else f"{count:,} with {size} corners"
        for size, count in sizes
    ]
    yield Fact("faces", _count(record.faces) + (f" ({', '.join(parts)})" if parts else ""))
    yield Fact("components", _count(record.components))
    surface = "closed"
    if not record.closed:
        surface = f"open, {format_count(record.boundary_edges, 'boundary edge')}"
    if record.non_manifold_edges:
        surface += f", {format_count(record.non_manifold_edges, 'non-manifold edge')}"
    yield Fact("surface", surface)
    yield Fact("winding", (record.winding or "-") + (", inside out" if record.inside_out else ""))
    for word, count, unit in (
        ("degenerate", record.degenerate_faces, ("face",)),
        ("duplicate", record.duplicate_faces, ("face",)),
        ("unreferenced", record.unreferenced_vertices, ("vertex", "vertices")),
        ("welded", record.welded_vertices, ("vertex", "vertices")),
    ):
        yield Fact(word, format_count(count, *unit) or "-")
    if record.self_intersections is not None:
        pairs = format_count(record.self_intersections, "pair of faces", "pairs of faces")
        yield Fact("intersecting", pairs)
    if record.bounds is not None:
        low, high = record.bounds
        yield Fact("from", ", ".join(f"{x:.9g}" for x in low))
        yield Fact("to", ", ".join(f"{x:.9g}" for x in high))
        yield Fact("size", " x ".join(f"{b - a:.6g}" for a, b in zip(low, high, strict=True)))
    yield Fact("area", figure(record.area, ".6g", unknown="-"))
    if record.volume_valid and record.volume is not None:
        yield Fact(
            "volume", f"{record.volume:.6g}" + (" (inside out)" if record.inside_out else "")
        )
    else:
        yield Fact("volume", f"- {record.volume_reason}".rstrip())
    yield Fact("mean edge", figure(record.mean_edge_length, ".6g", unknown="-"))
    if record.noise_estimate is not None:
        level, *details = noise_texts(record.noise_estimate, record)
        yield Fact("noise estimate", level)
        yield from (Fact("", text) for text in details)
    yield Fact("carried along", ", ".join(record.properties) or "nothing else")
    if record.references:
        yield Fact("refers to", ", ".join(record.references))
    yield from (Fact("warning", text, "bad") for text in record.warnings)


def _count(number: int | None) -> str:
    return figure(number, ",", unknown="-")


class InfoTable:
    """The lines of a table for files whose paths are known beforehand; ``width`` in columns."""

    def __init__(self, paths: Sequence[str], width: int) -> None:
        taken = sum(size + 2 for _, size in _COLUMNS) + 2 + _ROOM_FOR_PROBLEMS
        longest = max((columns(file_name(path)) for path in paths), default=0)
        self._name_width = max(4, min(longest, max(_MIN_NAME_WIDTH, width - taken)))

    def head(self) -> Line:
        return Line(self._join("file", [name for name, _ in _COLUMNS], _LAST), "faint")

    def row(self, record: InfoRecord) -> Line:
        """The line on a file that could be read."""
        noise = record.noise_estimate
        cells = [
            (record.format or "-") + (".gz" if record.compressed else ""),
            figure(record.vertices, ",", unknown="-"),
            figure(record.faces, ",", unknown="-"),
            "-" if noise is None else "none" if noise.negligible else f"{noise.mean_edges:.2g}",
            "-" if record.closed is None else "closed" if record.closed else "open",
        ]
        pairs = ("pair of faces that intersect", "pairs of faces that intersect")
        counts = (
            defects_text(record),
            format_count(record.self_intersections or None, *pairs),
            format_count(len(record.warnings) or None, "warning"),
        )
        problems = ", ".join(filter(None, counts))
        return Line(self._join(file_name(record.input), cells, problems))

    def foot(self) -> Line:
        return Line(
            "(noise in mean edge lengths; -v shows all that is known of each file)", "faint"
        )

    def _join(self, name: str, cells: Sequence[str], last: str) -> str:
        parts = [pad_name(shorten_name(name, self._name_width), self._name_width)]
        for cell, (head, size) in zip(cells, _COLUMNS, strict=True):
            parts.append(pad_name(cell, size, right=head not in ("format", "surface")))
        return "  ".join([*parts, last]).rstrip()
