"""The summary for people, comparisons with earlier runs, and every writer's output."""

import dataclasses
import json
import math
import unicodedata

import pytest

from msal_cli.errors import FormatError
from msal_cli.job.display_names import columns
from msal_cli.job.records import (
    ComparisonRecord,
    Displacement,
    Failure,
    GateResult,
    InfoRecord,
    MeshRecord,
    Reference,
    Volume,
)
from msal_cli.report import text as as_text
from msal_cli.report.comparison import (
    compare_with_baseline,
    find_partner,
    list_missing,
    read_comparisons,
)
from msal_cli.report.data import json_bytes, plain, render_json
from msal_cli.report.facts import worst_first
from msal_cli.report.text import describe_info
from tests.report.golden import FOLDER, outputs
from tests.report.made import HOSTILE_NAMES, RUN, failed, gated, written

BROKEN = GateResult("flipped_faces > 0", True, True, {}, "flipped_faces is 3")
PASSED = dataclasses.replace(BROKEN, broken=False)


def lines(*records, **options):
    return [line.text for line in as_text.summary(RUN, records, **options)]


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


def moved(name, most_edges, change=None, valid=True):
    return written(
        name,
        displacement=Displacement(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, most_edges, 1),
        volume=None if change is None else Volume(1.0, 1.0, 0.0, change, valid, ""),
    )


def test_worst_first():
    gates = gated().gates
    records = [
        moved("little", 0.1),
        written("unknown", displacement=None),
        moved("open", 0.5, 100.0, valid=False),
        moved("shrunk", 0.5, -3.0),
        moved("grown", 0.5, 2.0),
        moved("nan", math.nan),
        MeshRecord("planned", "planned"),
        gated("one"),
        gated("two", gates=gates[:1] * 2),
        failed("failed"),
    ]
    assert [record.input for record in worst_first(records)] == [
        "failed", "two", "one", "planned", "nan", "shrunk", "grown", "open", "little", "unknown",
    ]  # fmt: skip


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


def record(**figures):
    return ComparisonRecord("a", "b", **figures)


def broken(now, then, tolerance=0.02):
    return [gate.expression for gate in compare_with_baseline(now, then, tolerance) if gate.broken]


@pytest.mark.parametrize(
    ("now", "is_broken"), [(9.0, False), (10.0, False), (10.19, False), (10.21, True)]
)
def test_a_figure_may_grow_by_the_tolerance(now, is_broken):
    found = broken(record(vertex_error_percent=now), record(vertex_error_percent=10.0))
    assert found == (["vertex_error_percent > 10.2"] if is_broken else [])


@pytest.mark.parametrize(("now", "is_broken"), [(-1.0, False), (1.0, False), (-1.1, True)])
def test_changes_count_by_their_size(now, is_broken):
    found = broken(record(volume_change_percent=now), record(volume_change_percent=1.0))
    assert bool(found) == is_broken


def test_a_figure_that_is_not_known_any_more_is_broken_and_a_new_one_is_not():
    (gate,) = compare_with_baseline(record(), record(hausdorff_edges=1.0), 0.02)
    assert (gate.broken, gate.decided) == (True, False)
    assert "not known" in gate.reason
    assert broken(record(hausdorff_edges=1.0), record()) == []
    assert compare_with_baseline(record(hausdorff_edges=1.0), None, 0.02) == ()


def test_partners_are_found_by_path_or_by_its_end():
    earlier = {"old/x/a.ply": 1, "old/y/a.ply": 2, "old/b.ply": 3}
    names = ["old/x/a.ply", "y/a.ply", "a.ply", "b.ply", "c.ply"]
    assert [find_partner(name, earlier) for name in names] == [1, 2, None, 3, None]
    assert list_missing(["x/a.ply", "b.ply"], earlier) == ["old/y/a.ply"]


def test_a_baseline_comes_back_from_one_pair_from_many_and_from_a_report():
    pair, bad = record(hausdorff=0.5), ComparisonRecord("a", "c", error=failed().error)
    assert read_comparisons(json_bytes(plain(pair)), "x") == {"b": pair}
    many = {"schema": pair.schema, "records": [plain(one) for one in (pair, bad)]}
    assert read_comparisons(json_bytes(many), "x") == {"b": pair}
    reference = Reference("t.ply", hausdorff_edges=0.5)
    records = [written("a.ply", reference=reference), written("b.ply"), failed()]
    assert read_comparisons(render_json(RUN, records), "x") == {"out/a.ply": reference}


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"{", "it is not JSON"),
        (b'{"schema": "x"}', "missing or unsupported schema"),
        (json.dumps({"schema": ComparisonRecord.schema, "records": 3}).encode(), "no list"),
        (json.dumps({"schema": ComparisonRecord.schema, "records": [3]}).encode(), "cannot be int"),
        (render_json(RUN, [written()]), "no file in it was measured"),
    ],
)
def test_what_is_no_baseline(content, reason):
    with pytest.raises(FormatError, match=reason) as caught:
        read_comparisons(content, "x.json")
    assert caught.value.path == "x.json"


# Every writer makes of one run exactly what is kept


MADE = dict(outputs())


@pytest.mark.parametrize("name", MADE)
def test_output(name):
    assert MADE[name] == (FOLDER / name).read_bytes().decode()


def test_every_kept_file_is_compared():
    assert {path.name for path in FOLDER.iterdir()} == set(MADE)
