"""Kernels give what the plain functions give, and are compiled again only when they must be."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
import types

import numpy as np
import pytest

from msal_cli.core import compiled as module
from msal_cli.core import machine_code
from msal_cli.core.compiled import Kernel, compiled, kind

FACTOR = 3.0
TABLE = np.array([2, 5], dtype=np.int64)


@compiled
def scaled(values, result):
    for i in range(len(values)):
        result[i] = FACTOR * values[i]


@compiled
def scaled_sum(values, scratch):
    scaled(values, scratch)
    total = 0.0
    for i in range(len(scratch)):
        total += scratch[i]
    return total


@compiled
def described(values, number, is_odd):
    return len(values), number * 0.5, is_odd or TABLE[1] == number, values.shape[1]


@compiled
def column_sum(values):
    total = 0
    for i in range(values.shape[0]):
        total += values[i]
    return total


@compiled
def ratio(left, right):
    return left / right


@compiled
def room(size):
    return len(np.empty(size))


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MSAL_CACHE_DIR", str(tmp_path))
    return tmp_path


@pytest.fixture
def counted(monkeypatch):
    made = []
    real = Kernel._compiled
    monkeypatch.setattr(
        Kernel, "_compiled", lambda self, kinds: made.append(self.__name__) or real(self, kinds)
    )
    return made


def again(kernel):
    """The same kernel as a new process sees it."""
    return Kernel(kernel.function)


def test_arrays_are_written_and_numbers_come_back(cache):
    values, result = np.arange(5.0), np.empty(5)
    assert again(scaled)(values, result) is None
    assert np.array_equal(result, 3.0 * values)
    assert again(scaled_sum)(values, result) == 30.0
    answer = again(described)(np.zeros((4, 2)), 5, False)
    assert answer == (4, 2.5, True, 2)
    assert [type(one) for one in answer] == [int, float, bool, int]


@pytest.mark.parametrize("step", [1, 2, -1])
@pytest.mark.parametrize("dtype", [np.int8, np.uint16, np.int32, np.int64])
def test_types_and_strides_count(cache, dtype, step):
    values = np.arange(10, dtype=dtype)[::step]
    assert again(column_sum)(values) == values.sum()
    values.flags.writeable = False
    assert again(column_sum)(values) == values.sum()


def test_numbers_of_numpy_are_numbers(cache):
    kernel = again(described)
    for number in (np.int64(5), np.int32(5), 5):
        assert kernel(np.zeros((1, 1)), number, np.bool_(False)) == (1, 2.5, True, 1)
    assert kernel(np.zeros((1, 1)), np.float64(4.0), True)[1] == 2.0


def test_other_arguments_are_refused():
    with pytest.raises(TypeError, match="not list"):
        scaled([1.0], np.empty(1))
    assert kind(np.float64(1.0)) == kind(1.0) == "float64"
    assert kind(True) == "bool" and kind(1) == "int64"


def test_what_is_kept_is_not_compiled_again(cache, counted):
    values, result = np.arange(3.0), np.empty(3)
    again(scaled)(values, result)
    again(scaled)(values, result)
    assert counted == ["scaled"] and len(list(cache.glob("*.msal-kernel"))) == 1
    again(scaled)(values.astype(np.float32), result)
    assert counted == ["scaled"] * 2


def test_a_changed_constant_callee_or_body_is_compiled_again(cache, counted):
    def with_globals(kernel, **values):
        known = {**kernel.function.__globals__, **values}
        function = types.FunctionType(kernel.function.__code__, known, kernel.function.__name__)
        function.__module__ = kernel.function.__module__
        return Kernel(function)

    values, result = np.arange(3.0), np.empty(3)
    assert again(scaled_sum)(values, result) == 9.0
    assert with_globals(scaled_sum, scaled=with_globals(scaled, FACTOR=5.0))(values, result) == 15.0
    assert with_globals(scaled_sum)(values, result) == 9.0
    assert counted == ["scaled_sum"] * 2
    assert with_globals(described, TABLE=np.array([2, 7]))(np.zeros((1, 1)), 5, False)[2] is False


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "other"])
def test_a_damaged_file_is_made_again(cache, counted, damage):
    values, result = np.arange(3.0), np.empty(3)
    again(scaled)(values, result)
    (file,) = cache.glob("*.msal-kernel")
    data = bytearray(file.read_bytes())
    if damage == "flipped":
        data[-100] ^= 1
    file.write_bytes({"cut": data[:200], "flipped": data, "empty": b"", "other": b"x" * 99}[damage])
    again(scaled)(values, result)
    assert counted == ["scaled"] * 2
    again(scaled)(values, result)
    assert counted == ["scaled"] * 2


def test_a_place_that_cannot_be_written_costs_only_time(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("MSAL_CACHE_DIR", str(tmp_path / "file"))
    result = np.empty(2)
    again(scaled)(np.ones(2), result)
    assert (result == 3.0).all()


def test_the_users_folder_serves_where_the_package_cannot_be_written(tmp_path, monkeypatch):
    monkeypatch.delenv("MSAL_CACHE_DIR", raising=False)
    monkeypatch.setenv("LOCALAPPDATA" if os.name == "nt" else "XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "blocked").write_text("")
    monkeypatch.setattr(machine_code, "__file__", str(tmp_path / "blocked" / "machine_code.py"))
    again(scaled)(np.ones(2), np.empty(2))
    assert len(list((tmp_path / "msal").glob("*.msal-kernel"))) == 1


def test_who_waits_for_another_process_does_not_wait_for_ever(cache, counted, monkeypatch):
    pytest.importorskip("fcntl")
    monkeypatch.setattr(machine_code, "_LONGEST_WAIT_S", 0.05)
    program = (
        "import fcntl, sys\n"
        "handle = open(sys.argv[1], 'w')\n"
        "fcntl.lockf(handle, fcntl.LOCK_EX)\n"
        "print('locked', flush=True)\n"
        "sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", program, str(cache / ".msal-kernel-locks")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"locked\n"
        result = np.empty(2)
        again(scaled)(np.ones(2), result)
        other.stdin.close()
    assert (result == 3.0).all() and counted == ["scaled"]


@pytest.mark.parametrize("failure", [errno.ENOSPC, errno.EDQUOT, errno.EROFS])
def test_a_full_disk_costs_only_time(cache, monkeypatch, failure):
    def refused(path, data):
        path.touch()
        raise OSError(failure, os.strerror(failure))

    monkeypatch.setattr(machine_code.Path, "write_bytes", refused)
    result = np.empty(2)
    again(scaled)(np.ones(2), result)
    assert (result == 3.0).all()
    assert [one.name for one in cache.iterdir()] == [".msal-kernel-locks"]


def test_a_failure_in_a_kernel_is_an_exception(cache):
    with pytest.raises(RuntimeError, match="failed"):
        again(room)(-1)
    assert again(room)(7) == 7


def test_division_is_that_of_numpy(cache):
    assert again(ratio)(7.0, 2.0) == 3.5
    assert again(ratio)(1.0, 0.0) == np.inf


def test_without_the_way_into_numba_it_still_works(cache, monkeypatch):
    def gone(*arguments):
        raise AttributeError("changed inside")

    monkeypatch.setattr(Kernel, "_compiled", gone)
    result = np.empty(2)
    again(scaled)(np.ones(2), result)
    assert (result == 3.0).all() and not list(cache.glob("*.msal-kernel"))


def test_it_can_be_interpreted(monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    kernel = again(scaled)
    result = np.empty(2)
    kernel(np.ones(2), result)
    assert (result == 3.0).all()
    assert kernel._native[kind(np.ones(2)), kind(result)] is scaled.function


def test_threads_that_start_together_compile_once(cache, counted):
    kernel = again(scaled)
    results = [np.empty(4) for _ in range(8)]
    threads = [threading.Thread(target=kernel, args=(np.ones(4), one)) for one in results]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert counted == ["scaled"] and all((one == 3.0).all() for one in results)


def test_processes_that_start_together_share_the_cache_and_then_need_no_numba(cache):
    program = (
        "import numpy as np, sys\n"
        "from msal_cli.core.geometry import ring_means\n"
        "ring = np.array([1, 0], dtype=np.int32)\n"
        "means = ring_means(np.array([1.0, 2.0]), np.array([0, 1, 2], dtype=np.int32), ring)\n"
        "print(means.tolist(), 'numba' in sys.modules)\n"
    )
    processes = [
        subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    said = [process.communicate()[0] for process in processes]
    assert all(one.startswith("[2.0, 1.0]") for one in said)
    # Only one of them has compiled.
    assert [one.endswith("True\n") for one in said].count(True) == 1
    warm = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert warm.stdout == "[2.0, 1.0] False\n"
    assert not [one for one in cache.iterdir() if one.name.endswith(".tmp")]
    assert module.compiled is compiled
