"""A library of small kernels, built once."""

from __future__ import annotations

import ctypes
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from kernel_build import linking, objects
from kernel_build.targets import TARGETS, native_target
from kernel_build.written import written_arguments
from msal_cli.kernels import library
from msal_cli.kernels.compiled import arg_type
from tests.kernel_build import some_kernels as some

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
    (some.ratio, 1.0, 1.0),
    (some.room, 1),
    (some.functions, 1.0, 1.0),
]
"""Kernels with arguments of the types that the library has them for."""


@pytest.fixture(scope="session")
def compiler_process():
    """A process that compiles as those of a build do."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, objects._prepare_worker) as pool:
        yield pool


def lower_small(name, line):
    """A small kernel for the argument types of a line."""
    return objects.lower(getattr(some, name), line)


@pytest.fixture(scope="session")
def build(tmp_path_factory, compiler_process):
    """A function that builds a library of all small kernels with a compiler."""
    target = TARGETS[native_target()]
    folder = tmp_path_factory.mktemp("kernels")
    entries, files = {}, []
    for kernel, *arguments in CALLS:
        line = library.signature(kernel.name, tuple(map(arg_type, arguments)))
        symbol = f"kernel{len(entries)}"
        lowered = compiler_process.submit(lower_small, kernel.__name__, line)
        ir, entry, results = lowered.result()
        entries[line] = library.Entry(symbol, results, written_arguments(kernel), "")
        for suffix, processor in target.processors.items():
            files.append(folder / f"{symbol}{suffix}.o")
            made = objects.to_object(ir, entry, symbol + suffix, target.triple, processor)
            files[-1].write_bytes(made)

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
