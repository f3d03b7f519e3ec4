"""Words go to standard error, data to standard output, colours only where they are wanted."""

from __future__ import annotations

import io
import sys

import pytest

from msal_cli.cli import console as talk
from msal_cli.errors import ContentError, OutputError, UsageError
from msal_cli.job.records import Failure
from msal_cli.report.facts import Line


class Terminal(io.StringIO):
    def isatty(self):
        return True


def put_on_a_terminal(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return stream


def test_colours_on_a_terminal(monkeypatch):
    terminal = put_on_a_terminal(monkeypatch)
    talk.say("bad news", "bad")
    assert terminal.getvalue() == "\x1b[31mbad news\x1b[0m\n"


@pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("TERM", "dumb")])
def test_no_colours_where_they_are_not_wanted(monkeypatch, name, value):
    terminal = put_on_a_terminal(monkeypatch)
    monkeypatch.setenv(name, value)
    talk.say_lines([Line("bad news", "bad")])
    assert terminal.getvalue() == "bad news\n"


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


def test_a_usage_error_needs_no_code_and_no_name_twice(capsys):
    talk.say_error(UsageError("there is no file 'a.ply'", path="a.ply"))
    assert capsys.readouterr().err == "msal: error: there is no file 'a.ply'\n"


def test_the_failure_of_a_stream(capsys):
    talk.say_failure("-", Failure("E_FORMAT", "it is no mesh"))
    assert capsys.readouterr().err == "msal: error: standard input: it is no mesh (E_FORMAT)\n"


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


def test_a_full_disk_behind_standard_output(monkeypatch):
    class Full(io.BytesIO):
        def write(self, data):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(Full()))
    with pytest.raises(OutputError, match="No space left"):
        talk.put_bytes(b"x")


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


def test_a_terminal_that_is_gone_is_no_error(monkeypatch):
    class Gone(io.StringIO):
        def write(self, text):
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(sys, "stderr", Gone())
    talk.say("nobody hears")
