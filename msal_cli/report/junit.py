"""The JUnit report: XML that build services show as tests.

A suite is a folder, a case is a file, a broken gate is a failure, a file that failed is an error,
and one that was not dealt with is skipped.  The document keeps to the schemas of Ant and of Jenkins
alike: every attribute that either demands is there, and none that either does not know.

XML 1.0 has no way to write most control characters.  In names and reasons they are written as
``\\xNN`` or ``\\uNNNN``, as on a terminal.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from typing import Any
from xml.etree import ElementTree as Xml

from msal_cli.job.display_names import escape_for_display
from msal_cli.job.records import DONE, MeshRecord
from msal_cli.report.document import Run, plain
from msal_cli.report.phrases import (
    defects_text,
    despiked_text,
    failure_text,
    failure_texts,
    percent_text,
    vertices_text,
)
from msal_cli.report.ranking import broken_gates

# Half of a pair, and two code points that are no characters: all that is left for XML to refuse.
_NO_CHARACTER = re.compile("[\ud800-\udfff\ufffe\uffff]")

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
    suite = _element(
        "testsuite",
        id=str(at),
        package="msal",
        name=folder,
        # Ant's schema knows neither fractions nor time zones.
        timestamp=_timestamp(run.started),
        hostname="localhost",
        tests=str(len(cases)),
        failures=_count(cases, "failure"),
        errors=_count(cases, "error"),
        skipped=_count(cases, "skipped"),
        time=_seconds(sum(_duration(record) for record in records)),
    )
    properties = Xml.SubElement(suite, "properties")
    for name, value in _properties(run):
        properties.append(_element("property", name=name, value=value))
    suite.extend(cases)
    Xml.SubElement(suite, "system-out").text = _characters(
        "\n".join(line for record in records for line in _figures(record))
    )
    Xml.SubElement(suite, "system-err").text = _characters(
        "\n".join(
            f"{_name(record)}: {escape_for_display(warning)}"
            for record in records
            for warning in record.warnings
        )
    )
    return suite


def _case(folder: str, record: MeshRecord) -> Xml.Element:
    case = _element(
        "testcase", name=_name(record), classname=folder, time=_seconds(_duration(record))
    )
    broken = broken_gates(record)
    if record.error is not None:
        failure = record.error
        why = failure_text(failure, with_code=False)
        result = _element("error", type=failure.code, message=why)
        result.text = _characters(
            "\n".join(failure_texts(escape_for_display(record.input), failure))
        )
        case.append(result)
    elif broken:
        # Ant's schema has room for one failure in a case.
        result = _element(
            "failure", type="gate", message="; ".join(map(escape_for_display, broken))
        )
        result.text = _characters(
            "\n".join([f"{escape_for_display(record.input)}:", *map(escape_for_display, broken)])
        )
        case.append(result)
    elif record.status == "planned":
        case.append(_element("skipped"))
    return case


def _properties(run: Run) -> Iterator[tuple[str, str]]:
    yield "msal.version", run.version
    yield "msal.command", " ".join(run.command)
    yield from _flat("msal.settings", run.settings)


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}", inner)
    elif value is not None and value != ():
        # Words that a build service knows: true, and not True.
        yield name, value if isinstance(value, str) else json.dumps(plain(value))


def _figures(record: MeshRecord) -> Iterator[str]:
    """One line with the figures of a file; none if there are none."""
    moved, volume, choice = record.displacement, record.volume, record.choice
    far = "" if moved is None else f"{moved.mean_edges:.3g} (most {moved.max_edges:.3g})"
    parts = (
        vertices_text(record.vertices, record.corners) if record.vertices is not None else "",
        f"moved {far} mean edge lengths" if far else "",
        f"volume {percent_text(volume.change_percent)}" if volume and volume.valid else "",
        despiked_text(record.despiked) if record.despiked else "",
        f"chosen: {escape_for_display(choice.reason)}" if choice else "",
        defects_text(record),
    )
    if any(parts):
        yield f"{_name(record)}: {record.status}, {', '.join(filter(None, parts))}"


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
    return _NO_CHARACTER.sub(lambda one: f"\\u{ord(one[0]):04x}", text)


def _count(cases: Sequence[Xml.Element], tag: str) -> str:
    return str(sum(case.find(tag) is not None for case in cases))


def _duration(record: MeshRecord) -> float:
    is_done = record.seconds is not None and record.status in DONE
    return max(0.0, record.seconds.total) if is_done and record.seconds else 0.0


def _seconds(seconds: float) -> str:
    return f"{min(seconds, 1e9):.3f}"


def _timestamp(text: str) -> str:
    """A time to the second; a report that does not know when it was made gives the beginning."""
    found = re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", text)
    return found[0] if found else "1970-01-01T00:00:00"
