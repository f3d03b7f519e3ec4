"""What ``msal info`` prints for people about a file."""

from __future__ import annotations

from collections.abc import Iterator

from msal_cli.job.display_names import escape_for_display, figure
from msal_cli.job.info_record import InfoRecord
from msal_cli.report.phrases import Line, failure_lines, file_name, noise_texts

_SHAPES = {"3": "triangles", "4": "quads"}


def describe_info(record: InfoRecord) -> list[Line]:
    """The lines on one file: its name, then one line per fact."""
    name = file_name(record.input)
    if record.error is not None:
        return failure_lines(name, record.error)
    lines = [Line(name, "good")]
    lines += [Line(f"  {word:<15} {text}") for word, text in _facts(record)]
    return lines + [
        Line(f"  {'warning':<15} {escape_for_display(text)}", "bad") for text in record.warnings
    ]


def _facts(record: InfoRecord) -> Iterator[tuple[str, str]]:
    storage = [part for part in (record.format, record.encoding, record.precision) if part]
    size = f"{record.bytes:,} bytes" if record.bytes is not None else ""
    yield "format", ", ".join([*storage, *(["gzip"] if record.compressed else []), size])
    beside = f" (of {record.corners:,} corners)" if record.corners is not None else ""
    unknown = "not counted" if record.read_in_pieces else "-"
    yield "vertices", _count(record.vertices, unknown) + beside
    yield "faces", _faces(record)
    yield "components", _count(record.components, unknown)
    yield "surface", _surface(record)
    yield (
        "winding",
        escape_for_display(record.winding or "-") + (", inside out" if record.inside_out else ""),
    )
    for word, count, unit in (
        ("degenerate", record.degenerate_faces, "faces"),
        ("duplicate", record.duplicate_faces, "faces"),
        ("unreferenced", record.unreferenced_vertices, "vertices"),
        ("welded", record.welded_vertices, "vertices"),
    ):
        yield word, _count(count, unknown) + ("" if count is None else f" {unit}")
    if record.self_intersections is not None:
        yield "intersecting", f"{record.self_intersections:,} pairs of faces"
    if record.bounds is not None:
        low, high = record.bounds
        sides = (b - a for a, b in zip(low, high, strict=True))
        yield "from", _point(low)
        yield "to", _point(high)
        yield "size", " x ".join(f"{side:.6g}" for side in sides)
    yield "area", figure(record.area, ".6g", unknown="-")
    if record.volume_valid and record.volume is not None:
        yield "volume", f"{record.volume:.6g}" + (" (inside out)" if record.inside_out else "")
    else:
        yield "volume", f"- {escape_for_display(record.volume_reason)}".rstrip()
    yield "mean edge", figure(record.mean_edge_length, ".6g", unknown="-")
    if record.noise_estimate is not None:
        level, *rest = noise_texts(record.noise_estimate, record)
        yield "noise estimate", level
        yield from (("", text) for text in rest)
    yield (
        "carried along",
        ", ".join(escape_for_display(one) for one in record.properties) or "nothing else",
    )
    if record.read_in_pieces:
        yield "read in pieces", "the file is larger than memory; noise is that of a part"
    if record.references:
        yield "refers to", ", ".join(escape_for_display(one) for one in record.references)


def _faces(record: InfoRecord) -> str:
    sizes = sorted(record.polygon_sizes.items(), key=lambda item: (len(item[0]), item[0]))
    parts = [
        f"{count:,} {_SHAPES.get(size, f'with {escape_for_display(size)} corners')}"
        for size, count in sizes
    ]
    return _count(record.faces) + (f" ({', '.join(parts)})" if parts else "")


def _surface(record: InfoRecord) -> str:
    if record.closed is None and record.read_in_pieces:
        return "open, too many boundary edges to count them in pieces"
    kind = "closed" if record.closed else f"open, {_count(record.boundary_edges)} boundary edges"
    if record.non_manifold_edges:
        kind += f", {_count(record.non_manifold_edges)} non-manifold edges"
    return kind


def _count(number: int | None, unknown: str = "-") -> str:
    return figure(number, ",", unknown=unknown)


def _point(position: tuple[float, float, float]) -> str:
    return ", ".join(f"{one:.9g}" for one in position)
