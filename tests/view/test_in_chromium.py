"""The page in a real browser: it draws, obeys, and leaves the network alone."""

import numpy as np
import pytest

from msal_cli.mesh import Mesh
from msal_cli.view import pages, pictures, scene
from tests.report.made import HOSTILE_NAMES
from tests.shapes import cube, noisy, torus
from tests.view.decoded import decoded

pytestmark = [pytest.mark.xdist_group("chromium"), pytest.mark.ci]

HOSTILE = "".join(HOSTILE_NAMES)


def scene_of_two(around=48, across=24):
    vertices, faces = torus(around, across)
    before = Mesh(noisy(vertices, level=0.12), faces)
    return before, Mesh(vertices, faces), np.linalg.norm(before.vertices - vertices, axis=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("pages")
    before, after, deviation = scene_of_two()
    two = pictures.Scene((HOSTILE, "After"), before, after, deviation)
    page = pages.page_of(two, pictures.View(size=64, view="top"), "msal view")
    (path / "pair.html").write_bytes(page)
    return path


@pytest.fixture
def pair(browser, folder):
    """The browser with a page of two meshes as it is at the start."""
    address = (folder / "pair.html").as_uri()
    if browser.run("location.href") != address:
        browser.open(folder / "pair.html")
    browser.run("document.activeElement.blur()")
    browser.driver.find_elements("css selector", "[aria-label='Shading'] button")[0].click()
    browser.driver.find_elements("css selector", "[aria-label='Right side'] button")[0].click()
    browser.press("canvas", "0")
    return browser


def share_of_difference(one, other, threshold=16):
    return (np.abs(one - other).max(axis=2) > threshold).mean()


def middle(image):
    """Without the margins where the names, the ruler and the scale stand."""
    h, w, _ = image.shape
    return image[h // 5 : h * 3 // 4, w // 5 : w * 4 // 5]


def at_split(browser, key):
    browser.press("canvas", key)
    return middle(browser.pixels())


def test_the_two_sides_differ_and_the_line_parts_them(pair):
    before, half, after = (at_split(pair, key) for key in "123")
    assert share_of_difference(before, after) > 0.05
    w = half.shape[1] // 2 - 40
    # The handle is as wide as these 40 pixels on each side.
    assert share_of_difference(half[:, :w], before[:, :w]) == 0.0
    assert share_of_difference(half[:, -w:], after[:, -w:]) == 0.0
    # A mesh covers a good part, and is lit: no plain patch of one colour.
    assert before.std() > 20 and after.std() > 20


def test_nothing_is_asked_for_and_nothing_is_complained_about(browser, folder):
    browser.open(folder / "pair.html")
    pair = browser
    pair.press("canvas", "d", "f")
    assert pair.requests() == [(folder / "pair.html").as_uri()]
    assert pair.complaints() == []


def test_the_view_moves_and_comes_back(pair):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
    from selenium.webdriver.common.keys import Keys

    canvas = pair.driver.find_element("css selector", "canvas")

    def actions():
        return ActionChains(pair.driver, duration=0)

    def drag():
        start = actions().move_to_element_with_offset(canvas, 60, 60).click_and_hold()
        start.move_by_offset(80, 30).release().perform()

    def shift():
        actions().key_down(Keys.SHIFT).send_keys(Keys.ARROW_RIGHT).key_up(Keys.SHIFT).perform()

    def wheel():
        actions().scroll_from_origin(ScrollOrigin.from_element(canvas, 80, 0), 0, -200).perform()

    start = last = at_split(pair, "3")
    for act in (
        lambda: pair.press("canvas", Keys.ARROW_RIGHT, Keys.ARROW_UP),
        lambda: pair.press("canvas", "+", "+"),
        lambda: pair.press("canvas", "."),
        drag,
        shift,
        wheel,
    ):
        act()
        pair.settle()
        now = middle(pair.pixels())
        assert share_of_difference(now, last) > 0.01
        last = now
    pair.press("canvas", "0", "3")
    assert share_of_difference(middle(pair.pixels()), start) < 0.001


def test_the_deviation_has_colours_and_a_scale(pair):
    plain = at_split(pair, "3")
    pair.click("Deviation")
    coloured = middle(pair.pixels())
    assert share_of_difference(plain, coloured) > 0.05

    def colourful(image):
        return ((image.max(axis=2) - image.min(axis=2)) > 60).mean()

    assert colourful(coloured) > 0.05 > colourful(plain)
    _, _, deviation = scene_of_two()
    words = pair.run("document.querySelector('.msal-legend').innerText")
    assert "Displacement" in words and "file units" in words
    assert f"{deviation.max():.4f}".rstrip("0") in words


def test_the_script_reads_what_was_written(pair, folder):
    # The policy lets only the page's own script run, so this goes around it.
    before, _, _ = scene_of_two(12, 8)
    text = scene.encode_scene(before, Mesh(*cube()), np.arange(8.0)).text
    _, meshes, values = decoded(text)
    code = pages.viewer_script().replace(
        "for (const box of", "globalThis.unpacked = unpacked;\nfor (const box of"
    )
    page = f"<div class='msal-scene'></div><script>{code}</script>"
    (folder / "open.html").write_text(page)
    pair.open(folder / "open.html", state="still")
    found = pair.driver.execute_async_script(
        "const done = arguments[1]; unpacked(arguments[0]).then(({meshes, deviation}) => done("
        "[meshes.map((m) => [m.ticks.map((t) => [...t]), [...m.corners]]), [...deviation]]))",
        text,
    )
    for (ticks, faces), (read_ticks, corners) in zip(meshes, found[0], strict=True):
        assert np.array_equal(np.array(read_ticks).T, ticks)
        assert np.array_equal(np.array(corners), faces.reshape(-1))
    scale = np.array(found[1]) / 65535 * 7.0
    assert np.allclose(scale, values)


def test_without_webgl_there_is_the_picture(browsers, folder):
    browser = browsers("--disable-webgl", "--disable-3d-apis", "--disable-gpu")
    browser.open(folder / "pair.html", state="still")
    assert browser.run("document.querySelector('figure img').naturalWidth") > 64
    assert browser.run("getComputedStyle(document.querySelector('figure')).display") == "block"
    assert "WebGL" in browser.run("document.querySelector('.msal-why').textContent")
    assert browser.run("document.querySelectorAll('canvas').length") == 0
    assert browser.complaints() == []
