"""STL files that break the format in ways which other programs read: kept, and warned of."""

from __future__ import annotations

import re

import numpy as np
import pytest

from msal_cli.codecs import header, stl
from msal_cli.codecs.stl import MIN_FACET_BYTES
from msal_cli.errors import MsalError, TruncatedError
from tests.codecs import plain_stl
from tests.codecs.plain_stl import tetrahedron

TEXT = plain_stl.text(tetrahedron(), name="part").encode()
NORMAL = re.compile(rb"facet normal[^\n]*")
NUMBER = re.compile(rb"(?<=\s)-?\d+(?:\.\d+)?(?:e-?\d+)?")
NO_NORMAL = "facet has no normal, and none is added"
BAD_NORMAL = "facet has a normal that is not three finite numbers: it is kept, not recomputed"


def with_first_normal(line: bytes) -> bytes:
    return NORMAL.sub(line, TEXT, count=1)


def normal_lines(data: bytes) -> list[bytes]:
    return [one.strip() for one in data.splitlines() if re.match(rb"\s*facet", one, re.I)]


def checked(data: bytes) -> tuple[stl.StlTextFile, bytes]:
    """The file, and its text with all positions moved."""
    file = stl.read(data, "a.stl")
    assert np.array_equal(file.vertices, stl.read(TEXT, "a.stl").vertices)
    assert bytes(file.replaced(file.vertices.copy())) == data
    vertices = file.vertices[:, [1, 2, 0]] * [0.5, 0.25, 2.0] + 0.125
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert np.array_equal(stl.read(output, "a.stl").vertices, vertices)
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
    binary = stl.read(file.encoded(file.vertices, "binary", "same"), "a.stl")
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
    assert NUMBER.sub(b"", output) == NUMBER.sub(b"", data)


@pytest.mark.parametrize(
    "line", [b"vertex 0 0 0 1", b"vertex 0 0 0 -x", b"endloop 1", b"outer x loop"]
)
def test_a_number_too_many_is_damage(line):
    old = re.search(line.split()[0] + rb"[^\n]*", TEXT)
    with pytest.raises(MsalError) as caught:
        stl.read(TEXT.replace(old[0], line, 1), "a.stl")
    assert caught.value.code == "E_FORMAT"


def test_a_binary_file_may_hold_the_words_of_a_facet():
    header = b"solid a\nfacet normal 0 0 1\nouter loop"
    assert stl.read(plain_stl.binary(tetrahedron(), header=header), "").encoding != "ascii"


def test_the_shortest_facets_have_room():
    facet = b"facet outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet "
    data = b"solid\n" + facet * 500 + b"endsolid"
    assert len(facet) == MIN_FACET_BYTES
    file = stl.read(data, "a.stl")
    assert len(file.faces) == 500
    assert header.of_beginning(data, len(data), "a.stl").memory_bytes


@pytest.mark.parametrize("line", [b"facet", b"facet normal", b"facet normal x y z"])
def test_a_file_cut_short_is_still_known_as_such(line):
    data = with_first_normal(line)
    end = data.index(b"vertex")
    for size in range(data.index(b"facet"), end):
        with pytest.raises(TruncatedError):
            stl.read(data[:size], "a.stl")
