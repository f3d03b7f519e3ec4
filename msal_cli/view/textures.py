"""Images that a mesh file names, read with care, and their colours at texture coordinates.

The names and the images come from strangers: nothing outside the folder of the mesh file is opened,
nothing but regular files, and no image of more pixels than a scanner writes is decoded.
"""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats
from msal_cli.codecs.named_files import read_beside
from msal_cli.errors import ContentError

MOST_BYTES = 128 << 20
MOST_PIXELS = 1 << 26
"""Of one image: 8,192 x 8,192; decoded it takes 200 MB."""

_LARGEST_SIDE = 4096
"""Pixels of a side to which larger images are reduced; pictures show less."""

_FORMATS = ("PNG", "JPEG", "BMP", "TGA", "WEBP", "TIFF")

Texture = NDArray[np.uint8]
"""(h, w, 3), the first row on top."""


def read_texture(name: str, folder: Path | None) -> Texture:
    """The image ``name`` in ``folder``; ContentError where it cannot be had."""
    return decode_texture(read_beside(name, folder, MOST_BYTES), name)


def decode_texture(data: bytes, name: str) -> Texture:
    """The image in ``data``; ContentError where it is none, or too large."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            # Of images that are refused here anyway Pillow warns.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            picture = Image.open(io.BytesIO(data), formats=_FORMATS)
        with picture:
            width, height = picture.size
            if width * height <= MOST_PIXELS:
                picture.draft("RGB", (_LARGEST_SIDE, _LARGEST_SIDE))
                small = picture.convert("RGB")
                small.thumbnail((_LARGEST_SIDE, _LARGEST_SIDE), Image.Resampling.BOX)
                return np.asarray(small)
    except Exception as failure:  # Pillow's decoders raise whatever they meet
        reason = str(failure)[:100] or type(failure).__name__
        raise ContentError(f"the image {name[:200]!r} cannot be read: {reason}") from None
    raise ContentError(
        f"the image {name[:200]!r} has {width:,} x {height:,} pixels, more than {MOST_PIXELS:,}"
    )


def sample_texture(texture: Texture, places: Floats) -> Floats:
    """Colours (n, 3), 0 to 255, at ``places`` (n, 2): u to the right and v downwards, 0 to 1 once
    over the image, which repeats.  Bilinear; not-a-number where a place is none."""
    height, width = texture.shape[:2]
    # Not true of what is no number.
    is_known: Flags = np.asarray((np.abs(places) < 1e6).all(axis=1))
    at = np.where(is_known[:, None], places, 0.0)
    # 1 itself is the last pixel, not the first of the next copy.
    at = np.where((at < 0.0) | (at > 1.0), at - np.floor(at), at)
    x = np.clip(at[:, 0] * width - 0.5, 0.0, width - 1.0)
    y = np.clip(at[:, 1] * height - 0.5, 0.0, height - 1.0)
    left, top = x.astype(np.int64), y.astype(np.int64)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across, down = (x - left)[:, None], (y - top)[:, None]
    upper = texture[top, left] * (1.0 - across) + texture[top, right] * across
    lower = texture[bottom, left] * (1.0 - across) + texture[bottom, right] * across
    colours: Floats = upper * (1.0 - down) + lower * down
    colours[~is_known] = np.nan
    return colours
