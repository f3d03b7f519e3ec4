"""``docs/refresh.py`` as a module, for tests that hold pages against it."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType


def _loaded() -> ModuleType:
    script = Path(__file__).resolve().parents[1] / "docs" / "refresh.py"
    spec = importlib.util.spec_from_file_location("refresh", script)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


refresh = _loaded()
