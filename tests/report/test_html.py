"""The HTML report: whole, within its size, names in it are text; and the pictures for it."""

import base64
import io
import json
import re
from dataclasses import replace

import pytest
from hypothesis import given
from PIL import Image

from msal_cli.job.display_names import escape_for_display
from msal_cli.report import html as as_html
from msal_cli.report.data import read_json
from msal_cli.report.html import Gallery, Pictures
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal, open_scan
from tests.html_pages import Page, assert_self_contained
from tests.report.made import HOSTILE_NAMES, RECORDS, RUN, failed, gated, written


def page(records, gallery=as_html.EMPTY_GALLERY):
    text = as_html.render(RUN, records, gallery).decode()
    return text, Page(text)


def test_nothing_is_loaded_or_run_but_what_is_there():
    turned = Pictures(b"", b"", scene="<div></div>")
    text, reader = page([gated()], Gallery({gated().output: turned}))
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
    pictures = {"out/good": Pictures(b"a", b"b"), "out/gate": Pictures(b"c", b"d", b"e")}
    _, reader = page(records, Gallery(pictures, "<p>moved</p>"))
    coded = [base64.b64encode(one).decode() for one in (b"c", b"d", b"e", b"a", b"b")]
    assert json.loads(reader.ids["pictures"]) == [None, coded[:3], [*coded[3:], None]]


def test_two_thousand_files_are_a_small_page():
    records = [written(f"scans/{at}.ply") for at in range(2_000)]
    assert len(as_html.render(RUN, records)) < 1_200_000


def denoised(folder, *options):
    """Denoise a folder of three scans, one of them bad; the records."""
    folder_of(folder / "in", a=closed_scan(), b=open_scan(), bad=BAD_SCAN)
    if "--in-place" not in options:
        options = (*options, "-o", folder / "out")
    options = (*options, "--method", "msal", "-q", "-j", 1)
    msal("denoise", folder / "in", *options, "--report", folder / "r.json")
    return read_json((folder / "r.json").read_bytes(), "r.json")[1]


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """Of a run whose files stay as they are."""
    return denoised(tmp_path_factory.mktemp("run"))


def shown(records, found):
    assert found.pictures.keys() <= {one.output for one in records}
    return sorted(name.rpartition("/")[2] for name in found.pictures)


def test_every_file_that_was_written_is_shown(records):
    found = as_html.build_gallery(records)
    assert shown(records, found) == ["a.ply", "b.ply"]
    for one in found.pictures.values():
        assert one.scene
        images = [Image.open(io.BytesIO(data)) for data in (one.before, one.after, one.deviation)]
        assert {image.format for image in images} == {"JPEG"} and len({i.size for i in images}) == 1
        assert one.before != one.after != one.deviation


def test_a_file_that_changed_since_has_no_picture(records):
    other = [replace(one, output_sha256="0" * 64) for one in records if one.output_sha256]
    twice = [*records, *(replace(one, input="x.ply") for one in records)]
    assert as_html.build_gallery(other).pictures == as_html.build_gallery(twice).pictures == {}


def test_in_place_the_backup_is_the_input(tmp_path):
    records = denoised(tmp_path, "--in-place", "--backup", ".raw")
    assert shown(records, as_html.build_gallery(records, backup=".raw")) == ["a.ply", "b.ply"]
    assert as_html.build_gallery(records, backup=".orig").pictures == {}


def test_the_bounds_are_kept_and_said(records, monkeypatch):
    def built(**bounds):
        with monkeypatch.context() as patch:
            for name, value in bounds.items():
                patch.setattr(as_html, name, value)
            return as_html.build_gallery(records)

    found = built(MAX_SECONDS=-1.0)
    assert found.pictures == {} and found.remarks[0].startswith("2 files without")
    found = built(MAX_FACES=100)
    assert shown(records, found) == ["b.ply"] and found.remarks[0].startswith("1 file without")
    found = built(MAX_PICTURE_BYTES=0)
    assert len(found.pictures) == 1 and found.remarks[0].startswith("1 file without")
    found = built(MAX_SCENES=1)
    (name,) = (name for name, one in found.pictures.items() if one.scene)
    written = [one for one in records if one.output in found.pictures]
    assert name == max(written, key=lambda one: one.displacement.max_edges).output
    found = built(MAX_SCENE_FACES=100)
    assert "decimated" in found.remarks[0]


def test_what_cannot_be_drawn_keeps_back_no_report(records, monkeypatch):
    from msal_cli.view import pictures

    def broken(*_):
        raise RuntimeError

    monkeypatch.setattr(pictures, "camera_of", broken)
    assert as_html.build_gallery(records).pictures == {}


def test_the_report_of_a_run_has_its_pictures(tmp_path):
    folder_of(tmp_path / "in", a=closed_scan(), bad=BAD_SCAN)
    page = tmp_path / "run.html"
    msal("denoise", tmp_path / "in", "-o", tmp_path / "out", "--report", page, "-q")
    again = tmp_path / "again.html"
    msal("report", tmp_path / "out", "-o", again, "-q")
    for one in (page, again):
        text = one.read_text()
        found = re.search(r'id="pictures">(.*?)</script>', text)[1]
        assert [one is not None for one in json.loads(found)] == [False, True]
        assert text.count('class="msal-scene"') == 1
        assert "The worst file in 3D" in text and "mean edge lengths (outwards)" in text
