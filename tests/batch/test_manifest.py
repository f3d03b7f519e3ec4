"""The manifest survives torn lines and tells the truth about settings."""

import dataclasses
import json
import os
import time

import pytest

import msal_cli
from msal_cli.batch import manifest as manifests
from msal_cli.batch import resume
from msal_cli.batch.lock import Shard
from msal_cli.batch.manifest import NAME, FileStat, FolderManifest, done_line, intent_line
from msal_cli.batch.resume import hash_settings
from msal_cli.errors import OutputError
from msal_cli.job.settings import Settings
from tests.report.made import written

SETTINGS = Settings("msal", {"K": 0.5, "iterations": 4})


def record(tmp_path, name="a.ply", **changes):
    (tmp_path / name).write_bytes(b"out")
    sums = {"input_sha256": "i" * 64, "output_sha256": "o" * 64}
    values = {"output": str(tmp_path / name), "warnings": ("w\n", "bytes \udcff"), **sums}
    return written("in", **(values | changes))


def read_names(place):
    return set(manifests.merge_entries(manifests.read_views(str(place))))


def opened(folder, shard=None):
    manifest = FolderManifest(str(folder), shard)
    manifest.open()
    return manifest


def noted(folder, *lines, shard=None):
    manifest = opened(folder, shard)
    manifest.append(lines)
    manifest.close()
    return FolderManifest(str(folder))


def test_what_is_noted_is_read_back(tmp_path):
    one = record(tmp_path)
    (tmp_path / "in").write_bytes(b"input")
    entry = noted(tmp_path, done_line("a.ply", "hash", one, str(tmp_path / "in"))).get("a.ply")
    assert entry.is_done and entry.settings == "hash" and entry.status == "written"
    assert (entry.input_sha256, entry.output_sha256) == ("i" * 64, "o" * 64)
    assert entry.input_version == FileStat.of(str(tmp_path / "in"))
    assert entry.input_version.size == 5 and entry.output_version.size == 3
    assert entry.record() == one


@pytest.mark.parametrize("name", ["new\nline", 'quote"', "bytes\udcff\udcfe", "\u2028", "=1", "\\"])
def test_any_name_is_one_line(tmp_path, name):
    assert noted(tmp_path, intent_line(name, "nowhere")).get(name) is not None
    assert (tmp_path / NAME).read_bytes().count(b"\n") == 1


def test_a_torn_last_line_costs_itself_only_wherever_it_is_torn(tmp_path):
    noted(tmp_path, *(done_line(name, "h", record(tmp_path), "in") for name in ("a", "b")))
    whole = (tmp_path / NAME).read_bytes()
    first = whole.index(b"\n") + 1
    for length in [*range(first, len(whole) - 1, 29), len(whole) - 2]:
        (tmp_path / NAME).write_bytes(whole[:length])
        assert read_names(tmp_path) == {"a"}
        noted(tmp_path, intent_line("c", "in"))
        assert read_names(tmp_path) == {"a", "c"}
    (tmp_path / NAME).write_bytes(whole[:-1])
    noted(tmp_path, intent_line("c", "in"))
    assert read_names(tmp_path) == {"a", "b", "c"}


@pytest.mark.parametrize(
    "line",
    [
        *(b"", b"[]", b"{}", b"\xff\xfe\x00", b"[" * 100_000),
        b'{"kind":"done","name":"x"}',
        b'{"kind":"done","name":"x","format":2,"settings":"","status":"written","input":{}}',
        b'{"kind":"intent","name":["x"],"input":{}}',
        b'{"kind":"intent","name":"x","input":7}',
    ],
)
def test_a_line_without_sense_is_passed_over(tmp_path, line):
    noted(tmp_path, intent_line("a", "in"))
    with (tmp_path / NAME).open("ab") as file:
        file.write(line + b"\n")
    noted(tmp_path, intent_line("b", "in"))
    assert read_names(tmp_path) == {"a", "b"}


def test_lines_are_on_the_disk_before_append_returns(tmp_path, monkeypatch):
    manifest = opened(tmp_path)
    synced = []
    real = os.fsync
    monkeypatch.setattr(
        os, "fsync", lambda handle: synced.append((tmp_path / NAME).stat().st_size) or real(handle)
    )
    manifest.append([intent_line("a", "in"), intent_line("b", "in")])
    assert synced == [(tmp_path / NAME).stat().st_size] and synced[0] > 0
    manifest.append([])
    assert len(synced) == 1
    manifest.close()
    manifest.close()


@pytest.mark.skipif(os.name != "posix", reason="folders are synced on POSIX only")
def test_the_name_of_a_new_manifest_outlives_a_power_cut(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(os.fstat(handle).st_ino))
    opened(tmp_path).close()
    assert synced == [tmp_path.stat().st_ino]


def test_what_is_no_manifest_is_an_output_error(tmp_path):
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / NAME).symlink_to(tmp_path / "precious")
    for folder in ("linked", "no such folder"):
        with pytest.raises(OutputError):
            FolderManifest(str(tmp_path / folder)).open()
    assert not (tmp_path / "precious").exists()
    (tmp_path / NAME).mkdir()
    with pytest.raises(OutputError):
        FolderManifest(str(tmp_path))


class TestSeveral:
    """Shards write manifests of their own, and everybody reads all."""

    def test_the_newer_line_counts_whoever_wrote_it(self, tmp_path):
        line = done_line("a.ply", "new", record(tmp_path), "in")
        for first, second in ((None, Shard(1, 2)), (Shard(1, 2), None)):
            noted(tmp_path, line | {"settings": "old"}, shard=first)
            noted(tmp_path, line, shard=second)
            assert FolderManifest(str(tmp_path)).get("a.ply").settings == "new"
            assert read_names(tmp_path) == {"a.ply"}
            noted(tmp_path, intent_line("a.ply", "in"), shard=first)
            assert not FolderManifest(str(tmp_path)).get("a.ply").is_done

    def test_a_clock_that_is_slow_does_not_make_a_line_old(self, tmp_path, monkeypatch):
        line = done_line("a.ply", "first", record(tmp_path), "in")
        noted(tmp_path, line, shard=Shard(1, 2))
        monkeypatch.setattr(time, "time_ns", lambda: 5)
        noted(tmp_path, line | {"settings": "second"})
        noted(tmp_path, line | {"settings": "third"})
        assert FolderManifest(str(tmp_path)).get("a.ply").settings == "third"

    def test_compaction_drops_only_what_is_outdated_in_its_own(self, tmp_path, monkeypatch):
        monkeypatch.setattr(manifests, "_SPARE_LINES", 5)
        monkeypatch.setattr(manifests, "MAX_RUN_LINES", 3)
        line = done_line("a.ply", "h", record(tmp_path), "in")
        runs = [{"kind": "run", "format": 1, "number": n} for n in range(10)]
        noted(tmp_path, *runs, line | {"settings": "old"}, line, intent_line("b", "in"))
        noted(tmp_path, line | {"settings": "newer"}, shard=Shard(1, 2))
        other = (tmp_path / ".msal-manifest-1-of-2.jsonl").read_bytes()
        noted(tmp_path)
        lines = [json.loads(one) for one in (tmp_path / NAME).read_text().splitlines()]
        assert [one.get("number", one.get("name")) for one in lines] == [7, 8, 9, "a.ply", "b"]
        assert lines[3]["settings"] == "h"
        assert (tmp_path / ".msal-manifest-1-of-2.jsonl").read_bytes() == other
        after = FolderManifest(str(tmp_path))
        assert after.get("a.ply").settings == "newer" and after.get("a.ply").record() is not None

    def test_a_record_whose_file_was_rewritten_since_is_not_another_s(self, tmp_path):
        lines = [done_line(name, "h", record(tmp_path, name), "in") for name in ("a.ply", "b.ply")]
        noted(tmp_path, *lines)
        read = FolderManifest(str(tmp_path))
        whole = (tmp_path / NAME).read_bytes().splitlines(keepends=True)
        (tmp_path / NAME).write_bytes(whole[1] + whole[0])
        assert read.get("a.ply").record() is None
        (tmp_path / NAME).unlink()
        assert read.get("b.ply").record() is None


def test_the_hash_of_settings_changes_with_all_that_decides_the_bytes(monkeypatch):
    names = [field.name for field in dataclasses.fields(Settings)]
    hashes = [hash_settings(dataclasses.replace(SETTINGS, **{name: "other"})) for name in names]
    values = ({"K": 0.5, "iterations": 5}, {"K": 0.25, "iterations": 4}, {"K": 0.5})
    hashes += [hash_settings(Settings("msal", parameters)) for parameters in values]
    # The files of a tile set.
    hashes += [hash_settings(SETTINGS, files) for files in ([], ["a"], ["a", "b"])]
    monkeypatch.setattr(resume, "__version__", msal_cli.__version__ + ".1")
    hashes += [hash_settings(SETTINGS)]
    assert len(set(hashes)) == len(hashes) == len(names) + 7
