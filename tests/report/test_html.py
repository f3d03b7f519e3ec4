"""The HTML report: whole, within its size, under a strict policy, and names in it are text."""

import base64
import json

import pytest
from hypothesis import given

from msal_cli.job.display_names import escape_for_display
from msal_cli.report import html as as_html
from msal_cli.report.html import Gallery, Pictures
from tests.html_pages import Page, assert_self_contained
from tests.report.made import HOSTILE_NAMES, RECORDS, RUN, failed, gated, written


def page(records, gallery=as_html.EMPTY_GALLERY):
    text = as_html.render(RUN, records, gallery).decode()
    return text, Page(text)


def test_nothing_is_loaded_or_run_but_what_is_there():
    text, reader = page([gated()], Gallery(scenes={0: "<div></div>"}))
    assert_self_contained(reader)
    assert "http" not in text.partition("<script>")[0].replace("http-equiv", "")


@pytest.mark.parametrize("make", [written, failed, gated])
def test_names_stay_text(make):
    plain = page([make("a.ply", warnings=("b",))])[1]
    records = [make(name, warnings=(name,)) for name in HOSTILE_NAMES]
    text, reader = page(records)
    assert {tag for tag, _ in reader.tags} <= {tag for tag, _ in plain.tags} | {"br"}
    assert all(one not in text for one in ("<script>alert", "<img src=x", "\x1b", "\u202e"))
    names = [one["values"][0] for one in json.loads(reader.ids["rows"])]
    assert sorted(names) == sorted(map(escape_for_display, HOSTILE_NAMES))
    assert set(map(escape_for_display, HOSTILE_NAMES)) <= set(reader.texts["th"])


@given(RECORDS)
def test_any_records_make_a_page(records):
    _, reader = page(records)
    assert len(json.loads(reader.ids["rows"])) == len(records)


def test_pictures_stand_in_the_order_of_the_rows():
    records = [written("good"), failed("bad"), gated("gate")]
    gallery = Gallery(
        pictures={0: Pictures(b"a", b"b"), 2: Pictures(b"c", b"d", b"e")}, legend="<p>moved</p>"
    )
    _, reader = page(records, gallery)
    coded = [base64.b64encode(one).decode() for one in (b"c", b"d", b"e", b"a", b"b")]
    assert json.loads(reader.ids["pictures"]) == [None, coded[:3], [*coded[3:], None]]


def test_two_thousand_files_are_a_small_page():
    records = [written(f"scans/{at}.ply") for at in range(2_000)]
    assert len(as_html.render(RUN, records)) < 1_200_000
