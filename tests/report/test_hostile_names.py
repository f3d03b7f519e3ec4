"""Names of files stay data in every report and on every screen."""

from __future__ import annotations

import csv
import io
import json
import unicodedata

import pytest

from msal_cli.job.display_names import restore_name
from msal_cli.job.records import MeshRecord
from msal_cli.report import (
    csv_report as as_csv,
)
from msal_cli.report import (
    json_report as as_json,
)
from msal_cli.report import (
    text as as_text,
)
from tests.report.made import HOSTILE_NAMES, RUN, failed, written

RECORDS = tuple(make(name) for name in HOSTILE_NAMES for make in (written, failed))


def test_there_are_enough_names():
    assert len(set(HOSTILE_NAMES)) == len(HOSTILE_NAMES) >= 15


@pytest.mark.parametrize("records", [RECORDS, *((one,) for one in RECORDS)])
def test_the_terminal_and_the_log_obey_nothing(records):
    lines = as_text.summary(RUN, records, width=200, verbose=True)
    assert len(lines) >= len(records)
    for line in lines:
        for one in line.text:
            assert unicodedata.category(one) not in ("Cc", "Cf", "Cs", "Zl", "Zp"), line
        # Robots that read logs take a command only at the beginning of a line.
        assert not line.text.lstrip().startswith(("::", "##")), line


@pytest.mark.parametrize("record", RECORDS, ids=lambda one: f"{one.status}-{one.input!r}")
def test_a_cell_is_no_formula_and_comes_back(record):
    (row,) = csv.DictReader(io.StringIO(as_csv.render(RUN, [record]).decode(), newline=""))
    assert not row["input"].startswith(("=", "+", "-", "@", "\t", "\r", "\n"))
    assert restore_name(row["input"].removeprefix("'")) == record.input


def test_json_is_strict_and_gives_the_names_back():
    document = json.loads(as_json.render(RUN, RECORDS))
    told = [restore_name(one["input"]) for one in document["records"]]
    assert told == [one.input for one in RECORDS]
    lines = as_json.encoded_lines(RUN, RECORDS)
    assert lines.isascii() and b"\x1b" not in lines
    assert len(lines.splitlines()) == len(lines.decode().splitlines()) == len(RECORDS)
    told = [restore_name(json.loads(line)["input"]) for line in lines.splitlines()]
    assert told == [one.input for one in RECORDS]


def test_json_on_a_terminal_holds_no_escape():
    printed = as_json.render(RUN, RECORDS)
    assert b"\x1b" not in printed and b"\r" not in printed and b"\x07" not in printed


def test_what_a_record_says_beside_its_name_is_data_too():
    for name in HOSTILE_NAMES:
        record = MeshRecord(name, "written", f"out/{name}", warnings=(name,), sidecars=(name,))
        for line in as_text.summary(RUN, [record], verbose=True):
            assert "\x1b" not in line.text and "\n" not in line.text and "\u202e" not in line.text
