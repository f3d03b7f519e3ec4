"""Words go to standard error, data to standard output, all to the log; bars; exit statuses."""

import io
import itertools
import logging
import re
import sys

import pytest

from msal_cli.batch.schedule import Finished, Progress, Started
from msal_cli.cli import console, progress
from msal_cli.cli import console as talk
from msal_cli.errors import ContentError, OutputError
from msal_cli.job.settings import Task
from msal_cli.report.facts import Line
from tests.cli.scans import BAD_SCAN, msal
from tests.files import Terminal
from tests.report.made import HOSTILE_NAMES, failed, written


@pytest.mark.parametrize("name", ["", "NO_COLOR", "TERM"])
def test_colours_on_a_terminal_unless_they_are_not_wanted(monkeypatch, name):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "dumb" if name == "TERM" else "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    if name == "NO_COLOR":
        monkeypatch.setenv(name, "1")
    talk.say_lines([Line("bad news", "bad")])
    assert terminal.getvalue() == ("bad news\n" if name else "\x1b[31mbad news\x1b[0m\n")


def test_an_error_in_words(capsys):
    talk.say_error(
        ContentError(
            "position is not finite",
            where="vertex 17",
            hint="repair\nit",
            path="a\x1b.ply",
            code="E_NONFINITE",
        )
    )
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == (
        "msal: error: a\\x1b.ply: vertex 17: position is not finite (E_NONFINITE)\n"
        "hint: repair\\nit\n"
    )


def test_what_the_encoding_lacks_is_escaped(monkeypatch):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    talk.put("τ = K\n")
    talk.flush()
    assert raw.getvalue() == b"\\u03c4 = K\n"


def test_streams_that_are_closed(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    talk.say("nobody hears")
    talk.flush()
    with pytest.raises(OutputError, match="standard output is closed"):
        talk.put("x")
    with pytest.raises(OutputError, match="standard output is closed"):
        talk.put_bytes(b"x")
    assert not talk.is_terminal(sys.stderr)


@pytest.mark.parametrize("sizes", [[3], [1, 2, 3], [2, None, 2]])
def test_a_stream_that_takes_only_a_part_gets_the_rest(monkeypatch, sizes):
    taken, waiting = bytearray(), list(sizes)

    class Narrow(io.BytesIO):
        def write(self, data):
            size = waiting.pop(0) if waiting else 4
            taken.extend(data[: size or 0])
            return size and min(size, len(data))

    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(Narrow(), write_through=True))
    talk.put_bytes(b"0123456789")
    assert taken == b"0123456789"


@pytest.mark.parametrize(
    ("n_files", "n_failed", "gate", "status"),
    [(1, 0, False, 0), (3, 0, True, 4), (1, 1, False, 1), (3, 3, True, 1), (3, 1, True, 3)]
    + [(3, 2, False, 3), (0, 0, False, 0)],
)
def test_of_files(n_files, n_failed, gate, status):
    assert console.status_of_files(n_files, n_failed, is_gate_failed=gate) == status


def test_the_worst_wins():
    ranking = [130, 1, 3, 4, 0]
    for first, second in itertools.combinations_with_replacement(ranking, 2):
        assert console.worst_status(first, second) == first
        assert console.worst_status(second, first) == first
    assert console.worst_status(2, 1) == console.worst_status(1, 2) == 2
    assert console.worst_status(143, 130) == 143


LOG = logging.getLogger("msal.batch")


def speak():
    LOG.debug("detail")
    LOG.info("step")
    LOG.warning("careful")
    LOG.error("Traceback (most recent call last): in a worker")


@pytest.mark.parametrize(
    ("verbosity", "heard"),
    [(-1, []), (0, ["careful"]), (1, ["step", "careful", "Traceback"])]
    + [(2, ["detail", "step", "careful", "Traceback"])],
)
def test_what_is_said(capsys, verbosity, heard):
    with console.log_to_console(verbosity):
        speak()
    said = capsys.readouterr().err.splitlines()
    assert len(said) == len(heard)
    assert all(word in line for word, line in zip(heard, said, strict=True))


def test_an_exception_is_traced_with_v_only(capsys):
    for verbosity in (0, 2):
        with pytest.raises(ZeroDivisionError), console.log_to_console(verbosity):
            1 / 0  # noqa: B018
    said = capsys.readouterr().err
    assert said.count("ZeroDivisionError: division by zero") == 1
    assert re.match(r"\d{4}-\d\d-\d\d \S+ msal: error: internal error\n", said)


@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_a_name_is_no_entry_and_no_escape(capsys, name):
    with console.log_to_console(1):
        logging.getLogger("msal.denoise").info("%s: written", name)
        try:
            raise ValueError(name)
        except ValueError:
            logging.getLogger("msal.denoise").exception("defect at %r", name)
    said = capsys.readouterr().err
    assert said.count("msal: info: ") == said.count("msal: error: ") == 1
    assert "\x1b" not in said and "\u202e" not in said and "\r" not in said
    assert not any(line.lstrip().startswith(("::", "##")) for line in said.splitlines())


def test_a_run_marks_its_failures_once(tmp_path, monkeypatch):
    (tmp_path / "scans").mkdir()
    monkeypatch.chdir(tmp_path / "scans")
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path))
    (tmp_path / "scans" / "bad.ply").write_bytes(BAD_SCAN)
    made = msal("denoise", "bad.ply", "-o", tmp_path / "out.ply", "-q")
    assert made.stderr.count("\n::error file=scans/bad.ply,") == 1


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


def test_a_log_has_a_line_for_each_file_as_it_finishes_with_its_whole_name(monkeypatch, caplog):
    long = "folder/" * 30 + "scan.ply"
    stream, log = logged(monkeypatch, [long, "old.ply", "bad.ply", "-v.ply", "odd.ply"])
    log.on_event(Finished(0, written(flipped_faces=2, despiked=1)))
    log.on_event(Finished(1, written(status="up-to-date")))
    log.on_event(Finished(2, failed()))
    with caplog.at_level("INFO", "msal"):
        log.on_event(Finished(3, written()))
    log.on_event(Finished(4, written(warnings=("half\n::gone",))))
    assert stream.getvalue().splitlines() == [
        f"[1/5] {long}: msal; moved mean 0.11, most 0.44 mean edge lengths; volume -0.266 %; "
        "2 flipped faces; 1 outlier vertex brought back; 0.95 s",
        "[3/5] bad.ply: failed: vertex 17: position is not finite (E_NONFINITE)",
        "[5/5] odd.ply: msal; moved mean 0.11, most 0.44 mean edge lengths; volume -0.266 %; "
        "warning: half\\n::gone; 0.95 s",
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
