"""The HTML report: whole, within its size, under a strict policy, and names in it are text."""

from __future__ import annotations

import base64
import hashlib
import json
from html.parser import HTMLParser
from xml.etree import ElementTree as Xml

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from msal_cli.job.display_names import escape_for_display
from msal_cli.report import html as as_html
from msal_cli.report.html import Gallery, Pictures
from tests.report.made import HOSTILE_NAMES, RECORDS, RUN, failed, gated, written

VOID = {"meta", "link", "input", "br", "img"}


class Reader(HTMLParser):
    """What a page holds: its tags, its attributes, its scripts, and whether all is closed."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.attributes, self.texts, self.within = [], [], {}, []
        self.ids = {}
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [(tag, *one) for one in attributes]
        if tag not in VOID:
            self.within.append((tag, dict(attributes).get("id")))

    def handle_startendtag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [(tag, *one) for one in attributes]

    def handle_endtag(self, tag):
        assert self.within.pop()[0] == tag

    def handle_data(self, data):
        if self.within:
            tag, key = self.within[-1]
            self.texts.setdefault(tag, []).append(data)
            if key:
                self.ids[key] = self.ids.get(key, "") + data


def page(records, gallery=as_html.EMPTY_GALLERY):
    text = as_html.render(RUN, records, gallery).decode()
    reader = Reader(text)
    assert reader.within == []
    return text, reader


def test_the_policy_allows_what_is_there_and_nothing_else():
    text, reader = page([gated()], Gallery(scenes={0: "<div></div>"}))
    (policy,) = [
        value for _, name, value in reader.attributes if name == "content" and "'none'" in value
    ]
    for one in (*reader.texts["script"][-2:], *reader.texts["style"]):
        digest = base64.b64encode(hashlib.sha256(one.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert policy.count("'sha256-") == 4 and "unsafe" not in policy
    assert not [one for one in reader.attributes if one[1] == "style" or one[1].startswith("on")]
    loaded = [value for _, name, value in reader.attributes if name in ("src", "href")]
    assert all(one.startswith("data:") for one in loaded)
    assert "http" not in text.partition("<script>")[0].replace("http-equiv", "")


@pytest.mark.parametrize("make", [written, failed, gated])
def test_names_stay_text(make):
    plain_tags = set(page([make("a.ply", warnings=("b",))])[1].tags)
    records = [make(name, warnings=(name,)) for name in HOSTILE_NAMES]
    text, reader = page(records)
    assert set(reader.tags) <= plain_tags | {"br"}
    assert all(one not in text for one in ("<script>alert", "<img src=x", "\x1b", "\u202e"))
    names = [one["values"][0] for one in json.loads(reader.ids["rows"])]
    assert sorted(names) == sorted(map(escape_for_display, HOSTILE_NAMES))
    assert set(map(escape_for_display, HOSTILE_NAMES)) <= set(reader.texts["th"])


@settings(max_examples=25, deadline=None)
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


# Histograms


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=50))
@example([-1.7e308, 0.0, 1.7e308])
@example([5e-324, 0.0])
def test_a_histogram_counts_every_value(values):
    edges, counts = as_html.bin_values(sorted(values))
    assert sum(counts) == len(values)
    assert len(edges) == len(counts) - 1 and sorted(edges) == edges
    Xml.fromstring(as_html.draw_histogram("title", values, ".3g"))
