"""Every writer makes of one run exactly what is kept."""

from __future__ import annotations

import pytest

from tests.report.golden import FOLDER, outputs

MADE = dict(outputs())


@pytest.mark.parametrize("name", MADE)
def test_output(name):
    assert MADE[name] == (FOLDER / name).read_bytes().decode()


def test_every_kept_file_is_compared():
    assert {path.name for path in FOLDER.iterdir()} == set(MADE)
