"""JSON and JSON Lines: strict, complete and deterministic."""

from __future__ import annotations

import json

from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.job.display_names import restore_name
from msal_cli.job.plain_data import from_data
from msal_cli.job.records import MeshRecord
from msal_cli.report import json_report as as_json
from tests.report.made import RUN, failed, of, written


def strict(data):
    def refuse(token):
        raise AssertionError(f"{token} is not JSON")

    return json.loads(data.decode("utf-8"), parse_constant=refuse)


@settings(max_examples=40, deadline=None)
@given(st.lists(of(MeshRecord), max_size=3))
def test_any_records_make_strict_json_and_one_ascii_line_each(records):
    made = strict(as_json.render(RUN, records))["records"]
    assert [restore_name(one["input"]) for one in made] == [record.input for record in records]
    data = as_json.render_lines(RUN, records)
    assert data.isascii()
    *lines, last = data.split(b"\n")
    assert last == b""
    assert [strict(line)["input"] for line in lines] == [one["input"] for one in made]


def test_a_record_comes_back_from_a_line():
    records = [written(), failed()]
    lines = as_json.render_lines(RUN, records).splitlines()
    assert [from_data(MeshRecord, strict(line)) for line in lines] == records


def test_the_document_tells_of_the_run():
    made = strict(as_json.render(RUN, [written(), failed()]))
    assert made["schema"] == "msal.report/1"
    assert made["command"] == ["msal", "denoise", "scans", "-o", "out"]
    assert made["settings"]["parameters"] == {"K": 0.5}
    assert made["totals"]["failed"] == 1
    assert made["records"][1]["error"]["where"] == "vertex 17"
    assert made["interrupted"] is False


def test_numbers_that_are_not_finite_are_null():
    made = strict(as_json.render(RUN, [written(seam_gap=float("nan"))]))
    assert made["records"][0]["seam_gap"] is None
