"""All that fuzzing ever found is run again: errors of ours and whole results, in bounded memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest

from tests.fuzz import corpus, mutants, survival


@pytest.mark.parametrize("format", survival.FORMATS)
def test_the_whole_corpus(format):
    found = corpus.kept(format)
    assert len(found) >= 50
    ends = set()
    for data in mutants.seeds(format):
        survival.outcome(data, format)  # libraries and kernels are loaded
    for name, data in found.items():
        try:
            ends.add(survival.outcome(data, format))
        except BaseException as failure:
            raise AssertionError(f"{name} in corpus/{format}.tar.xz") from failure
    tracemalloc.start()  # makes all several times slower
    for data in list(found.values())[::7]:
        survival.outcome(data, format)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert {"ok", "E_FORMAT", "E_TRUNCATED", "E_NO_FACES", "E_NONFINITE"} <= ends
    assert peak < 20_000_000


def test_the_corpus_is_small():
    assert sum(path.stat().st_size for path in corpus.FOLDER.iterdir()) < 200_000


def test_what_is_kept_can_be_kept_again(tmp_path, monkeypatch):
    found = corpus.kept("gz")
    for name, data in found.items():
        (tmp_path / name).write_bytes(data)
    before = (corpus.FOLDER / "gz.tar.xz").read_bytes()
    monkeypatch.setattr(corpus, "FOLDER", tmp_path / "again")
    assert corpus.keep("gz", tmp_path) == len(found)
    assert corpus.kept("gz") == found
    assert len((tmp_path / "again" / "gz.tar.xz").read_bytes()) <= len(before) * 1.05


@pytest.mark.slow
@pytest.mark.parametrize("format", survival.FORMATS)
def test_no_kernel_leaves_its_arrays(format):
    # Compiled kernels do not notice an index beyond an array; as Python they raise IndexError.
    code = (
        "import numpy, sys; numpy.seterr(all='ignore')\n"
        "from tests.fuzz import corpus, survival\n"
        "for data in corpus.kept(sys.argv[1]).values(): survival.outcome(data, sys.argv[1])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, format],
        env={**os.environ, "MSAL_INTERPRET_KERNELS": "1"},
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
