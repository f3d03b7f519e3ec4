"""``msal report``: runs reported from what they left behind; reports are written whole."""

import csv
import io
import json
import shutil

import pytest

from msal_cli.batch.lock import FolderLock, Shard
from msal_cli.batch.manifest import NAME
from msal_cli.cli import report_files as reports
from msal_cli.report.html import EMPTY_GALLERY
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal
from tests.files import tree
from tests.report.made import RUN, written


@pytest.fixture
def scans(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return folder_of(tmp_path / "in", **{f"s{n}": closed_scan(n) for n in range(3)})


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder after a run, made once: in, out, r.json and r.jsonl."""
    folder = tmp_path_factory.mktemp("finished")
    folder_of(folder / "in", **{f"s{n}": closed_scan(n) for n in range(3)})
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        denoised("--report", "r.json", "--report", "r.jsonl")
    return folder


@pytest.fixture
def done(finished, tmp_path, monkeypatch):
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "in"


def ran(*words):
    one = msal(*words)
    assert "Traceback" not in one.stderr and "internal error" not in one.stderr, one.stderr
    return one


def denoised(*words, out="out"):
    return ran("denoise", "in", "-o", out, "-j", "1", *words)


def report_of(*words):
    one = ran("report", *words, "--json")
    assert one.exit_code == 0, one.stderr
    return json.loads(one.stdout)


def by_name(document):
    return {record["input"]: record["status"] for record in document["records"]}


class TestOneFolder:
    def test_it_tells_what_the_run_itself_told(self, scans):
        (scans / "bad.ply").write_bytes(BAD_SCAN)
        own = json.loads(denoised("--json").stdout)
        again = report_of("out")
        assert again["records"] == own["records"]
        for key in ("schema", "version", "command", "settings", "totals", "interrupted"):
            assert again[key] == own[key], key
        assert own["started"] <= again["started"] <= again["finished"] <= own["finished"]
        assert 0.0 < again["seconds"] <= own["seconds"]

    def test_every_format_and_the_summary(self, done):
        (done.parent / "out/s1.ply").write_bytes(b"ply")
        for name in ("out", "out/.msal-manifest.jsonl"):
            one = ran("report", name, "--check")
            assert (one.exit_code, "gone or changed: 'out/s1.ply'\n" in one.stderr) == (3, True)
        denoised("--fields", "noise")
        one = ran("report", "out", "-o", "new/r.json", "-o", "r.jsonl", "-o", "r.csv", "--check")
        assert (one.exit_code, one.stdout, "3 files: 3 written" in one.stderr) == (0, "", True)
        rows = csv.DictReader(io.StringIO((done.parent / "r.csv").read_text()))
        names = [f"in/s{n}.ply" for n in range(3)]
        assert [row["input"] for row in rows] == names
        assert [list(by_name(report_of(name))) for name in ("new/r.json", "r.jsonl")] == [names] * 2
        assert ran("report", "out", "-q").stderr == ""
        (done.parent / "out/s1.fields.ply").unlink()
        assert ran("report", "out", "--check").exit_code == 3

    def test_what_was_not_finished_is_seen(self, done):
        path = done.parent / "out" / NAME
        lines = path.read_bytes().splitlines(keepends=True)
        torn, kept = lines[-2], lines[:-3]
        assert b'"end"' in lines[-1] and b'"done"' in torn
        path.write_bytes(b"".join(kept) + torn[:-7])
        document = report_of("out")
        assert list(by_name(document)) == ["in/s0.ply", "in/s1.ply", "in/s2.ply"]
        assert sorted(by_name(document).values()) == ["planned", "planned", "written"]
        assert document["interrupted"] and document["totals"]["planned"] == 2
        one = ran("report", "out", "--check", "-o", "r.md")
        assert one.exit_code == 3 and "2 not done" in one.stderr
        assert "did not come to its end" in one.stderr
        path.write_bytes(b"".join(line for line in kept if b'"done"' not in line))
        assert ran("report", "out", "--check").exit_code == 3, "nothing failed, nothing is done"
        denoised()
        assert ran("report", "out", "--check", "-o", "r.md").exit_code == 0
        path.write_bytes(b"\0" * 4096)
        assert ran("report", "out", "--check").exit_code == 3

    def test_a_run_at_work_is_named(self, done):
        with FolderLock("out", Shard(1, 2)):
            one = ran("report", "out", "--check")
        assert one.exit_code == 3 and "(shard 1/2) still at work" in one.stderr


class TestCheck:
    def test_some_and_all_failed(self, scans):
        (scans / "bad.ply").write_bytes(BAD_SCAN)
        assert denoised().exit_code == ran("report", "out", "--check").exit_code == 3
        assert ran("report", "out").exit_code == 0
        for n in range(3):
            (scans / f"s{n}.ply").write_bytes(BAD_SCAN)
        assert denoised().exit_code == ran("report", "out", "--check").exit_code == 1

    def test_a_shard_that_did_not_run(self, scans):
        first = 1 if Shard(1, 2).has("s0.ply") else 2
        denoised("--shard", f"{first}/2")
        one = ran("report", "out", "--check")
        assert one.exit_code == 3 and f"shard {3 - first}/2" in one.stderr
        denoised("--shard", f"{3 - first}/2")
        one = ran("report", "out", "--check")
        assert one.exit_code == 0 and "3 files: 3 written" in one.stderr
        # Other shards of the same work do not undo that it was done.
        denoised("--shard", "1/5")
        assert ran("report", "out", "--check").exit_code == 0


def test_the_newest_record_of_a_file_counts(scans):
    (scans / "s1.ply").write_bytes(BAD_SCAN)
    denoised("--report", "first.json", "--report", "first.jsonl")
    (scans / "s1.ply").write_bytes(closed_scan(1))
    denoised("--report", "second.json")
    for first in ("first.json", "first.jsonl"):
        states = by_name(report_of(first, "second.json"))
        assert list(states.values()) == ["up-to-date", "written", "up-to-date"]
    assert by_name(report_of("second.json", "first.json")) == by_name(report_of("second.json"))
    # The folder's own record of s1 is newer than the first report's, and no other is.
    assert set(by_name(report_of("first.json", "out")).values()) == {"written"}
    # Files of another site with the same names are others; the failed one has no output.
    shutil.copytree("out", "site/out")
    shutil.copy("first.json", "site")
    assert len(report_of("out", "site/out", "second.json")["records"]) == 6
    one = ran("report", "out", "site/first.json", "--check", "-o", "r.xml")
    assert (one.exit_code, "  site/out/s1.ply: " in one.stderr) == (3, True)
    assert 'name="s1.ply" classname="site/out"' in (scans.parent / "r.xml").read_text()


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("nowhere",), 2, "no file or folder"),
        (("in",), 2, "no manifest in the folder"),
        (("in/s0.ply",), 2, "suffix"),
        (("r.json", "-o", "r.json"), 2, "would replace"),
        (("r.json", "-o", "./out/s0.json"), 0, ""),
        ((), 2, "Missing argument"),
        *(((f"{name}.{suffix}",), 1, "no report of msal denoise")
          for name in ("null", "nested", "no schema", "latin") for suffix in ("json", "jsonl")),
        (("empty.jsonl",), 0, "0 files"),
        (("empty.jsonl", "--check"), 3, "no run is recorded"),
        (("killed.jsonl",), 0, "0 files"),
    ],
)  # fmt: skip
def test_what_is_a_run_and_what_is_none(done, words, status, said):
    contents = {"null": "null", "nested": "[" * 100_000, "latin": "\xff", "empty": ""}
    contents |= {"no schema": '{"schema": "msal.report/1", "records": []}'}
    for name, text in (contents | {"killed": '{"kind":"done"'}).items():
        for suffix in ("json", "jsonl"):
            (done.parent / f"{name}.{suffix}").write_text(text, "latin-1")
    before = tree(done.parent, has_own=True)
    one = ran("report", *words)
    assert one.exit_code == status and said in one.stderr
    assert before.items() <= tree(done.parent, has_own=True).items()


def test_who_waits_for_the_end_gets_a_page_without_pictures(tmp_path, monkeypatch):
    from msal_cli.report import html

    asked = []
    build = lambda *_, **options: asked.append(options) or EMPTY_GALLERY  # noqa: E731
    monkeypatch.setattr(html, "build_gallery", build)
    reports.write([str(tmp_path / "a.html")], RUN, [written()], without_pictures=True)
    reports.write([str(tmp_path / "b.html")], RUN, [written()], backup=".raw")
    assert [options["backup"] for options in asked] == [".raw"]
    pages = [(tmp_path / name).read_bytes() for name in ("a.html", "b.html")]
    assert pages[0] == pages[1] and b"scan.ply" in pages[0]


def test_pages_are_written_last(tmp_path, monkeypatch):
    from msal_cli.report import html

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(html, "build_gallery", interrupted)
    with pytest.raises(KeyboardInterrupt):
        reports.write([str(tmp_path / "a.html"), str(tmp_path / "a.csv")], RUN, [written()])
    assert [one.name for one in tmp_path.iterdir()] == ["a.csv"]
