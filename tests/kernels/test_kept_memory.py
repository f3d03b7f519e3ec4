"""The memory of arrays that have ended, which the next ones take."""

import numpy as np
import pytest

from msal_cli.kernels import array_files
from tests.files import run_python

pytestmark = pytest.mark.skipif(not array_files.can_use_files(), reason="maps memory as numpy does")

MEGABYTE = 1 << 17  # numbers


def test_arrays_keep_what_is_theirs():
    draws = np.random.default_rng(3)
    arrays: list[tuple[np.ndarray, float]] = []
    with array_files.kept_memory():
        for value in range(400):
            size = int(draws.integers(MEGABYTE, 9 * MEGABYTE))
            if value % 3:
                new = np.zeros(size)
                assert not new.any()
            else:
                new = np.full(size, -1.0)
                new.resize(int(draws.integers(1, 2 * size)), refcheck=False)
                assert (new[: min(size, len(new))] == -1.0).all()
            new[:] = value
            arrays.append((new, float(value)))
            if len(arrays) > 6:
                old, wanted = arrays.pop(int(draws.integers(len(arrays))))
                assert (old == wanted).all()
                del old
    assert all((array == wanted).all() for array, wanted in arrays)


WAY = """
import sys
import numpy as np
from contextlib import nullcontext
from msal_cli import machine
from msal_cli.kernels import array_files

with array_files.kept_memory() if sys.argv[1] == "kept" else nullcontext():
    machine.forget_peak()
    for sizes in ((60, 50), (30, 90), (100, 5, 5), (20, 20, 20, 40)):
        arrays = [np.ones(megabytes << 17) for megabytes in sizes]
        del arrays
print(machine.peak_bytes(), machine.memory_bytes("VmRSS"))
"""


def test_no_more_is_kept_than_arrays_took():
    found = (map(int, run_python(WAY, word).split()) for word in ("kept", "not"))
    for kept, usual in zip(*found, strict=True):
        assert kept < usual + (8 << 20)


def test_memory_is_taken_again():
    import resource

    def count_faults():
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(20):
            np.ones(3 * MEGABYTE)
        return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

    with array_files.kept_memory():
        above = np.ones(30 * MEGABYTE)
        del above
        assert count_faults() < 300
