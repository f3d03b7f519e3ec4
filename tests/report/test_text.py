"""The summary for people: every failure with its reason, no figure that cannot be trusted."""

from __future__ import annotations

import dataclasses
import unicodedata

import pytest

from msal_cli.job.display_names import columns
from msal_cli.job.records import Failure, MeshRecord, Volume
from msal_cli.report import text as as_text
from tests.report.made import HOSTILE_NAMES, RUN, failed, written

OPEN = Volume(1.0, 0.9, -0.1, -10.0, False, "open (812 boundary edges)")


def text(records, **options):
    return "\n".join(line.text for line in as_text.summary(RUN, records, **options))


def test_one_file_is_told_in_some_detail():
    said = text([written(degenerate_faces=1, non_manifold_edges=12)], verbose=True)
    assert said.startswith("scan.ply -> out/scan.ply\n")
    assert "35,947 vertices, 69,451 faces, 1 component, ply ascii float32" in said
    assert "12 non-manifold edges, 1 degenerate face\n" in said
    assert "msal (iterations 4, K 0.5)" in said
    assert "10 -> 9.9734 (-0.266 %)" in said
    assert (
        "mean 0.11, 95 % below 0.33, most 0.44 mean edge lengths (most 0.4 in file units)" in said
    )
    assert "vertices/s" not in said
    assert "0.95 s (read 0.10, connectivity 0.20, normals 0.05, sweeps 0.30" in said


def test_no_volume_change_that_nobody_can_trust():
    for records in ([written(volume=OPEN)], [written(volume=OPEN), written("b")]):
        said = text(records)
        assert "open (812 boundary edges)" in said
        assert "-10" not in said


def test_a_place_is_named_once():
    message = "vertex 5 has a coordinate that is not a finite number"
    one = failed(error=Failure("E_NONFINITE", message, "", "vertex 5"))
    assert text([one]) == f"bad.ply: {message} (E_NONFINITE)"


def test_a_single_failure_has_reason_place_code_and_hint():
    assert text([failed()]) == (
        "bad.ply: vertex 17: position is not finite (E_NONFINITE)\n  hint: repair it"
    )


@pytest.mark.parametrize(
    ("record", "word"),
    [
        (written(status="unchanged"), "byte for byte as it was"),
        (written(status="up-to-date"), "out/scan.ply is up to date"),
        (MeshRecord("a", "planned", "b"), "a would be written to b"),
        (written(output="-", input="-"), "standard input -> standard output"),
        (written(warnings=("lost in stl: colours",)), "warning       lost in stl: colours"),
        (written(sidecars=("copied a.mtl",)), "beside it     copied a.mtl"),
    ],
)
def test_what_one_file_may_say(record, word):
    assert word in text([record])


def test_a_table_of_several_files():
    said = text([written("a.ply"), written("long/name/b.ply", volume=OPEN), failed()])
    lines = said.split("\n")
    assert lines[0].split() == ["file", "vertices", "volume", "max", "move", "seconds"]
    assert lines[1].split() == ["a.ply", "35,947", "-0.266", "%", "0.440", "0.95"]
    assert lines[2].endswith("     0.95  open (812 boundary edges)")
    assert lines[1].index("35,947") == lines[2].index("35,947")
    assert "failed: 1" in lines
    assert "  bad.ply: vertex 17: position is not finite (E_NONFINITE)" in lines
    assert "volume change: median -0.266 %, from -0.266 % to -0.266 % (1 closed file)" in lines
    assert lines[-1] == "3 files: 2 written, 1 failed; 71,894 vertices in 10.0 s"


def test_the_table_and_the_summary_name_what_calls_for_attention():
    records = [written("a.ply", flipped_faces=1_234), written("b.ply", despiked=3, warnings=("w",))]
    lines = text(records).split("\n")
    assert lines[0].split()[-4:] == ["flipped", "outliers", "warnings", "seconds"]
    assert lines[1].split()[-4:] == ["1,234", "-", "0", "0.95"]
    assert lines[2].split()[-4:] == ["-", "3", "1", "0.95"]
    assert (
        "largest move: 0.44 mean edge lengths (a.ply); 1,234 flipped faces in 1 file; "
        "3 outliers brought back in 1 file" in lines
    )


@pytest.mark.parametrize("width", [60, 80, 100, 140])
def test_the_table_keeps_to_the_width(width):
    records = [written("folder/" * 20 + f"{at}.ply") for at in range(3)]
    records.append(written("扫描" * 40 + "z.ply"))
    rows = text(records, width=width).split("\n")[:5]
    assert max(map(columns, rows)) <= max(width, 78)
    assert all(row.startswith("...") for row in rows[1:])
    assert "2.ply " in rows[3]


def test_long_tables_are_left_to_reports_unless_asked_for():
    records = [written(f"{at:03}.ply") for at in range(as_text.MOST_ROWS + 1)]
    assert "017.ply" not in text(records)
    assert "(41 files: -v lists them all" in text(records)
    assert "017.ply" in text(records, verbose=True)
    assert "017.ply" in text(records[:-1])


def test_many_warnings_and_failures_are_counted():
    records = [written(f"{at}", warnings=("w",)) for at in range(as_text.MOST_WARNINGS + 5)]
    assert "warnings: 25" in text(records)
    assert "... and 5 more" in text(records)
    assert "more (-v" not in text(records, verbose=True)
    records = [failed(f"{at}") for at in range(as_text.MOST_FAILURES + 2)]
    assert "... and 2 more" in text(records)
    assert "... and 2 more" not in text(records, verbose=True)


def test_what_earlier_runs_did_is_listed_only_on_demand():
    records = [written("old.ply", status="up-to-date", warnings=("w",)), written("new.ply")]
    assert not any(line.startswith("old.ply") for line in text(records).split("\n"))
    (row,) = [
        line for line in text(records, verbose=True).split("\n") if line.startswith("old.ply")
    ]
    # The speed of an earlier run says nothing about this one.
    assert row.split()[-6:] == ["0.440", "1", "-", "up", "to", "date"]
    assert "2 files: 1 written, 1 up to date" in text(records)


def test_a_run_that_was_cut_short_says_what_is_not_done():
    run = dataclasses.replace(RUN, interrupted=True)
    lines = as_text.summary(run, [written("a"), MeshRecord("b", "planned", "out/b")])
    assert "1 written, 1 not done" in lines[-1].text
    assert lines[-1].tone == "bad"


NASTY = "a\x1b[2J\nb\udcff"
RECORDS = [
    make(name, error=Failure("E_X", name, name, name), warnings=(name,), sidecars=(name,))
    for name in (*HOSTILE_NAMES, NASTY)
    for make in (written, failed)
]


@pytest.mark.parametrize("records", [RECORDS, *([one] for one in RECORDS)])
def test_the_terminal_and_the_log_obey_nothing(records):
    lines = as_text.summary(RUN, records, width=200, verbose=True)
    assert len(lines) >= len(records)
    for line in lines:
        for one in line.text:
            assert unicodedata.category(one) not in ("Cc", "Cf", "Cs", "Zl", "Zp"), line
        # Robots that read logs take a command only at the beginning of a line.
        assert not line.text.lstrip().startswith(("::", "##")), line


def test_the_listing_of_a_dry_run():
    records = [MeshRecord("a", "planned", "out/a"), written("b", status="up-to-date"), failed()]
    assert [line.text for line in as_text.listing(records)][:3] == [
        "a -> out/a",
        "out/b is up to date",
        "bad.ply: vertex 17: position is not finite (E_NONFINITE)",
    ]


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.0, "0.00 s"), (9.994, "9.99 s"), (12.34, "12.3 s"), (99.96, "1 min 40 s")]
    + [(185.4, "3 min 05 s"), (3599.9, "1 h 00 min"), (7800, "2 h 10 min")],
)
def test_seconds(seconds, said):
    assert as_text.seconds_text(seconds) == said


def test_figures():
    assert as_text.percent_text(-0.2664) == "-0.266 %"
    assert as_text.percent_text(123.456) == "+123.5 %"
    assert as_text.percent_text(None) == ""


def test_corners_stand_beside_the_vertices():
    record = written("a.stl", format="stl", vertices=6720, corners=40320)
    assert "6,720 vertices (of 40,320 corners), " in text([record])
    (row,) = [
        line for line in text([record, written("b")]).splitlines() if line.startswith("a.stl")
    ]
    assert row.split()[1] == "6,720"
    assert row.endswith("  40,320 corners")


def test_inside_out_is_told_of_one_file_and_in_the_table():
    record = written(inside_out=True)
    assert ", inside out\n" in text([record])
    assert "defects       inside out" in text([record], verbose=True)
    assert text([record, written("b")]).splitlines()[1].endswith("inside out")
