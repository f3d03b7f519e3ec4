"""Ascii PLY in one walk: the same as the walk that keeps the place of every word."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.codecs import ply, ply_body
from msal_cli.errors import InputError

WORDS = st.one_of(
    st.floats(-1e4, 1e4).map(lambda v: b"%.4f" % v),
    st.floats(-1e4, 1e4).map(lambda v: repr(v).encode()),
    st.sampled_from(
        [b"1e-5", b"-2.5E+3", b"+1", b".5", b"3.", b"123456789012", b"0.1234567890123"]
    ),
)


@st.composite
def files(draw: st.DrawFn) -> bytes:
    """An ascii PLY file of a few vertices and faces, often with more than positions."""
    newline = draw(st.sampled_from([b"\n", b"\r\n", b"\r"]))
    blank = draw(st.sampled_from([b" ", b"  ", b"\t"]))
    word = WORDS if draw(st.booleans()) else st.floats(-9, 9).map(lambda v: b"%.6f" % v)
    scalars = list(draw(st.sampled_from([
        "x y z", "x y z nx ny nz", "red x y z", "y x z", "x y q z", "nx ny nz x y z alpha", "z y x",
    ])).split())  # fmt: skip
    more = draw(st.sampled_from(["", "quality", "nx ny nz"])).split()
    n = draw(st.integers(3, 8))
    faces = [
        [draw(st.integers(0, n - 1)) for _ in range(draw(st.sampled_from([3, 3, 3, 4, 2])))]
        for _ in range(draw(st.integers(1, 6)))
    ]
    head = [b"ply", b"format ascii 1.0", b"element vertex %d" % n]
    head += [b"property float %s" % name.encode() for name in scalars]
    head += [b"element face %d" % len(faces)]
    head += [b"property list uchar int vertex_indices"]
    head += [b"property float %s" % name.encode() for name in more] + [b"end_header"]
    lines = [blank.join(draw(word) for _ in scalars) for _ in range(n)]
    for face in faces:
        words = [b"%d" % one for one in (len(face), *face)]
        lines.append(blank.join([*words, *(draw(word) for _ in more)]))
    ending = draw(st.sampled_from([b"", newline, b" " + newline + b" tail" + newline]))
    space = draw(st.sampled_from([b"", b"", b" ", newline]))
    return newline.join(head) + newline + (space + newline).join(lines) + ending


def outcome(data: bytes, seed: int) -> list[Any]:
    """What is read and written of a file, or the error."""
    try:
        file = ply.read(data)
    except InputError as error:
        return [str(error), error.where]
    vertices = file.vertices.copy()
    vertices += np.random.default_rng(seed).normal(size=vertices.shape) * [[1e-2, 1e-9, 0.0]]
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    arrays = (file.vertices, file.faces)
    return [*(one.tobytes() for one in arrays), file.n_polygons, file.warnings, output]


@given(files(), st.binary(max_size=2), st.integers(0, 10**9), st.integers(0, 9))
def test_both_walks_read_and_write_the_same(
    data: bytes, noise: bytes, place: int, seed: int
) -> None:
    body = data.index(b"end_header") + 12
    at = body + place % (len(data) - body)
    data = data[:at] + noise + data[at + len(noise) :]
    plain = outcome(data, seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ply_body, "_plain_lines", lambda *_: None)
        assert plain == outcome(data, seed)


def scan(lines: list[bytes]) -> bytes:
    return (
        b"ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        % len(lines)
        + b"\n".join([*lines, b"3 0 1 2\n"])
    )


def test_a_position_has_the_decimals_of_its_own_line() -> None:
    lines = [b"%.3f %.3f 0" % (math.cos(k / 100), math.sin(k / 100)) for k in range(600)]
    lines[7] = b"0.997551000253279572 0.069942847337532768 0"
    file = ply.read(scan(lines))
    output = bytes(file.replaced(file.vertices + 1e-4)).split(b"\n")
    decimals = [{len(w.partition(b".")[2]) for w in one.split()} for one in output[9:-2]]
    assert decimals == [{15} if k == 7 else {7} for k in range(600)]


def test_many_items_in_a_list_find_room() -> None:
    lines = [b"%.3f %.3f 0" % (math.cos(k / 100), math.sin(k / 100)) for k in range(600)]
    wide = b"600 " + b" ".join(b"%d" % k for k in range(600))
    file = ply.read(scan(lines).replace(b"3 0 1 2", wide))
    assert (len(file.faces), file.faces[-1].tolist()) == (598, [0, 598, 599])


def vertices_of(*properties: str, rows: str) -> bytes:
    """An ascii PLY file of three vertices and one triangle."""
    head = [
        "ply",
        "format ascii 1.0",
        "element vertex 3",
        *(f"property {one}" for one in properties),
    ]
    head += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    return "\n".join([*head, rows, "3 0 1 2", ""]).encode()


@pytest.mark.parametrize("token", ["0.5^2", "0,5", "1e-5x", "0.1234567890123456789_1"])
def test_a_number_ends_with_its_token(token):
    columns = "float x", "float y", "float z", "uchar red"
    data = vertices_of(*columns, rows=f"0 0 0 1\n1 0 {token}\n0 1 0 1")
    with pytest.raises(InputError) as caught:
        ply.read(data)
    assert "vertex 1" in str(caught.value.where)


def test_a_fraction_in_a_column_of_whole_numbers_is_kept_where_it_is_not_moved():
    file = ply.read(vertices_of("int x", "int y", "float z", rows="-1.5 0 0\n5 0 0\n0 5 0"))
    vertices = file.vertices + [[0.0, 0.0, 0.25], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert b"\n-1.5 0 0" in output and b"\n7 0 0\n0 5 0\n" in output


def test_letters_behind_a_number_do_not_stand_for_the_next_one() -> None:
    data = scan([b"0 0 0 7", b"0 0 1.0`1", b"0 1 0 7"])
    data = data.replace(b"element face", b"property uchar red\nelement face")
    with pytest.raises(InputError, match="fewer values"):
        ply.read(data)
