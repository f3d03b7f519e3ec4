"""What is read from the source of a kernel: its hash, and the arguments that it writes to."""

import types

import numpy as np
import pytest

from kernel_build.signatures import arg_types_of, kernel_of, listed
from kernel_build.sources import check_library, source_hash
from kernel_build.written import written_arguments
from msal_cli.kernels import geometry, library, umbrellas, vectors
from msal_cli.kernels.library import Kernel, compiled
from tests.kernel_build import some_kernels as some


def with_globals(kernel, code=None, **values):
    names, code = {**kernel.function.__globals__, **values}, code or kernel.function.__code__
    function = types.FunctionType(code, names, kernel.function.__name__)
    function.__module__ = kernel.function.__module__
    return Kernel(function)


def test_the_hash_is_of_the_body_constants_and_callees_but_not_of_docstrings():
    same = source_hash(with_globals(some.scaled_sum))
    code = some.scaled_sum.function.__code__
    code = code.replace(co_consts=("Another text.", *code.co_consts[1:]))
    assert same == source_hash(some.scaled_sum) == source_hash(with_globals(some.scaled_sum, code))
    other_callee = with_globals(some.scaled, FACTOR=5.0)
    hashes = {
        same,
        source_hash(some.scaled),
        source_hash(other_callee),
        source_hash(with_globals(some.scaled_sum, scaled=other_callee)),
        source_hash(with_globals(some.scaled, FACTOR=3)),
        source_hash(some.described),
        source_hash(with_globals(some.described, TABLE=np.array([2, 7]))),
    }
    assert len(hashes) == 7


@compiled
def by_views(values, words, rows, unused):
    bits = values.view(np.int64)
    row = rows[1]
    first, second = unused, words
    for at in range(2):
        bits[at] += 1
        row[at] = second[at]
    return first[0]


@compiled
def by_chance(left, right, is_left):
    target = left if is_left else right
    target[0] = 1.0


scaled_sum = some.scaled_sum


@compiled
def through_callee(scratch, values):
    return scaled_sum(values, scratch[1:])


@compiled
def in_a_loop(rows, order, result):
    for row in rows:
        row[0] = 0.0
    order[::2].sort()
    result[0], result[1] = order[0], order[1]


@pytest.mark.parametrize(
    "kernel, expected",
    [
        (some.scaled, {1}),
        (some.scaled_sum, {1}),
        (some.described, set()),
        (by_views, {0, 2}),
        (by_chance, {0, 1}),
        (through_callee, {0}),
        (in_a_loop, {0, 1, 2}),
    ],
)
def test_written_arguments(kernel, expected):
    assert written_arguments(kernel) == expected


def test_every_line_names_a_kernel_and_its_arguments():
    for line in listed():
        code = kernel_of(line).function.__code__
        assert len(arg_types_of(line)) == code.co_argcount, line
    assert list(listed()) == sorted(set(listed()))


def test_an_edited_kernel_is_an_error(monkeypatch, tmp_path):
    check_library()
    monkeypatch.setattr(library, "TABLE", tmp_path / "table.txt")
    library.TABLE.write_text(f"{listed()[0]}\tsymbol\tf8\t0\t0123\n")
    with pytest.raises(SystemExit, match="was edited: python -m kernel_build"):
        check_library()


def test_kernels_that_are_called_by_their_module_belong_to_the_source(monkeypatch):
    before = source_hash.__wrapped__(geometry._distances)
    assert source_hash.__wrapped__(geometry._distances) == before
    monkeypatch.setattr(vectors, "norm", vectors.is_zero)
    assert source_hash.__wrapped__(geometry._distances) != before
    assert written_arguments(umbrellas._umbrella) == {5}
