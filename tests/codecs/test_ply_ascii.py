"""Ascii PLY: one walk and the walk that keeps the place of every word, comments, odd headers."""

from __future__ import annotations

import struct
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.codecs import ply, ply_body
from msal_cli.errors import FormatError, InputError, MsalError
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


HEADER = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 3
property list uchar int vertex_indices
end_header
"""
VERTICES = "0 0 0.25\n1 0 0\n0 1 0\n0 0 1\n"
FACES = "3 0 1 2\n4 0 1 3 2\n3 1 2 3\n"
PLAIN = HEADER + VERTICES + FACES
BLENDER = "Created by Blender3D 2.43 - www.blender.org, source file: a b.blend\n"


def moved(file: ply.PlyFile) -> np.ndarray:
    """Positions of which the second is the file's."""
    vertices = file.vertices * 0.5 + 0.125
    vertices[1] = file.vertices[1]
    return vertices


BODY = ["comment one 1 2 3", *VERTICES.split("\n")[:2], "  obj_info 7", *VERTICES.split("\n")[2:]]
COMMENTED = HEADER + "\n".join([*BODY[:-1], "comment", FACES.replace("\n4", "\ncomment\tx\n4")])


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("text", [COMMENTED, COMMENTED.replace("1 0 0", "1e0 0 0", 1)])
def test_comments_among_records_stay_in_their_places(text, end):
    data = text.replace("\n", end).encode()
    file, plain = ply.read(data), ply.read(PLAIN.encode())
    assert np.array_equal(file.vertices, plain.vertices)
    assert np.array_equal(file.faces, plain.faces)
    assert file.warnings == ()
    vertices = moved(file)
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    old, new = data.split(end.encode()), output.split(end.encode())
    changed = [was for was, now in zip(old, new, strict=True) if was != now]
    assert changed == [b"0 0 0.25", b"0 1 0", b"0 0 1"]


@pytest.mark.parametrize("line", ["# one", "comments", "Comment one", "0 0 0.25 comment"])
def test_other_words_among_records_are_refused(line):
    with pytest.raises(MsalError):
        ply.read(PLAIN.replace("0 0 0.25", f"0 0 0.25\n{line}").encode())


@pytest.mark.parametrize(
    ("before", "stray"),
    [
        ("format", "modelname bunny\n"),
        ("element vertex", BLENDER),
        ("element vertex", "source: caf\u00e9\tb\n"),
        ("element face", "texture a.png\n"),
        ("property float z", "# of the scanner\n"),
        ("end_header", "coment Created by hand\n"),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_header_line_without_a_keyword_is_kept_like_a_comment(before, stray, end):
    data = PLAIN.replace(before, stray + before, 1).replace("\n", end).encode()
    file = ply.read(data)
    line = data[: data.index(stray.strip().encode())].count(end.encode()) + 1
    assert len(file.warnings) == 1
    assert "no known keyword" in file.warnings[0] and f"in line {line}" in file.warnings[0]
    vertices = moved(file)
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    size = data.index(b"end_header")
    assert output[:size] == data[:size]
    again = ply.read(file.encoded(vertices, "binary", "float64"))
    assert again.warnings == file.warnings
    assert np.array_equal(again.vertices, vertices)


def binary(stray: str = "") -> bytes:
    header = HEADER.replace("ascii", "binary_little_endian").replace("face 3", "face 1")
    corners = struct.pack("<12f", *(float(one) for one in VERTICES.split()))
    return header.replace("element face", stray + "element face").encode() + (
        corners + struct.pack("<B3i", 3, 0, 1, 2)
    )


def test_a_stray_line_among_elements_must_not_hide_data():
    assert len(ply.read(binary("polygons 1\n")).faces) == 1
    with pytest.raises(FormatError, match="'polygons 1' is not understood, and 4 bytes") as caught:
        ply.read(binary("polygons 1\n") + bytes(4))
    assert caught.value.where == "line 7"
    # Before the first element it declares nothing, and what follows the data is kept.
    data = binary().replace(b"element vertex", BLENDER.encode() + b"element vertex") + bytes(4)
    assert len(ply.read(data).warnings) == 2
