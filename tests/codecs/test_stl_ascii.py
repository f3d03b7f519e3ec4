"""Ascii STL: forms of text, tokens replaced, and breaks of the format that others read."""

from __future__ import annotations

import re
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.codecs import header, stl
from msal_cli.codecs.stl import MIN_FACET_BYTES
from tests.codecs import plain_stl
from tests.codecs.plain_stl import tetrahedron
from tests.codecs.test_stl import corners_of, moved, soups

NUMBER = re.compile(rb"(?<=[\s])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?=[\s])")


def read(text: str | bytes) -> stl.StlTextFile:
    file = stl.read(text.encode() if isinstance(text, str) else text)
    assert file.encoding == "ascii"
    return file


def corner_tokens(data: bytes) -> list[list[bytes]]:
    """The three words behind each ``vertex``, in order."""
    words = data.split()
    at = [k for k, word in enumerate(words) if word.lower() == b"vertex"]
    return [words[k + 1 : k + 4] for k in at]


def blanked(data: bytes) -> bytes:
    return NUMBER.sub(b"#", data)


SPACES = [" ", "  ", "\t", " \t ", "\n", "\r\n", "\n\n  "]
FORMS = ["{}", "{:.9g}", "{:.3f}", "{:e}", "{:+.5E}", "{:.0f}", "{:.20f}"]


def texts(random: Random, corners: np.ndarray) -> bytes:
    """Any ascii STL that the format allows, with these corners."""
    case, form = random.choice([str.lower, str.upper, str.title]), random.choice(FORMS)
    newline = random.choice(["\n", "\r\n", "\r"])

    def gap() -> str:
        return random.choice(SPACES)

    parts = [random.choice(["", " \n", "\ufeff"]), case("solid"), " a name", newline]
    for corner in corners:
        parts += [case("facet"), gap(), case("normal")]
        for _ in range(3):
            parts += [gap(), random.choice(["0", "1.0", "-1e0", "nan", "-nan(ind)"])]
        parts += [gap(), case("outer"), gap(), case("loop")]
        for k in range(9):
            if k % 3 == 0:
                parts += [gap(), case("vertex")]
            parts += [gap(), form.format(corner[k])]
        parts += [gap(), case("endloop"), gap(), case("endfacet"), gap()]
    parts += [case("endsolid"), " a name", random.choice(["", newline, newline + "\0"])]
    return "".join(parts).encode()


TEXTS = st.builds(texts, st.randoms(use_true_random=True), soups(4))


@given(TEXTS)
def test_every_form_of_text_is_read_exactly_and_comes_back(data):
    file = read(data)
    expected = np.array([[float(word) for word in words] for words in corner_tokens(data)])
    assert np.array_equal(corners_of(file), expected.reshape(-1, 9))
    assert bytes(file.replaced(file.vertices.copy())) == data
    file.check(data, file.vertices)


@given(TEXTS, st.integers(0, 2**32 - 1))
def test_only_tokens_that_moved_change(data, seed):
    file = read(data)
    rng = np.random.default_rng(seed)
    extent = max(1e-3, float(np.ptp(file.vertices)))
    step = np.where(rng.random(file.vertices.shape) < 0.5, 0.0, 0.01 * extent)
    vertices = file.vertices + step
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert blanked(output) == blanked(data)
    before, after = corner_tokens(data), corner_tokens(output)
    for k, i in enumerate(file.faces.reshape(-1)):
        for axis in range(3):
            if vertices[i, axis] == file.vertices[i, axis]:
                assert after[k][axis] == before[k][axis]
            else:
                # 1e-7 of the diagonal, or the digits of the file, whichever is finer.
                assert abs(float(after[k][axis]) - vertices[i, axis]) <= 1e-7 * extent


def test_normals_follow_and_zero_and_nan_ones_stay():
    corners = np.array([[0, 0, 0, 1, 0, 0, 0, 1, 0]] * 3, dtype=float)
    normals = np.array([[0, 0, -1], [0, 0, 0], [0, 0, 1]], dtype=float)
    text = plain_stl.text(corners, normals=normals)
    text = text.replace("0.000000 0.000000 1.000000", "nan 1.#QNAN -1.#IND")
    file = read(text)
    turned = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    output = bytes(file.replaced(turned))
    file.check(output, turned)
    lines = [line.split()[2:] for line in output.splitlines() if b"normal" in line]
    assert [float(word) for word in lines[0]] == [-1, 0, 0]
    assert lines[1] == [b"0.000000"] * 3
    assert lines[2] == [b"nan", b"1.#QNAN", b"-1.#IND"]


def test_several_solids_with_names():
    one, two = plain_stl.text(tetrahedron(), name="left leg"), plain_stl.text(tetrahedron() + 5)
    file = read(one + "\n" + two.replace("part", "") + "solid empty\nendsolid empty\n")
    assert file.n_polygons == 8
    assert file.properties[-2:] == ("solid 'left leg'", "solid 'empty'")
    assert "3 solids" in file.properties
    assert "solid 'left leg'" in file.properties
    vertices = moved(file)
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert output.count(b"solid left leg") == 2


TEXT = plain_stl.text(tetrahedron(), name="part").encode()
NORMAL = re.compile(rb"facet normal[^\n]*")
ANY_NUMBER = re.compile(rb"(?<=\s)-?\d+(?:\.\d+)?(?:e-?\d+)?")
NO_NORMAL = "facet has no normal, and none is added"
BAD_NORMAL = "facet has a normal that is not three finite numbers: it is kept, not recomputed"


def with_first_normal(line: bytes) -> bytes:
    return NORMAL.sub(line, TEXT, count=1)


def normal_lines(data: bytes) -> list[bytes]:
    return [one.strip() for one in data.splitlines() if re.match(rb"\s*facet", one, re.I)]


def checked(data: bytes) -> tuple[stl.StlTextFile, bytes]:
    """The file, and its text with all positions moved."""
    file = stl.read(data)
    assert np.array_equal(file.vertices, stl.read(TEXT).vertices)
    assert bytes(file.replaced(file.vertices.copy())) == data
    vertices = file.vertices[:, [1, 2, 0]] * [0.5, 0.25, 2.0] + 0.125
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert np.array_equal(stl.read(output).vertices, vertices)
    return file, output


@pytest.mark.parametrize(
    ("line", "warning"),
    [
        (b"facet", NO_NORMAL),
        (b"facet normal", NO_NORMAL),
        (b"FACET NORMAL \t", NO_NORMAL),
        (b"facet normal nan nan nan", BAD_NORMAL),
        (b"facet normal -nan(ind) -nan(ind) -nan(ind)", BAD_NORMAL),
        (b"facet normal 1.#QNAN -1.#IND 1.#INF", BAD_NORMAL),
        (b"facet normal inf -inf 0", BAD_NORMAL),
        (b"facet normal 1e999 0 0", BAD_NORMAL),
        (b"facet normal 0,0 0,0 1,0", BAD_NORMAL),
        (b"facet normal ***** 0 0", BAD_NORMAL),
        (b"facet normal 0 0 \xff\xfe", BAD_NORMAL),
        (b"facet normal 0 0 up", BAD_NORMAL),
    ],
)
def test_a_normal_that_is_missing_or_no_number_is_kept(line, warning):
    file, output = checked(with_first_normal(line))
    assert file.warnings == (f"1 {warning}",)
    before, after = normal_lines(TEXT), normal_lines(output)
    assert after[0] == line.strip()
    # The others are recomputed as ever.
    plain = normal_lines(checked(TEXT)[1])
    assert after[1:] == plain[1:] != before[1:]


def test_a_file_without_normals():
    data = NORMAL.sub(b"facet", TEXT)
    file, output = checked(data)
    assert file.warnings == ("4 facets have no normal, and none is added",)
    assert "facet normals" not in file.properties
    assert b"normal" not in output
    binary = stl.read(file.encoded(file.vertices, "binary", "same"))
    assert not binary.normals.any()
    assert np.array_equal(binary.vertices, file.vertices)


@pytest.mark.parametrize(
    "data",
    [
        TEXT.replace(b"endfacet", b"end facet").replace(b"endloop", b"End\tLoop"),
        TEXT.replace(b"endsolid part", b"end solid"),
        TEXT.replace(b"solid part", b"solid a\x01\x1b[0m", 1),
        TEXT.replace(b"solid part", b"solid a\0\0", 1),
        TEXT.replace(b"solid part", b"SOLID caf\xe9 \xff (1) [x]", 1),
    ],
)
def test_ends_in_two_words_and_odd_names(data):
    file, output = checked(data)
    assert file.warnings == ()
    assert output.splitlines()[0] == data.splitlines()[0]
    assert output.splitlines()[-1] == data.splitlines()[-1]


@pytest.mark.parametrize(
    ("word", "words"),
    [
        (rb"facet normal[^\n]*", rb"\g<0> extra"),
        (rb"outer loop", rb"\g<0> xyz 7"),
        (rb"vertex[^\n]*", rb"\g<0>\t; a corner"),
        (rb"endloop", rb"\g<0> # 1"),
        (rb"endfacet", rb"\g<0> foo facet"),
        (rb"endfacet", rb"END FACET foo"),
        (rb"endsolid[^\n]*", rb"\g<0> extra words"),
        (rb"(?<!d)solid[^\n]*", rb"\g<0>... facet normal"),
    ],
)
@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_words_behind_statements_are_kept(word, words, end):
    data = re.sub(word, words, TEXT).replace(b"\n", end)
    file, output = checked(data)
    assert file.warnings == ()
    assert ANY_NUMBER.sub(b"", output) == ANY_NUMBER.sub(b"", data)


def test_the_shortest_facets_have_room():
    facet = b"facet outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet "
    data = b"solid\n" + facet * 500 + b"endsolid"
    assert len(facet) == MIN_FACET_BYTES
    file = stl.read(data)
    assert len(file.faces) == 500
    assert header.of_beginning(data, len(data), "a.stl").memory_bytes
