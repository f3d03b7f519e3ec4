"""Large arrays go back to the system, where the C library can be told so."""

from __future__ import annotations

import subprocess
import sys

import pytest

from msal_cli.machine import give_back_large_arrays

SEEN = """
import os, sys
import numpy as np
from msal_cli.machine import give_back_large_arrays

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

give_back_large_arrays()
np.ones(7 << 19)  # glibc would from now on keep what is not larger
before = resident()
arrays = [np.ones(3 << 19) for _ in range(4)]
small = np.ones(1 << 10)
del arrays
print(resident() - before < 16 << 20)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_what_is_let_go_of_goes_back():
    run = subprocess.run([sys.executable, "-c", SEEN], capture_output=True, text=True, check=True)
    assert run.stdout == "True\n"


def test_the_environment_has_the_last_word(monkeypatch):
    import ctypes

    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "1000000")
    monkeypatch.setattr(ctypes, "CDLL", lambda name: pytest.fail("asked"))
    give_back_large_arrays.__wrapped__()
