"""Arrays of numbers inside a file, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.codecs.slots import require_range
from msal_cli.codecs.text_slots import line_of, number_hint, parse_floats
from msal_cli.errors import ContentError, FormatError

VALUES = np.arange(12.0).reshape(4, 3)
LARGEST = float(np.finfo(np.float32).max)


def as_bytes(*parts):
    return np.frombuffer(b"".join(parts), dtype=np.uint8)


@pytest.mark.parametrize(
    ("code", "value", "fits"),
    [
        ("<f4", LARGEST, True), ("<f4", -LARGEST, True), ("<f4", 1.1 * LARGEST, False),
        ("<f4", -1.1 * LARGEST, False), ("<f4", np.nan, False), ("<f8", 1e300, True),
        ("|u1", 255.4, True), ("|u1", 255.6, False), ("|u1", -0.4, True), ("|u1", -0.6, False),
        ("<i8", 2.0**63, False), ("<i8", -(2.0**63), True),
    ],
)  # fmt: skip
def test_a_number_fits_its_type_or_not(code, value, fits):
    values, is_changed = VALUES.copy(), np.zeros((4, 3), dtype=bool)
    values[2, 1] = value
    for codes in (["<f8", code, "<f8"], [code] * 3):
        is_changed[2, 1] = False
        require_range(values, is_changed, codes)  # what stays as it is may be anything
        is_changed[2, 1] = True
        if fits:
            require_range(values, is_changed, codes, first=5)
            continue
        with pytest.raises(ContentError, match="the new y of vertex 7 does not fit") as caught:
            require_range(values, is_changed, codes, first=5)
        assert (caught.value.where, caught.value.code) == ("vertex 7", "E_RANGE")


def words(*texts):
    ends = np.cumsum([len(text) + 1 for text in texts])
    starts = ends - [len(text) + 1 for text in texts]
    return as_bytes(*(text + b"\n" for text in texts)), starts, ends - 1


def test_words_are_numbers():
    assert parse_floats(*words(b"1", b"-2.5e1")).tolist() == [1.0, -25.0]
    assert parse_floats(*words(b"1", b"2d1", b"3D-1", b"4e1")).tolist() == [1.0, 20.0, 0.3, 40.0]
    for texts, line in (((b"1", b"x"), 2), ((b"1d0", b"1,5"), 2), ((b"1,5", b"1"), 1)):
        with pytest.raises(FormatError, match="is not a number") as caught:
            parse_floats(*words(*texts))
        assert caught.value.where == f"line {line}"
    assert "comma" in number_hint(b"1,5") and number_hint(b"1.5", "other") == "other"
    assert [line_of(b"a\nb\rc\r\nd", at) for at in (0, 2, 4, 5, 6, 7)] == [1, 2, 3, 3, 4, 4]
