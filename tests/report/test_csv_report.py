"""CSV: one row per file that any reader of RFC 4180 takes, and no formula in it."""

from __future__ import annotations

import csv
import io

from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.job.display_names import restore_name
from msal_cli.job.records import GateResult, MeshRecord, MethodUsed
from msal_cli.report import csv_report as as_csv
from tests.report.made import RUN, failed, of, written


def rows(records):
    text = raw(records).decode("utf-8")
    return list(csv.DictReader(io.StringIO(text, newline=""), strict=True))


def raw(records):
    return as_csv.render(RUN, records, has_all=True)


@settings(max_examples=40, deadline=None)
@given(st.lists(of(MeshRecord), max_size=4))
def test_any_records_can_be_read_back_and_no_text_begins_like_a_formula(records):
    text = raw(records).decode("utf-8")
    header, *table = csv.reader(io.StringIO(text, newline=""), strict=True)
    assert len(table) == len(records)
    assert {len(row) for row in table} <= {len(header)}
    at = header.index("input")
    assert [restore_name(row[at].removeprefix("'")) for row in table] == [
        one.input for one in records
    ]
    for cell in (cell for row in table for cell in row):
        assert cell[:1] not in ("=", "+", "@", "\t", "\r", "\n")
        if cell[:1] == "-":
            float(cell)


def test_an_apostrophe_in_front_is_told_from_ours():
    assert rows([written("'=a"), written("it's")])[0]["input"] == "''=a"
    assert rows([written("it's")])[0]["input"] == "it's"


def test_numbers_stay_numbers():
    row = rows([written()])[0]
    assert row["volume.change"] == "-0.0266"
    assert row["volume.valid"] == "true"
    assert row["vertices"] == "35947"
    assert row["method.parameters.K"] == "0.5"


def test_columns_are_those_of_the_record_with_sorted_parameters():
    header = raw([written()]).split(b"\r\n")[0].decode().split(",")
    assert header[:3] == ["input", "status", "output"]
    assert header[-4:] == ["error.code", "error.message", "error.hint", "error.where"]
    at = header.index("method.name")
    assert header[at + 1 : at + 3] == ["method.parameters.K", "method.parameters.iterations"]
    assert len(header) == len(set(header))
    assert header == raw([failed(method=written().method)]).split(b"\r\n")[0].decode().split(",")


def test_by_default_a_table_has_the_columns_that_people_use_and_no_hashes():
    text = as_csv.render(RUN, [written(border_marks=(12345678,)), failed()]).decode()
    header = text.split("\r\n")[0].split(",")
    every = raw([written(border_marks=(12345678,))]).decode()
    assert header == list(as_csv.COMMON)
    assert set(header) <= set(every.split("\r\n")[0].split(","))
    assert "border_marks" not in every and "12345678" not in every


def test_parameters_of_several_methods_stand_side_by_side():
    other = written("b", method=MethodUsed("al", {"time_step": 1.0}))
    first, second = rows([written("a"), other])
    assert first["method.parameters.time_step"] == ""
    assert second["method.parameters.time_step"] == "1.0"
    assert second["method.parameters.K"] == ""


def test_failures_and_what_is_unknown():
    row = rows([failed()])[0]
    assert row["error.code"] == "E_NONFINITE"
    assert row["vertices"] == row["volume.before"] == row["output"] == ""


def test_lines_end_as_the_standard_says_and_cells_are_quoted():
    data = raw([written('a,"b"\nc.ply', warnings=("one", "two"))])
    assert data.endswith(b"\r\n")
    assert b'"a,""b""\nc.ply"' in data
    assert rows([written(warnings=("one", "two"))])[0]["warnings"] == "one; two"


def test_gates_are_texts_in_one_cell():
    broken = GateResult("faces > 9", True, True, {"faces": 10.0}, "faces is 10")
    held = GateResult("-faces > 9", False, True, {"faces": 10.0}, "faces is 10")
    row = rows([written(gates=(broken, held))])[0]
    assert row["gates"] == "broken: faces > 9 (faces is 10); held: -faces > 9 (faces is 10)"
    assert rows([written()])[0]["gates"] == ""
