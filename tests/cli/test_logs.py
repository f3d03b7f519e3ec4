"""The log: warnings to people, traces only on demand, all of it to a file."""

from __future__ import annotations

import logging
import subprocess
import sys

import pytest

from msal_cli.cli import logs
from msal_cli.errors import UsageError
from tests.report.made import HOSTILE_NAMES

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
    with logs.log_to_console(verbosity):
        speak()
    said = capsys.readouterr().err.splitlines()
    assert len(said) == len(heard)
    assert all(word in line for word, line in zip(heard, said, strict=True))


def test_everything_goes_to_the_file(tmp_path, capsys):
    path = tmp_path / "msal.log"
    for _ in range(2):
        with logs.log_to_console(-1, str(path)):
            speak()
    lines = path.read_text().splitlines()
    assert len(lines) == 8
    assert "msal.batch: detail" in lines[0]
    assert capsys.readouterr().err == ""


def test_names_that_are_no_text_go_to_the_file(tmp_path):
    # In a process of its own: what pytest captures may have to travel, which a surrogate cannot.
    path = tmp_path / "msal.log"
    code = (
        "import logging, sys; from msal_cli.cli import logs\n"
        "with logs.log_to_console(-1, sys.argv[1]):\n"
        "    logging.getLogger('msal.batch').warning('name a\\udcff')"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=True)
    assert "name a\\xff\n" in path.read_text()


@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_a_name_is_no_entry_and_no_escape(tmp_path, capsys, name):
    path = tmp_path / "msal.log"
    with logs.log_to_console(1, str(path)):
        logging.getLogger("msal.denoise").info("%s: written", name)
        try:
            raise ValueError(name)
        except ValueError:
            logging.getLogger("msal.denoise").exception("defect at %r", name)
    said = capsys.readouterr().err
    assert said.count("msal: info: ") == said.count("msal: error: ") == 1
    for text in (path.read_text(), said):
        assert "\x1b" not in text and "\u202e" not in text and "\r" not in text
        assert not any(line.lstrip().startswith(("::", "##")) for line in text.splitlines())


def test_an_unexpected_exception_is_traced_there_only(tmp_path, capsys):
    path = tmp_path / "msal.log"
    with pytest.raises(ZeroDivisionError), logs.log_to_console(0, str(path)):
        1 / 0  # noqa: B018
    assert "ZeroDivisionError: division by zero" in path.read_text()
    assert capsys.readouterr().err == ""


def test_an_error_of_ours_is_not_traced(tmp_path):
    path = tmp_path / "msal.log"
    with pytest.raises(UsageError), logs.log_to_console(0, str(path)):
        raise UsageError("x")
    assert path.read_text() == ""


def test_handlers_do_not_pile_up():
    before = list(logs.logger.handlers)
    with logs.log_to_console(0):
        assert len(logs.logger.handlers) == len(before) + 1
    assert logs.logger.handlers == before


def test_a_log_file_that_cannot_be_opened(tmp_path):
    with pytest.raises(UsageError, match="log file"), logs.log_to_console(0, str(tmp_path)):
        pytest.fail("the block must not run")
