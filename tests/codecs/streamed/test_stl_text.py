"""Ascii STL in pieces: the same facets, the same bytes and the same errors as the whole file."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.codecs.streamed import line_blocks, stl_text
from msal_cli.errors import MsalError
from tests.codecs import plain_stl
from tests.codecs.streamed import pieces

NUMBERS = ["{:.0f}", "{:.3f}", "{:.9f}", "{:.17g}", "{:g}", "{:.2e}", "+{:.1f}", "{:.20f}"]
NORMALS = ["normal 0 0 1", "normal 0 0 0", "normal nan x 1", "NORMAL -1 0 0", "", "normal"]
ENDS = [("endloop", "endfacet"), ("end loop", "ENDFACET"), ("endloop", "end\nfacet")]


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Blocks of a facet or two, so that every border is met."""
    monkeypatch.setattr(line_blocks, "BLOCK_BYTES", 200)
    monkeypatch.setattr(stl_text, "_AT_ONCE", 2)


@st.composite
def files(draw):
    """A text of one or several solids, written in different ways."""
    size = draw(st.sampled_from([1.0, 1e-3, 1e6, 1e13]))
    usual = draw(st.sampled_from(NUMBERS))
    random = draw(st.randoms(use_true_random=False))
    odd = draw(st.sampled_from([0.0, 0.0, 0.2]))

    def number() -> str:
        text = random.choice(NUMBERS) if random.random() < odd else usual
        value = random.choice([0.0, 0.25, 0.5, 0.1234567890123, 1.0])
        return text.format(value * size if text.startswith("+") else -value * size)

    lines = []
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(["", " part", " solid thing of facet"]))
        lines.append("solid" + name)
        for _ in range(draw(st.integers(0 if lines[1:] else 1, 4))):
            lines.append(f"facet {random.choice(NORMALS[: 6 if odd else 1])}".rstrip())
            lines.append("outer loop")
            lines += [f" vertex {number()} {number()}  {number()}" for _ in range(3)]
            lines += random.choice(ENDS[: 3 if odd else 1])
        lines.append("endsolid" + name)
    newline = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    mark = draw(st.sampled_from(["", "\ufeff"]))
    end = draw(st.sampled_from(["", "\n", "\n\n", "\n\x1a", "\n\0\0"]))
    return (mark + "\n".join(lines) + end).replace("\n", newline).encode()


@settings(max_examples=50, deadline=None)
@given(data=files(), size=st.integers(1, 600), random=st.randoms(use_true_random=False))
def test_pieces_are_the_whole_file(data, size, random):
    whole = pieces.whole(data, "stl")
    with tempfile.TemporaryDirectory() as folder:
        mesh = pieces.stored(Path(folder), data, "stl")
        for name in ("encoding", "precision", "properties", "references", "n_polygons", "warnings"):
            assert getattr(mesh, name) == getattr(whole, name), name
        corners = whole.faces.reshape(-1)
        assert pieces.read_vertices(mesh, 5).tobytes() == whole.vertices[corners].tobytes()
        assert np.array_equal(pieces.read_triangles(mesh, 3).reshape(-1), np.arange(len(corners)))
        new = whole.vertices.copy()
        scale = np.abs(new).max() * random.choice([1e-9, 0.1, 1.0, 1e3]) + 1e-3
        share = random.choice([0.05, 0.5, 1.0])
        for i in range(len(new)):
            for k in range(3):
                if random.random() < share:
                    new[i, k] += random.uniform(-scale, scale)
        assert pieces.replace(mesh, new[corners], step=size) == bytes(whole.replaced(new))
        assert pieces.replace(mesh, whole.vertices[corners], step=size) == data


def failure(read) -> tuple[str, str, str]:
    with pytest.raises(MsalError) as caught:
        read()
    return caught.value.code, caught.value.where, caught.value.message


def scan(n: int = 20) -> list[str]:
    corners = np.random.default_rng(0).normal(size=(n, 9))
    return plain_stl.text(corners).splitlines()


def test_every_prefix_is_refused_as_the_whole_file_is(tmp_path):
    text = "\n".join([*scan(2), ""]).encode()
    for size in range(len(text)):
        part = text[:size]
        try:
            whole = pieces.whole(part, "stl")
        except MsalError:
            expected = failure(lambda part=part: pieces.whole(part, "stl"))
            assert failure(lambda part=part: pieces.stored(tmp_path, part, "stl")) == expected
        else:
            assert pieces.stored(tmp_path, part, "stl").n_polygons == whole.n_polygons


@pytest.mark.parametrize("line", ["vertex 1 nan 2", "vertex 1 2", "vertex a 2 3", "corner 1 2 3"])
def test_what_is_wrong_is_named_with_its_line(tmp_path, line):
    lines = scan()
    place = next(i for i in range(100, 140) if "vertex" in lines[i])
    lines[place] = line
    text = "\n".join([*lines, ""]).encode()
    expected = failure(lambda: pieces.whole(text, "stl"))
    assert failure(lambda: pieces.stored(tmp_path, text, "stl")) == expected


def test_what_follows_a_solid_is_refused_with_its_line(tmp_path):
    text = "\n".join([*scan(), "rest", ""]).encode()
    expected = failure(lambda: pieces.whole(text, "stl"))
    assert failure(lambda: pieces.stored(tmp_path, text, "stl")) == expected


def test_digits_of_all_facets_depend_on_the_largest_new_number(tmp_path):
    text = "\n".join([*scan(), ""]).encode()
    whole, mesh = pieces.whole(text, "stl"), pieces.stored(tmp_path, text, "stl")
    new = whole.vertices + 0.001
    new[40] = 1e17
    corners = whole.faces.reshape(-1)
    assert pieces.replace(mesh, new[corners]) == bytes(whole.replaced(new))
