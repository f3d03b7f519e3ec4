"""Panels with words, the scale of colours, and PNG."""

import io

import numpy as np
import pytest
from PIL import Image

from msal_cli.analysis import colour_maps as colours
from msal_cli.view.panels import Legend, draw_panels, fit_text, png_bytes


def plain(colour, width=120, height=80):
    return np.full((height, width, 3), colour, dtype=np.uint8)


def test_images_appear_side_by_side_unchanged():
    sheet = draw_panels([(plain(10), "one", ["a"]), (plain(200), "two", ["b", "c"])])
    for tone in (10, 200):
        rows, columns = np.nonzero((sheet == tone).all(axis=2))
        assert rows.max() - rows.min() + 1 >= 80
        assert columns.max() - columns.min() + 1 >= 120
        assert (sheet == tone).all(axis=2).sum() >= 80 * 120


def test_the_legend_shows_its_colours_in_order():
    ramp = np.stack([np.arange(256), np.zeros(256), 255 - np.arange(256)], axis=1)
    legend = Legend(("how far",), ramp.astype(np.uint8), ((0.0, "0", "0"), (1.0, "3", "0.2")))
    image = draw_panels([(plain(255, 400), "", [])], legend).astype(int)
    on_scale = (image[:, :, 1] == 0) & (image[:, :, 0] + image[:, :, 2] == 255)
    row = np.argmax(on_scale.sum(axis=1))
    reds = image[row, on_scale[row], 0]
    assert len(reds) > 200
    assert (np.diff(reds) >= 0).all()
    assert reds[0] == 0 and reds[-1] == 255


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("a\nb", "\\x0a"),
        ("\x1b[31mred", "\\x1b"),
        ("evil\u202egnp.ply", "\\u202e"),
        ("byte\udcff.ply", "\\xff"),
        ("<script>alert(1)</script>", "<script>"),
    ],
)
def test_names_are_drawn_as_data(name, part):
    words, _ = fit_text(name, 14, 10_000)
    assert part in words
    assert words.isprintable()
    draw_panels([(plain(1), name, [name])], footer=[name])


def test_png_keeps_every_pixel_and_says_the_same_twice():
    image = np.random.default_rng(3).integers(0, 256, (40, 30, 3)).astype(np.uint8)
    data = png_bytes(image)
    assert (np.asarray(Image.open(io.BytesIO(data))) == image).all()
    assert png_bytes(image) == data


def test_a_palette_keeps_the_background_and_comes_near_to_all_else():
    random = np.random.default_rng(8)
    image = np.full((120, 200, 3), (254, 255, 251), dtype=np.uint8)
    # Clay over most of it, and a small scale with all colours of a map.
    image[:80] = random.integers(60, 220, (80, 200, 1)) + np.array([4, 2, 0])
    image[100, :200] = colours.colour_table("diverging")[:200]
    back = Image.open(io.BytesIO(png_bytes(image, 256))).convert("RGB")
    off = np.abs(np.asarray(back).astype(int) - image).max(axis=2)
    assert (off[85:95] == 0).all()
    assert off.max() <= 12
    assert off[:80].mean() < 2.0
