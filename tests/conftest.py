"""Meshes and paths that many tests share."""

import logging
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# As the command has it.  BLAS threads of several workers wait for one another: a product of small
# matrices took seven times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_configure(config: pytest.Config) -> None:
    """Keep byte code in the cache of pytest where Python is to write none beside the sources.

    Tests start hundreds of processes, and each would compile all that it imports.
    """
    if sys.dont_write_bytecode and hasattr(config, "cache"):
        sys.pycache_prefix = str(config.cache.mkdir("bytecode"))
        sys.dont_write_bytecode = False
        os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    # pytest rewrites the modules of hypothesis, and keeps them only from here on.
    from hypothesis import settings

    # Few examples by default, many in .ci/run (HYPOTHESIS_PROFILE=full).
    settings.register_profile("quick", max_examples=20, deadline=None)
    settings.register_profile("full", max_examples=100, deadline=None)
    settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files whose tests are all for .ci/run: what they import takes seconds."""
    if "not ci" not in config.option.markexpr or not collection_path.name.startswith("test_"):
        return None
    text = collection_path.read_text("utf-8") if collection_path.is_file() else ""
    return True if re.search(r"^pytestmark = [^\]\n]*(\[[^\]]*)?mark\.ci\b", text, re.M) else None


def pytest_sessionstart(session: pytest.Session) -> None:
    """Test no kernels but those that the sources have now; once, not in each worker."""
    if not hasattr(session.config, "workerinput"):
        from kernel_build.sources import check_library

        try:
            check_library()
        except SystemExit as edited:
            pytest.exit(str(edited), 1)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real scans, named by the environment variable MSAL_DATA."""
    folder = os.environ.get("MSAL_DATA", "")
    if not folder:
        pytest.skip("MSAL_DATA is not set: no real scans at hand")
    return Path(folder)


@pytest.fixture(autouse=True)
def run_here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Denoise batches in this process in the tests of commands, of the API and of reports."""
    if request.path.parent.name in ("api", "cli", "report"):
        from tests.batch.fakes import InProcess

        monkeypatch.setattr("msal_cli.batch.workers.WorkerPool", InProcess)


@pytest.fixture
def empty_store() -> None:
    """The store ``memory://``, with nothing in it."""
    from fsspec.implementations.memory import MemoryFileSystem

    MemoryFileSystem.store.clear()
    MemoryFileSystem.pseudo_dirs[:] = [""]


@pytest.fixture(autouse=True)
def default_logger() -> Iterator[None]:
    """Undo what a command that a test ran in this process has set for its log."""
    yield
    logger = logging.getLogger("msal")
    logger.propagate = True
    logger.setLevel(logging.NOTSET)
