"""Images side by side with text and a colour scale, as PNG or JPEG."""

from __future__ import annotations

import functools
import io
from collections.abc import Sequence
from dataclasses import replace
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.job.display_names import escape_for_display
from msal_cli.light_dataclass import dataclass
from msal_cli.view.rendering import WHITE, Image

if TYPE_CHECKING:
    from PIL import ImageFont
    from PIL.ImageDraw import ImageDraw

TEXT, FAINT = (28, 30, 34), (96, 100, 108)  # colours of titles and of the lines below
Panel = tuple[Image, str, Sequence[str]]  # an image (h, w, 3), its title, and the lines below it


@dataclass(frozen=True, eq=False)
class Legend:
    """A colour scale, drawn below the last panel."""

    lines: tuple[str, ...]  # what the colours mean, and in which units
    colours: NDArray[np.uint8]  # (k, 3) uint8 from the left end to the right one
    # positions from 0 to 1, each with the text above and below the scale there
    ticks: tuple[tuple[float, str, str], ...]


def draw_panels(
    panels: Sequence[Panel],
    legend: Legend | None = None,
    *,
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
    words = _Words(width)
    panels = [(image, title, words.wrap(lines, width)) for image, title, lines in panels]
    below = max(len(lines) for _, _, lines in panels) * words.line_height
    if legend is not None:
        legend = replace(legend, lines=words.wrap(legend.lines, width))
        n_lines = len(panels[-1][2]) + len(legend.lines)
        below = max(below, n_lines * words.line_height + words.scale_height)
    cell = (width, words.title_height + height + words.gap // 2 + below)
    foot = len(footer) * words.line_height + (words.gap if footer else 0)
    whole = (
        2 * words.margin + columns * cell[0] + (columns - 1) * words.gap,
        2 * words.margin + n_rows * cell[1] + (n_rows - 1) * 2 * words.gap + foot,
    )
    sheet = Pictures.new("RGB", whole, WHITE)
    words.draw = ImageDraw.Draw(sheet)
    for at, (image, title, lines) in enumerate(panels):
        left = words.margin + (at % columns) * (cell[0] + words.gap)
        y = words.margin + (at // columns) * (cell[1] + 2 * words.gap)
        words.write((left, y), title, TEXT, width, words.title)
        y += words.title_height
        across, down = (width - image.shape[1]) // 2, (height - image.shape[0]) // 2
        sheet.paste(Pictures.fromarray(image), (left + across, y + down))
        y = words.write_lines((left, y + height + words.gap // 2), lines, width)
    if legend is not None:
        _draw_legend(words, legend, (left, y), width)
    y = whole[1] - words.margin - len(footer) * words.line_height
    words.write_lines((words.margin, y), footer, whole[0] - 2 * words.margin)
    return np.asarray(sheet)


class _Words:
    """Sizes in pixels of what surrounds panels of a certain width, and the text in it."""

    draw: ImageDraw

    def __init__(self, width: int) -> None:
        text = min(22, max(10, round(width / 28)))
        self.text = self.margin = text
        self.title = round(1.2 * text)
        self.gap = round(1.25 * text)
        self.line_height = round(1.4 * text)
        self.title_height = round(1.6 * self.title)
        self.bar_height = round(0.9 * text)
        self.scale_height = self.gap // 2 + 2 * self.line_height + self.bar_height + text

    def write(
        self,
        place: tuple[float, float],
        text: str,
        colour: tuple[int, int, int],
        width: int,
        size: int | None = None,
        anchor: str = "la",
    ) -> None:
        """Draw a line of ``text`` at ``place``, shortened to ``width``."""
        plain, font = fit_text(text, size or self.text, width)
        self.draw.text(place, plain, fill=colour, font=font, anchor=anchor)

    def wrap(self, lines: Sequence[str], width: int) -> tuple[str, ...]:
        """The lines, with those that are too long broken at spaces."""
        rows: list[str] = []
        for line in lines:
            is_cut = fit_text(line, self.text, width)[0].startswith("...")
            # The mean width of letters is 0.6 of their size.
            rows += wrap(line, round(1.7 * width / self.text)) if is_cut else [line]
        return tuple(rows)

    def write_lines(self, place: tuple[int, int], lines: Sequence[str], width: int) -> int:
        """Draw faint lines below one another; returns y of the next one."""
        left, y = place
        for line in lines:
            self.write((left, y), line, FAINT, width)
            y += self.line_height
        return y


def _draw_legend(words: _Words, legend: Legend, place: tuple[int, int], width: int) -> None:
    draw, left = words.draw, place[0]
    y = words.write_lines((left, place[1] + words.gap // 2), legend.lines, width)
    # Texts at the ends extend beyond the scale by half their width.
    ticks, texts = legend.ticks, [word for _, *both in legend.ticks for word in both]
    lengths = [fit_text(word, words.text, width)[1].getlength(word) for word in texts]
    longest = max(lengths, default=0)
    inset = round(min(0.5 * longest, 0.2 * width)) + 1
    first, last = left + inset, left + width - inset
    top = y + words.line_height + words.text // 3
    bottom = top + words.bar_height
    for x in range(first, last):
        k = round((x - first) / max(1, last - 1 - first) * (len(legend.colours) - 1))
        red, green, blue = (int(part) for part in legend.colours[k])
        draw.line([(x, top), (x, bottom)], fill=(red, green, blue))
    draw.rectangle([first - 1, top - 1, last, bottom + 1], outline=FAINT)
    while (each := (last - first) // max(1, len(ticks) - 1) - 4) < longest and len(ticks) > 2:
        ticks = ticks[::2]
    for share, above, below in ticks:
        x = round(first + share * (last - 1 - first))
        draw.line([(x, top - 4), (x, top - 1)], fill=FAINT)
        words.write((x, top - 6), above, TEXT, each, anchor="ms")
        if below:
            draw.line([(x, bottom + 1), (x, bottom + 4)], fill=FAINT)
            words.write((x, bottom + 7), below, TEXT, each, anchor="ma")


# Text: the font that comes with Pillow, and what it cannot draw


# Tried in turn for characters that the built-in font lacks; it has little beyond ASCII.
_OTHER_FONTS = ("DejaVuSans.ttf", "NotoSans-Regular.ttf", "NotoSansCJK-Regular.ttc", "Arial.ttf")

_NO_CHARACTER = "\U0010fffd"


def fit_text(text: str, size: int, width: int) -> tuple[str, ImageFont.FreeTypeFont]:
    """``text`` as it can be drawn in ``width`` pixels, and a font of ``size`` pixels for it.

    Characters that the font lacks, and those without a shape (line ends, changes of the writing
    direction), become escapes such as ``\\x0a``.  A text that is too long is cut to its end,
    because the end of a path says most.
    """
    # No character is narrower than a third of a pixel.
    max_length = 3 * max(width, 1)
    plain = escape_for_display(text[-max_length:])
    fonts = [font for name in ("", *_OTHER_FONTS) if (font := _load_font(name, size))]
    font = next((font for font in fonts if all(_has(font, c) for c in set(plain))), fonts[0])
    plain = "".join(
        c if _has(font, c) else c.encode("ascii", "backslashreplace").decode() for c in plain
    )
    if len(text) <= max_length and font.getlength(plain) <= width:
        return plain, font
    tail = plain[-max_length:]
    while tail and font.getlength("..." + tail) > width:
        tail = tail[1:]
    return "..." + tail, font


@functools.cache
def _load_font(name: str, size: int) -> ImageFont.FreeTypeFont | None:
    """The font in a file, or the built-in one for an empty name; None if it is missing."""
    from PIL import ImageFont

    # The basic layout does not depend on an optional library for complex scripts.
    plain = ImageFont.Layout.BASIC
    if name:
        try:
            return ImageFont.truetype(name, size, layout_engine=plain)
        except OSError:
            return None
    font = ImageFont.load_default(size)
    if not isinstance(font, ImageFont.FreeTypeFont):
        raise ImportError("this Pillow is built without FreeType, which draws text")
    return font.font_variant(layout_engine=plain)


@functools.cache
def _has(font: ImageFont.FreeTypeFont, character: str) -> bool:
    """Whether a font has a shape for a character."""
    return character == " " or bytes(font.getmask(character)) != bytes(font.getmask(_NO_CHARACTER))


# Image files; for pages JPEG, which takes a fraction of the bytes


def jpeg_bytes(image: NDArray[np.uint8], quality: int = 80) -> bytes:
    """(h, w, 3) uint8 as the bytes of a JPEG file; text needs a ``quality`` of 90."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(image).save(data, "JPEG", quality=quality, optimize=True)
    return data.getvalue()


def png_bytes(image: NDArray[np.uint8], max_colours: int | None = None) -> bytes:
    """(h, w, 3) uint8 as the bytes of a PNG file; the same image always gives the same bytes.

    ``max_colours``, up to 256, reduces the colours, and the file to about a third of its size.
    """
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(image))
    if max_colours is not None:
        picture = picture.quantize(max_colours, dither=Image.Dither.NONE)
    data = io.BytesIO()
    picture.save(data, format="PNG", optimize=True)
    return data.getvalue()
