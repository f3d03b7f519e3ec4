"""Arrays of numbers inside a file, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.codecs.text_slots import (
    Patch,
    replace_statements,
    require_replaced,
)
from msal_cli.errors import InternalError
from msal_cli.kernels import parallel


def as_bytes(*parts):
    return np.frombuffer(b"".join(parts), dtype=np.uint8)


def runs(separator):
    """A text with 60 runs of three numbers, and the patch that renews two of three of them."""
    parts, at, size = [], [], 0
    for row in range(60):
        prefix = b"# note\nv " if row % 7 == 0 else b"v "
        text = prefix + separator.join(b"%d.5" % (row * k) for k in (1, 10, 100)) + b" # end\n"
        at.append(size + len(prefix))
        parts.append(text)
        size += len(text)
    values = np.arange(180.0).reshape(60, 3) / 7.0 - 9.0
    is_changed = np.arange(180).reshape(60, 3) % 3 != 1
    decimals = (np.arange(60) % 5).astype(np.uint8)
    return as_bytes(*parts), Patch(np.array(at), values, is_changed, decimals)


@pytest.mark.parametrize("separator", [b" ", b"\n"])
def test_pieces_of_a_text_are_replaced_and_checked_by_many_threads(separator, monkeypatch):
    data, patch = runs(separator)
    plain = bytes(replace_statements(data, [patch]))
    monkeypatch.setattr(parallel, "MIN_COUNT", 1)
    monkeypatch.setenv("MSAL_THREADS", "4")
    # Two kinds of runs that take turns, as positions and normals do.
    patches = [Patch(*[array[first::2] for array in patch]) for first in (0, 1)]
    assert bytes(replace_statements(data, [patch])) == plain
    assert bytes(replace_statements(data, patches)) == plain
    result = as_bytes(plain)
    require_replaced(data, result, patches)
    for at in range(0, len(result), 11):
        wrong = result.copy()
        wrong[at] = ord("7") if wrong[at] != ord("7") else ord("8")
        with pytest.raises(InternalError):
            require_replaced(data, wrong, patches)
    for wrong in (result[:-1], as_bytes(plain, b"\n")):
        with pytest.raises(InternalError, match="more than positions"):
            require_replaced(data, wrong, patches)
