"""Records in words: the phrases that several reports share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from msal_cli.job.display_names import escape_for_display, figure
from msal_cli.job.info_record import InfoRecord
from msal_cli.job.records import (
    ChoiceMade,
    Failure,
    GateResult,
    MeshRecord,
    NoiseEstimate,
    Reference,
    RunnerUp,
    SelfIntersections,
)
from msal_cli.job.tile_records import Tiles, TileSetPart
from msal_cli.machine import megabytes

Tone = Literal["plain", "good", "bad", "faint"]

IMPULSIVE_TAIL = 0.02
"""Share of outlying vertices from which noise is called impulsive; Gaussian noise has 0.01."""


@dataclass(frozen=True)
class Line:
    """A line of text and how it may be coloured."""

    text: str
    tone: Tone = "plain"


# Figures


def format_count(number: int | None, one: str, several: str = "") -> str:
    """``1 file``, ``1,200 files``; empty for None."""
    if number is None:
        return ""
    return f"{number:,} {one if number == 1 else several or one + 's'}"


def percent_text(percent: float | None) -> str:
    """``-0.266 %``, with its sign; empty for None."""
    if percent is None:
        return ""
    return f"{percent:+.3f} %" if abs(percent) < 10.0 else f"{percent:+.1f} %"


def seconds_text(seconds: float) -> str:
    """``0.42 s``, ``3 min 05 s`` or ``2 h 10 min``."""
    if seconds < 99.95:
        return f"{seconds:.2f} s" if seconds < 10.0 else f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


# Runs, files and failures


def command_text(command: Sequence[str], most: int) -> str:
    """A command line as a shell takes it, cut after ``most`` characters."""
    import shlex

    text = shlex.join(command)
    return text if len(text) <= most else f"{text[:most]} ..."


def file_name(name: str) -> str:
    """A file's name for people; ``-`` is where a stream comes from."""
    return "standard input" if name == "-" else escape_for_display(name)


def reason(where: str, message: str, code: str) -> str:
    """Why something failed, in one line: ``vertex 17: position is not finite (E_NONFINITE)``."""
    is_named = not where or message.startswith(f"{where} ")
    place = "" if is_named else f"{escape_for_display(where)}: "
    return f"{place}{escape_for_display(message)}" + (
        f" ({escape_for_display(code)})" if code else ""
    )


def failure_text(failure: Failure, *, with_code: bool = True) -> str:
    """Why something failed; see ``reason``."""
    return reason(failure.where, failure.message, failure.code if with_code else "")


def failure_texts(name: str, failure: Failure | None) -> list[str]:
    """Why a file failed, and what to do about it; nothing if it did not fail."""
    if failure is None:
        return []
    hint = [f"hint: {escape_for_display(failure.hint)}"] if failure.hint else []
    return [f"{name}: {failure_text(failure)}", *hint]


def failure_lines(name: str, failure: Failure | None, indent: str = "") -> list[Line]:
    """``failure_texts`` as lines."""
    texts = failure_texts(name, failure)
    lines = [Line(f"{indent}{text}", "bad") for text in texts[:1]]
    return lines + [Line(f"{indent}  {text}") for text in texts[1:]]


def gate_text(gate: GateResult) -> str:
    """``broken: max_displacement > 0.5e (max_displacement is 0.0123 (0.62e))``."""
    word = "passed" if not gate.broken else "broken" if gate.decided else "not decided"
    return f"{word}: {escape_for_display(gate.expression)} ({escape_for_display(gate.reason)})"


# Tile sets


def tile_set_text(records: Sequence[MeshRecord]) -> str:
    """What came of the files of a tile set that are written; empty if there is none."""
    parts = [one.tile_set for one in records if one.tile_set is not None]
    if not parts:
        return ""
    gaps = [one.tile_gap for one in records if one.tile_set is not None]
    known = [one for one in gaps if one is not None]
    gap = f"{max(known):.3g}" if known and len(known) == len(gaps) else "not known"
    texts = [f"{format_count(len(parts), 'file')} as one mesh"]
    texts.append(f"largest gap between shared vertices {gap}")
    if n_welded := sum(one.welded_vertices for one in parts):
        widest = max(one.largest_weld for one in parts)
        welded = format_count(n_welded, "border vertex", "border vertices")
        texts.append(f"{welded} welded, which closed gaps of up to {widest:.3g}")
    if n_fixed := sum(one.fixed_border_vertices for one in parts):
        texts.append(f"{format_count(n_fixed, 'border vertex', 'border vertices')} held fixed")
    return "; ".join(texts)


def touches_text(part: TileSetPart) -> str:
    """What a file of a tile set shares with others: ``touches b.ply, c.ply: 60 vertices``."""
    if not part.neighbours:
        return "touches no other file"
    names = ", ".join(map(escape_for_display, part.neighbours))
    return f"touches {names}: {format_count(part.shared_vertices, 'vertex', 'vertices')}"


# Meshes


def vertices_text(vertices: int | None, corners: int | None) -> str:
    """``6,720 vertices (of 40,320 corners)``: corners where the file stores these (STL); they alone
    where the vertices are not known."""
    if vertices is None:
        return format_count(corners, "corner")
    beside = f" (of {corners:,} corners)" if corners is not None else ""
    return format_count(vertices, "vertex", "vertices") + beside


def storage_text(record: MeshRecord) -> str:
    """``ply binary_little_endian float32``."""
    return " ".join(one for one in (record.format, record.encoding, record.precision) if one)


def defects_text(record: MeshRecord | InfoRecord) -> str:
    """What is wrong with a mesh, as counts; empty if nothing is."""
    counts = (
        format_count(record.boundary_edges or None, "boundary edge"),
        format_count(record.non_manifold_edges or None, "non-manifold edge"),
        format_count(record.inconsistent_edges or None, "edge between faces of opposite winding",
                "edges between faces of opposite winding"),
        format_count(record.degenerate_faces or None, "degenerate face"),
        format_count(record.duplicate_faces or None, "duplicate face"),
        format_count(record.unreferenced_vertices or None, "unreferenced vertex",
                "unreferenced vertices"),
        "inside out" if record.inside_out else "",
    )  # fmt: skip
    return ", ".join(filter(None, counts))


def despiked_text(despiked: int) -> str:
    """``12 outlier vertices brought back``."""
    return format_count(despiked, "outlier vertex", "outlier vertices") + " brought back"


def tiles_text(tiles: Tiles) -> str:
    """Such as ``128 tiles with 6 rings around each, 2 at a time, 21 GB of scratch space``."""
    parts = [format_count(tiles.number, "tile")]
    if tiles.rings is not None:
        parts[0] += f" with {format_count(tiles.rings, 'ring')} around each"
    # The rings are known once tiles are made; before, the rest is an estimate.
    about = "about " * (tiles.rings is None)
    space = f"{about}{megabytes(tiles.scratch_bytes)} of scratch space"
    parts += [f"{tiles.jobs} at a time", space]
    if tiles.choice_vertices is not None:
        parts.append(
            f"noise and choice of {format_count(tiles.choice_vertices, 'vertex', 'vertices')}"
        )
    if tiles.resumed_tasks:
        parts.append(f"{format_count(tiles.resumed_tasks, 'task')} done by an earlier run")
    is_done = tiles.rings is not None
    if tiles.memory_bytes is not None and not is_done:
        parts.append(f"{megabytes(tiles.memory_bytes)} of memory")
    if tiles.expected_seconds is not None and not is_done:
        parts.append(f"about {seconds_text(tiles.expected_seconds)}")
    return ", ".join(parts)


def self_intersections_text(one: SelfIntersections) -> str:
    """``164 -> 145 pairs of faces, 101 of them new``."""
    new = "" if one.created is None else f", {one.created:,} of them new"
    return f"{one.before:,} -> {one.after:,} pairs of faces{new}"


def reference_text(one: Reference) -> str:
    """How far an output is from its reference."""
    parts = (
        ("normals", figure(one.mean_angular_error_deg, ".2f", " degrees off in the mean")),
        ("vertices", figure(one.vertex_error_percent, ".3g", " % of the mean edge length")),
        ("Hausdorff", figure(one.hausdorff_edges, ".3g", " mean edge lengths")),
    )
    return ", ".join(f"{word} {text}" for word, text in parts if text) or "not known"


def negligible_text(record: MeshRecord | InfoRecord) -> str:
    """What is said of noise that is negligible: it may be filtered all the same."""
    is_filtered = (
        isinstance(record, MeshRecord)
        and record.method is not None
        and record.left_alone is None
        and record.status != "unchanged"
    )
    return "hardly any, filtered all the same" if is_filtered else "none to speak of"


def noise_texts(noise: NoiseEstimate, record: MeshRecord | InfoRecord) -> list[str]:
    """What is estimated of a mesh's noise: the level, then what is peculiar about it."""
    level = f"{noise.mean_edges:.3g} mean edge lengths"
    if noise.low_edges is not None and noise.high_edges is not None:
        level += f", {noise.low_edges:.2g} to {noise.high_edges:.2g}"
    level += f" ({noise.file_units:.3g} in file units)"
    if noise.negligible:
        return [f"{level}: {negligible_text(record)}"]
    texts = [level]
    if noise.words and noise.confidence is not None:
        texts.append(f"{noise.words} ({100.0 * noise.confidence:.0f} % sure: {noise.basis})")
    is_uneven = noise.uneven and noise.kind != "uneven"
    if is_uneven and noise.lowest_edges is not None and noise.highest_edges is not None:
        texts.append(f"uneven: {noise.lowest_edges:.2g} to {noise.highest_edges:.2g} by region")
    stand_out, rms = noise.tail, noise.rms_edges
    if stand_out is not None and rms is not None and stand_out >= IMPULSIVE_TAIL:
        texts.append(
            f"impulsive: {100.0 * stand_out:.1f} % of the vertices stand out; with them "
            f"{rms:.3g} mean edge lengths"
        )
    return texts


def unsure_text(record: MeshRecord) -> str:
    """Where a choice was made for noise or texture: ``noise of 0.08 e (60 %) or texture (40 %):
    filtered mildly, --assume noise or texture decides``; else empty."""
    noise, choice = record.noise_estimate, record.choice
    if noise is None or choice is None or not noise.unsure or choice.wishes.get("assume"):
        return ""
    readings = " or ".join(
        escape_for_display(one.kind)
        + (f" of {one.level_edges:.2g} e" if one.level_edges else "")
        + f" ({100.0 * one.probability:.0f} %)"
        for one in noise.readings
    )
    done = "left as it is" if record.status == "unchanged" else "filtered mildly"
    return f"{readings}: {done}, --assume noise or texture decides"


# What was chosen


def auto_text(records: Sequence[MeshRecord]) -> str:
    """Where --auto is expected to come much nearer to the truth, in one line; else empty."""
    known = [one.choice.auto_seconds for one in records if one.choice is not None]
    seconds = [one for one in known if one is not None]
    if not seconds:
        return ""
    where = "" if len(records) == 1 else f" on {len(seconds):,} of {len(records):,} files"
    about = f"{sum(seconds):.0f} s" if sum(seconds) < 100.0 else f"{sum(seconds) / 60.0:.0f} min"
    return (
        f"--auto would probably come much nearer to the true surface{where} (machined parts, "
        f"strong noise), in about {about} of one core"
    )


def by_hand(choice: ChoiceMade) -> str:
    """The options that repeat a choice, as a shell takes them."""
    import shlex

    return escape_for_display(shlex.join(choice.repeat))


def runners_up_text(several: tuple[RunnerUp, ...]) -> str:
    """What was nearly chosen: ``AL, 3 sweeps (risk 0.072 e), MSAL, 2 sweeps (risk 0.08 e)``."""
    return ", ".join(
        f"{escape_for_display(one.label)} (risk {one.risk_edges:.2g} e)" for one in several
    )


def chosen_text(chosen: Mapping[str, int]) -> str:
    """What was chosen, and how often: ``msal 12, bilateral_normal 5, none 3``."""
    return ", ".join(f"{escape_for_display(name)} {count:,}" for name, count in chosen.items())
