"""Ascii PLY in pieces: the same mesh, the same bytes and the same errors as the whole file."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.codecs import ply_ascii, text_slots
from msal_cli.codecs.streamed import line_blocks, ply_text, text_mesh
from msal_cli.errors import MsalError, UnsupportedError
from tests.codecs import plain_ply
from tests.codecs.plain_ply import Element, Ply
from tests.codecs.streamed import pieces

NUMBERS = ["{:.0f}", "{:.3f}", "{:.9f}", "{:.17g}", "{:g}", "{:.2e}", "+{:.1f}", "{:.20f}"]


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Blocks of a few lines, so that every border is met."""
    monkeypatch.setattr(line_blocks, "BLOCK_BYTES", 60)
    monkeypatch.setattr(text_mesh, "_AT_ONCE", 2)


@st.composite
def files(draw):
    """An ascii PLY of a few vertices and polygons, written in different ways."""
    n = draw(st.integers(3, 12))
    size = draw(st.sampled_from([1.0, 1e-3, 1e6, 1e12]))
    usual = draw(st.sampled_from(NUMBERS))
    random = draw(st.randoms(use_true_random=False))
    odd = draw(st.sampled_from([0.0, 0.0, 0.1, 0.5]))

    def number() -> str:
        text = random.choice(NUMBERS) if random.random() < odd else usual
        value = abs(random.uniform(-1, 1)) if text.startswith("+") else random.uniform(-1, 1)
        return text.format(value * size)

    names = ["x", "y", "z"]
    if draw(st.booleans()):
        names += ["nx", "ny", "nz"]
    if draw(st.booleans()):
        names.insert(draw(st.integers(0, len(names))), "quality")
    if draw(st.booleans()):
        names = draw(st.permutations(names))
    coordinate = draw(st.sampled_from(["float", "double", "double", "int"]))
    rows = []
    for _ in range(n):
        row = []
        for name in names:
            if name in "xyz" and coordinate == "int":
                row.append(str(random.randint(-99, 99)))
            elif name.startswith("n"):
                row.append(random.choice(["0", "1", "-1", "0.5", "nan" if odd else "0.25"]))
            else:
                row.append(number())
        rows.append(row)
    kinds = [coordinate if name in "xyz" else "float" for name in names]
    vertex = Element("vertex", [(a, b, "") for a, b in zip(names, kinds, strict=True)], rows)
    smallest, largest = draw(st.sampled_from([(3, 3), (1, 6)]))
    corners = st.lists(st.integers(0, n - 1), min_size=smallest, max_size=largest)
    polygons = [*draw(st.lists(corners, max_size=12)), [0, 1, 2]]
    face = Element("face", [("vertex_indices", "int", "uchar")], [[one] for one in polygons])
    if draw(st.booleans()):
        face.properties.append(("flag", "int", ""))
        face.rows = [[*row, 7] for row in face.rows]
    other = Element("extra", [("a", "float", ""), ("b", "float", "uchar")], [[3, [1.5]], [4, []]])
    none = Element("none", [], [[]])
    chosen = draw(st.sampled_from([[], [other], [none, other]]))
    elements = draw(st.permutations([vertex, face, *chosen]))
    newline = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    trailing = draw(st.sampled_from([b"", b"\n \n", b"rest \nof it"]))
    return plain_ply.written(Ply("ascii", list(elements), [], newline, trailing))


def new_normals(whole, mesh, new):
    return pieces.new_normals(whole, new) if mesh.has_normals else None


@pytest.mark.parametrize("limits", [(4096, 5000), (4, 1)], ids=["usual", "low"])
@settings(max_examples=30, deadline=None)
@given(data=files(), size=st.integers(1, 300), random=st.randoms(use_true_random=False))
def test_pieces_are_the_whole_file(limits, data, size, random):
    with pytest.MonkeyPatch.context() as patch:
        for module in (text_slots, text_mesh):
            patch.setattr(module, "MOST_TURNS", limits[0])
        for module in (ply_ascii, ply_text):
            patch.setattr(module, "MOST_UNUSUAL", limits[1])
        compare(data, size, random)


def compare(data, size, random):
    whole = pieces.whole(data, "ply")
    with tempfile.TemporaryDirectory() as folder:
        mesh = pieces.stored(Path(folder), data, "ply")
        for name in ("encoding", "precision", "properties", "references", "n_polygons", "warnings"):
            assert getattr(mesh, name) == getattr(whole, name), name
        assert pieces.read_vertices(mesh, 5).tobytes() == whole.vertices.tobytes()
        assert np.array_equal(pieces.read_triangles(mesh, 3), whole.faces)
        for name in ("x", "quality"):
            if f"property float {name}".encode() in data:
                values = whole.vertex_property(name)
                assert np.array_equal(mesh.read_property(name, 1, len(values)), values[1:])
        new = whole.vertices.copy()
        scale = np.abs(new).max() * random.choice([1e-9, 0.1, 1.0, 30.0]) + 1e-3
        share = random.choice([0.05, 0.5, 1.0])
        for i in range(len(new)):
            for k in range(3):
                if random.random() < share:
                    new[i, k] += random.uniform(-scale, scale)
        normals = new_normals(whole, mesh, new)
        assert pieces.replace(mesh, new, normals, size) == bytes(whole.replaced(new))
        kept = np.full(new.shape, np.nan) if mesh.has_normals else None
        assert pieces.replace(mesh, whole.vertices, kept, size) == data


def scan(n: int = 40, normals: bool = False, number: str = "{:.4f}") -> Ply:
    rng = np.random.default_rng(1)
    names = ["x", "y", "z", *(["nx", "ny", "nz"] if normals else [])]
    rows = [
        [number.format(one) for one in row] + ["0", "0", "1"] * normals
        for row in rng.normal(size=(n, 3))
    ]
    faces = [[rng.integers(0, n, 3).tolist()] for _ in range(2 * n)]
    vertex = Element("vertex", [(name, "float", "") for name in names], rows)
    return Ply("ascii", [vertex, Element("face", [("vertex_indices", "int", "uchar")], faces)])


def failure(read) -> tuple[str, str, str]:
    with pytest.raises(MsalError) as caught:
        read()
    return caught.value.code, caught.value.where, caught.value.message


def test_every_prefix_is_refused_as_the_whole_file_is(tmp_path):
    mesh = scan(4)
    mesh.element("face").rows[3] = [[0, 1, 2, 3]]
    mesh.elements.append(Element("extra", [("a", "float", "")], [[1.0], [2.0]]))
    data = plain_ply.written(mesh)
    for size in range(len(data) - 4):
        part = data[:size]
        expected = failure(lambda part=part: pieces.whole(part, "ply"))
        assert failure(lambda part=part: pieces.stored(tmp_path, part, "ply")) == expected


@pytest.mark.parametrize(
    ("element", "row", "value"),
    [
        ("vertex", 33, ["0", "nan", "0"]),
        ("vertex", 33, ["0", "inf", "0"]),
        ("vertex", 33, ["0", "1,5", "0"]),
        ("vertex", 33, ["0", "word", "0"]),
        ("vertex", 33, ["0", "0"]),
        ("vertex", 33, ["0", "0", "0", "0"]),
        ("face", 71, [[0, 40, 1]]),
        ("face", 71, [[0, -1, 1]]),
        ("face", 71, [[0, 12345678901, 1]]),
        ("face", 71, [[0, "1.5", 1]]),
        ("face", 71, ["3 1 2"]),
        ("face", 71, ["3 1 2 3 40"]),
        ("face", 71, ["-1 1 2 3"]),
        ("face", 71, ["x 1 2 3"]),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path, element, row, value):
    mesh = scan()
    data = plain_ply.written(mesh).decode().splitlines()
    place = data.index("end_header") + 1 + (40 if element == "face" else 0) + row
    if isinstance(value[0], list):
        value = [len(value[0]), *value[0]]
    data[place] = " ".join(map(str, value))
    text = "\n".join([*data, ""]).encode()
    expected = failure(lambda: pieces.whole(text, "ply"))
    assert failure(lambda: pieces.stored(tmp_path, text, "ply")) == expected


def test_a_text_needs_a_folder(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(plain_ply.written(scan()))
    with pytest.raises(UnsupportedError) as caught:
        pieces.open_streamed(path)
    assert caught.value.hint


def test_a_text_that_changed_is_read_anew(tmp_path):
    first = pieces.stored(tmp_path, plain_ply.written(scan()), "ply")
    other = plain_ply.written(scan(41))
    second = pieces.stored(tmp_path, other, "ply")
    assert (first.n_vertices, second.n_vertices) == (40, 41)


def test_a_text_is_read_once(tmp_path, monkeypatch):
    mesh = pieces.stored(tmp_path, plain_ply.written(scan()), "ply")
    monkeypatch.setattr(ply_text, "convert", None)
    again = pieces.open_streamed(tmp_path / "a.ply", folder=tmp_path / "folder")
    assert again.facts == mesh.facts


def test_digits_of_a_line_depend_on_the_largest_new_number_of_the_file(tmp_path):
    mesh = scan(150)
    mesh.element("vertex").rows[3] = ["0.12345678901234567", "0.1", "0.2"]
    data = plain_ply.written(mesh)
    whole, mesh = pieces.whole(data, "ply"), pieces.stored(tmp_path, data, "ply")
    new = whole.vertices + 0.001
    new[149] += 123456.0
    assert pieces.replace(mesh, new) == bytes(whole.replaced(new))
