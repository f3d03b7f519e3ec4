"""JUnit: a suite for a folder, a case for a file, and a form that Ant and Jenkins both know."""

from __future__ import annotations

import re
from xml.etree import ElementTree as Xml

import pytest
from hypothesis import given

from msal_cli.job.records import Failure
from msal_cli.report import junit as as_junit
from tests.report.made import HOSTILE_NAMES, RECORDS, RUN, failed, written

# What fits the schemas of Ant (JUnit.xsd) and of Jenkins (junit-10.xsd) alike: the attributes of
# each element, all of which are there, and the children in their order.
TOKEN, TEXT = r".+", r"[\s\S]*"
NUMBER, DECIMAL = r"\d+", r"\d+(\.\d+)?"
ATTRIBUTES = {
    "testsuites": {},
    "testsuite": {
        "id": NUMBER,
        "package": TOKEN,
        "name": TOKEN,
        "timestamp": r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d",
        "hostname": TOKEN,
        "tests": NUMBER,
        "failures": NUMBER,
        "errors": NUMBER,
        "skipped": NUMBER,
        "time": DECIMAL,
    },
    "properties": {},
    "property": {"name": TOKEN, "value": TEXT},
    "testcase": {"name": TOKEN, "classname": TOKEN, "time": DECIMAL},
    "error": {"type": TEXT, "message": TEXT},
    "failure": {"type": TEXT, "message": TEXT},
    "skipped": {},
    "system-out": {},
    "system-err": {},
}
CHILDREN = {
    "testsuites": "(testsuite )*",
    "testsuite": "properties (testcase )*system-out system-err ",
    "properties": "(property )*",
    "testcase": "(error |failure |skipped )?",
}


def parsed(records):
    root = Xml.fromstring(as_junit.render(RUN, records))
    for one in root.iter():
        assert set(one.attrib) == set(ATTRIBUTES[one.tag])
        for name, value in one.attrib.items():
            assert re.fullmatch(ATTRIBUTES[one.tag][name], value), (one.tag, name, value)
        inside = "".join(f"{child.tag} " for child in one)
        assert re.fullmatch(CHILDREN.get(one.tag, ""), inside), (one.tag, inside)
    for suite in root:
        cases = suite.findall("testcase")
        assert int(suite.get("tests")) == len(cases)
        for word, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            assert int(suite.get(word)) == sum(case.find(tag) is not None for case in cases)
    return root


@given(RECORDS)
def test_any_records_keep_to_the_schemas(records):
    root = parsed(records)
    assert len(root.findall(".//testcase")) == len(records)


@pytest.mark.parametrize(
    "name", [*HOSTILE_NAMES, "\x00\x0b\ufffe\uffff.ply", "\udcff.ply", " .ply"]
)
def test_names_stay_data(name):
    record = failed(name, error=Failure("E_X", name, name, name), warnings=(name,))
    (suite,) = parsed([record, written(name, warnings=(name,))])
    assert {one.tag for one in suite.iter()} <= set(ATTRIBUTES)
    assert len(suite.findall("testcase")) == 2
    if name.isprintable() and not name.lstrip().startswith("::") and "##" not in name:
        assert suite.find("testcase").get("name") == name
        assert name in suite.find("testcase/error").text
