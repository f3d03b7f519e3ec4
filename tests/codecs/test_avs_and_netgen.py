"""AVS UCD files and Netgen's."""

from __future__ import annotations

import pytest

from msal_cli.codecs import open_mesh
from msal_cli.errors import MsalError
from tests.codecs.patching import changed_lines, patched

AVS = """# a comment 1 2 3
4 4 1 0 0
1 0 0 0
2 1.0 0 0
3 0 1 0
9 1 1.50 0
1 1 tri 1 2 3
2 1 quad 1 2 9 3
3 1 line 1 2
4 1 tet 1 2 3 9
1 1
height, m
1 0.5
2 0.6
3 0.7
9 0.8
"""
VOL = """mesh3d
dimension
3
geomtype
0

# surfnr    bcnr   domin  domout      np      p1      p2      p3
surfaceelements
2
 1 1 1 0 3 1 2 3
 1 1 1 0 4 1 2 4 3

volumeelements
1
1 4 1 2 3 4

edgesegmentsgi2
0

points
4
0 0 0
1.0 0 0
0 1 0
1 1 1.50

materials
1
1 steel
"""


def test_avs():
    file, _, output = patched(AVS.encode(), "a.avs")
    assert [one.tolist() for one in file.polygons()] == [[0, 1, 2], [0, 1, 3, 2]]
    assert changed_lines(AVS.encode(), output) == [2, 3, 4]
    assert file.properties == ("data of nodes",)
    assert "1 tetra" in file.warnings[0]


def test_netgen():
    file, _, output = patched(VOL.encode(), "a.vol")
    assert [one.tolist() for one in file.polygons()] == [[0, 1, 2], [0, 1, 3, 2]]
    assert len(changed_lines(VOL.encode(), output)) == 3
    assert "1 volume" in file.warnings[0]


@pytest.mark.parametrize(
    ("text", "old", "new", "code"),
    [
        (AVS, "4 4 1 0 0", "4 99 1 0 0", "E_TRUNCATED"),
        (AVS, "tri 1 2 3", "tri 1 2 8", "E_INDEX"),
        (AVS, "tri 1 2 3", "tri 1 2", "E_FORMAT"),
        (AVS, "tri 1 2 3", "try 1 2 3", "E_FORMAT"),
        (AVS, "2 1.0 0 0", "2 inf 0 0", "E_NONFINITE"),
        (AVS, "# a", "\a# a", "E_UNSUPPORTED"),
        (VOL, "points\n4", "points\n99", "E_TRUNCATED"),
        (VOL, "3 1 2 3\n", "3 1 2 7\n", "E_INDEX"),
        (VOL, "3 1 2 3\n", "6 1 2 3 1 2 3\n", "E_UNSUPPORTED"),
        (VOL, "3 1 2 3\n", "3 1 2\n", "E_FORMAT"),
        (VOL, "dimension\n3", "dimension\n2", "E_UNSUPPORTED"),
        (VOL, "mesh3d", "mush", "E_FORMAT"),
        (VOL, VOL[VOL.index("points") :], "", "E_TRUNCATED"),
    ],
)
def test_damage(text, old, new, code):
    assert old in text
    with pytest.raises(MsalError) as caught:
        open_mesh(text.replace(old, new).encode(), "a.avs" if text is AVS else "a.vol")
    assert caught.value.code == code
