"""A histogram as SVG: how one figure is spread over the files of a run."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from msal_cli.job.display_names import figure
from msal_cli.report.phrases import format_count

MOST_BINS, LEAST_BINS = 24, 8
"""Bars between the ends of the axis: more for more files."""

_WIDTH, _HEIGHT = 360, 170
_LEFT, _RIGHT, _TOP, _BOTTOM = 34, 8, 14, 26
_FAR_OUT = 6.0


@dataclass(frozen=True)
class Bins:
    """Counts between ``edges``; what lies below the first and beyond the last edge beside them."""

    edges: tuple[float, ...]
    counts: tuple[int, ...]
    below: int
    beyond: int


def bin_values(values: Sequence[float]) -> Bins:
    """The values in equal steps; a few far outliers get no axis that squeezes all the others.

    ``values`` are finite, and at least one.
    """
    ranked = sorted(values)
    low, high = _limits(ranked)
    if high <= low:
        pad = abs(low) * 0.05 or 0.5
        low, high = low - pad, high + pad
    n_bins = min(MOST_BINS, max(LEAST_BINS, round(1.5 * math.sqrt(len(ranked)))))
    step = (high - low) / n_bins
    if not (math.isfinite(step) and low + step > low):
        # Values that are too large or too close for steps between them.
        return Bins((low, high), (len(values),), 0, 0)
    counts = [0] * n_bins
    below = beyond = 0
    for value in values:
        if value < low:
            below += 1
        elif value > high:
            beyond += 1
        else:
            counts[min(n_bins - 1, int((value - low) / step))] += 1
    return Bins(tuple(low + step * at for at in range(n_bins + 1)), tuple(counts), below, beyond)


def svg(title: str, values: Sequence[float], form: str, unit: str = "") -> str:
    """An SVG element with its description; ``form`` and ``unit`` say how a value is written.

    What is not finite is left out.
    """
    ranked = sorted(value for value in values if math.isfinite(value))
    if not ranked:
        return ""

    def text(value: float) -> str:
        return html.escape(figure(value, form, unit))

    bins = bin_values(ranked)
    low, median, high = (text(ranked[at]) for at in (0, len(ranked) // 2, -1))
    label = f"{html.escape(title)}: {len(ranked):,} files from {low} to {high}, median {median}"
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{label}">'
        f"{_bars(bins, text)}{_axes(bins, text)}</svg>"
    )


def _limits(ranked: Sequence[float]) -> tuple[float, float]:
    """The ends of the axis: those of the values, unless a few lie far from nearly all."""

    def at(share: float) -> float:
        return ranked[round(share * (len(ranked) - 1))]

    low, high = ranked[0], ranked[-1]
    middle = at(0.5)
    reach_below, reach_above = middle - at(0.05), at(0.95) - middle
    # Where nearly all are alike there is nothing to be squeezed.
    if reach_above > 0.0 and high - middle > _FAR_OUT * reach_above:
        high = middle + _FAR_OUT * 0.5 * reach_above
    if reach_below > 0.0 and middle - low > _FAR_OUT * reach_below:
        low = middle - _FAR_OUT * 0.5 * reach_below
    return low, high


def _bars(bins: Bins, text: Callable[[float], str]) -> str:
    most = max(*bins.counts, bins.below, bins.beyond, 1)
    slot = (_WIDTH - _LEFT - _RIGHT) / (len(bins.counts) + 2)
    floor, room = _HEIGHT - _BOTTOM, _HEIGHT - _BOTTOM - _TOP
    steps = zip(bins.counts, bins.edges, bins.edges[1:], strict=False)
    rows = [
        (bins.below, f"below {text(bins.edges[0])}", "out"),
        *((count, f"{text(low)} to {text(high)}", "bar") for count, low, high in steps),
        (bins.beyond, f"above {text(bins.edges[-1])}", "out"),
    ]
    parts = []
    for at, (count, where, kind) in enumerate(rows):
        if count:
            # A single file among thousands must still be seen.
            height = max(2.0, room * count / most)
            parts.append(
                f'<rect class="{kind}" x="{_LEFT + slot * at + 0.75:.2f}" '
                f'y="{floor - height:.2f}" width="{max(1.0, slot - 1.5):.2f}" '
                f'height="{height:.2f}" rx="1">'
                f"<title>{format_count(count, 'file')}, {where}</title></rect>"
            )
    return (
        f'{"".join(parts)}<line class="rule" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{_TOP}" '
        f'y2="{_TOP}"/><text x="{_LEFT - 5}" y="{_TOP + 4}" text-anchor="end">{most:,}</text>'
    )


def _axes(bins: Bins, text: Callable[[float], str]) -> str:
    floor = _HEIGHT - _BOTTOM
    slot = (_WIDTH - _LEFT - _RIGHT) / (len(bins.counts) + 2)
    left, right = _LEFT + slot, _WIDTH - _RIGHT - slot
    low, high = bins.edges[0], bins.edges[-1]
    parts = [
        f'<line class="axis" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{floor}" y2="{floor}"/>'
        f'<text x="{_LEFT - 5}" y="{floor + 1}" text-anchor="end">0</text>'
    ]
    for share, anchor in ((0.0, "start"), (0.5, "middle"), (1.0, "end")):
        x = left + share * (right - left)
        parts.append(
            f'<line class="axis" x1="{x:.2f}" x2="{x:.2f}" y1="{floor}" y2="{floor + 4}"/>'
            f'<text x="{x:.2f}" y="{floor + 17}" text-anchor="{anchor}">'
            f"{text(low + share * (high - low))}</text>"
        )
    return "".join(parts)
