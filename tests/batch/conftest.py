"""Workers are fresh interpreters: they must find the fakes of these tests by themselves."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def importable_fakes(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
