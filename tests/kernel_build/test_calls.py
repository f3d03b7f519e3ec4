"""Kernels in a shared library give what the plain functions give."""

import ctypes
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from kernel_build import linking, objects
from kernel_build.targets import TARGETS, native_target
from kernel_build.written import written_arguments
from msal_cli.errors import InternalError
from msal_cli.kernels import library
from msal_cli.kernels.library import arg_type
from tests.files import run_python
from tests.kernel_build import some_kernels as some

pytestmark = pytest.mark.ci

ROWS, COLUMN = np.zeros((4, 2)), np.zeros(5)

CALLS = [
    (some.scaled, COLUMN, COLUMN),
    (some.scaled_sum, COLUMN, COLUMN),
    (some.described, ROWS, 5, False),
    (some.described, ROWS, 5.0, True),
    *[
        (some.column_sum, np.zeros(6, dtype)[::step])
        for dtype in (np.int8, np.uint16, np.int64)
        for step in (1, 2)
    ],
    (some.room, 1),
    (some.functions, 1.0, 1.0),
]
"""Kernels with arguments of the types that the library has them for."""


def lower_small(name, line):
    """A small kernel for the argument types of a line."""
    return objects.lower(getattr(some, name), line)


@pytest.fixture(scope="session")
def build(tmp_path_factory):
    """A function that builds a library of all small kernels with a compiler."""
    target = TARGETS[native_target()]
    folder = tmp_path_factory.mktemp("kernels")
    entries, files = {}, []
    # A process that compiles as those of a build do.
    context = multiprocessing.get_context("spawn")
    compiler_process = ProcessPoolExecutor(1, context, objects._prepare_worker)
    for kernel, *arguments in CALLS:
        line = library.signature(kernel.name, tuple(map(arg_type, arguments)))
        symbol = f"kernel{len(entries)}"
        lowered = compiler_process.submit(lower_small, kernel.__name__, line)
        ir, entry, results = lowered.result()
        entries[line] = library.Entry(symbol, results, written_arguments(kernel))
        for suffix, processor in target.processors.items():
            files.append(folder / f"{symbol}{suffix}.o")
            made = objects.to_object(ir, entry, symbol + suffix, target.triple, processor)
            files[-1].write_bytes(made)
    compiler_process.shutdown()

    def build_with(compiler):
        path = folder / f"{len(compiler)}{target.suffix}"
        linking.link(files, target, compiler, path)
        return ctypes.CDLL(str(path)), entries

    return build_with


@pytest.fixture(scope="session")
def call(build):
    """A function that calls a kernel of the library."""
    loaded, entries = build(linking.system_compiler() or linking.ZIG)

    def call_with(kernel, *arguments):
        arg_types = tuple(map(arg_type, arguments))
        entry = entries[library.signature(kernel.name, arg_types)]
        return library.bind(loaded, entry, arg_types)(*arguments)

    return call_with


def test_arrays_are_written_and_numbers_come_back(call):
    values, result = np.arange(5.0), np.empty(5)
    assert call(some.scaled, values, result) is None
    assert np.array_equal(result, 3.0 * values)
    assert call(some.scaled_sum, values, result) == 30.0
    answer = call(some.described, np.zeros((4, 2)), 5, False)
    assert answer == (4, 2.5, True, 2)
    assert [type(number) for number in answer] == [int, float, bool, int]


@pytest.mark.parametrize("step", [1, 2, -1])
@pytest.mark.parametrize("dtype", [np.int8, np.uint16, np.int64])
def test_types_and_strides_count(call, dtype, step):
    values = np.arange(10, dtype=dtype)[::step]
    assert call(some.column_sum, values) == values.sum()
    # The kernel does not write to it: no other code is needed.
    values.flags.writeable = False
    assert call(some.column_sum, values) == values.sum()


def test_arrays_need_not_be_aligned(call):
    values = np.zeros(1 + 8 * 33, dtype=np.uint8)[1:].view(np.float64)
    values[:], result = np.arange(33.0), np.empty(33)
    assert not values.flags.aligned
    assert call(some.scaled_sum, values, result) == 3.0 * values.sum()


def test_a_read_only_array_is_not_written(call):
    result = np.zeros(3)
    result.flags.writeable = False
    with pytest.raises(ValueError, match=r"argument 1 .* is read-only"):
        call(some.scaled, np.ones(3), result)
    assert not result.any()


def test_a_failure_in_a_kernel_is_an_exception(call):
    with pytest.raises(RuntimeError, match="failed"):
        call(some.room, -1)
    assert call(some.room, 7) == 7


def test_zig_links_what_the_systems_compiler_links(build):
    pytest.importorskip("ziglang")
    loaded, entries = build(linking.ZIG)
    arg_types = (arg_type(np.ones(1)),) * 2
    entry = entries[library.signature(some.scaled_sum.name, arg_types)]
    kernel = library.bind(loaded, entry, arg_types)
    assert kernel(np.arange(3.0), np.empty(3)) == 9.0


def test_a_level_that_is_not_there_is_an_error(build, monkeypatch):
    monkeypatch.setenv("MSAL_CPU", "v9")
    loaded, _ = build(linking.system_compiler() or linking.ZIG)
    if not loaded.msal_cpu_level():
        pytest.skip("this kind of processor has one level")
    with pytest.raises(InternalError, match="MSAL_CPU is v9"):
        library.level_suffix(loaded)


_OBJECT = """
import hashlib, sys
from kernel_build import objects
from kernel_build.signatures import kernel_of
objects._prepare_worker()
for line in sys.argv[1:]:
    ir, entry, _ = objects.lower(kernel_of(line), line)
    made = objects.to_object(ir, entry, "kernel", "x86_64-unknown-linux-gnu", "x86-64-v3")
    print(line, hashlib.sha256(made).hexdigest())
"""


@pytest.mark.slow
def test_objects_do_not_depend_on_what_was_compiled_before():
    lines = ["welding._mark(i4[::1], b1[::1])", "text.parse_integer(u1[::1], i8, i8)"]
    orders = (lines, lines[::-1])
    sums = [sorted(run_python(_OBJECT, *order).splitlines()) for order in orders]
    assert sums[0] == sums[1] and len(sums[0]) == 2
