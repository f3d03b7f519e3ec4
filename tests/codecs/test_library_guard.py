"""Libraries made harmless."""

from __future__ import annotations

import contextlib
import logging
import sys
import time
import warnings

import numpy as np
import pytest

from msal_cli.codecs import library_guard as guard
from msal_cli.codecs.library_guard import guarded
from msal_cli.errors import FormatError, ResourceError, TooLargeError, UnsupportedError


def run(call, size=0):
    return guarded(call, "lib", "read this XYZ file", size)


def test_the_result_comes_back():
    assert run(lambda: 42) == (42, ())


def test_what_is_printed_becomes_notes(capfd):
    def talk():
        print("Warning: one")
        print("two\n\ntwo", file=sys.stderr)
        logging.getLogger("trimesh").error("three")
        warnings.warn("four", stacklevel=1)
        np.float32(3e38) * np.float32(10)
        return 1

    assert run(talk) == (1, ("lib: one", "lib: two"))
    assert capfd.readouterr() == ("", "")
    assert not logging.getLogger("trimesh").disabled


def test_a_flood_of_notes_is_cut():
    assert len(run(lambda: [print(k) for k in range(1000)])[1]) == 5


@pytest.mark.parametrize(
    ("failure", "kind"),
    [
        (SystemExit(1), FormatError),
        (ValueError("bad things"), FormatError),
        (AssertionError(), FormatError),
        (RecursionError("deep"), FormatError),
        (KeyError("x"), FormatError),
        (UnicodeDecodeError("ascii", b"\xff", 0, 1, "no"), FormatError),
        (MemoryError(), TooLargeError),
        (NotImplementedError("curves"), UnsupportedError),
        (ModuleNotFoundError("No module named 'h5py'", name="h5py"), UnsupportedError),
        (ImportError("missing `pip install pycollada`"), UnsupportedError),
    ],
    ids=lambda x: getattr(x, "__name__", None) or type(x).__name__,
)
def test_every_way_to_fail_is_an_error_of_ours(failure, kind):
    def fail():
        raise failure

    with pytest.raises(kind) as caught:
        run(fail)
    assert "lib" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_packages_are_named():
    for failure, package in (
        (ModuleNotFoundError("No module named 'h5py'", name="h5py"), "h5py"),
        (ModuleNotFoundError("No module named 'collada'", name="collada"), "pycollada"),
        (ImportError("missing `pip install pycollada`"), "pycollada"),
    ):

        def fail(failure=failure):
            raise failure

        with pytest.raises(UnsupportedError) as caught:
            run(fail)
        assert caught.value.hint == f"pip install {package}"


def test_what_was_printed_before_an_exit_is_the_reason():
    def fail():
        print("Error: Couldn't read file x as y")
        sys.exit(1)

    with pytest.raises(FormatError, match="Couldn't read file x as y"):
        run(fail)


def test_failing_to_write_is_no_fault_of_the_file():
    def fail():
        raise ValueError("no")

    with pytest.raises(UnsupportedError):
        guarded(fail, "lib", "write a XYZ file", 0)


def test_long_reasons_are_cut():
    def fail():
        raise ValueError("x" * 10_000)

    with pytest.raises(FormatError) as caught:
        run(fail)
    assert len(str(caught.value)) < 300


def test_an_interrupt_passes():
    def fail():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(fail)


def endless():
    while True:
        with contextlib.suppress(Exception):
            sum(range(100))


def stubborn():
    swallowed = 0
    while swallowed < 2:
        try:
            while True:
                sum(range(100))
        except BaseException:
            swallowed += 1
    endless()


@pytest.mark.parametrize("call", [endless, stubborn])
def test_an_endless_loop_ends(monkeypatch, call):
    monkeypatch.setattr(guard, "LEAST_S", 0.2)
    start = time.monotonic()
    with pytest.raises(ResourceError) as caught:
        run(call)
    assert caught.value.code == "E_TIMEOUT"
    assert time.monotonic() - start < 20
    # Nothing arrives late.
    for _ in range(1000):
        sum(range(1000))


def test_larger_files_have_more_time(monkeypatch):
    monkeypatch.setattr(guard, "LEAST_S", 0.05)
    run(lambda: time.sleep(0.3), size=1_000_000)


def test_calls_that_end_about_the_limit_never_leak_the_exception(monkeypatch):
    def work():
        end = time.monotonic() + 0.002
        while time.monotonic() < end:
            pass

    monkeypatch.setattr(guard, "LEAST_S", 0.002)
    ended = late = 0
    for _ in range(200):
        try:
            run(work)
            ended += 1
        except ResourceError:
            late += 1
        for _ in range(50):
            sum(range(10))
    assert ended + late == 200


def test_a_temporary_folder_is_not_named():
    def fail():
        raise OSError(28, "No space left on device", "/tmp/msal-a_1B2c3d/mesh.vtu")

    with pytest.raises(UnsupportedError, match=r"No space left on device: 'mesh\.vtu'"):
        guarded(fail, "lib", "write a VTU file", 0)
