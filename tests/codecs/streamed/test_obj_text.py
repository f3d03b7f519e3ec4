"""OBJ in pieces: the same mesh, the same bytes and the same errors as the whole file."""

from __future__ import annotations

import random
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.codecs import text_slots
from msal_cli.codecs.streamed import line_blocks, text_mesh
from msal_cli.errors import MsalError, UnsupportedError
from tests.codecs.streamed import pieces

NUMBERS = ["{:.0f}", "{:.3f}", "{:.9f}", "{:.17g}", "{:g}", "{:.2e}", "+{:.1f}", "{:.20f}"]
OTHERS = [
    "# a comment \\",
    "",
    "g part",
    "usemtl red",
    "mtllib a.mtl b c.mtl",
    "vt 0.5 0.25",
    "l 1 2",
    "f 1 2",
    "call some thing",
    "vp 1 2",
    "g a \\\n b",
    "V 1 2 3",
]


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Blocks of a few lines, so that every border is met."""
    monkeypatch.setattr(line_blocks, "BLOCK_BYTES", 60)
    monkeypatch.setattr(text_mesh, "_AT_ONCE", 2)


@st.composite
def files(draw):
    """An OBJ of a few vertices and polygons, written in different ways."""
    n = draw(st.integers(3, 12))
    size = draw(st.sampled_from([1.0, 1e-3, 1e6, 1e12, 1e17]))
    usual = draw(st.sampled_from(NUMBERS))
    random = draw(st.randoms(use_true_random=False))
    odd = draw(st.sampled_from([0.0, 0.0, 0.1, 0.5]))
    normals = draw(st.sampled_from(["none", "unused", "used"]))

    def number() -> str:
        text = random.choice(NUMBERS) if random.random() < odd else usual
        value = abs(random.uniform(-1, 1)) if text.startswith("+") else random.uniform(-1, 1)
        return text.format(value * size)

    tail = draw(st.sampled_from(["", " 1.0", " 0.5", " 0.1 0.2 0.3"]))
    vertices = [f"v {number()}  {number()}\t{number()}{tail}" for _ in range(n)]
    if odd:
        vertices[0] = f"v {number()} \\\n {number()} {number()}"
    vn = [random.choice(["vn 0 0 1", "vn 0.5 0.5 0.123", "vn 0 0 0", "vn 1e-3 nan 2"])] * n
    order = draw(st.sampled_from(["alternating", "normals first", "apart"]))
    if normals == "none":
        lines = vertices
    elif order == "alternating":
        lines = [one for pair in zip(vn, vertices, strict=True) for one in pair]
    else:
        lines = vn + vertices if order == "normals first" else vertices + vn
    smallest, largest = draw(st.sampled_from([(3, 3), (3, 6)]))
    corners = st.lists(st.integers(1, n), min_size=smallest, max_size=largest)
    form = {"used": "{0}//{0}"}.get(normals, draw(st.sampled_from(["{0}", "{0}/1", "-{0}"])))
    for polygon in [*draw(st.lists(corners, max_size=8)), [1, 2, 3]]:
        lines.append("f " + " ".join(form.format(one) for one in polygon))
    if draw(st.booleans()):
        is_free = normals == "none" and not form.startswith("-")
        lines = lines[n:] + lines[:n] if is_free else lines
    for _ in range(draw(st.integers(0, 6))):
        other = random.choice(OTHERS)
        if normals == "used" and other.startswith("f "):
            continue
        lines.insert(random.randint(0, len(lines) - 1), other)
    newline = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    mark = draw(st.sampled_from(["", "\ufeff"]))
    end = draw(st.sampled_from(["", "\n", "\n\n"]))
    return (mark + "\n".join(lines) + end).replace("\n", newline).encode()


@pytest.mark.parametrize("turns", [4096, 4], ids=["usual", "low"])
@settings(max_examples=30, deadline=None)
@given(data=files(), size=st.integers(1, 300), random=st.randoms(use_true_random=False))
def test_pieces_are_the_whole_file(turns, data, size, random):
    with pytest.MonkeyPatch.context() as patch:
        for module in (text_slots, text_mesh):
            patch.setattr(module, "MOST_TURNS", turns)
        compare(data, size, random)


def compare(data, size, random):
    whole = pieces.whole(data, "obj")
    with tempfile.TemporaryDirectory() as folder:
        mesh = pieces.stored(Path(folder), data, "obj")
        for name in ("encoding", "precision", "properties", "references", "n_polygons", "warnings"):
            assert getattr(mesh, name) == getattr(whole, name), name
        assert pieces.read_vertices(mesh, 5).tobytes() == whole.vertices.tobytes()
        assert np.array_equal(pieces.read_triangles(mesh, 3), whole.faces)
        assert mesh.has_normals == bool(whole._layout.normals)
        new = whole.vertices.copy()
        scale = np.abs(new).max() * random.choice([1e-9, 0.1, 1.0, 30.0]) + 1e-3
        share = random.choice([0.05, 0.5, 1.0])
        for i in range(len(new)):
            for k in range(3):
                if random.random() < share:
                    new[i, k] += random.uniform(-scale, scale)
        normals = pieces.new_normals(whole, new) if mesh.has_normals else None
        assert pieces.replace(mesh, new, normals, size) == bytes(whole.replaced(new))
        kept = np.full(new.shape, np.nan) if mesh.has_normals else None
        assert pieces.replace(mesh, whole.vertices, kept, size) == data


def failure(read) -> tuple[str, str, str]:
    with pytest.raises(MsalError) as caught:
        read()
    return caught.value.code, caught.value.where, caught.value.message


def scan(n: int = 30) -> list[str]:
    rng = np.random.default_rng(1)
    vertices = ["v {:.3f} {:.3f} {:.3f}".format(*row) for row in rng.normal(size=(n, 3))]
    faces = ["f {} {} {}".format(*row) for row in rng.integers(1, n + 1, (2 * n, 3))]
    return ["# made by a test", *vertices, "f 1 2", *faces]


def test_every_prefix_is_refused_as_the_whole_file_is(tmp_path):
    text = "\n".join([*scan(3)[:9], ""]).encode()
    for size in range(len(text)):
        part = text[:size]
        try:
            whole = pieces.whole(part, "obj")
        except MsalError:
            expected = failure(lambda part=part: pieces.whole(part, "obj"))
            assert failure(lambda part=part: pieces.stored(tmp_path, part, "obj")) == expected
        else:
            assert pieces.stored(tmp_path, part, "obj").n_polygons == whole.n_polygons


@pytest.mark.parametrize(
    ("row", "line"),
    [
        (20, "v 1 nan 2"),
        (20, "v 1 inf 2"),
        (20, "v 1,5 2 3"),
        (20, "v 1 2"),
        (20, "v 1 2 3 x"),
        (20, "vn 1 2"),
        (60, "f 1 2 31"),
        (60, "f 1 2 99999999999"),
        (60, "f 1 2 0"),
        (60, "f"),
        (60, "f 1 x 2"),
        (60, "f 1 2/1/1/1 2"),
        (60, "call \0"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path, row, line):
    lines = scan()
    lines[row] = line
    text = "\n".join([*lines, ""]).encode()
    expected = failure(lambda: pieces.whole(text, "obj"))
    assert failure(lambda: pieces.stored(tmp_path, text, "obj")) == expected


@pytest.mark.parametrize("form", ["f {0} 1 {2}", "f {0}/{0} 2 {1}/-1", "f {0}//{0} {1}//{1} 3//3"])
def test_relative_numbers_count_what_is_before_their_block(tmp_path, form):
    lines = ["vt 0 0", "vt 0 1", "# filled " + "x" * 70]
    n = 8
    for k in range(n):
        lines += [f"vn 0 0 {k}", f"v {k} {k * k} 0.5"] if "//" in form else [f"v {k} {k * k} 0.5"]
        if k > 3:
            lines.append(form.format(*(-one for one in range(1, 4))))
    data = "\n".join([*lines, ""]).encode()
    compare(data, 100, random.Random(0))


@pytest.mark.parametrize("number", ["-9", "0", "-99999999999"])
def test_relative_numbers_before_the_first_vertex_are_refused(tmp_path, number):
    lines = [*(f"v {k} {k * k} 0.5" for k in range(8)), "f 1 2 3", f"f 1 2 {number}", ""]
    data = "\n".join(lines).encode()
    expected = failure(lambda: pieces.whole(data, "obj"))
    assert failure(lambda: pieces.stored(tmp_path, data, "obj")) == expected


def test_normals_that_are_shared_are_refused_with_a_hint(tmp_path):
    lines = [*scan(), "vn 0 0 1", "f 1//1 2//1 3//1"]
    with pytest.raises(UnsupportedError) as caught:
        pieces.stored(tmp_path, "\n".join(lines).encode(), "obj")
    assert caught.value.hint


def test_no_faces_is_refused_with_the_same_words(tmp_path):
    for lines in (["v 0 0 0"], ["F 1 2 3", "v 0 0 0"], ["f 1 2 3"], ["v 0 0 0", "f 1 1", ""]):
        text = "\n".join(lines).encode()
        expected = failure(lambda text=text: pieces.whole(text, "obj"))
        assert failure(lambda text=text: pieces.stored(tmp_path, text, "obj")) == expected


def test_digits_of_a_line_depend_on_the_largest_new_number_of_the_file(tmp_path):
    lines = scan(150)
    lines[3] = "v 0.12345678901234567 0.1 0.2"
    data = "\n".join([*lines, ""]).encode()
    whole, mesh = pieces.whole(data, "obj"), pieces.stored(tmp_path, data, "obj")
    new = whole.vertices + 0.001
    new[149] += 123456.0
    assert pieces.replace(mesh, new) == bytes(whole.replaced(new))
