"""Ascii PLY: one walk and the walk that keeps the place of every word, and other lines."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.codecs import ply, ply_body
from msal_cli.errors import InputError, MsalError
from tests.codecs.patching import any_float

WORDS = [b"1e-5", b"-2.5E+3", b"+1", b".5", b"3.", b"123456789012", b"0.1234567890123"]


def files(random: Random) -> bytes:
    """An ascii PLY file of a few vertices and faces, often with more than positions."""
    newline = random.choice([b"\n", b"\r\n", b"\r"])
    blank = random.choice([b" ", b"  ", b"\t"])
    is_plain = random.random() < 0.5

    def word() -> bytes:
        value = any_float(random, 1e4)
        forms = [b"%.4f" % value, repr(value).encode(), random.choice(WORDS)]
        return b"%.6f" % (value / 1e3) if is_plain else random.choice(forms)

    scalars = random.choice([
        "x y z", "x y z nx ny nz", "red x y z", "y x z", "x y q z", "nx ny nz x y z alpha", "z y x",
    ]).split()  # fmt: skip
    more = random.choice(["", "quality", "nx ny nz"]).split()
    n = random.randint(3, 8)
    faces = [
        random.choices(range(n), k=random.choice([3, 3, 3, 4, 2]))
        for _ in range(random.randint(1, 6))
    ]
    head = [b"ply", b"format ascii 1.0", b"element vertex %d" % n]
    head += [b"property float %s" % name.encode() for name in scalars]
    head += [b"element face %d" % len(faces)]
    head += [b"property list uchar int vertex_indices"]
    head += [b"property float %s" % name.encode() for name in more] + [b"end_header"]
    lines = [blank.join(word() for _ in scalars) for _ in range(n)]
    for face in faces:
        words = [b"%d" % one for one in (len(face), *face)]
        lines.append(blank.join([*words, *(word() for _ in more)]))
    ending = random.choice([b"", newline, b" " + newline + b" tail" + newline])
    space = random.choice([b"", b"", b" ", newline])
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


@given(st.randoms(use_true_random=True), st.binary(max_size=2), st.integers(0, 9))
def test_both_walks_read_and_write_the_same(random: Random, noise: bytes, seed: int) -> None:
    data = files(random)
    body = data.index(b"end_header") + 12
    at = random.randrange(body, len(data))
    data = data[:at] + noise + data[at + len(noise) :]
    plain = outcome(data, seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ply_body, "_plain_lines", lambda *_: None)
        assert plain == outcome(data, seed)


def test_a_normal_that_stays_keeps_its_spelling(monkeypatch):
    names = ("double x", "double y", "double z", "double nx", "double ny", "double nz")
    rows = "0 0 0 0 -0.0 1.00\n1 0 0 0 -0.0 1.00\n0 1 0 0 -0.0 1.00"
    expected = [b"0 -0.0 1.00"] * 3
    for is_slow in (False, True):
        if is_slow:
            monkeypatch.setattr(ply_body, "_plain_lines", lambda *_: None)
        file = ply.read(vertices_of(*names, rows=rows))
        lines = bytes(file.replaced(file.vertices * [[2.0, 1.0, 1.0]])).splitlines()
        vertices = lines[lines.index(b"end_header") + 1 :][:3]
        assert [line.split(b" ", 3)[3] for line in vertices] == expected
        assert vertices[1].startswith(b"2")


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


@pytest.mark.parametrize("line", ["# one", "comment one", "0 0 0.25 comment"])
def test_other_words_among_records_are_refused(line):
    with pytest.raises(MsalError):
        ply.read(vertices_of("float x", "float y", "float z", rows=f"0 0 0\n{line}\n1 0 0\n0 1 0"))
