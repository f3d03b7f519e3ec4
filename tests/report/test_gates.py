"""Gates: what expressions mean, where they are refused, and what is not known."""

import dataclasses

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from msal_cli.errors import UsageError
from msal_cli.job.records import Area, MeshRecord, NormalChange, Reference, Volume
from msal_cli.report.gates import MAX_LENGTH, parse_gates, refuse_without_reference, with_gates
from tests.report.made import failed, written

# Volume 10 -> 9.9734 (-0.266 %), displacement 0.1 to 0.4, which is 1 to 4 mean edge lengths.
CLOSED = written(
    mean_edge_length=0.1,
    flipped_faces=3,
    area=Area(4.0, 5.0, 25.0),
    normal_change=NormalChange(5.0, 50.0),
)
OPEN = dataclasses.replace(CLOSED, volume=Volume(1.0, 3.0, 2.0, 200.0, False, "open (8 edges)"))


def result(text, record=CLOSED):
    return parse_gates([text], MeshRecord)[0].evaluate(record)


@pytest.mark.parametrize(
    ("text", "unit", "is_broken"),
    [
        ("max_displacement > 39cm", "m", True),
        ("max_displacement < 0.41mm + 0.1um", "mm", True),
        ("max_displacement > 0.01in", "mm", True),
        ("max_displacement / 1mm > 399", "m", True),
        ("max_displacement > 1e-999999999km", "m", True),
    ],
)
def test_lengths_with_a_unit(text, unit, is_broken):
    found = parse_gates([text], MeshRecord, unit)[0].evaluate(CLOSED)
    assert found.broken == is_broken


BROKEN = (
    "abs(volume_change) > 0.2%; volume_change <= -0.266%; volume.change_percent < -1 / 5; "
    "abs(volume.after / volume.before - 1) > 0.2%; max_displacement > 3.9e; "
    "max_displacement - mean_displacement > 2.9e; mean_displacement > 20% * max_displacement; "
    "area_change / volume_change < -90; 50% * area_change < 2 * area_change / 4 + 1%; "
    "flipped_faces > 0; min(flipped_faces, 2) == 2 and max(1, flipped_faces, 2) == 3; "
    "volume.valid; flipped_faces == 9 - 3 - 3; flipped_faces == 12 / 2 / 2; "
    "flipped_faces == (1 + 2) * 1 and 7 == 1 + 2 * 3; "
    "-flipped_faces * 2 == -6 and --flipped_faces == 3; not flipped_faces > 9 and volume.valid; "
    "1 > 0 or 1 > 0 and 1 > 2; max_displacement > 1e - 0.09"
)
KEPT = (
    "abs(volume_change) > 1%; volume_change < -0.266%; max_displacement / 1e > 4.1; "
    "flipped_faces / faces > 0.01%; not (flipped_faces == 3); "
    "not volume.valid or flipped_faces == 2; known(seam_gap); flipped_faces>.5e1"
)


@pytest.mark.parametrize(("texts", "is_broken"), [(BROKEN, True), (KEPT, False)])
def test_verdicts_by_hand(texts, is_broken):
    for text in texts.split("; "):
        found = result(text)
        assert found.decided and found.broken is is_broken, text


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("  ", 1, "it ends early"),
        ("faces >", 1, "'faces >' cannot be read"),
        ("faces > (1", 9, "'(1' cannot be read"),
        ("faces > 1)", 10, "')' cannot be read"),
        ("faces > 1) or (1 > 0", 10, "cannot be read"),
        ("faces = 1", 7, "'=' means nothing"),
        ("faces > 1 && faces > 2", 11, "'&' means nothing"),
        ("1 < faces < 3", 13, "third time"),
        ("faces > 0.5edges", 9, "'0.5edges' means nothing"),
        ("faces > __", 9, "no record has a number '__'"),
        ("abs(faces, x=1) > 1", 13, "'=' means nothing"),
        ("faces > 2,000", 1, "'faces > 2,000' means nothing"),
        ("faces > 1 1", 11, "'1' cannot be read"),
        ("faces > (1, 2)", 9, "means nothing"),
        ("sqrt(faces) > 1", 1, "no function sqrt"),
        ("abs(faces, 1) > 1", 1, "abs takes one value"),
        ("min() > 1", 1, "min takes 1 to 9 values"),
        ("faces > 1e999", 9, "too large"),
        ("__import__('os')", 12, "means nothing"),
        ("faces > 1\x1b[2J", 10, "means nothing"),
        ("1 > " + "0" * MAX_LENGTH, MAX_LENGTH, "longer"),
        ("+faces", 2, "this is a number"),
        # Units that do not go together.
        ("volume_change > 1", 1, ""),
        ("volume_change > 1e", 1, ""),
        ("volume_change > 1 / 100", 1, "without a unit"),
        ("1e > 2%", 1, ""),
        ("max_displacement + 1% > 0", 1, ""),
        ("flipped_faces > 1%", 1, ""),
        ("max_displacement > 1%", 1, ""),
        ("area.after > 2e", 1, ""),
        ("area.after > 2e * 2e", 14, "a length and a length do not go together"),
        ("volume.after / area.after > 2e", 1, "a volume and an area"),
        ("volume.valid > 1", 1, ""),
        ("abs(volume.valid) > 1", 5, "a number is needed"),
        ("flipped_faces", 1, ""),
        ("known(1)", 7, "takes a name"),
        ("max_displacement > 0.1mm", 20, "0.1mm: mesh files have no unit"),
        ("max_displacement > 1e308km", 20, "too large"),
        ("seconds > 5min", 11, "'5min' means nothing"),
    ],
)
def test_what_is_wrong_is_told_with_its_column(text, column, words):
    with pytest.raises(UsageError) as caught:
        parse_gates([text], MeshRecord, None if "no unit" in words else "mm")
    assert f"column {column}: " in caught.value.message
    assert words in caught.value.message
    assert caught.value.hint or "km" in text


def test_what_is_not_known_breaks_a_gate_with_its_reason():
    found = result("abs(volume_change) > 1%", OPEN)
    assert (found.broken, found.decided) == (True, False)
    assert found.values == {"volume_change": None}
    assert found.reason == "volume_change is not known: open (8 edges)"
    bare = MeshRecord("a.ply", "up-to-date")
    assert "flipped_faces is not known" in result("flipped_faces > 0", bare).reason
    assert not result("max_displacement > 0.5e", bare).decided
    other = dataclasses.replace(bare, reference=Reference("true.ply", "surface"))
    found = result("reference.flipped_faces > 0", other)
    assert found.reason == "reference.flipped_faces is not known: the faces are not the same"


@pytest.mark.parametrize(
    ("text", "is_broken", "is_decided"),
    [
        ("volume.valid and abs(volume_change) > 1%", False, True),
        ("known(volume_change) and abs(volume_change) > 1%", False, True),
        ("abs(volume_change) > 1% and not volume.valid", True, False),
        ("not volume.valid or abs(volume_change) > 1%", True, True),
        ("volume.valid or abs(volume_change) > 1%", True, False),
        ("not (volume_change > 0)", True, False),
        ("flipped_faces / (flipped_faces - 3) > 1", True, False),
        ("1 / 0 > 1", True, False),
        ("1e300 * 1e300 > 1", True, False),
    ],
)
def test_one_side_may_decide(text, is_broken, is_decided):
    found = result(text, OPEN)
    assert (found.broken, found.decided) == (is_broken, is_decided)
    assert found.reason


def test_only_files_with_an_output_are_judged():
    gates = parse_gates(["faces > 9"], MeshRecord)
    judged = [CLOSED, failed(), MeshRecord("b", "planned"), MeshRecord("c", "up-to-date")]
    assert [len(one.gates) for one in with_gates(gates, judged)] == [1, 0, 0, 1]
    assert with_gates((), [CLOSED]) == [CLOSED]


@pytest.mark.parametrize(
    "name",
    [
        "mean_angular_error_deg",
        "max_angular_error_deg",
        "vertex_error_percent",
        "hausdorff",
        "reference.flipped_faces",
    ],
)
def test_what_needs_a_reference_is_not_judged_by_the_input(name):
    text = f"{name} > 0"
    found = result(text)
    assert (found.broken, found.decided) == (True, False)
    assert "nothing was measured against a reference" in found.reason
    with pytest.raises(UsageError, match="measured against a reference") as caught:
        refuse_without_reference(parse_gates([text], MeshRecord), "give one")
    assert caught.value.hint.startswith("give one")
    is_angle = name.endswith("angular_error_deg")
    assert ("normal_change." in caught.value.hint) == is_angle
    asked = f"known({name}) and {text}"
    refuse_without_reference(parse_gates([asked], MeshRecord), "give one")
    assert not result(asked).broken


@pytest.mark.parametrize("sign", ["+1", "-1", "*1", "/1", " or 1>2", " and 1>0", "-"])
def test_the_longest_expressions_can_be_judged(sign):
    start = "1>0" if "1>" in sign else "1"
    start = "" if sign == "-" else start
    text = start + sign * ((MAX_LENGTH - 8) // len(sign)) + ("" if "1>" in sign else "1 > 0")
    assert parse_gates([text], MeshRecord)[0].evaluate(CLOSED).decided


WORDS = [
    *("faces", "volume_change", "displacement.max", "volume.valid", "seconds", "x", "e", "1"),
    *("0.5e", "1%", "0", "1e9", "(", ")", ",", "+", "-", "*", "/", "<", ">=", "==", "and", "or"),
    *("not", "abs(", "min(", "max(", "known("),
]
ANY = st.characters(exclude_categories=["Cs"])


@given(st.lists(st.sampled_from(WORDS), max_size=12).map(" ".join) | st.text(ANY, max_size=40))
@example("volume.valid == 1")
def test_any_text_is_refused_or_judged(text):
    try:
        gates = parse_gates([text], MeshRecord)
    except UsageError as error:
        assert "column" in error.message
    else:
        result = gates[0].evaluate(CLOSED)
        is_unknown = None in result.values.values() or "cannot be computed" in result.reason
        assert (result.decided or (result.broken and is_unknown)) and result.reason
