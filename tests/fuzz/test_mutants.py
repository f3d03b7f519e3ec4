"""Damaged files end in an error of ours or in a whole result, whatever was done to them.

`python -m tests.fuzz.mutants` runs 30,000 of each format and says how fast.
"""

import gzip
import tracemalloc

import numpy as np
import pytest

from msal_cli import codecs
from msal_cli.job import pipeline
from msal_cli.job.settings import Task
from tests.files import run_python
from tests.frozen import corpus_sums
from tests.fuzz import mutants, survival
from tests.fuzz.seeds import CORPUS, kept
from tests.job.test_pipeline import settings


@pytest.mark.parametrize("format", survival.FORMATS)
def test_the_whole_corpus(format):
    """All that fuzzing found is run again, in bounded memory."""
    found = kept(format)
    assert len(found) >= 50
    ends = set()
    for data in mutants.seeds(format):
        whole = gzip.compress(data) if format == "gz" else data
        assert survival.outcome(whole, format) == "ok"
    for name, data in found.items():
        try:
            ends.add(survival.outcome(data, format))
        except BaseException as failure:
            raise AssertionError(f"{name} in corpus/{format}.tar.xz") from failure
    tracemalloc.start()  # makes all several times slower
    for data in list(found.values())[::21]:
        survival.outcome(data, format)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert {"ok", "E_FORMAT", "E_TRUNCATED", "E_NO_FACES", "E_NONFINITE"} <= ends
    assert peak < 20_000_000
    assert sum(path.stat().st_size for path in CORPUS.iterdir()) < 200_000


@pytest.mark.slow
@pytest.mark.parametrize("format", survival.FORMATS)
def test_no_kernel_leaves_its_arrays(format):
    # Compiled kernels do not notice an index beyond an array; as Python they raise IndexError.
    code = (
        "import numpy, sys; numpy.seterr(all='ignore')\n"
        "from tests.fuzz import seeds, survival\n"
        "for data in seeds.kept(sys.argv[1]).values(): survival.outcome(data, sys.argv[1])\n"
    )
    run_python(code, format, MSAL_INTERPRET_KERNELS="1")


@pytest.mark.parametrize("format", corpus_sums.formats())
def test_mutants(format):
    # The first hundred are those of the frozen sums.
    tally, _ = mutants.campaign(format, 100, first=100)
    # Both ends of the scale must be met, or the damage is too mild or too rough to tell.
    assert 0.02 * tally.total() < tally["ok"] < 0.95 * tally.total()
    assert len(tally) >= 4


@pytest.mark.parametrize("format", [name for name in survival.FORMATS if name != "gz"])
def test_mutants_through_the_whole_pipeline(format, tmp_path):
    """A typed failure or a whole output, and nothing else."""
    source, target = tmp_path / f"scan.{format}", tmp_path / "out" / f"scan.{format}"
    target.parent.mkdir()
    task, chosen = Task(str(source), str(target), source.name), settings(iterations=2)
    n_written = 0
    for number in range(60):
        source.write_bytes(mutants.mutant(format, number))
        record = pipeline.denoise_file(task, chosen)
        if record.error is None:
            n_written += record.status == "written"
            after = codecs.open_mesh(target.read_bytes(), source.name)
            assert np.isfinite(after.vertices).all()
            assert len(after.faces) == record.triangles
            target.unlink()
        else:
            assert record.error.code != "E_INTERNAL", (number, record.error)
            assert record.error.message
        assert not list(target.parent.iterdir()), "something was left behind"
    assert 0 < n_written < 60
