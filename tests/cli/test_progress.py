"""Bars: on a terminal only, with the file in hand and the failures, never in the data."""

from __future__ import annotations

import io
import os
import re
import sys

import pytest

from msal_cli.batch.schedule import Finished, Progress, Started
from msal_cli.cli import progress
from msal_cli.job.settings import Task
from tests.files import Terminal
from tests.report.made import failed, written

POSIX = pytest.mark.skipif(os.name != "posix", reason="terminals of POSIX")


def on_a_terminal(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(progress, "_DELAY_S", 0.0)
    monkeypatch.setattr(progress, "_BETWEEN_S", 0.0)
    return stream


def tasks(*names):
    return [Task(f"in/{name}", f"out/{name}", name) for name in names]


def frames(stream):
    return [one.strip() for one in re.split(r"[\r\n]", stream.getvalue()) if one.strip()]


@pytest.mark.parametrize("names", [("a.ply",), ("a.ply", "b.ply")])
def test_no_bar_off_a_terminal_or_when_quiet(monkeypatch, names):
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert type(progress.bar(tasks(*names), quiet=False)) is progress.Log
    assert type(progress.bar(tasks(*names), quiet=True)) is progress.Silent
    on_a_terminal(monkeypatch)
    assert type(progress.bar(tasks(*names), quiet=True)) is progress.Silent
    assert type(progress.stream_bar("-", quiet=True)) is progress.Silent
    assert type(progress.bar(tasks(*names), quiet=False)) is not progress.Silent


def test_a_bar_over_files_shows_the_file_in_hand_and_the_failures(monkeypatch):
    stream = on_a_terminal(monkeypatch)
    todo = tasks("folder/first\x1b.ply", "second.ply", "third.ply")
    bar = progress.bar(todo, quiet=False)
    bar.on_event(Started(0))
    assert "folder/first\\x1b.ply" in frames(stream)[-1]
    assert "0/3" in frames(stream)[-1]
    bar.on_event(Finished(0, written()))
    assert "1/3" in frames(stream)[-1]
    assert "failed" not in frames(stream)[-1]
    bar.on_event(Started(1))
    bar.on_event(Progress(1, "sweeps", 1, 4))
    bar.on_event(Finished(1, failed()))
    assert "second.ply" in frames(stream)[-1]
    assert "2/3" in frames(stream)[-1]
    assert "1 failed" in frames(stream)[-1]
    bar.close()
    assert "\x1b.ply" not in stream.getvalue()


def logged(monkeypatch, names):
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    return stream, progress.bar(tasks(*names), quiet=False)


def test_a_log_has_a_line_for_each_file_as_it_finishes_with_its_whole_name(monkeypatch):
    long = "folder/" * 30 + "scan.ply"
    stream, log = logged(monkeypatch, [long, "old.ply", "bad.ply", "odd.ply"])
    log.on_event(Finished(0, written(flipped_faces=2, despiked=1)))
    log.on_event(Finished(1, written(status="up-to-date")))
    log.on_event(Finished(2, failed()))
    log.on_event(Finished(3, written(warnings=("half\n::gone",))))
    assert stream.getvalue().splitlines() == [
        f"[1/4] {long}: msal, largest move 0.44 mean edge lengths, 2 flipped faces, "
        "1 outlier vertex brought back, 0.95 s",
        "[3/4] bad.ply: failed: vertex 17: position is not finite (E_NONFINITE)",
        "[4/4] odd.ply: msal, largest move 0.44 mean edge lengths, 0.95 s; warning: half\\n::gone",
    ]


def test_a_log_of_many_files_has_a_line_every_few_seconds(monkeypatch):
    monkeypatch.setattr(progress, "_MAX_LINES", 2)
    stream, log = logged(monkeypatch, ["a", "b", "c", "d"])
    log.on_event(Finished(0, written()))
    log.on_event(Finished(1, failed()))
    assert stream.getvalue() == ""
    monkeypatch.setattr(progress, "_LOG_EVERY_S", 0.0)
    log.on_event(Finished(2, written()))
    assert re.fullmatch(r"\[3/4\] 1 failed; about \S+ s left\n", stream.getvalue())


def test_a_line_on_one_mesh(monkeypatch):
    stream = on_a_terminal(monkeypatch)
    line = progress.bar(tasks("scan\x1b.ply"), quiet=False)
    line.on_event(Started(0))
    for event, text in (
        (("read", 0, 1), "read"),
        (("choose", 0, 1), "choose"),
        (("choose", 3, 12), "choose 3 of 12"),
        (("sweeps", 4, 4), "sweeps 4 of 4"),
        (("measure", 0, 1), "measure"),
    ):
        line.on_event(Progress(0, *event))
        assert frames(stream)[-1] == f"scan\\x1b.ply: {text}"
    line.on_event(Finished(0, written()))
    line.close()
