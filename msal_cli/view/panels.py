"""Images side by side with words, and a scale of colours, as one picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.view.shading import LIGHT, Image, Style

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

Panel = tuple[Image, str, Sequence[str]]
"""An image (h, w, 3), its title, and the lines below it."""


@dataclass(frozen=True, eq=False)
class Legend:
    """A scale of colours, drawn below the last panel.

    Attributes
    ----------
    lines : what the colours mean, and in which units.
    colours : (k, 3) uint8 from the left end to the right one.
    ticks : places from 0 to 1, each with the words above and below the scale there.
    """

    lines: tuple[str, ...]
    colours: NDArray[np.uint8]
    ticks: tuple[tuple[float, str, str], ...]


def labelled_panels(
    panels: Sequence[Panel],
    legend: Legend | None = None,
    *,
    style: Style = LIGHT,
    columns: int | None = None,
    footer: Sequence[str] = (),
) -> Image:
    """(H, W, 3) uint8: the images with their titles above and their lines below.

    Parameters
    ----------
    panels : at least one; images may differ in size, and a cell is as large as the largest.
    legend : drawn below the lines of the last panel.
    columns : panels in a row; all in one row by default.
    footer : lines below everything.
    """
    from PIL import Image as Pictures
    from PIL import ImageDraw

    columns = columns or len(panels)
    n_rows = -(-len(panels) // columns)
    width = max(image.shape[1] for image, _, _ in panels)
    height = max(image.shape[0] for image, _, _ in panels)
    words = _Words.for_width(width)
    n_lines = max(len(lines) for _, _, lines in panels)
    below = n_lines * words.line_height
    if legend is not None:
        lines_of_last = len(panels[-1][2])
        scale = len(legend.lines) * words.line_height + words.scale_height
        below = max(below, lines_of_last * words.line_height + scale)
    cell = (width, words.title_height + height + words.gap // 2 + below)
    foot = len(footer) * words.line_height + (words.gap if footer else 0)
    whole = (
        2 * words.margin + columns * cell[0] + (columns - 1) * words.gap,
        2 * words.margin + n_rows * cell[1] + (n_rows - 1) * 2 * words.gap + foot,
    )
    sheet = Pictures.new("RGB", whole, style.background)
    draw = ImageDraw.Draw(sheet)
    room = whole[0] - 2 * words.margin
    for at, (image, title, lines) in enumerate(panels):
        left = words.margin + (at % columns) * (cell[0] + words.gap)
        y = words.margin + (at // columns) * (cell[1] + 2 * words.gap)
        words.write(draw, (left, y), title, style.text, width, words.title)
        y += words.title_height
        across, down = (width - image.shape[1]) // 2, (height - image.shape[0]) // 2
        sheet.paste(Pictures.fromarray(image), (left + across, y + down))
        y += height + words.gap // 2
        for line in lines:
            words.write(draw, (left, y), line, style.faint, width)
            y += words.line_height
        if legend is not None and at == len(panels) - 1:
            _draw_legend(draw, words, legend, (left, y), width, style)
    y = whole[1] - words.margin - len(footer) * words.line_height
    for line in footer:
        words.write(draw, (words.margin, y), line, style.faint, room)
        y += words.line_height
    return np.asarray(sheet)


@dataclass(frozen=True)
class _Words:
    """Sizes in pixels of what surrounds panels of a certain width."""

    text: int
    title: int
    margin: int
    gap: int

    @classmethod
    def for_width(cls, width: int) -> _Words:
        text = min(22, max(10, round(width / 28)))
        return cls(text, round(1.2 * text), text, round(1.25 * text))

    @property
    def line_height(self) -> int:
        return round(1.4 * self.text)

    @property
    def title_height(self) -> int:
        return round(1.6 * self.title)

    @property
    def bar_height(self) -> int:
        return round(0.9 * self.text)

    @property
    def scale_height(self) -> int:
        return self.gap // 2 + 2 * self.line_height + self.bar_height + self.text

    def write(
        self,
        draw: ImageDraw,
        place: tuple[float, float],
        text: str,
        colour: tuple[int, int, int],
        width: int,
        size: int | None = None,
        anchor: str = "la",
    ) -> None:
        """Draw a line of ``text`` at ``place``, shortened to ``width``."""
        from msal_cli.view.labels import fit_text

        plain, font = fit_text(text, size or self.text, width)
        draw.text(place, plain, fill=colour, font=font, anchor=anchor)


def _draw_legend(
    draw: ImageDraw,
    words: _Words,
    legend: Legend,
    place: tuple[int, int],
    width: int,
    style: Style,
) -> None:
    from msal_cli.view.labels import fit_text

    left, y = place[0], place[1] + words.gap // 2
    for line in legend.lines:
        words.write(draw, (left, y), line, style.faint, width)
        y += words.line_height
    # Words at the ends extend beyond the scale by half their width.
    ends = [word for _, *both in legend.ticks for word in both]
    longest = max(
        (fit_text(word, words.text, width)[1].getlength(word) for word in ends), default=0
    )
    inset = round(min(0.5 * longest, 0.2 * width)) + 1
    first, last = left + inset, left + width - inset
    top = y + words.line_height + words.text // 3
    bottom = top + words.bar_height
    for x in range(first, last):
        k = round((x - first) / max(1, last - 1 - first) * (len(legend.colours) - 1))
        red, green, blue = (int(one) for one in legend.colours[k])
        draw.line([(x, top), (x, bottom)], fill=(red, green, blue))
    draw.rectangle([first - 1, top - 1, last, bottom + 1], outline=style.faint)
    each = (last - first) // max(1, len(legend.ticks) - 1) - 4
    for share, above, below in legend.ticks:
        x = round(first + share * (last - 1 - first))
        draw.line([(x, top - 4), (x, top - 1)], fill=style.faint)
        words.write(draw, (x, top - 6), above, style.text, each, anchor="ms")
        if below:
            draw.line([(x, bottom + 1), (x, bottom + 4)], fill=style.faint)
            words.write(draw, (x, bottom + 7), below, style.text, each, anchor="ma")
