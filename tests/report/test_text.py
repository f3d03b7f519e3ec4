"""The summary for people: what is cut, what is never cut, and nothing that a terminal obeys."""

from __future__ import annotations

import dataclasses
import unicodedata

import pytest

from msal_cli.job.display_names import columns
from msal_cli.job.records import Failure, GateResult, InfoRecord, MeshRecord, Planned
from msal_cli.report import text as as_text
from msal_cli.report.info import describe_info
from tests.report.made import HOSTILE_NAMES, RUN, failed, written

BROKEN = GateResult("flipped_faces > 0", True, True, {}, "flipped_faces is 3")
PASSED = dataclasses.replace(BROKEN, broken=False)


def lines(*records, **options):
    return [line.text for line in as_text.summary(RUN, records, **options)]


@pytest.mark.parametrize(
    ("record", "line"),
    [
        (written(status="unchanged"), "scan.ply -> out/scan.ply in 0.95 s, byte for byte as it "
         "was: no vertex moved"),
        (written(status="up-to-date"), "out/scan.ply is up to date"),
        (MeshRecord("a", "planned", "b"), "a would be written to b"),
        (written(output="-", input="-"), "standard input -> standard output in 0.95 s"),
        (failed(), "bad.ply: vertex 17: position is not finite (E_NONFINITE)"),
    ],
)  # fmt: skip
def test_the_line_that_names_a_file(record, line):
    assert lines(record)[0] == line


@pytest.mark.parametrize("n_warnings", range(8))
def test_one_file_takes_at_most_eight_lines(n_warnings):
    warnings = tuple(f"warning {k}" for k in range(n_warnings))
    record = written(warnings=warnings, gates=(PASSED, BROKEN), sidecars=("copied a.mtl",))
    whole = lines(record, verbose=True)
    assert all(f"  warning       {warning}" in whole for warning in warnings)
    found = lines(record)
    assert "  gate          broken: flipped_faces > 0 (flipped_faces is 3)" in found
    n_facts = 6 + n_warnings
    if n_facts <= 7:
        assert len(found) == 1 + n_facts
    else:
        assert len(found) == as_text.MAX_LINES
        assert found[-1] == f"  ...           and {n_facts - 6} more (-v shows them)"


def test_what_is_left_out_is_red_if_it_is_a_warning():
    assert as_text.summary(RUN, [written(warnings=tuple("abcdefgh"))])[-1].tone == "bad"
    assert as_text.summary(RUN, [written(sidecars=tuple("abcdefgh"))])[-1].tone == "faint"


@pytest.mark.parametrize("width", [60, 80, 100, 140])
def test_the_table_keeps_to_the_width(width):
    records = [written("folder/" * 20 + f"{at}.ply") for at in range(3)]
    rows = lines(*records, written("扫描" * 40 + "z.ply"), width=width)[:5]
    assert max(map(columns, rows)) <= max(width, 78)
    assert all(row.startswith("...") for row in rows[1:])
    assert "2.ply " in rows[3]


def test_many_warnings_and_failures_are_counted():
    records = [written(f"{at}", warnings=("w",)) for at in range(as_text.MAX_WARNINGS + 5)]
    assert {"warnings: 25", "  ... and 5 more (-v or --report)"} <= set(lines(*records))
    assert not any("more (-v" in line for line in lines(*records, verbose=True))
    records = [failed(f"{at}") for at in range(as_text.MAX_FAILURES + 2)]
    assert "  ... and 2 more (-v or --report)" in lines(*records)
    assert not any("more (-v" in line for line in lines(*records, verbose=True))


def test_a_run_that_was_cut_short_says_what_is_not_done():
    run = dataclasses.replace(RUN, interrupted=True)
    last = as_text.summary(run, [written("a"), MeshRecord("b", "planned", "out/b")])[-1]
    assert "1 written, 1 not done" in last.text and last.tone == "bad"
    (line,) = as_text.summary(run, [MeshRecord("b", "planned", "out/b")])
    assert (line.text, line.tone) == ("b was not finished", "bad")


NASTY = "a\x1b[2J\nb\udcff"
RECORDS = [
    make(name, error=Failure("E_X", name, name, name), warnings=(name,), sidecars=(name,))
    for name in (*HOSTILE_NAMES, NASTY)
    for make in (written, failed)
]


@pytest.mark.parametrize("records", [RECORDS, *([record] for record in RECORDS)])
def test_the_terminal_and_the_log_obey_nothing(records):
    shown = [*as_text.summary(RUN, records, width=200, verbose=True), *as_text.listing(records)]
    assert len(shown) >= len(records)
    said = [line.text for line in shown] + [as_text.file_text(record) for record in records]
    said += [line.text for line in describe_info(InfoRecord(NASTY, warnings=(NASTY,)))]
    for text in said:
        for character in text:
            assert unicodedata.category(character) not in ("Cc", "Cf", "Cs", "Zl", "Zp"), text
        # Robots that read logs take a command only at the beginning of a line.
        assert not text.lstrip().startswith(("::", "##")), text


def test_the_listing_and_the_outlook_of_a_dry_run():
    planned = Planned(2_000, 10, 8.0)
    records = [
        MeshRecord("a", "planned", "out/a", planned=planned),
        MeshRecord("c", "planned", "out/c", planned=dataclasses.replace(planned, seconds=2.0)),
        written("b", status="up-to-date"),
        failed(),
    ]
    assert [line.text for line in as_text.listing(records)] == [
        "a -> out/a: 2.0 kB, 10 vertices, about 8.00 s",
        "c -> out/c: 2.0 kB, 10 vertices, about 2.00 s",
        "out/b is up to date",
        "bad.ply: vertex 17: position is not finite (E_NONFINITE)",
        "  hint: repair it",
    ]
    start = "2 files to denoise, 0.0 MB, about 20 vertices, about"
    assert as_text.outlook(records, 1).text == (
        f"{start} 10.9 s on an idle machine, 1 up to date, 1 will fail"
    )
    assert as_text.outlook(records, 2).text.startswith(f"{start} 8.90 s")
