"""Range grids: raw scans of the Stanford archive, whose samples are joined when they are read.

No other reader here knows them, so that all cases are worked by hand.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from msal_cli.codecs import open_mesh, ply
from msal_cli.codecs.header import read_header
from msal_cli.errors import MsalError
from tests.codecs import plain_ply
from tests.codecs.plain_ply import ENCODINGS, Element, Ply

SAMPLES = [
    [0, 1, 2, None],
    [3, 4, 5, 6],
    [None, 7, None, 8],
]
PLACES = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (1.75, 0.875), (3, 1), (1, 2), (3, 2)]
"""A vertex for each sample, on whole numbers but for the sixth, which is nearer to the second."""

TRIANGLES = [
    # Both diagonals are as long; in the next cell the first one is shorter.
    *([0, 1, 3], [1, 4, 3]),
    *([1, 2, 5], [1, 5, 4]),
    # Cells of three samples.
    [6, 5, 2],
    [3, 4, 7],
    [7, 4, 5],
    [5, 6, 8],
]
INFOS = ["obj_info is_mesh 0", "obj_info num_cols 4", "obj_info num_rows 3", "comment a scan"]


def scan(encoding: str = "ascii", infos=INFOS, samples=SAMPLES, heights=None) -> Ply:
    heights = heights or {}
    rows = [[float(x), float(y), heights.get(k, 0.0), 0.5] for k, (x, y) in enumerate(PLACES)]
    cells = [[[] if k is None else [k]] for row in samples for k in row]
    return Ply(
        encoding,
        [
            Element(
                "vertex", [(name, "float", "") for name in ("x", "y", "z", "confidence")], rows
            ),
            Element("range_grid", [("vertex_indices", "int", "uchar")], cells),
        ],
        list(infos),
    )


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_neighbouring_samples_are_joined_and_only_positions_change(encoding):
    plain = scan(encoding)
    data = plain_ply.written(plain)
    file = open_mesh(data, "a.ply")
    assert file.faces.tolist() == TRIANGLES
    assert file.n_polygons == len(TRIANGLES)
    assert file.properties == ("vertex.confidence float", "range grid of 3 rows and 4 columns")
    assert file.warnings == ()
    assert file.replaced(file.vertices.copy()) is data
    vertices = file.vertices.copy()
    vertices[4] = [1.25, 1.5, -0.5]
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    columns = {name: vertices[:, k].tolist() for k, name in enumerate("xyz")}
    assert plain_ply.read(output) == replace(plain.with_columns("vertex", columns), newline="\n")
    assert plain_ply.header(plain) == output[: output.index(b"end_header\n") + 11]


def test_a_step_in_depth_is_not_joined():
    # The median edge is 1, so that the limit is 4: the last vertex is 5 behind its neighbours.
    file = ply.read(plain_ply.written(scan(heights={8: 5.0})))
    assert file.faces.tolist() == TRIANGLES[:-1]
    file = ply.read(plain_ply.written(scan(heights={8: 3.5})))
    assert file.faces.tolist() == TRIANGLES


def test_faces_go_before_the_grid():
    plain = scan(infos=[])
    plain.elements.append(Element("face", [("vertex_indices", "int", "uchar")], [[[0, 1, 4]]]))
    file = ply.read(plain_ply.written(plain))
    assert file.faces.tolist() == [[0, 1, 4]]
    assert "element range_grid (12)" in file.properties


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"infos": []}, "E_FORMAT", "no 'obj_info num_rows' and no 'obj_info num_cols'"),
        ({"infos": ["obj_info num_cols 4"]}, "E_FORMAT", "no 'obj_info num_rows'"),
        ({"infos": ["obj_info num_cols 4", "obj_info num_rows 4"]}, "E_FORMAT", "12 samples"),
        ({"infos": ["obj_info num_cols -4", "obj_info num_rows -3"]}, "E_FORMAT", "-3 by -4"),
        ({"samples": [[0, 1, 2, None], [9, 4, 5, 6], [None] * 4]}, "E_INDEX", "vertex 9"),
        ({"samples": [[0, 1, 2, None], [None] * 4, [3, 4, 5, 6]]}, "E_NO_FACES",
            "no three samples"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_what_is_wrong_with_a_grid(change, code, words, encoding):
    with pytest.raises(MsalError, match=words) as caught:
        open_mesh(plain_ply.written(scan(encoding, **change)), "a.ply")
    assert caught.value.code == code
    assert caught.value.hint and caught.value.where


def test_a_sample_has_at_most_one_vertex():
    plain = scan("binary_big_endian")
    plain.element("range_grid").rows[5] = [[4, 5]]
    with pytest.raises(MsalError, match="more than one vertex") as caught:
        open_mesh(plain_ply.written(plain), "a.ply")
    assert caught.value.where == "range_grid 5"


def test_the_forecast_counts_its_triangles():
    data = plain_ply.written(scan("binary_little_endian"))
    header = read_header("ply", data, len(data))
    assert (header.n_vertices, header.n_triangles, header.error) == (9, 18, None)
