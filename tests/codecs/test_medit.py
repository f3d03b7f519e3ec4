"""Medit files."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.codecs import open_mesh
from msal_cli.errors import MsalError
from tests.codecs.patching import changed_lines, patched, texts_between_numbers

TEXT = """# made by hand: Vertices 99
MeshVersionFormatted 2

Dimension
3
Vertices
5   # x y z and a reference
0 0 0 1
1. 0 0 1
0 1 0 1
1.0E+00 1 0 1
0 0 1 2

Corners
2
1 2
RequiredVertices
1
3
Ridges
1
1
Edges 2
1 2 7
2 3 7
RequiredEdges
1
2
Triangles
2
1 2 4 5
1 4 3 5
RequiredTriangles
1
1
Quadrilaterals 1
1 2 4 3 9
Tetrahedra
1
1 2 3 5 0
Normals
1
0 0 1
NormalAtVertices
1
1 1
SubDomainFromMesh
1
3 1 1 0
End
"""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_everything_but_positions_stays(end):
    data = TEXT.replace("\n", end).encode()
    file, _, output = patched(data, "a.mesh")
    assert [one.tolist() for one in file.polygons()] == [[0, 1, 3], [0, 3, 2], [0, 1, 3, 2]]
    assert changed_lines(data, output) == [7, 8, 9, 10]
    assert texts_between_numbers(output) == texts_between_numbers(data)
    assert file.warnings == (
        "other cells (1 tetra) are kept; their corners move with the surface",
        "normals are kept as they are",
    )


def binary(version: int, order: str) -> bytes:
    real = {1: "f4"}.get(version, "f8")
    whole = {4: "i8"}.get(version, "i4")
    place = "i4" if version < 3 else "i8"

    def number(value, code):
        return np.array(value, order + code).tobytes()

    data = number(1, "i4") + number(version, "i4")

    def add(keyword, body, data):
        at = len(data) + 4 + np.dtype(place).itemsize + len(body)
        return data + number(keyword, "i4") + number(at, place) + body

    data = add(3, number(3, "i4"), data)
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]
    rows = b"".join(number(point, real) + number(k, whole) for k, point in enumerate(points))
    data = add(4, number(4, whole) + rows, data)
    data = add(14, number(1, whole) + number(2, whole), data)  # RequiredEdges
    data = add(6, number(2, whole) + number([1, 2, 4, 5, 1, 4, 3, 5], whole), data)
    return data + number(54, "i4") + number(0, place)


@pytest.mark.parametrize("version", [1, 2, 3, 4])
@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_files(version, order):
    data = binary(version, order)
    file, moved, output = patched(data, "a.meshb")
    assert file.faces.tolist() == [[0, 1, 3], [0, 3, 2]]
    assert file.precision == ("float32" if version == 1 else "float64")
    code = order + ("f4" if version == 1 else "f8")
    for old, new in zip(file.vertices, moved, strict=True):
        output = output.replace(new.astype(code).tobytes(), old.astype(code).tobytes())
    assert output == data


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("Dimension\n3", "Dimension\n2", "E_UNSUPPORTED"),
        ("Vertices\n5", "Vertices\n6", "E_FORMAT"),
        ("Vertices\n5", "Vertices\n999999999999", "E_FORMAT"),
        ("1 2 4 5", "1 2 6 5", "E_INDEX"),
        ("1 2 4 5", "0 2 4 5", "E_INDEX"),
        ("1 2 4 5", "1 2 4.5 5", "E_FORMAT"),
        ("1. 0 0 1", "nan 0 0 1", "E_NONFINITE"),
        ("\nTriangles\n2", "\nTrianglesP2\n2", "E_UNSUPPORTED"),
        (TEXT[TEXT.index("Corners") :], "", "E_NO_FACES"),
        (TEXT[TEXT.index("0 0 1 2") :], "", "E_TRUNCATED"),
        (TEXT[TEXT.index("Vertices\n5") :], "", "E_TRUNCATED"),
    ],
)
def test_damage(old, new, code):
    assert old in TEXT
    with pytest.raises(MsalError) as caught:
        open_mesh(TEXT.replace(old, new).encode(), "a.mesh", "mesh")
    assert caught.value.code == code


def test_a_keyword_that_points_nowhere():
    data = bytearray(binary(2, "<"))
    data[12:16] = (1 << 30).to_bytes(4, "little")
    with pytest.raises(MsalError, match="next keyword"):
        open_mesh(bytes(data), "a.meshb")


def test_words_without_end_are_refused(monkeypatch):
    from msal_cli.codecs import tokens as words

    monkeypatch.setattr(words, "_MOST_KEYWORDS", 100)
    with pytest.raises(MsalError) as caught:
        open_mesh(TEXT.replace("End", "a " * 200).encode(), "a.mesh")
    assert caught.value.code == "E_TOO_LARGE"
