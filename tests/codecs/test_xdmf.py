"""XDMF files."""

from __future__ import annotations

import meshio
import numpy as np
import pytest

from msal_cli.codecs import convert, open_mesh
from msal_cli.errors import MsalError
from tests.codecs.patching import changed_lines, patched
from tests.shapes import torus

TEXT = """<?xml version="1.0" ?>
<!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []>
<Xdmf Version="3.0"><!-- kept -->
<Domain><Grid Name="mesh" GridType="Uniform">
<Topology TopologyType="Mixed" NumberOfElements="3">
<DataItem Dimensions="14" NumberType="Int">
4 0 1 2  5 0 1 3 2  2 2 0 1
</DataItem></Topology>
<Geometry GeometryType="XYZ">
<DataItem Dimensions="4 3" Format="XML" Precision="8">
0 0 0
1 0 0
0 1 0
1 1 0.5
</DataItem></Geometry>
<Attribute Name="T" Center="Node"><DataItem Dimensions="4" Format="XML">
1 2 3 4
</DataItem></Attribute>
</Grid></Domain></Xdmf>
"""


def test_everything_but_positions_stays():
    file, _, output = patched(TEXT.encode(), "a.xdmf")
    assert [one.tolist() for one in file.polygons()] == [[0, 1, 2], [0, 1, 3, 2]]
    assert changed_lines(TEXT.encode(), output) == [10, 11, 12]
    assert file.properties == ("node.T",)
    assert file.precision == "float64"


@pytest.mark.parametrize("kind", ["Triangle", "Polygon"])
def test_topologies_of_one_kind(kind):
    data = TEXT.replace('"Mixed"', f'"{kind}" NodesPerElement="3"')
    data = data.replace("4 0 1 2  5 0 1 3 2  2 2 0 1", "0 1 2 1 3 2")
    file, _, _ = patched(data.encode(), "a.xdmf")
    assert file.faces.tolist() == [[0, 1, 2], [1, 3, 2]]


def test_what_is_written_holds_its_numbers_itself(tmp_path):
    pytest.importorskip("h5py")
    vertices, faces = torus(12, 8)
    source = open_mesh(TEXT.encode(), "a.xdmf")
    source.vertices, source.faces, source.n_polygons = vertices, faces, len(faces)
    source.format = "ply"
    data, _ = convert(source, vertices, "xdmf")
    (tmp_path / "a.xdmf").write_bytes(data)
    judged = meshio.read(tmp_path / "a.xdmf")
    assert np.array_equal(judged.points, vertices)
    assert np.array_equal(judged.cells[0].data, faces)
    assert np.array_equal(open_mesh(data, "a.xdmf").faces, faces)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('Format="XML" Precision="8">', 'Format="HDF">a.h5:/x', "another file"),
        ('Format="XML" Precision="8">', 'Format="Binary" Seek="3">/etc/passwd', "another file"),
        ("<Attribute ", '<xi:include href="/etc/passwd"/><Attribute ', "includes another"),
        ('Dimensions="4"', 'Dimensions="4" Reference="/x"', "other items"),
        ('Dimensions="4"', 'Dimensions="4" ItemType="HyperSlab"', "other items"),
        ('"Xdmf.dtd" []', '"Xdmf.dtd" [<!ENTITY e SYSTEM "/etc/passwd">]', "entities"),
    ],
)
def test_no_other_file_is_opened(old, new, message):
    assert old in TEXT
    with pytest.raises(MsalError, match=message) as caught:
        open_mesh(TEXT.replace(old, new).encode(), "a.xdmf")
    assert caught.value.code in ("E_UNSUPPORTED", "E_FORMAT")
    assert "root" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ('"XYZ"', '"XY"', "E_UNSUPPORTED"),
        ('"Mixed"', '"Tri_6"', "E_UNSUPPORTED"),
        ('"Mixed"', '"Tetrahedron"', "E_NO_FACES"),
        ("5 0 1 3 2", "5 0 1 3 9", "E_INDEX"),
        ("5 0 1 3 2", "36 0 1 3 2", "E_UNSUPPORTED"),
        ("2 2 0 1", "2 9 0 1", "E_FORMAT"),
        ("1 1 0.5", "1 1", "E_FORMAT"),
        ("1 1 0.5", "1 1 nan", "E_NONFINITE"),
        ("</Geometry>", "", "E_FORMAT"),
        ("Xdmf Version", "Ydmf Version", "E_FORMAT"),
    ],
)
def test_damage(old, new, code):
    with pytest.raises(MsalError) as caught:
        open_mesh(TEXT.replace(old, new).encode(), "a.xdmf")
    assert caught.value.code == code
