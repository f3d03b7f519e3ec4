"""The published schemas are current, described in full, and fit every record."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from msal_cli.job.info_record import InfoRecord
from msal_cli.job.records import MeshRecord
from msal_cli.report import json_report as as_json
from msal_cli.report.document import plain_record
from tests.report.made import RUN, failed, of, written
from tests.report.schemas import DOCS, info_schema, load, report_schema

REPORT = Draft202012Validator(report_schema())
INFO = Draft202012Validator(info_schema())
SCHEMAS = ("report.schema.json", "info.schema.json", "compare.schema.json")


def test_the_committed_schemas_are_current(tmp_path):
    subprocess.run([sys.executable, DOCS / "make_schemas.py", tmp_path], check=True)
    for name in SCHEMAS:
        assert (DOCS / name).read_bytes() == (tmp_path / name).read_bytes(), "run docs/refresh.py"


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_schemas_are_schemas(name):
    Draft202012Validator.check_schema(load(name))


@settings(max_examples=40, deadline=None)
@given(st.lists(of(MeshRecord), max_size=2))
def test_every_report_fits(records):
    REPORT.validate(json.loads(as_json.render(RUN, records)))


@settings(max_examples=40, deadline=None)
@given(of(InfoRecord))
def test_every_info_fits(record):
    data = {"schema": "msal.info/1", "version": "1", "records": [plain_record(record)]}
    INFO.validate(data)


def test_every_line_fits_the_part_for_records():
    for line in as_json.render_lines(RUN, [written(), failed()]).splitlines():
        validator = Draft202012Validator(
            {"$ref": "#/$defs/MeshRecord", "$defs": report_schema()["$defs"]}
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
    data = json.loads(as_json.render(RUN, [written()]))
    REPORT.validate(data)
    spoil(data)
    assert not REPORT.is_valid(data)
