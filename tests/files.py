"""Files in folders, scripts as modules, and limits of time and of systems."""

import importlib.util
import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import pytest

from msal_cli.job.pipeline import FileRun
from msal_cli.job.records import MeshRecord
from msal_cli.job.settings import Settings
from msal_cli.storage.regular import Buffer

ROOT = Path(__file__).resolve().parents[1]
"""The checkout."""

SAMPLES = ROOT / "sample_meshes"

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX: links, pipes or signals")


def denoise_bytes(data: bytes, name: str, settings: Settings) -> tuple[Buffer | None, MeshRecord]:
    """The output for the bytes of a file, None if that failed, and its record."""
    run = FileRun(name, settings)
    try:
        return run.denoise(data, None).data, run.finish(None)
    except Exception as error:
        return None, run.fail(error)


def make_files(folder: Path, *names: str) -> None:
    """Make files with a letter in them, and their folders."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")


def tree(folder: Path, has_own: bool = False) -> dict[str, bytes]:
    """All files below a folder by relative name, msal's own only if asked for."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(Path(folder).rglob("*"))
        if path.is_file() and (has_own or not path.name.startswith(".msal-"))
    }


def write_sparse(path: Path, beginning: bytes, size: int) -> Path:
    """Make a file that takes no room on the disk however large it is."""
    with path.open("wb") as file:
        file.write(beginning)
        try:
            file.truncate(size)
        except OSError:
            pytest.skip("this file system has no files so large")
    if path.stat().st_blocks * 512 > max(1 << 20, 2 * len(beginning)):
        pytest.skip("this file system has no sparse files")
    return path


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@contextmanager
def umask(mask: int) -> Iterator[None]:
    """Another umask of this process within the block."""
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Fail with AssertionError if the block takes longer; for POSIX, in the main thread."""

    def fail(signum: int, frame: object) -> None:
        raise AssertionError(f"it waits: {seconds} s have passed")

    before = signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def run_python(code: str, *words: object, **variables: str) -> str:
    """What another Python prints that runs some code with words as arguments; it must end well."""
    command = [sys.executable, "-c", code, *map(str, words)]
    options = {"cwd": ROOT, "env": {**os.environ, **variables}}
    made = subprocess.run(command, **options, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    return made.stdout


def load_script(path: str) -> ModuleType:
    """The module of a script that is in no package, by its path in the checkout."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
