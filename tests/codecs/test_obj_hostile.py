"""Bad OBJ files: a typed error with the place, never anything else, however the bytes are bent."""

from __future__ import annotations

import pytest

from msal_cli.codecs import obj
from msal_cli.errors import InputError

V = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
F = b"f 1 2 3\n"

# name: data, code, place
DAMAGED = {
    # nothing there
    "empty": (b"", "E_TRUNCATED", ""),
    "only a mark": (b"\xef\xbb\xbf", "E_NO_FACES", ""),
    "only comments": (b"# v 1 2 3\n# f 1 2 3\n", "E_NO_FACES", ""),
    "no faces": (V, "E_NO_FACES", ""),
    "only lines": (V + b"l 1 2 3\n", "E_NO_FACES", ""),
    "only short faces": (V + b"f 1 2\nf 3\n", "E_NO_FACES", ""),
    "capitals": ((V + F).upper(), "E_NO_FACES", ""),
    "no vertices": (b"vt 0 0\nvn 0 0 1\n", "E_NO_FACES", ""),
    "another text": (b"<html>\n<body>\n", "E_NO_FACES", ""),
    "curves only": (b"vp 0\ncurv 0 1 1 2\nend\n", "E_NO_FACES", ""),
    # not text
    "zero byte": (V + b"\x00" + F, "E_FORMAT", "byte 24, line 4"),
    "zero byte far behind": (V + F + b"#" * 5000 + b"\n\x00", "E_FORMAT", "byte 5033, line 6"),
    "binary": (bytes(range(1, 256)), "E_FORMAT", "byte 0"),
    "gzip": (b"\x1f\x8b\x08\x00" + V, "E_FORMAT", "bytes 0 to 28"),
    "control behind text": (V + b"\x02" + F, "E_FORMAT", "line 4"),
    # positions
    "one number": (b"v 1\n" + V + F, "E_FORMAT", "line 1, vertex 1"),
    "two numbers": (V + b"v 1 2\n" + F, "E_FORMAT", "line 4, vertex 4"),
    "in the plane": (b"# 2-D\nv 0 0\nv 1 0 \nv 0 1\n" + F, "E_FORMAT", "line 2, vertex 1"),
    "a word": (V + b"v 1 zwei 3\n" + F, "E_FORMAT", "line 4, vertex 4"),
    "comma": (b"v 1,5 2 3\n" + V + F, "E_FORMAT", "line 1"),
    "half an exponent": (b"v 1e 2 3\n" + V + F, "E_FORMAT", "line 1"),
    "fortran": (b"v 1d0 2 3\n" + V + F, "E_FORMAT", "line 1"),
    "glued comment": (b"v 1 2 3#c\n" + V + F, "E_FORMAT", "line 1"),
    "lonely backslash": (b"v 1 \\ 2 3\n" + V + F, "E_FORMAT", "line 1"),
    "bad w": (V + b"v 1 2 3 w\n" + F, "E_FORMAT", "line 4, vertex 4"),
    "not ascii": (b"v 1 2 \xc2\xb3\n" + V + F, "E_FORMAT", "line 1"),
    "very long word": (b"v " + b"9" * 9000 + b"x 1 2\n" + V + F, "E_FORMAT", "line 1"),
    "nan": (V + b"v nan 0 0\n" + F, "E_NONFINITE", "line 4, vertex 4"),
    "infinite": (b"v 0 0 inf\n" + V + F, "E_NONFINITE", "line 1, vertex 1"),
    "too large": (V + b"v 0 1e999 0\n" + F, "E_NONFINITE", "line 4, vertex 4"),
    "old nan": (V + b"v 1.#QNAN 0 0\n" + F, "E_NONFINITE", "line 4"),
    "old nan behind many digits": (
        b"v 0 " + b"8" * 30 + b".#IND 0\n" + V + F, "E_NONFINITE", "line 1",
    ),
    # normals
    "short normal": (V + b"vn 0 1\n" + F, "E_FORMAT", "line 4, normal 1"),
    "bad normal alone": (b"vn \xff\n", "E_FORMAT", "line 1, normal 1"),
    "bad normal": (V + b"vn 0 0 up\n" + F, "E_FORMAT", "line 4, normal 1"),
    # faces
    "index 0": (V + b"f 0 1 2\n", "E_INDEX", "line 4, face 1"),
    "beyond": (V + F + b"f 1 2 4\n", "E_INDEX", "line 5, face 2"),
    "beyond in a quad": (
        V + b"v 1 1 0\nf 1 2 3\nf 1 2\nf 1 2 3 4\nf 1 2 4 9\n", "E_INDEX", "line 8, face 4",
    ),
    "before the first": (V + b"f -1 -2 -4\n", "E_INDEX", "line 4, face 1"),
    "before any": (b"f -1 -2 -3\n" + V + F, "E_INDEX", "line 1, face 1"),
    "huge": (V + b"f 1 2 " + b"9" * 20 + b"\n", "E_INDEX", "line 4, face 1"),
    "index 0 in a short one": (V + F + b"f 0 1\n", "E_INDEX", "line 5, face 2"),
    "bad behind short": (V + b"f 1\nf 1 2 x\n", "E_FORMAT", "line 5, face 2"),
    "no corners": (V + b"f\n" + F, "E_FORMAT", "line 4, face 1"),
    "not whole": (V + b"f 1.0 2 3\n" + F, "E_FORMAT", "line 4, face 1"),
    "a name": (V + b"f a b c\n" + F, "E_FORMAT", "line 4, face 1"),
    "no vertex": (V + b"f //1 2 3\n" + F, "E_FORMAT", "line 4, face 1"),
    "four numbers": (V + b"f 1/1/1/1 2 3\n" + F, "E_FORMAT", "line 4"),
    "bad vn": (V + b"f 1//x 2 3\n" + F, "E_FORMAT", "line 4"),
    "commas in a face": (V + b"f 1,2,3\n" + F, "E_FORMAT", "line 4"),
    "second face": (V + F + b"f 1 2 x\n", "E_FORMAT", "line 5, face 2"),
    "comment glued": (V + b"f 1 2 3#\n" + F, "E_FORMAT", "line 4"),
    # cut off
    "cut vertex": (V + F + b"v 1 2", "E_TRUNCATED", "line 5"),
    "cut number": (V + F + b"v 1 2 -", "E_TRUNCATED", "line 5"),
    "cut keyword": (V + F + b"v", "E_TRUNCATED", "line 5"),
    "cut face": (V + F + b"f 1 2", "E_TRUNCATED", "line 5"),
    "cut normal": (V + F + b"vn 0 0", "E_TRUNCATED", "line 5"),
    "cut continuation": (V + b"f 1 \\\n2 3 \\", "E_TRUNCATED", "line 5"),
    "cut behind vn": (V + F + b"vn", "E_TRUNCATED", "line 5"),
}  # fmt: skip


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize(
    ("lines", "place"),
    [
        ([b"# a", b"", b"v 0 0 0", b"v 1 x 0"], "line 4"),
        ([b"v 0 \\", b"0 \\", b"0", b"v 1 0 x"], "line 4"),
        ([b"v 0 0 0", b"v 1 0 \\", b"", b"f 1 1 1"], "line 3"),
        ([b"v 0 0 0", b"g a \\", b"b", b"f 1 1 2"], "line 4"),
        ([b"v 0 0 0", b"# a \\", b"f 1 1 2"], "line 3"),
        ([b"\xef\xbb\xbfv 0 0 0", b"", b"", b"f 1 1 0"], "line 4"),
        ([b"v 0 0 0", b"v 0 nan 0", b"f 1 1 1"], "line 2"),
    ],
)
def test_lines_are_counted_for_every_line_end(lines: list[bytes], place: str, end: bytes) -> None:
    with pytest.raises(InputError) as caught:
        obj.read(end.join([*lines, b""]), "bad.obj")
    assert caught.value.where.split(",")[0] == place


def test_claims_do_not_take_memory() -> None:
    # Counted as statements at first sight, and none of them is one.
    data = V + F + b"#" + b" v" * 300_000 + b" f" * 300_000 + b"\n"
    file = obj.read(data, "")
    assert (len(file.vertices), len(file.faces)) == (3, 1)
    base = file.vertices.base
    assert base is not None and base.nbytes < 4 * len(data)


def test_normals_of_any_length_are_replaced_without_a_word() -> None:
    normals = b"".join(b"vn -1.7e308 1.7e308 %s1.7e308\n" % sign for sign in (b"", b"-"))
    data = V + b"v 1 1 1\n" + normals + b"f 1//1 2//1 3//2\nf 2//1 3//2 4//1\n"
    file = obj.read(data, "")
    vertices = file.vertices * 1.5
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert b"308" not in output
