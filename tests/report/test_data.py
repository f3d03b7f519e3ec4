"""JSON, JSON Lines and CSV: strict, complete, and as the published schemas say."""

import csv
import io
import json

import numpy as np
import pytest
from hypothesis import given
from jsonschema import Draft202012Validator

from msal_cli.errors import FormatError
from msal_cli.job.display_names import restore_name
from msal_cli.job.records import Volume
from msal_cli.report.data import plain, read_json, read_lines, render_csv, render_json, render_lines
from msal_cli.report.facts import totals
from tests.report.made import RECORDS, RUN, failed, load_schema, written

REPORT = Draft202012Validator(load_schema("report"))


def test_the_volume_spread_is_over_valid_volumes_only():
    def volume(percent, valid=True):
        return Volume(1.0, 1.0, 0.0, percent, valid, "" if valid else "open")

    changes = [-3.0, 1.0, -0.5]
    records = [written(str(change), volume=volume(change)) for change in changes]
    records.append(written("open", volume=volume(-99.0, valid=False)))
    records.append(written("flat", volume=volume(None)))
    spread = totals(records).volume_change_percent
    assert (spread.files, spread.lowest, spread.median, spread.highest) == (3, -3.0, -0.5, 1.0)
    assert totals([failed()]).volume_change_percent is None


def test_plain_data():
    made = plain(
        {"a": float("nan"), "b": (1, float("-inf")), "c": "x\udcff", "d": True, 3: None}
        | {"n": np.float64(1.5), "i": np.int32(7), "t": np.bool_(True), "z": np.float32("nan")}
    )
    assert made == {"a": None, "b": [1, None], "c": "x\\udcff", "d": True, "3": None} | {
        "n": 1.5, "i": 7, "t": True, "z": None,
    }  # fmt: skip
    assert {type(made["n"]), type(made["i"]), type(made["t"])} == {float, int, bool}
    with pytest.raises(TypeError, match="object"):
        plain([object()])


# JSON


def parse_strict(data):
    def refuse(token):
        raise AssertionError(f"{token} is not JSON")

    return json.loads(data.decode("utf-8"), parse_constant=refuse)


@given(RECORDS)
def test_any_records_make_json_of_the_schema_and_one_ascii_line_each(records):
    made = parse_strict(render_json(RUN, records))
    REPORT.validate(made)
    assert [restore_name(row["input"]) for row in made["records"]] == [
        record.input for record in records
    ]
    data = render_lines(RUN, records)
    assert data.isascii()
    *lines, last = data.split(b"\n")
    assert last == b""
    assert list(map(parse_strict, lines)) == made["records"]


def test_records_come_back():
    records = [written(), failed()]
    assert read_lines(render_lines(RUN, records), "r.jsonl") == records
    assert read_json(render_json(RUN, records), "r.json") == (RUN, records)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda data: data.update(schema="msal.report/2"), "missing or unsupported schema"),
        (lambda data: data.update(records=3), "no list of records"),
        (lambda data: data["records"][0].update(status="fine"), "status: it is none of"),
        (lambda data: data["records"][0].update(status="failed"), "it is no record"),
        (lambda data: data["records"][0].update(vertices="many"), "vertices: it is str, not int"),
        (lambda data: data["records"][0]["volume"].pop("valid"), "valid"),
        (lambda data: data["records"][0].update(error={"code": "E_X"}), "message"),
    ],
)
def test_a_spoilt_report_is_refused_and_does_not_fit_the_schema(spoil, reason):
    data = json.loads(render_json(RUN, [written()]))
    REPORT.validate(data)
    spoil(data)
    assert not REPORT.is_valid(data) or reason == "it is no record"
    with pytest.raises(FormatError, match=reason):
        read_json(json.dumps(data).encode(), "r.json")


@pytest.mark.parametrize("name", ["report", "info", "compare"])
def test_the_schemas_are_schemas(name):
    Draft202012Validator.check_schema(load_schema(name))


# CSV


@given(RECORDS)
def test_any_records_can_be_read_back_and_no_text_begins_like_a_formula(records):
    text = render_csv(RUN, records, has_all=True).decode("utf-8")
    names, *table = csv.reader(io.StringIO(text, newline=""), strict=True)
    assert len(table) == len(records)
    assert {len(row) for row in table} <= {len(names)}
    at = names.index("input")
    assert [restore_name(row[at].removeprefix("'")) for row in table] == [
        record.input for record in records
    ]
    for cell in (cell for row in table for cell in row):
        assert cell[:1] not in ("=", "+", "@", "\t", "\r", "\n")
        if cell[:1] == "-":
            float(cell)
