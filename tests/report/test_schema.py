"""The published schemas are current, described in full, and fit every record."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from msal_cli.job.records import ComparisonRecord, InfoRecord, MeshRecord
from msal_cli.report import json_report as as_json
from msal_cli.report import jsonl as as_jsonl
from msal_cli.report import schema
from msal_cli.report.document import plain_record
from tests.report.made import RUN, failed, of, written

DOCS = Path(__file__).parents[2] / "docs"
REPORT = Draft202012Validator(schema.report_schema())
INFO = Draft202012Validator(schema.info_schema())


@pytest.mark.parametrize("name", schema.SCHEMAS)
def test_the_committed_schema_is_current(name):
    made = as_json.json_bytes(schema.SCHEMAS[name]())
    assert (DOCS / name).read_bytes() == made, "run: python -m msal_cli.report.schema docs"


@pytest.mark.parametrize("make", schema.SCHEMAS.values())
def test_the_schemas_are_schemas(make):
    Draft202012Validator.check_schema(make())


@settings(max_examples=40, deadline=None)
@given(st.lists(of(MeshRecord), max_size=2))
def test_every_report_fits(records):
    REPORT.validate(json.loads(as_json.encoded(RUN, records)))


@settings(max_examples=40, deadline=None)
@given(of(InfoRecord))
def test_every_info_fits(record):
    data = {"schema": "msal.info/1", "version": "1", "records": [plain_record(record)]}
    INFO.validate(data)


def test_every_line_fits_the_part_for_records():
    for line in as_jsonl.encoded(RUN, [written(), failed()]).splitlines():
        validator = Draft202012Validator(
            {"$ref": "#/$defs/MeshRecord", "$defs": schema.report_schema()["$defs"]}
        )
        validator.validate(json.loads(line))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data.pop("totals"),
        lambda data: data.update(schema="msal.report/2"),
        lambda data: data["records"][0].update(status="fine"),
        lambda data: data["records"][0].update(vertices="many"),
        lambda data: data["records"][0]["volume"].pop("valid"),
        lambda data: data["records"][0].update(error={"code": "E_X"}),
    ],
)
def test_a_spoilt_report_does_not_fit(spoil):
    data = json.loads(as_json.encoded(RUN, [written()]))
    REPORT.validate(data)
    spoil(data)
    assert not REPORT.is_valid(data)


def test_every_field_has_a_description_and_no_description_is_left_over():
    used = set()
    for kind in (MeshRecord, InfoRecord, ComparisonRecord):
        for one in dataclasses.fields(kind):
            own = f"{kind.__name__}.{one.name}"
            used.add(own if own in schema.DESCRIPTIONS else f"MeshRecord.{one.name}")
    for made in (make() for make in schema.SCHEMAS.values()):
        for name, kind in made["$defs"].items():
            assert kind["description"]
            for field, typed in kind["properties"].items():
                assert typed["description"].strip(), f"{name}.{field}"
                used.add(f"{name}.{field}")
        for field, typed in made["properties"].items():
            assert typed["description"].strip(), field
            used.add(f"Run.{field}")
    assert set(schema.DESCRIPTIONS) <= used


def test_the_schemas_can_be_written_anew(tmp_path):
    schema.main(str(tmp_path))
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted(schema.SCHEMAS)
