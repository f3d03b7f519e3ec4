"""Words in pictures: the font that comes with Pillow, and what it cannot draw."""

from __future__ import annotations

import functools
import unicodedata
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL import ImageFont

# Tried in turn for what the built-in font lacks; it has little beyond ASCII.
_OTHER_FONTS = ("DejaVuSans.ttf", "NotoSans-Regular.ttf", "NotoSansCJK-Regular.ttc", "Arial.ttf")

_UNSAFE_CATEGORIES = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})

_NO_CHARACTER = "\U0010fffd"


def fit_text(text: str, size: int, width: int) -> tuple[str, ImageFont.FreeTypeFont]:
    """``text`` as it can be drawn in ``width`` pixels, and the font of ``size`` pixels for it.

    What a font cannot draw, and what has no shape of its own (line ends, marks that turn the
    writing direction), becomes an escape such as ``\\x0a``.  Of what is too long the end stays,
    because the end of a path says more than its beginning.
    """
    # No shape is narrower than a third of a pixel.
    most = 3 * max(width, 1)
    plain = "".join(_visible(one) for one in text[-most:])
    font = _font("", size)
    for name in ("", *_OTHER_FONTS):
        other = _font_or_none(name, size)
        if other is not None and all(_has(name, size, one) for one in set(plain)):
            font = other
            break
    else:
        plain = "".join(one if _has("", size, one) else _escape(one) for one in plain)
    if len(text) <= most and font.getlength(plain) <= width:
        return plain, font
    tail = plain[-most:]
    while tail and font.getlength("..." + tail) > width:
        tail = tail[1:]
    return "..." + tail, font


def _visible(one: str) -> str:
    return _escape(one) if unicodedata.category(one) in _UNSAFE_CATEGORIES else one


def _escape(one: str) -> str:
    code = ord(one)
    if 0xDC80 <= code <= 0xDCFF:
        code -= 0xDC00  # a byte that is not UTF-8
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


@functools.cache
def _font_or_none(name: str, size: int) -> ImageFont.FreeTypeFont | None:
    """A font by its file name, the built-in one for no name; None where it is not there."""
    from PIL import ImageFont

    # The plain layout is the same whether or not a library for complex scripts is there.
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


def _font(name: str, size: int) -> ImageFont.FreeTypeFont:
    font = _font_or_none(name, size)
    assert font is not None
    return font


@functools.cache
def _has(name: str, size: int, one: str) -> bool:
    """Whether a font has a shape for a character."""
    if one == " ":
        return True
    font = _font(name, size)
    return bytes(font.getmask(one)) != bytes(font.getmask(_NO_CHARACTER))
