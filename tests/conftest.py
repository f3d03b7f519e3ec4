"""Meshes and paths that many tests share."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Of hypothesis: few examples by default, many in .ci/run (HYPOTHESIS_PROFILE=full).
settings.register_profile("quick", max_examples=20, deadline=None)
settings.register_profile("full", max_examples=100, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real scans, named by the environment variable MSAL_DATA."""
    folder = os.environ.get("MSAL_DATA", "")
    if not folder:
        pytest.skip("MSAL_DATA is not set: no real scans at hand")
    return Path(folder)


@pytest.fixture(autouse=True)
def default_logger() -> Iterator[None]:
    """Undo what a command that a test ran in this process has set for its log."""
    yield
    logger = logging.getLogger("msal")
    logger.propagate = True
    logger.setLevel(logging.NOTSET)
