"""The grammar of gates: what binds how, and where it says that something is wrong."""

from __future__ import annotations

import ast

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from msal_cli.errors import UsageError
from msal_cli.job.records import MeshRecord
from msal_cli.report.gates import evaluate_gates, parse_gates
from msal_cli.report.gates.grammar import LONGEST, Expression

RECORD = MeshRecord("a.ply", "written", vertices=12, faces=20, mean_edge_length=0.5)


def shape(expression, node):
    """A syntax tree with parentheses around everything."""
    token = expression.token(node)
    inner = [one for one in ast.iter_child_nodes(node) if isinstance(one, ast.expr)]
    inner = inner[1:] if isinstance(node, ast.Call) else inner
    parts = " ".join(shape(expression, one) for one in inner)
    return f"({token.text} {parts})" if inner else token.text + token.unit


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a > 1 + 2 * 3", "(> a (+ 1 (* 2 3)))"),
        ("a > 1 - 2 - 3", "(> a (- (- 1 2) 3))"),
        ("a > 8 / 4 / 2", "(> a (/ (/ 8 4) 2))"),
        ("a > (1 + 2) * 3", "(> a (* (+ 1 2) 3))"),
        ("a > -b * 2", "(> a (* (- b) 2))"),
        ("a > --b", "(> a (- (- b)))"),
        ("not a > 1 and b < 2", "(and (not (> a 1)) (< b 2))"),
        ("a > 1 or b > 1 and c > 1", "(or (> a 1) (and (> b 1) (> c 1)))"),
        ("not not a", "(not (not a))"),
        ("max(a, -b, abs(c)) >= 1%", "(>= (max a (- b) (abs c)) 1%)"),
        ("a.b_c <= .5e", "(<= a.b_c .5e)"),
        ("a > 1e-3", "(> a 1e-3)"),
        ("a > 1e - 3", "(> a (- 1e 3))"),
        ("a > 2e3e", "(> a 2e3e)"),
        ("a>1.", "(> a 1.)"),
    ],
)
def test_what_binds_how(text, expected):
    expression = Expression(text)
    assert shape(expression, expression.root) == expected


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("", 1, "ends too early"),
        ("   ", 4, "ends too early"),
        ("faces >", 8, "ends too early"),
        ("faces > (1", 11, "')' is missing"),
        ("faces > 1)", 10, "')' is out of place"),
        ("faces = 1", 7, "'=' means nothing"),
        ("faces > 1 && faces > 2", 11, "'&' means nothing"),
        ("1 < faces < 3", 11, "third time"),
        ("faces > 1 1", 11, "'1' is out of place"),
        ("faces > 0.5edges", 12, "'edges' is out of place"),
        ("sqrt(faces) > 1", 1, "no function sqrt"),
        ("abs(faces, 1) > 1", 1, "abs takes one value"),
        ("and > 1", 1, "'and' is out of place"),
        ("faces > 1e999", 9, "too large"),
        ("__import__('os')", 12, "means nothing"),
        ("faces > 1\x1b[2J", 10, "means nothing"),
        ("(" * 30 + "1" + ")" * 30, 22, "deeper than 20"),
        ("1 > 0" + " " * LONGEST, LONGEST, "longer"),
    ],
)
def test_what_is_wrong_is_told_with_its_column(text, column, words):
    with pytest.raises(UsageError) as caught:
        parse_gates([text], MeshRecord)
    assert f"column {column}: " in caught.value.message
    assert words in caught.value.message
    assert caught.value.hint


@pytest.mark.parametrize("sign", ["+1", "-1", "*1", "/1", " or 1>2", " and 1>0", "-"])
def test_the_longest_expressions_can_be_judged(sign):
    start = "1>0" if "1>" in sign else "1"
    start = "" if sign == "-" else start
    text = start + sign * ((LONGEST - 8) // len(sign)) + ("" if "1>" in sign else "1 > 0")
    assert evaluate_gates(parse_gates([text], MeshRecord), RECORD)[0].decided


WORDS = [
    *("faces", "volume_change", "displacement.max", "volume.valid", "seconds", "x", "e", "1"),
    *("0.5e", "1%", "0", "1e9", "(", ")", ",", "+", "-", "*", "/", "<", ">=", "==", "and", "or"),
    *("not", "abs(", "min(", "max(", "known("),
]


@settings(max_examples=300, deadline=None)
@given(st.lists(st.sampled_from(WORDS), max_size=12).map(" ".join) | st.text(max_size=40))
@example("volume.valid == 1")
def test_any_text_is_refused_or_judged(text):
    try:
        gates = parse_gates([text], MeshRecord)
    except UsageError as error:
        assert "column" in error.message
    else:
        (result,) = evaluate_gates(gates, RECORD)
        assert result.broken or result.decided
        assert result.reason
