"""OFF files."""

import numpy as np
import pytest

from msal_cli.codecs import open_mesh
from msal_cli.errors import MsalError
from tests.codecs.patching import patched, polygons_of, texts_between_numbers

POINTS = ["0 0 0", "1 0 0", "0.0 1.0 0.0", "0 0 1"]
FACES = ["3 0 2 1", "3 0 1 3", "3 1 2 3", "3 2 0 3"]


def off(head="OFF\n4 4 6", points=POINTS, faces=FACES, end="\n") -> bytes:
    return end.join([head, *points, *faces, ""]).encode("latin-1")


HEADS = [
    "OFF\n4 4 6",
    "OFF\n4 4",
    "OFF 4 4 6",
    "OFF4 4 6",
    "# a comment\n4 4 6",
    "# a comment\nOFF4 4",
    "OFF # made by hand\n\n# caf\xe9\n4 4 6 # counts\n",
    "# a comment\n\n  OFF\n\n4 4 6\n\n",
    "\n\nOFF\n4\n4 6",
]


@pytest.mark.parametrize("head", HEADS)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_comments_and_blank_lines_stay(head, end):
    data = off(head.replace("\n", end), end=end)
    file, _, output = patched(data, "a.off")
    assert file.warnings == ()
    assert texts_between_numbers(output) == texts_between_numbers(data)
    assert output.startswith(head.replace("\n", end).encode("latin-1"))
    assert output.endswith(end.join([POINTS[3], *FACES, ""]).encode())


@pytest.mark.parametrize(
    ("kind", "tail", "words"),
    [
        ("COFF", " 255 0 0 255", {"vertex colours"}),
        ("COFF", " 0.5 0.25 0", {"vertex colours"}),
        ("STOFF", " 0.5 0.25", {"texture coordinates"}),
        ("NOFF", " 0 0 2", {"point.normals"}),
        ("STCNOFF", " 0 0 2 1 1 1 1 .5 .5", {"point.normals", "vertex colours"}),
    ],
)
def test_variants(kind, tail, words):
    data = off(f"{kind}\n4 4 6", [point + tail for point in POINTS])
    file, moved, output = patched(data, "a.off")
    assert words <= set(file.properties)
    assert file.warnings == ()
    rows = [line.split() for line in output.splitlines()[2:6]]
    assert np.abs(np.array(rows, dtype=float)[:, :3] - moved).max() < 1e-6
    own = tail.split()
    if "N" in kind:
        normals = np.array(rows, dtype=float)[:, 3:6]
        assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5
        assert [row[6:] for row in rows] == [[word.encode() for word in own[3:]]] * 4
    else:
        assert [row[3:] for row in rows] == [[word.encode() for word in own]] * 4


def test_meshlab_writes_colours_before_normals():
    head = "NCSTOFF\n4 4 0"
    data = off(head, [point + " 255 0 0 255 0 0 2 .5 .5" for point in POINTS])
    file, _, output = patched(data, "a.off")
    assert file.warnings == ()
    for line in output.splitlines()[2:6]:
        words = line.split()
        assert words[3:7] == [b"255", b"0", b"0", b"255"] and words[10:] == [b".5", b".5"]
        assert abs(np.linalg.norm([float(word) for word in words[7:10]]) - 1) < 1e-5


def test_colours_behind_plain_positions_are_kept_and_told_of():
    file, _, output = patched(off(points=[point + " 9 8 7" for point in POINTS]), "a.off")
    assert file.warnings == ("3 numbers behind each position, kept",)
    assert all(line.endswith(b" 9 8 7") for line in output.splitlines()[2:6])


def test_faces_keep_their_colours_and_corners():
    faces = ["3 0 2 1 255 0 0", "4 0 1 3 2  0.1 0.2 0.3 1", "3 2 0 3"]
    file, _, output = patched(off("OFF\n4 3 0", faces=faces), "a.off")
    assert [len(one) for one in polygons_of(file)] == [3, 4, 3]
    assert len(file.faces) == 4
    assert "face colours" in file.properties
    assert output.splitlines()[-3:] == [face.encode() for face in faces]


DAMAGED = {
    "cut.off": (off()[:40], "E_TRUNCATED"),
    "counts.off": (b"OFF\n999999999999 1 0\n0 0 0\n", "E_TRUNCATED"),
    "words.off": (b"OFF\nthree one none\n", "E_FORMAT"),
    "no_faces.off": (b"OFF\n1 0 0\n0 0 0\n", "E_NO_FACES"),
    "page.off": (b"<html></html>", "E_FORMAT", "line 1"),
    "binary.off": (b"OFF BINARY\n" + bytes(60), "E_UNSUPPORTED"),
    "four.off": (b"4OFF\n1 0 0\n0 0 0 1\n", "E_UNSUPPORTED"),
    "nan.off": (off().replace(b"1 0 0\n", b"nan 0 0\n"), "E_NONFINITE"),
    "coordinate.off": (off(points=[*POINTS[:3], "0 0 x"]), "E_FORMAT", "line 6"),
    "two corners.off": (off(faces=[*FACES[:3], "3 2 0"]), "E_FORMAT", "line 10"),
    "corner.off": (off(faces=[*FACES[:3], "3 2 0 4"]), "E_INDEX", "line 10"),
    "fraction.off": (off(faces=[*FACES[:3], "3 2 0 1.5"]), "E_FORMAT", "line 10"),
    "a face more.off": (off("OFF\n4 5 0"), "E_TRUNCATED", "line 11"),
    "no normals.off": (off("NOFF\n4 4 0"), "E_FORMAT"),
}


@pytest.mark.parametrize("head", [b"#" * 5000 + b"\nX", b"# # " * 5000, b"#\n" * 50_000])
def test_comments_take_no_time(head):
    with pytest.raises(MsalError, match="does not begin with OFF"):
        open_mesh(head, "a.off")
