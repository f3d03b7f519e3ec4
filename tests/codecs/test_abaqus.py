"""Abaqus input files."""

from __future__ import annotations

import pytest

from msal_cli.codecs import open_mesh
from msal_cli.errors import MsalError
from tests.codecs.patching import changed_lines, patched

TEXT = """*HEADING
 a part, not *INCLUDE, of two
** a comment: *NODE
*Node, nset=all
10, 0.0, 0.0, 0.0
20, 1.0, 0.0, 0.0
** between
30, 0.0, 1.0, 0.0
40, 1.0D+00, 1.0, 0.5
*ELEMENT, TYPE=S3R,
 ELSET=skin
1, 10, 20, 30
*Element, type=S4
2, 10, 20,
 40, 30
*ELEMENT, TYPE=T3D2
3, 10, 20
*ELEMENT, TYPE=C3D4
4, 10, 20, 30, 40
*NSET, NSET=some, INPUT=other.txt
*MATERIAL, NAME=steel
*END STEP
"""


def test_everything_but_positions_stays():
    file, _, output = patched(TEXT.encode(), "a.inp")
    assert [one.tolist() for one in file.polygons()] == [[0, 1, 2], [0, 1, 3, 2]]
    assert changed_lines(TEXT.encode(), output) == [4, 5, 7]
    assert file.warnings == ("other cells (1 C3D4) are kept; their corners move with the surface",)


def test_parts_number_their_own_nodes():
    part = (
        "*PART, NAME={}\n*NODE\n1,{},0,0\n2,1,0,0\n3,0,1,0\n*ELEMENT,TYPE=STRI3\n1,{}\n*END PART\n"
    )
    data = (part.format("a", 0, "1,2,3") + part.format("b", 5, "3,2,1")).encode()
    file, _, _ = patched(data, "a.inp")
    assert file.faces.tolist() == [[0, 1, 2], [5, 4, 3]]
    assert file.vertices[3, 0] == 5
    assert "parts are denoised where their own nodes are" in file.warnings[0]


@pytest.mark.parametrize(
    "line",
    [
        "*INCLUDE, INPUT={}",
        "*include,input={}",
        " *Include,\n input={}",
        "*NODE, INPUT={}",
        "*ELEMENT, TYPE=S3, INPUT={}",
    ],
)
@pytest.mark.parametrize("is_absolute", [True, False])
def test_no_other_file_is_opened(tmp_path, monkeypatch, line, is_absolute):
    (tmp_path / "secret.txt").write_text("1, 7, 7, the secret\n")
    monkeypatch.chdir(tmp_path)
    name = str(tmp_path / "secret.txt") if is_absolute else "secret.txt"
    with pytest.raises(MsalError, match="another file, which msal does not open") as caught:
        open_mesh((TEXT + line.format(name) + "\n").encode(), "a.inp")
    assert caught.value.code == "E_UNSUPPORTED"
    assert "secret" not in str(caught.value) + caught.value.hint
    assert caught.value.where.startswith("line ")


def test_an_endless_file_is_not_opened():
    with pytest.raises(MsalError, match="another file"):
        open_mesh(TEXT.encode() + b"*INCLUDE, INPUT=/dev/zero\n", "a.inp")


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("1, 10, 20, 30\n", "1, 10, 20, 31\n", "E_INDEX"),
        ("1, 10, 20, 30\n", "1, 10, 20\n", "E_FORMAT"),
        ("TYPE=S3R", "TYPE=STRI65", "E_UNSUPPORTED"),
        ("nset=all", "system=C", "E_UNSUPPORTED"),
        ("20, 1.0, 0.0, 0.0", "20, 1.0, 0.0", "E_UNSUPPORTED"),
        ("20, 1.0, 0.0, 0.0", "20, 1.0, x, 0.0", "E_FORMAT"),
        ("*Node", "*Nodes", "E_FORMAT"),
        (TEXT[TEXT.index("*ELEMENT, TYPE=S3R") :], "", "E_NO_FACES"),
    ],
)
def test_damage(old, new, code):
    assert old in TEXT
    with pytest.raises(MsalError) as caught:
        open_mesh(TEXT.replace(old, new).encode(), "a.inp")
    assert caught.value.code == code


def test_words_without_end_are_refused(monkeypatch):
    from msal_cli.codecs import abaqus

    monkeypatch.setattr(abaqus, "_MOST_KEYWORDS", 100)
    with pytest.raises(MsalError) as caught:
        open_mesh(TEXT.encode() + b"*A\n" * 200, "a.inp")
    assert caught.value.code == "E_TOO_LARGE"
