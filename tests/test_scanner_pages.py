"""The table of scanners in docs/noise.md: every example has its row and its picture."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import scanner_cases

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = (DOCS / "noise.md").read_text("utf-8")
LARGEST_PICTURE = 150_000


@pytest.fixture(autouse=True)
def scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))


def made(name: str) -> list[str]:
    """The rows of a made table, without its head."""
    place = re.search(rf"<!-- made: {name} -->\n(.*?)<!-- end -->", PAGE, re.DOTALL)
    assert place is not None
    return place[1].splitlines()[2:]


def test_every_example_has_its_row_and_picture() -> None:
    from scanner_examples import EXAMPLES

    pictures = [f"images/scanners/{one.name}.png" for one in EXAMPLES]
    rows = made("your scanner")
    for one, row, picture in zip(EXAMPLES, rows, pictures, strict=True):
        assert one.scanner in row and one.noise in row and one.does in row and picture in row
        assert (DOCS / picture).stat().st_size < LARGEST_PICTURE
    assert len(made("pictures of scanners")) == len(EXAMPLES)
    assert {path.name for path in (DOCS / "images/scanners").iterdir()} == {
        Path(one).name for one in pictures
    }


def test_examples_name_kinds_of_the_benchmark() -> None:
    from scanner_examples import EXAMPLES

    known = {*scanner_cases.ADDED, *scanner_cases.SIMULATED, *scanner_cases.REAL}
    assert {kind for one in EXAMPLES for kind in one.kinds} <= known


def test_a_picture_shows_three_panels(monkeypatch: pytest.MonkeyPatch) -> None:
    import make_scanner_pages
    from scanner_examples import EXAMPLES

    monkeypatch.setattr(make_scanner_pages, "SIZE", (200, 200))
    monkeypatch.setattr(make_scanner_pages, "COMMAND", "plain")
    (laser,) = (one for one in EXAMPLES if one.name == "laser")
    shown = make_scanner_pages.draw(laser)
    assert shown.picture.shape == (200, 3 * 200 + 2 * 10, 3)
    noisy, result, truth = (shown.picture[:, at : at + 200].astype(float) for at in (0, 210, 420))
    # Noise is contrast between pixels side by side.
    contrast = [np.abs(np.diff(one, axis=1)).mean() for one in (noisy, result, truth)]
    assert contrast[0] > 1.1 * contrast[1] > contrast[2]
    assert shown.after_deg < 0.6 * shown.before_deg and shown.reason


def test_the_page_of_accuracy_has_every_kind() -> None:
    page = (DOCS / "accuracy.md").read_text("utf-8")
    place = re.search(r"<!-- made: scanners -->\n(.*?)<!-- end -->", page, re.DOTALL)
    assert place is not None
    kinds = re.findall(r"^\| ([^|]+) \(\d+\) \|", place[1], re.MULTILINE)
    assert kinds == [*scanner_cases.ADDED, *scanner_cases.SIMULATED, *scanner_cases.REAL]
