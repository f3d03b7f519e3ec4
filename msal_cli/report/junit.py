"""The JUnit report: XML that build services show as tests.

A suite is a folder, a case is a file, a broken gate is a failure, a file that failed is an error,
and one that was not dealt with is skipped.  The document keeps to the schemas of Ant and of Jenkins
alike: every attribute that either demands is there, and none that either does not know.

XML 1.0 has no way to write most control characters.  In names and reasons they are written as
``\\xNN`` or ``\\uNNNN``, as on a terminal.
"""

import os
import re
import shlex
from collections.abc import Sequence
from xml.etree import ElementTree as Xml

from msal_cli.job.display_names import escape_for_display
from msal_cli.job.records import DONE, MeshRecord
from msal_cli.report import facts
from msal_cli.report.data import Run

# Half of a pair, and two code points that are no characters: all that is left for XML to refuse.
_NO_CHARACTERS = re.compile("[\ud800-\udfff\ufffe\uffff]")

_TOP = "."
_STREAM = "standard input"


def render(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The records as JUnit XML in UTF-8; folders in the order in which the inputs name them."""
    folders: dict[str, list[MeshRecord]] = {}
    for record in records:
        folders.setdefault(_folder(record.input), []).append(record)
    root = Xml.Element("testsuites")
    for at, (folder, inside) in enumerate(folders.items()):
        root.append(_suite(run, at, folder, inside))
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _suite(run: Run, at: int, folder: str, records: Sequence[MeshRecord]) -> Xml.Element:
    cases = [_case(folder, record) for record in records]
    # Ant's schema knows neither fractions nor time zones.
    started = re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", run.started)
    suite = _element(
        "testsuite",
        id=str(at),
        package="msal",
        name=folder,
        timestamp=started[0] if started else "1970-01-01T00:00:00",
        hostname="localhost",
        tests=str(len(cases)),
        failures=str(sum(case.find("failure") is not None for case in cases)),
        errors=str(sum(case.find("error") is not None for case in cases)),
        skipped=str(sum(case.find("skipped") is not None for case in cases)),
        time=_seconds(sum(_duration(record) for record in records)),
    )
    properties = Xml.SubElement(suite, "properties")
    properties_of_run = (
        ("msal.version", run.version),
        ("msal.command", shlex.join(run.command)),
        *((f"msal.settings.{name}", text) for name, text in facts.setting_texts(run.settings)),
    )
    for name, value in properties_of_run:
        properties.append(_element("property", name=name, value=value))
    suite.extend(cases)
    texts, warnings = [], []
    for record in records:
        parts = [
            f"{fact.word}: {fact.text}"
            for fact in facts.list_facts(record)
            if fact.level == facts.SHORT
        ]
        if parts and record.error is None:
            texts.append(f"{_name(record)}: {record.status}; {'; '.join(parts)}")
        warnings += [f"{_name(record)}: {escape_for_display(text)}" for text in record.warnings]
    Xml.SubElement(suite, "system-out").text = _characters("\n".join(texts))
    Xml.SubElement(suite, "system-err").text = _characters("\n".join(warnings))
    return suite


def _case(folder: str, record: MeshRecord) -> Xml.Element:
    case = _element(
        "testcase", name=_name(record), classname=folder, time=_seconds(_duration(record))
    )
    why = "\n".join(map(escape_for_display, facts.problem_texts(record)))
    if record.error is not None:
        message = facts.failure_text(record.error, with_code=False)
        case.append(_element("error", type=record.error.code, message=message))
    elif why:
        # Ant's schema has room for one failure in a case.
        broken = "; ".join(map(facts.gate_values, facts.list_broken(record)))
        case.append(_element("failure", type="gate", message=broken))
    elif record.status == "planned":
        case.append(_element("skipped"))
    if why:
        case[0].text = _characters(why)
    return case


def _folder(name: str) -> str:
    if name == "-":
        return _STREAM
    return escape_for_display(os.path.dirname(name)) or _TOP


def _name(record: MeshRecord) -> str:
    name = record.input
    return _STREAM if name == "-" else escape_for_display(os.path.basename(name)) or _TOP


def _element(tag: str, **attributes: str) -> Xml.Element:
    return Xml.Element(
        tag, {name: _characters(escape_for_display(v)) for name, v in attributes.items()}
    )


def _characters(text: str) -> str:
    """``text`` without what XML 1.0 has no place for."""
    return _NO_CHARACTERS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def _duration(record: MeshRecord) -> float:
    if record.seconds is None or record.status not in DONE:
        return 0.0
    return max(0.0, record.seconds.total)


def _seconds(seconds: float) -> str:
    return f"{min(seconds, 1e9):.3f}"
