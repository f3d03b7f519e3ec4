"""What is said of a single denoised file: a few lines, of which the long form has every figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from msal_cli.job.display_names import escape_for_display
from msal_cli.job.records import MeshRecord, MethodUsed, NoiseEstimate
from msal_cli.report.phrases import (
    Tone,
    auto_text,
    defects_text,
    despiked_text,
    failure_text,
    file_name,
    format_count,
    gate_text,
    negligible_text,
    percent_text,
    reference_text,
    seconds_text,
    self_intersections_text,
    tile_set_text,
    tiles_text,
    unsure_text,
    vertices_text,
)

MOST_LINES = 8
"""Lines on a file, with the one that names it."""

Fact = tuple[str, str, Tone]


def short_facts(record: MeshRecord, defaults: Mapping[str, Any]) -> list[Fact]:
    """A word, a text and a tone for each line below the name of a file that was written.

    ``defaults`` are the default parameters of its method; only others are shown.
    """
    facts: list[Fact] = [
        (word, text, "plain") for word, text in _facts(record, defaults) if text or word == "mesh"
    ]
    remarks = list(_remarks(record))
    room = MOST_LINES - 1 - len(facts)
    if len(remarks) > room:
        n_left = len(remarks) - (room - 1)
        tone: Tone = "bad" if any(one[2] == "bad" for one in remarks[room - 1 :]) else "faint"
        remarks = [*remarks[: room - 1], ("...", f"and {n_left:,} more (-v shows them)", tone)]
    return facts + remarks


def ending(record: MeshRecord) -> str:
    """What follows the name of the output: how long it took."""
    return "" if record.seconds is None else f" in {seconds_text(record.seconds.total)}"


def file_text(record: MeshRecord) -> str:
    """What became of a file, in one line: how, how far it moved, what calls for attention."""
    if record.error is not None:
        return f"failed: {failure_text(record.error)}"
    moved = record.displacement
    parts = [
        escape_for_display(record.method.name) if record.method is not None else "",
        f"largest move {moved.max_edges:.3g} mean edge lengths" if moved is not None else "",
    ]
    if record.status == "unchanged":
        parts = [escape_for_display(f"left as it is: {record.left_alone or 'no vertex moved'}")]
    parts += [
        format_count(record.flipped_faces or None, "flipped face"),
        despiked_text(record.despiked) if record.despiked else "",
        seconds_text(record.seconds.total) if record.seconds is not None else "",
    ]
    warnings = (f"warning: {escape_for_display(one)}" for one in record.warnings)
    return "; ".join([", ".join(filter(None, parts)), *warnings])


def _facts(record: MeshRecord, defaults: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    counts = (
        vertices_text(record.vertices, record.corners),
        format_count(record.faces, "face"),
        format_count(record.components, "component"),
        defects_text(record),
    )
    yield "mesh", ", ".join(filter(None, counts))
    if record.noise_estimate is not None:
        yield "noise", _noise_text(record.noise_estimate, record)
    yield "unsure", unsure_text(record)
    if record.choice is not None:
        yield "chosen", escape_for_display(record.choice.reason)
        yield "better", auto_text([record])
    elif record.method is not None:
        yield "method", _method_text(record.method, defaults)
    if record.tiles is not None:
        yield "tiles", tiles_text(record.tiles)
    if record.status == "unchanged":
        return
    if record.left_alone:
        yield "left as it is", escape_for_display(record.left_alone)
    yield "moved", _changes_text(record)


def _noise_text(noise: NoiseEstimate, record: MeshRecord) -> str:
    level = f"{noise.mean_edges:.3g} mean edge lengths"
    if noise.negligible:
        return f"{level}: {negligible_text(record)}"
    return ", ".join(filter(None, (level, noise.words)))


def _method_text(method: MethodUsed, defaults: Mapping[str, Any]) -> str:
    """The method's name, and what differs from its defaults."""
    named = ", ".join(
        f"{name} {escape_for_display(str(value))}"
        for name, value in method.parameters.items()
        if name not in defaults or defaults[name] != value
    )
    return method.name + (f" ({named})" if named else "")


def _changes_text(record: MeshRecord) -> str:
    moved, volume = record.displacement, record.volume
    texts = []
    if moved is not None:
        texts.append(f"mean {moved.mean_edges:.3g}, most {moved.max_edges:.3g} mean edge lengths")
    if volume is not None and volume.valid:
        texts.append(f"volume {percent_text(volume.change_percent)}".rstrip())
    elif volume is not None and not record.boundary_edges:
        # Boundary edges are a reason that the line on the mesh gives.
        texts.append(f"no volume: {escape_for_display(volume.reason)}")
    if record.despiked:
        texts.append(despiked_text(record.despiked))
    for count, word in (
        (record.clamped_vertices, "cut to the longest move"),
        (record.locked_vertices, "locked"),
    ):
        if count is not None:
            texts.append(f"{format_count(count, 'vertex', 'vertices')} {word}")
    return "; ".join([*texts, *filter(None, [tile_set_text([record])])])


def _remarks(record: MeshRecord) -> Iterator[Fact]:
    """What calls for attention first."""
    n_passed = sum(not gate.broken for gate in record.gates)
    for gate in record.gates:
        if gate.broken:
            yield "gate", gate_text(gate), "bad"
    for warning in record.warnings:
        yield "warning", escape_for_display(warning), "bad"
    reference = record.reference
    if reference is not None and reference.error is not None:
        yield "reference", failure_text(reference.error), "bad"
    elif reference is not None:
        yield "reference", f"{reference_text(reference)} ({file_name(reference.path)})", "plain"
        for warning in reference.warnings:
            yield "warning", escape_for_display(warning), "bad"
    if n_passed:
        yield "gate", f"{n_passed:,} passed", "good"
    if record.self_intersections is not None:
        yield "intersecting", self_intersections_text(record.self_intersections), "plain"
    for sidecar in record.sidecars:
        yield "beside it", escape_for_display(sidecar), "plain"
