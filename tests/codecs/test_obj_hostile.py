"""Bad OBJ files: a typed error with the place, never anything else, however the bytes are bent."""

from __future__ import annotations

import pytest

from msal_cli.codecs import obj
from msal_cli.errors import ContentError, FormatError, InputError, MsalError, TruncatedError

V = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
F = b"f 1 2 3\n"

# name: data, class, code, what "where" must hold, a word of the message or of the hint
MALFORMED: dict[str, tuple[bytes, type[InputError], str, str, str]] = {
    # nothing there
    "empty": (b"", TruncatedError, "E_TRUNCATED", "", "empty"),
    "only a mark": (b"\xef\xbb\xbf", ContentError, "E_NO_FACES", "", "no vertices"),
    "only line ends": (b"\r\n\n\r", ContentError, "E_NO_FACES", "", "no vertices"),
    "only comments": (b"# v 1 2 3\n# f 1 2 3\n", ContentError, "E_NO_FACES", "", "no vertices"),
    "no faces": (V, ContentError, "E_NO_FACES", "", "point cloud"),
    "only lines": (V + b"l 1 2 3\n", ContentError, "E_NO_FACES", "", "no faces"),
    "only short faces": (V + b"f 1 2\nf 3\n", ContentError, "E_NO_FACES", "", "one or two corners"),
    "capitals": ((V + F).upper(), ContentError, "E_NO_FACES", "", "capitals"),
    "no vertices": (b"vt 0 0\nvn 0 0 1\n", ContentError, "E_NO_FACES", "", "no vertices"),
    "another text": (b"<html>\n<body>\n", ContentError, "E_NO_FACES", "", "check that this is"),
    "curves only": (b"vp 0\ncurv 0 1 1 2\nend\n", ContentError, "E_NO_FACES", "", "no vertices"),
    # not text
    "zero byte": (V + b"\x00" + F, FormatError, "E_FORMAT", "byte 24, line 4", "binary"),
    "zero byte far behind": (
        V + F + b"#" * 5000 + b"\n\x00", FormatError, "E_FORMAT", "byte 5033, line 6", "binary",
    ),
    "binary": (bytes(range(1, 256)), FormatError, "E_FORMAT", "byte 0", "control"),
    "gzip": (b"\x1f\x8b\x08\x00" + V, FormatError, "E_FORMAT", "byte 0", "control"),
    "control behind text": (V + b"\x02" + F, FormatError, "E_FORMAT", "line 4", "control"),
    # positions
    "one number": (b"v 1\n" + V + F, FormatError, "E_FORMAT", "line 1, vertex 1", "three numbers"),
    "two numbers": (V + b"v 1 2\n" + F, FormatError, "E_FORMAT", "line 4, vertex 4", "three"),
    "in the plane": (
        b"# 2-D\nv 0 0\nv 1 0 \nv 0 1\n" + F, FormatError, "E_FORMAT", "line 2, vertex 1",
        "it has two",
    ),
    "no number": (b"\n\nv\n" + V + F, FormatError, "E_FORMAT", "line 3, vertex 1", "three numbers"),
    "two and a comment": (b"v 1 2 # 3\n" + V + F, FormatError, "E_FORMAT", "line 1", "three"),
    "a word": (V + b"v 1 zwei 3\n" + F, FormatError, "E_FORMAT", "line 4, vertex 4", "'zwei'"),
    "comma": (b"v 1,5 2 3\n" + V + F, FormatError, "E_FORMAT", "line 1", "'1,5'"),
    "commas between": (b"v 1, 2, 3\n" + V + F, FormatError, "E_FORMAT", "line 1", "'1,'"),
    "half an exponent": (b"v 1e 2 3\n" + V + F, FormatError, "E_FORMAT", "line 1", "'1e'"),
    "fortran": (b"v 1d0 2 3\n" + V + F, FormatError, "E_FORMAT", "line 1", "'1d0'"),
    "hexadecimal": (b"v 0x1 2 3\n" + V + F, FormatError, "E_FORMAT", "line 1", "'0x1'"),
    "underscore": (b"v 1_0 2 3\n" + V + F, FormatError, "E_FORMAT", "line 1", "'1_0'"),
    "two signs": (b"v --1 2 3\n" + V + F, FormatError, "E_FORMAT", "line 1", "'--1'"),
    "glued comment": (b"v 1 2 3#c\n" + V + F, FormatError, "E_FORMAT", "line 1", "'3#c'"),
    "lonely backslash": (b"v 1 \\ 2 3\n" + V + F, FormatError, "E_FORMAT", "line 1", "number"),
    "bad w": (V + b"v 1 2 3 w\n" + F, FormatError, "E_FORMAT", "line 4, vertex 4", "'w'"),
    "not ascii": (b"v 1 2 \xc2\xb3\n" + V + F, FormatError, "E_FORMAT", "line 1", "number"),
    "very long word": (b"v " + b"9" * 9000 + b"x 1 2\n" + V + F, FormatError, "E_FORMAT", "line 1",
                       "9999"),
    "nan": (V + b"v nan 0 0\n" + F, ContentError, "E_NONFINITE", "line 4, vertex 4", "nan"),
    "minus nan": (V + b"v 0 -NaN(ind) 0\n" + F, ContentError, "E_NONFINITE", "line 4", "nan"),
    "infinite": (b"v 0 0 inf\n" + V + F, ContentError, "E_NONFINITE", "line 1, vertex 1", "inf"),
    "too large": (V + b"v 0 1e999 0\n" + F, ContentError, "E_NONFINITE", "line 4, vertex 4", "inf"),
    "old nan": (V + b"v 1.#QNAN 0 0\n" + F, ContentError, "E_NONFINITE", "line 4", "not finite"),
    "old nan behind many digits": (
        b"v 0 " + b"8" * 30 + b".#IND 0\n" + V + F, ContentError, "E_NONFINITE", "line 1",
        "not finite",
    ),
    "old inf": (V + b"v 0 0 -1.#INF\n" + F, ContentError, "E_NONFINITE", "line 4", "not finite"),
    # normals
    "short normal": (V + b"vn 0 1\n" + F, FormatError, "E_FORMAT", "line 4, normal 1", "three"),
    "bad normal alone": (b"vn \xff\n", FormatError, "E_FORMAT", "line 1, normal 1", "number"),
    "bad normal": (V + b"vn 0 0 up\n" + F, FormatError, "E_FORMAT", "line 4, normal 1", "'up'"),
    # faces
    "index 0": (V + b"f 0 1 2\n", ContentError, "E_INDEX", "line 4, face 1", "vertex 0"),
    "beyond": (V + F + b"f 1 2 4\n", ContentError, "E_INDEX", "line 5, face 2", "vertex 4"),
    "beyond in a quad": (
        V + b"v 1 1 0\nf 1 2 3\nf 1 2\nf 1 2 3 4\nf 1 2 4 9\n", ContentError, "E_INDEX",
        "line 8, face 4", "vertex 9",
    ),
    "before the first": (V + b"f -1 -2 -4\n", ContentError, "E_INDEX", "line 4, face 1", "-4"),
    "before any": (b"f -1 -2 -3\n" + V + F, ContentError, "E_INDEX", "line 1, face 1", "-1"),
    "huge": (V + b"f 1 2 " + b"9" * 20 + b"\n", ContentError, "E_INDEX", "line 4, face 1", "2147"),
    "32 bits": (V + b"f 1 2 4294967297\n", ContentError, "E_INDEX", "line 4, face 1", "2147"),
    "very negative": (V + b"f 1 2 -" + b"9" * 20 + b"\n", ContentError, "E_INDEX", "line 4", "-99"),
    "index 0 in a short one": (V + F + b"f 0 1\n", ContentError, "E_INDEX", "line 5, face 2", "0"),
    "behind a short one": (V + b"f 1 2\nf 0 1 2\n", ContentError, "E_INDEX", "line 5, face 2", "0"),
    "bad behind short": (V + b"f 1\nf 1 2 x\n", FormatError, "E_FORMAT", "line 5, face 2", "x"),
    "no corners": (V + b"f\n" + F, FormatError, "E_FORMAT", "line 4, face 1", "no corners"),
    "comment only": (V + b"f # 1 2 3\n" + F, FormatError, "E_FORMAT", "line 4, face 1", "corners"),
    "not whole": (V + b"f 1.0 2 3\n" + F, FormatError, "E_FORMAT", "line 4, face 1", "'1.0'"),
    "a name": (V + b"f a b c\n" + F, FormatError, "E_FORMAT", "line 4, face 1", "'a'"),
    "no vertex": (V + b"f //1 2 3\n" + F, FormatError, "E_FORMAT", "line 4, face 1", "'//1'"),
    "four numbers": (V + b"f 1/1/1/1 2 3\n" + F, FormatError, "E_FORMAT", "line 4", "'1/1/1/1'"),
    "bad vt": (V + b"f 1/a 2 3\n" + F, FormatError, "E_FORMAT", "line 4", "'1/a'"),
    "bad vn": (V + b"f 1//x 2 3\n" + F, FormatError, "E_FORMAT", "line 4", "'1//x'"),
    "commas in a face": (V + b"f 1,2,3\n" + F, FormatError, "E_FORMAT", "line 4", "'1,2,3'"),
    "second face": (V + F + b"f 1 2 x\n", FormatError, "E_FORMAT", "line 5, face 2", "'x'"),
    "comment glued": (V + b"f 1 2 3#\n" + F, FormatError, "E_FORMAT", "line 4", "'3#'"),
    # cut off
    "cut vertex": (V + F + b"v 1 2", TruncatedError, "E_TRUNCATED", "line 5", "breaks off"),
    "cut number": (V + F + b"v 1 2 -", TruncatedError, "E_TRUNCATED", "line 5", "breaks off"),
    "cut exponent": (V + F + b"v 1 2 3e", TruncatedError, "E_TRUNCATED", "line 5", "breaks off"),
    "cut keyword": (V + F + b"v", TruncatedError, "E_TRUNCATED", "line 5", "breaks off"),
    "cut face": (V + F + b"f 1 2", TruncatedError, "E_TRUNCATED", "line 5", "three corners"),
    "cut behind f": (V + F + b"f ", TruncatedError, "E_TRUNCATED", "line 5", "breaks off"),
    "cut minus": (V + F + b"f 1 2 -", TruncatedError, "E_TRUNCATED", "line 5", "breaks off"),
    "cut normal": (V + F + b"vn 0 0", TruncatedError, "E_TRUNCATED", "line 5", "breaks off"),
    "cut continuation": (V + b"f 1 \\\n2 3 \\", TruncatedError, "E_TRUNCATED", "line 5", "breaks"),
    "cut behind vn": (V + F + b"vn", TruncatedError, "E_TRUNCATED", "line 5", "breaks off"),
}  # fmt: skip


@pytest.mark.parametrize("name", MALFORMED)
def test_malformed(name: str) -> None:
    data, kind, code, where, words = MALFORMED[name]
    with pytest.raises(MsalError) as caught:
        obj.read(data, "bad.obj")
    error = caught.value
    assert type(error) is kind and error.code == code
    assert where in error.where and bool(where) == bool(error.where)
    assert words in error.message or words in error.hint
    assert error.hint and len(error.message) < 200


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


def test_a_last_line_without_its_end_is_fine() -> None:
    for data in (V + F[:-1], F + V[:-1], V + F + b"# x", V + F + b"g"):
        assert obj.read(data, "").faces.tolist() == [[0, 1, 2]]


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
