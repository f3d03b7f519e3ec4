"""Facts: each once, with its level; which files come first; figures, totals and phrases."""

from __future__ import annotations

import dataclasses
import math

import pytest

from msal_cli.job.records import (
    ChoiceMade,
    Displacement,
    Failure,
    GateResult,
    MeshRecord,
    NoiseEstimate,
    NoiseReading,
    Reference,
    Volume,
)
from msal_cli.report.facts import (
    ATTENTION,
    DETAIL,
    SHORT,
    auto_text,
    facts,
    problem_tables,
    seconds_text,
    unsure_text,
    worst_first,
)
from tests.report.made import failed, gated, written

BROKEN = GateResult("flipped_faces > 0", True, True, {}, "flipped_faces is 3")
CHOICE = ChoiceMade("noise 0.3 e; AL", "machined", 0.3, None, 3, (), {}, (), "family", 2.6)
READINGS = (NoiseReading("texture", 0.0, 0.7), NoiseReading("noise", 0.05, 0.3))
NONE = NoiseEstimate(0.001, 0.0002, negligible=True)
FAILURE = Failure("E_X", "it ends early", "", "byte 9")
OPEN = Volume(None, None, None, None, False, "not orientable")


@pytest.mark.parametrize(
    ("changes", "level", "fact"),
    [
        ({"inside_out": True}, SHORT, "mesh: 35,947 vertices, 69,451 faces, 1 component, "
         "inside out"),
        ({"corners": 9, "vertices": None, "faces": 3, "components": 2}, SHORT,
         "mesh: 9 corners, 3 faces, 2 components"),
        ({"noise_estimate": NONE}, SHORT,
         "noise: 0.001 mean edge lengths: hardly any, filtered all the same"),
        ({"noise_estimate": NONE, "status": "unchanged"}, SHORT,
         "noise: 0.001 mean edge lengths: none to speak of"),
        ({}, SHORT, "method: msal (iterations 4, K 0.5)"),
        ({"choice": CHOICE}, DETAIL, "method: msal (iterations 4, K 0.5)"),
        ({"left_alone": "no noise"}, SHORT, "left as it is: no noise"),
        ({"left_alone": "no noise", "status": "unchanged"}, DETAIL, "left as it is: no noise"),
        ({"despiked": 1, "locked_vertices": 0}, SHORT, "moved: mean 0.11, most 0.44 mean edge "
         "lengths; volume -0.266 %; 1 outlier vertex brought back; 0 vertices locked"),
        ({"volume": OPEN}, SHORT, "volume: no figure: not orientable"),
        ({"volume": OPEN, "boundary_edges": 2}, DETAIL, "volume: no figure: not orientable"),
        ({"gates": (dataclasses.replace(BROKEN, broken=False),)}, SHORT,
         "gate: passed: flipped_faces > 0 (flipped_faces is 3)"),
        ({"gates": (dataclasses.replace(BROKEN, decided=False),)}, ATTENTION,
         "gate: not decided: flipped_faces > 0 (flipped_faces is 3)"),
        ({"reference": Reference("t.ply", hausdorff_edges=0.5)}, SHORT,
         "reference: Hausdorff 0.5 mean edge lengths (t.ply)"),
        ({"reference": Reference("t.ply", error=FAILURE)}, ATTENTION,
         "reference: byte 9: it ends early (E_X)"),
        ({"reference": Reference("t.ply", warnings=("odd",))}, ATTENTION, "warning: odd"),
        ({"sidecars": ("a\x1b.mtl",)}, SHORT, "beside it: a\\x1b.mtl"),
    ],
)  # fmt: skip
def test_fact(changes, level, fact):
    found = {f"{fact.word}: {fact.text}": fact.level for fact in facts(written(**changes))}
    assert found.get(fact) == level, list(found)


def advised(choice=CHOICE, **noise):
    estimate = NoiseEstimate(0.3, 0.1, **noise)
    return MeshRecord("a.ply", "written", noise_estimate=estimate, choice=choice)


def test_one_line_says_where_auto_is_better_and_how_long_it_takes():
    other = advised(dataclasses.replace(CHOICE, auto_seconds=None))
    assert auto_text([other]) == auto_text([]) == ""
    assert auto_text([advised()]).endswith(
        "(machined parts, strong noise), in about 3 s of one core"
    )
    assert "on 2 of 3 files" in auto_text([advised(), other, advised()])
    assert auto_text([advised()] * 100).endswith("about 4 min of one core")


def test_unsure_files_are_named_with_their_readings_unless_something_is_assumed():
    record = advised(unsure=True, readings=READINGS)
    assert unsure_text(record).startswith("texture (70 %) or noise of 0.05 e (30 %): filtered mild")
    assert problem_tables([record])[0].rows == [(record, (unsure_text(record),))]
    assert unsure_text(advised(unsure=False, readings=READINGS)) == ""
    assumed = dataclasses.replace(CHOICE, wishes={"assume": "noise"})
    assert unsure_text(advised(assumed, unsure=True, readings=READINGS)) == ""


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


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.0, "0.00 s"), (9.994, "9.99 s"), (12.34, "12.3 s"), (99.96, "1 min 40 s")]
    + [(185.4, "3 min 05 s"), (3599.9, "1 h 00 min"), (7800, "2 h 10 min")],
)
def test_seconds(seconds, said):
    assert seconds_text(seconds) == said
