"""Images as PNG, or as JPEG: a tenth of the bytes, for pages with very many of them."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Longs

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

_AT_ONCE = 1 << 14


def jpeg_bytes(image: NDArray[np.uint8], quality: int = 80) -> bytes:
    """(h, w, 3) as JPEG; ``quality`` up to 95, more is larger and closer to the image."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(image).save(data, "JPEG", quality=quality, optimize=True)
    return data.getvalue()


def png_bytes(image: NDArray[np.uint8], most_colours: int | None = None) -> bytes:
    """(h, w, 3) uint8 as the bytes of a PNG file; the same image always gives the same bytes.

    ``most_colours`` up to 256 makes a file of about a third of the size, with that many colours.
    """
    from PIL import Image

    if most_colours is None:
        picture = Image.fromarray(np.ascontiguousarray(image))
    else:
        picture = _with_palette(image, most_colours)
    data = io.BytesIO()
    picture.save(data, format="PNG", optimize=True)
    return data.getvalue()


def _with_palette(image: NDArray[np.uint8], most_colours: int) -> Picture:
    """(h, w, 3) ``image`` as a picture with a palette of ``most_colours``, at most 256.

    Half of the palette are shades that cover many pixels each, for the clay, and half are spread
    over all colours there are, for heat maps and their scale.  The most frequent colour, which is
    the background, stays as it is.
    """
    from PIL import Image as Pictures

    packed = image.astype(np.uint32) @ np.array([65536, 256, 1], dtype=np.uint32)
    codes, which, count = np.unique(packed.reshape(-1), return_inverse=True, return_counts=True)
    colours = np.stack([codes >> 16, (codes >> 8) & 255, codes & 255], axis=1).astype(np.float64)
    if len(codes) <= most_colours:
        palette, nearest = colours, np.arange(len(codes))
    else:
        picture = Pictures.fromarray(np.ascontiguousarray(image))
        spread = max(1, most_colours // 2)
        parts = [colours[[np.argmax(count)]]]
        for n, method in (
            (spread, Pictures.Quantize.MAXCOVERAGE),
            (most_colours - 1 - spread, Pictures.Quantize.MEDIANCUT),
        ):
            if n > 0:
                listed = picture.quantize(n, method=method).getpalette() or []
                parts.append(np.array(listed[: 3 * n], dtype=np.float64).reshape(-1, 3))
        palette = np.unique(np.concatenate(parts), axis=0)
        nearest = _nearest(colours, palette)
    result = Pictures.fromarray(nearest[which].reshape(image.shape[:2]).astype(np.uint8))
    result.putpalette(palette.astype(np.uint8).tobytes())
    return result


def _nearest(colours: Floats, palette: Floats) -> Longs:
    """The number of the nearest of ``palette`` (k, 3) for each of ``colours`` (n, 3)."""
    lengths = 0.5 * (palette**2).sum(axis=1)
    parts = [
        np.argmin(lengths - colours[start : start + _AT_ONCE] @ palette.T, axis=1)
        for start in range(0, len(colours), _AT_ONCE)
    ]
    return np.concatenate(parts)
