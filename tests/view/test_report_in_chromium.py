"""The HTML report in a real browser: it sorts, filters and unfolds, and names stay text."""

import io

import pytest

from msal_cli.job.display_names import escape_for_display
from msal_cli.mesh import Mesh
from msal_cli.report import html as as_html
from msal_cli.report.html import Gallery, Pictures
from msal_cli.view import pages, scene
from tests.report.made import HOSTILE_NAMES, RUN, failed, gated, written
from tests.shapes import noisy, torus

pytestmark = [pytest.mark.xdist_group("chromium"), pytest.mark.ci]

N_MORE = 120


def jpeg(colour):
    from PIL import Image

    data = io.BytesIO()
    Image.new("RGB", (40, 30), colour).save(data, "JPEG")
    return data.getvalue()


def records():
    made = [failed(name, warnings=(name,)) for name in HOSTILE_NAMES]
    made += [gated(f"gate{at}.ply") for at in range(3)]
    return made + [written(f"scan{at}.ply", vertices=1000 + at) for at in range(N_MORE)]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    every = records()
    vertices, faces = torus()
    drawn = scene.encode_scene(Mesh(noisy(vertices, level=0.1), faces), Mesh(vertices, faces))
    at = len(HOSTILE_NAMES)
    views = Pictures(jpeg("red"), jpeg("green"), jpeg("blue"))
    turned = pages.embed_scene("scene0", drawn, picture=b"", description=HOSTILE_NAMES[5])
    shown = {one.output: views for one in every[at:]} | {
        every[at].output: views._replace(scene=turned)
    }
    gallery = Gallery(shown, "<p>moved</p>")
    page = tmp_path_factory.mktemp("report") / "run.html"
    page.write_bytes(as_html.render(RUN, every, gallery))
    return page


@pytest.fixture
def page(browser, path):
    browser.open(path, state="waiting")
    return browser


def names(page):
    return page.run("[...document.querySelectorAll('#files .open')].map((one) => one.textContent)")


def count(page):
    return page.run("document.getElementById('count').textContent")


def find(page, text):
    field = page.driver.find_element("id", "find")
    field.clear()
    field.send_keys(text)
    page.settle()


def head(page, title):
    """The button of a column."""
    for one in page.driver.find_elements("css selector", "#files thead button"):
        if one.text.startswith(title):
            return one
    raise AssertionError(title)


def test_nothing_is_asked_for_and_nothing_is_complained_about(page, path):
    # The first page that a browser opens comes with requests of its own.
    page.open(path, state="waiting")
    page.click("Open in 3D")
    page.wait(lambda: page.run("document.querySelector('.msal-scene').dataset.state") == "ready")
    page.driver.find_elements("css selector", "#files .open")[0].click()
    find(page, "gate")
    assert page.requests() == [path.as_uri()]
    assert page.complaints() == []


def test_the_table_is_sorted_by_keys(page):
    button = head(page, "Vertices")
    page.driver.execute_script("arguments[0].focus()", button)
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    ActionChains(page.driver, duration=0).send_keys(Keys.ENTER).perform()
    page.settle()
    assert names(page)[0] == "gate0.ply" and names(page)[3] == f"scan{N_MORE - 1}.ply"
    th = "document.querySelector('#files [aria-sort]')"
    assert page.run(f"{th}.getAttribute('aria-sort')") == "descending"
    ActionChains(page.driver, duration=0).send_keys(Keys.SPACE).perform()
    page.settle()
    assert names(page)[0] == "scan0.ply"
    assert page.run(f"{th}.getAttribute('aria-sort')") == "ascending"
    page.click("Worst first")
    assert names(page)[0] == escape_for_display(HOSTILE_NAMES[0])
    assert page.run(f"{th}") is None


def test_histograms_count_every_file_with_a_figure(page):
    titles = page.run("[...document.querySelectorAll('.histogram b')].map((e) => e.textContent)")
    assert titles == ["Volume change", "Largest displacement", "Time for a file"]
    counts = page.run(
        "[...document.querySelectorAll('.histogram .bars')].map((bars) => [...bars.children]"
        ".reduce((sum, bar) => sum + parseInt(bar.title), 0))"
    )
    assert counts == [3 + N_MORE] * 3
    heights = page.run(
        "[...document.querySelectorAll('.bars i')].map((bar) => bar.offsetHeight).filter(Boolean)"
    )
    assert len(heights) == 3 and min(heights) > 50


def test_it_finds_names_reasons_and_gates(page):
    find(page, "scan11.ply")
    assert names(page) == ["scan11.ply"] and count(page) == "1–1 of 1"
    find(page, "not finite")
    assert len(names(page)) == len(HOSTILE_NAMES)
    find(page, "volume_change GATE2")
    assert names(page) == ["gate2.ply"]
    find(page, "<script>")
    assert names(page) == ["<script>alert(1)<!-- .ply"]
    find(page, "nowhere")
    assert names(page) == [] and count(page) == "no file matches"


def test_a_status_is_chosen_and_pages_are_turned(page):
    page.click(f"Well {N_MORE}")
    assert count(page) == f"1–50 of {N_MORE}"
    page.click("›")
    page.click("›")
    assert count(page) == f"101–{N_MORE} of {N_MORE}" and len(names(page)) == 20
    assert page.run("document.getElementById('on').disabled")
    page.click("‹")
    assert count(page) == f"51–100 of {N_MORE}"
    page.click("Gate broken 3")
    assert names(page) == ["gate0.ply", "gate1.ply", "gate2.ply"]
    page.click(f"All {len(records())}")
    assert count(page) == f"1–50 of {len(records())}"


def test_a_row_shows_its_pictures_and_unfolds(page):
    find(page, "gate1")
    assert page.run("document.querySelectorAll('#files .views img').length") == 3
    button = page.driver.find_element("css selector", "#files .open")
    button.click()
    assert button.get_attribute("aria-expanded") == "true"
    assert page.run("[...document.querySelectorAll('.more figcaption')].map((e) => e.textContent)")
    assert "volume_change is -2.1%" in page.run("document.querySelector('.more').textContent")
    page.wait(lambda: page.run("document.querySelector('.more img').naturalWidth") == 40)
    button.click()
    assert page.run("document.querySelector('.more')") is None


@pytest.mark.parametrize("width", [1400, 1100, 390, 320])
def test_the_page_fits_a_desk_and_a_phone(page, width):
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        page.settle()
        widths = page.run(
            "[document.documentElement, ...document.querySelectorAll('.scroll')]"
            ".map((one) => [one.scrollWidth, one.clientWidth])"
        )
        assert len(widths) > 1
        if width != 1100:
            assert [one for one in widths if one[0] > one[1]] == []
        assert widths[0][0] <= width
    finally:
        page.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
