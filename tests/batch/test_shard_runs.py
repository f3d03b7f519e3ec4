"""Runs that come after others or beside them: shards, remembered failures, lines about runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import msal_cli
from msal_cli.batch.manifest import NAME
from msal_cli.batch.plan import select_shard
from msal_cli.batch.shard import Shard, parse_shard
from msal_cli.job.settings import Settings
from tests.batch import fakes
from tests.batch.test_run import SETTINGS, fill, plan_of, ran, statuses, tried

FAULTS = (
    "E_FORMAT", "E_TRUNCATED", "E_CONTENT", "E_NONFINITE", "E_INDEX", "E_NO_FACES", "E_RANGE",
    "E_LOSS",
)  # fmt: skip
CIRCUMSTANCES = (
    "E_CRASH", "E_TIMEOUT", "E_WRITE", "E_READ", "E_UNSUPPORTED", "E_TOO_LARGE", "E_INTERNAL"
)  # fmt: skip


@pytest.fixture
def folders(tmp_path):
    (tmp_path / "in").mkdir()
    return tmp_path


def rerun(folders, settings=SETTINGS, **options):
    names, on_event = tried(folders)
    records = ran(folders, settings, plan_of(folders, **options), on_event=on_event)
    return sorted(names), records


class TestRememberedFailures:
    def test_only_what_may_go_away_by_itself_is_tried_again(self, folders):
        codes = (*FAULTS, *CIRCUMSTANCES)
        fill(folders, 1, **{f"f{code}": f"fail {code}" for code in codes})
        first = ran(folders)
        assert not any(record.remembered for record in first)
        names, second = rerun(folders)
        assert names == sorted(CIRCUMSTANCES)
        for one, two in zip(first, second, strict=True):
            assert one.error == two.error
            assert two.remembered == (Path(two.input).stem in FAULTS)
        assert statuses(second).count("failed") == len(codes)

    def test_what_changed_or_is_asked_for_is_tried_again(self, folders):
        fill(folders, 1, f01="fail E_INDEX", f02="fail E_INDEX")
        ran(folders)
        assert rerun(folders)[0] == []
        assert rerun(folders, retry_failed=True)[0] == ["01", "02"]
        assert rerun(folders)[0] == []
        assert rerun(folders, fresh=True)[0] == ["00", "01", "02"]
        assert rerun(folders, Settings("other"))[0] == ["00", "01", "02"]
        assert rerun(folders)[0] == ["00", "01", "02"]
        (folders / "in/02.ply").write_text("fail E_RANGE")
        (folders / "in/01.ply").write_text("well again")
        names, records = rerun(folders)
        assert names == ["01", "02"] and statuses(records) == ["up-to-date", "written", "failed"]

    def test_what_could_not_be_read_is_tried_again(self, folders):
        fill(folders, 1, f01="fail")
        ran(folders)
        assert rerun(folders)[0] == ["01"]

    def test_a_dry_run_tells_it_too(self, folders):
        fill(folders, 1, f01="fail E_INDEX")
        ran(folders)
        assert statuses(ran(folders, dry_run=True)) == ["up-to-date", "failed"]


class TestShards:
    def ran(self, folders, text, settings=SETTINGS, **options):
        return ran(
            folders, settings, select_shard(plan_of(folders), parse_shard(text, {})), **options
        )

    def test_whoever_did_it_it_is_done(self, folders):
        fill(folders, 8, f03="fail E_INDEX")
        names, on_event = tried(folders)
        for k in (1, 2):
            self.ran(folders, f"{k}/2")
        assert statuses(ran(folders, on_event=on_event)).count("up-to-date") == 7
        for k in (1, 2, 3):
            self.ran(folders, f"{k}/3", on_event=on_event)
        assert names == []
        (folders / "in/07.ply").write_text("changed")
        ran(folders, on_event=on_event)
        for k in (1, 2):
            self.ran(folders, f"{k}/2", on_event=on_event)
        assert names == ["07"]
        other = Settings("other")
        self.ran(folders, "1/1", other)
        # The newest lines are those of 1/1 and not what the older manifests say.
        assert statuses(ran(folders, other, on_event=on_event)).count("up-to-date") == 7
        assert names == ["07"]

    def test_an_empty_shard_leaves_word_that_it_ran(self, folders):
        fill(folders, 1)
        k = next(k for k in (1, 2) if not Shard(k, 2).has("00.ply"))
        assert self.ran(folders, f"{k}/2") == []
        path = folders / f"out/.msal-manifest-{k}-of-2.jsonl"
        lines = [json.loads(line)["kind"] for line in path.read_text().splitlines()]
        assert lines == ["run", "end"]

    def test_the_temporaries_of_live_shards_stay(self, folders):
        fill(folders, 4)
        (folders / "out").mkdir()
        with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
            own = f"-{os.getpid()}-"
            live = fakes.temporary_name("00.ply").replace(own, f"-{other.pid}-")
            (folders / "out" / live).touch()
            self.ran(folders, "1/2")
            assert (folders / "out" / live).exists()
            other.kill()
        self.ran(folders, "2/2")
        assert not (folders / "out" / live).exists()


class TestRunLines:
    def lines(self, folders, kind):
        lines = map(json.loads, (folders / "out" / NAME).read_text().splitlines())
        return [line for line in lines if line["kind"] == kind]

    def test_a_run_says_when_it_began_and_ended(self, folders):
        fill(folders, 2)
        ran(folders, command=("msal", "denoise", "\udcff"))
        (run,), (end,) = self.lines(folders, "run"), self.lines(folders, "end")
        assert run["command"] == ["msal", "denoise", "\udcff"] and run["pid"] == os.getpid()
        assert run["settings"]["method"] == "fake" and run["version"] == msal_cli.__version__
        assert run["files"] == 2 and run["shard"] is None and run["host"]
        assert run["started"] <= end["finished"] and end["interrupted"] is False
        assert 0.0 <= end["seconds"] < 60.0 and run["at"] < end["at"]

    def test_a_run_that_is_broken_off_says_so(self, folders):
        fill(folders, 2)

        def on_event(event):
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            ran(folders, on_event=on_event)
        assert self.lines(folders, "end")[0]["interrupted"] is True
