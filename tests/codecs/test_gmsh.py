"""Gmsh files."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.codecs import open_mesh
from msal_cli.errors import MsalError
from tests.codecs.patching import changed_lines, patched

POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0.5), (0, 0, 1)]
TAGS = [1, 2, 3, 7, 5]
"""Numbers of nodes need not follow one another."""

NODE_DATA = """$NodeData
1
"height of \xfc"
1
0.0
3
0
1
2
1 0.25
2 -1e-3
$EndNodeData
"""
NAMES = '$PhysicalNames\n1\n2 1 "skin $Nodes 5"\n$EndPhysicalNames\n'

TEXT_22 = (
    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
    + NAMES
    + "$Nodes\n5\n"
    + "".join(f"{tag} {x} {y} {z}\n" for tag, (x, y, z) in zip(TAGS, POINTS, strict=True))
    + "$EndNodes\n$Elements\n5\n1 15 2 0 1 1\n2 1 2 0 1 1 2\n"
    + "3 2 2 1 1 1 2 3\n4 3 3 1 1 0 1 2 7 3\n5 4 2 0 1 1 2 3 5\n$EndElements\n"
    + NODE_DATA
)
TEXT_41 = (
    "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
    + NAMES
    + "$Entities\n0 0 1 0\n1 0 0 0 1 1 1 1 1 0\n$EndEntities\n"
    + "$Nodes\n2 5 1 7\n2 1 1 3\n1\n2\n3\n0 0 0 0.1 0.2\n1 0 0 0.5 0.6\n0 1 0 0.7 0.8\n"
    + "2 1 0 2\n7\n5\n1 1 0.5\n0 0 1\n$EndNodes\n"
    + "$Elements\n3 3 1 3\n1 1 1 1\n1 1 2\n2 1 2 1\n2 1 2 3\n2 1 3 1\n3 1 2 7 3\n$EndElements\n"
    + NODE_DATA
)
TEXT_40 = (
    "$MeshFormat\n4 0 8\n$EndMeshFormat\n"
    + "$Nodes\n1 5\n1 2 0 5\n"
    + "".join(f"{tag} {x} {y} {z}\n" for tag, (x, y, z) in zip(TAGS, POINTS, strict=True))
    + "$EndNodes\n$Elements\n2 2\n1 2 2 1\n2 1 2 3\n1 2 3 1\n3 1 2 7 3\n$EndElements\n"
)
TEXTS = {"2.2": TEXT_22, "4.0": TEXT_40, "4.1": TEXT_41}


@pytest.mark.parametrize("version", TEXTS)
def test_text_files_keep_all_but_positions(version):
    data = TEXTS[version].encode("utf-8")
    file, _, output = patched(data, "a.msh")
    assert [one.tolist() for one in file.polygons()] == [[0, 1, 2], [0, 1, 3, 2]]
    lines = data.splitlines()
    moved = [lines[k].split()[-5 if version == "4.1" else 0 :] for k in changed_lines(data, output)]
    assert len(moved) == 4
    before, after = data.splitlines(), output.splitlines()
    for k in changed_lines(data, output):
        kept = slice(3, None) if version == "4.1" else slice(0, 1)
        assert before[k].split()[kept] == after[k].split()[kept]
    if version != "4.0":
        assert file.properties == ("PhysicalNames", "NodeData")
        assert output.endswith(NODE_DATA.encode())


def binary(version: str, order: str) -> bytes:
    def i4(*values):
        return np.array(values, f"{order}i4").tobytes()

    def u8(*values):
        return np.array(values, f"{order}u8").tobytes()

    def f8(*values):
        return np.array(values, f"{order}f8").tobytes()

    data = f"$MeshFormat\n{version} 1 8\n".encode() + i4(1) + b"\n$EndMeshFormat\n$Nodes\n"
    if version == "2.2":
        data += b"5\n" + b"".join(i4(t) + f8(*p) for t, p in zip(TAGS, POINTS, strict=True))
        data += b"\n$EndNodes\n$Elements\n3\n" + i4(1, 1, 2, 9, 0, 1, 1, 2)
        data += i4(2, 1, 2, 10, 0, 1, 1, 2, 3) + i4(3, 1, 2, 11, 0, 1, 1, 2, 7, 3)
        return data + b"\n$EndElements\n"
    data += u8(2, 5, 1, 7) + i4(2, 1, 1) + u8(3) + u8(*TAGS[:3])
    data += b"".join(f8(*p, 0.25, 0.75) for p in POINTS[:3])
    data += i4(2, 1, 0) + u8(2) + u8(*TAGS[3:]) + f8(*POINTS[3]) + f8(*POINTS[4])
    data += b"\n$EndNodes\n$Elements\n" + u8(2, 2, 1, 2) + i4(2, 1, 2) + u8(1) + u8(1, 1, 2, 3)
    return data + i4(2, 1, 3) + u8(1) + u8(2, 1, 2, 7, 3) + b"\n$EndElements\n"


@pytest.mark.parametrize("version", ["2.2", "4.1"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_files(version, order):
    data = binary(version, order)
    file, moved, output = patched(data, "a.msh")
    assert file.encoding == "binary"
    assert [one.tolist() for one in file.polygons()] == [[0, 1, 2], [0, 1, 3, 2]]
    assert np.array_equal(file.vertices, POINTS)
    assert len(output) == len(data)
    # The numbers stand in the file as they are, and nothing else differs.
    for old, new in zip(POINTS, moved, strict=True):
        output = output.replace(
            np.array(new, f"{order}f8").tobytes(), np.array(old, f"{order}f8").tobytes()
        )
    assert output == data


def changed(text: str, old: str, new: str) -> bytes:
    assert old in text
    return text.replace(old, new).encode()


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (changed(TEXT_22, "2.2 0 8", "1 0 8"), "E_UNSUPPORTED"),
        (changed(TEXT_22, "$Nodes\n5", "$Nodes\n6"), "E_TRUNCATED"),
        (changed(TEXT_22, "$EndNodes", ""), "E_TRUNCATED"),
        (changed(TEXT_22, "3 2 2 1 1 1 2 3", "3 2 2 1 1 1 2 4"), "E_INDEX"),
        (changed(TEXT_22, "3 2 2 1 1 1 2 3", "3 2 2 1 1 1 2"), "E_FORMAT"),
        (changed(TEXT_22, "3 2 2 1 1 1 2 3", "3 9 2 1 1 1 2 3 1 2 3"), "E_UNSUPPORTED"),
        (changed(TEXT_22, "$Elements\n5", "$Elements\n99"), "E_TRUNCATED"),
        (changed(TEXT_41, "$Nodes\n2", "$Nodes\n99999999"), "E_TRUNCATED"),
        (changed(TEXT_41, "2 1 3 1\n", "2 1 99 1\n"), "E_UNSUPPORTED"),
        (changed(TEXT_41, "0 1 0 0.7", "0 x 0 0.7"), "E_FORMAT"),
        (binary("4.1", "<")[:-30], "E_TRUNCATED"),
        (binary("4.1", "<").replace(b"\1\0\0\0\n$End", b"\2\0\0\0\n$End"), "E_FORMAT"),
        (b"$NOD\n1\n1 0 0 0\n$ENDNOD\n", "E_UNSUPPORTED"),
        (b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n", "E_FORMAT"),
        (b'(1 "meshio 5.3.5")\n(2 3)\n(10 (0 1 a 0))\n', "E_UNSUPPORTED"),
        (b'(0 "GAMBIT to Fluent File")\n', "E_UNSUPPORTED"),
        (
            changed(TEXT_22, "$Nodes\n5", "$ParametricNodes\n5").replace(
                b"$EndNodes", b"$EndParametricNodes"
            ),
            "E_UNSUPPORTED",
        ),
    ],
)
def test_damage(data, code):
    with pytest.raises(MsalError) as caught:
        open_mesh(data, "a.msh")
    assert caught.value.code == code
