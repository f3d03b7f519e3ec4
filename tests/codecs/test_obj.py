"""OBJ: positions and normals replaced and every other byte kept, or an error with the place."""

import math
import re
from random import Random
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.codecs import obj
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.errors import InputError, InternalError
from msal_cli.kernels import obj_scan, text
from tests.codecs.patching import any_float, polygons_of, rewritten
from tests.codecs.plain_obj import blanked, parsed, tokens

ROOF = b"""# two sides that meet at an edge, one normal each, and a face without any
v 0 0 0
v 2 0 0
v 2 1 1
v 0 1 1
v 2 2 0
v 0 2 0
vn 0.00 -0.71 0.71
vn 0.0 0.7 0.7
f 1//1 2//1 3//1 4//1
f 4//2 3//2 5//2 6//2
f 1 4 6
"""


def moved(file: MeshFile, seed: int = 0, share: float = 1.0, size: float = 0.01) -> np.ndarray:
    """The file's vertices, some of them shifted."""
    random = np.random.default_rng(seed)
    shift = random.normal(size=file.vertices.shape) * size
    shift[random.random(len(shift)) >= share] = 0.0
    return np.asarray(file.vertices + shift)


# Hand-worked


@pytest.mark.parametrize(
    ("line", "polygon"),
    [
        (b"f 1 2 3", [0, 1, 2]), (b"f 1/1 2/1 3/1", [0, 1, 2]), (b"f 1//1 2//1 3//1", [0, 1, 2]),
        (b"f 1/1/1 2/1/1 3/1/1", [0, 1, 2]), (b"f -4 -3 -2", [0, 1, 2]),
        (b"f -4//-1 2//1 -2//1", [0, 1, 2]), (b"f 1 2 3 4", [0, 1, 2, 3]),
        (b"f\t1\t2\t3", [0, 1, 2]), (b"   f 1   2 3   ", [0, 1, 2]),
        (b"f 1 2 \\\n 3 4", [0, 1, 2, 3]), (b"f 1 2\\\r\n3", [0, 1, 2]), (b"f\\\n1 2 3", [0, 1, 2]),
        (b"f 1 2 3 # 4", [0, 1, 2]), (b"fo 1 2 3", [0, 1, 2]), (b"f +1 2 03", [0, 1, 2]),
        (b"f 1/ 2// 3/1/", [0, 1, 2]), (b"f 1 2/1 3//1", [0, 1, 2]), (b"f 1 1 2", [0, 0, 1]),
        (b"f 4 3 2 1 2 3", [3, 2, 1, 0, 1, 2]), (b"f 1 2 3\\", None), (b"f 1 2 3 #\\", [0, 1, 2]),
        (b"f 1 2 3 \\\n\\\n4", [0, 1, 2, 3]), (b"f 1 2 3 \\\n# 4 is not meant", [0, 1, 2]),
    ],
)  # fmt: skip
def test_forms_of_a_face(line: bytes, polygon: list[int] | None) -> None:
    head = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n"
    file = obj.read(head + line + b"\n" + (b"4\n" if polygon is None else b"f 1 3 4\n"))
    wanted = [0, 1, 2, 3] if polygon is None else polygon
    assert np.asarray(polygons_of(file)[0]).tolist() == wanted
    assert file.faces[: len(wanted) - 2].tolist() == [
        [wanted[0], wanted[k], wanted[k + 1]] for k in range(1, len(wanted) - 1)
    ]
    assert file.warnings == ()


def test_normals_follow_the_faces_that_use_them() -> None:
    file = obj.read(ROOF)
    vertices = file.vertices.copy()
    vertices[[0, 1], 2] = 1.0  # the first side becomes level, the second stays
    output = rewritten(file, vertices)
    assert b"vn 0.00 0.000000 1.000000\nvn 0.0 0.7 0.7\n" in output
    assert blanked(output) == blanked(ROOF)


@pytest.mark.parametrize(
    ("scale", "token"),
    [
        (1.0, b"0.2500000"), (1000.0, b"250.0000"), (1e6, b"250000.0"), (1e-3, b"0.0002500000"),
        (1e9, b"250000000"), (1e-20, b"2.5e-21"), (1e30, b"2.5e+29"),
    ],
)  # fmt: skip
def test_as_many_decimals_as_the_extent_asks_for(scale: float, token: bytes) -> None:
    data = b"v 0 0 0\nv %r 0 0\nv 0 %r 0\nf 1 2 3\n".replace(b"%r", repr(scale).encode())
    file = obj.read(data.replace(b".0\n", b"\n"))
    if repr(scale).endswith(".0"):
        data = data.replace(b".0 ", b" ")
        file = obj.read(data.replace(b".0 0\n", b" 0\n"))
    vertices = file.vertices.copy()
    vertices[0, 2] = scale / 4
    output = rewritten(file, vertices)
    assert tokens(output, "v")[0][2] == token


# What else a file says


def test_properties_references_and_warnings() -> None:
    data = b"""# all of it
mtllib a.mtl my scan.mtl "c d.mtl"
mtllib ./sub/e.MTL \\
 f.mtl
mtllib no suffix
mtllib a.mtl
o thing
g part
s 1
usemtl red
v 0 0 0 0.5
v 1 0 0 1 0 0
v 0 1 0 1.0
vt 0 0
vn 0 0 1
f 1/1/1 2/1/1 3/1/1
f 1/2/1 2/1/7 3/0/1
f 1 99
l 1 2
p 1
vp 0.5
cstype bspline
wibble 1 2
V 1 2 3
"""
    file = obj.read(data)
    assert file.references == (
        "a.mtl", "my scan.mtl", "c d.mtl", "./sub/e.MTL", "f.mtl", "no suffix"
    )  # fmt: skip
    for word in ("texture", "normals", "colours", "weights", "materials", "groups", "objects",
                 "smoothing", "lines", "points", "free-form"):  # fmt: skip
        assert any(word in one for one in file.properties), word
    for words in ("weight w .*line 11", "three corners .*line 18", "coordinate 2, but there are 1",
                  "normal 7, but there are 1", "normal 0, .*1 corner",
                  "'wibble' in line 23, 'V' in line 24"):  # fmt: skip
        assert any(re.search(words, one) for one in file.warnings), words
    assert len(file.warnings) == 6
    assert file.faces.tolist() == [[0, 1, 2]] * 2
    vertices = moved(file)
    output = rewritten(file, vertices)
    assert blanked(output) == blanked(data)


@given(st.binary(max_size=200), st.lists(st.sampled_from([b"v ", b"\nvn\t", b" f\\", b"v"])))
def test_room_is_counted_generously(noise: bytes, more: list[bytes]) -> None:
    data = noise.join([b"", *more])
    lines = re.split(rb"[\r\n]", data)
    found = [obj_scan.count_statements(text.as_bytes(data))[:3] if data else (1, 1, 1)]
    for place, keyword in enumerate((b"v", b"vn", b"f")):
        real = sum(1 for line in lines if re.match(rb"[\s]*%s[ \t\\]" % keyword, line))
        assert found[0][place] >= real


# Identities


BLANKS = [b" ", b"  ", b"\t", b" \t", b" \\\n", b"\\\r\n ", b"\x0c"]
ENDINGS = [b"", b" ", b"\t", b" # trailing v 1 2 3", b" #\\"]


def files(random: Random) -> bytes:
    """An OBJ file with every odd form that the format and its writers know."""
    newline = random.choice([b"\n", b"\r\n", b"\r"])
    n_vertices = n_normals = n_texture = 0
    lines = [] if random.random() < 0.5 else [b"# made by hand \\"]

    def number() -> bytes:
        form = random.choice(["%.3f", "%g", "%.9g", "%r", "%.4e", "%+.2f", "%d"])
        return (form % any_float(random, 1e6)).encode()

    def vector(keyword: bytes, count: int) -> bytes:
        words = b"".join(random.choice(BLANKS) + number() for _ in range(count))
        return keyword + words + random.choice(ENDINGS)

    def index(count: int) -> bytes:
        return b"%d" % random.choice([random.randint(1, count), -random.randint(1, count)])

    for _ in range(random.randint(1, 4)):
        for _ in range(random.randint(3, 6)):
            count = random.choice([3, 3, 3, 4, 6, 7])
            lines.append(random.choice([b"", b" ", b"\t"]) + vector(b"v", count))
            n_vertices += 1
            if random.random() < 0.25:
                lines.append(vector(b"vn", 3))
                n_normals += 1
            if random.random() < 0.25:
                lines.append(vector(b"vt", 2))
                n_texture += 1
        lines += random.choices([
            b"", b"g a b", b"s off", b"usemtl C:\\stone", b"l 1 2 3", b"p 1", b"o v 1 2 3",
            b"#f 9 9",
            b"mtllib v.mtl", b"cstype bezier", b"curv 0 1 \\\n 1 2", b"\t# \xe9\xff", b"f 1 2",
        ], k=random.randint(0, 3))  # fmt: skip
        for _ in range(random.randint(1, 4)):
            face = b"f"
            form = random.randint(0, 3)
            for _ in range(random.choice([3, 3, 4, 5])):
                face += random.choice(BLANKS) + index(n_vertices)
                if form in (1, 3) and n_texture:
                    face += b"/" + index(n_texture)
                if form in (2, 3) and n_normals:
                    slash = b"/" if b"/" in face.split()[-1] else b"//"
                    face += slash + index(n_normals)
            lines.append(face + random.choice(ENDINGS))
    mark = random.choice([b"", b"\xef\xbb\xbf"])
    return mark + newline.join(lines) + random.choice([b"", newline, newline + b"# end"])


FILES = st.builds(files, st.randoms(use_true_random=True))


def read_in_pieces(data: bytes, n_pieces: int) -> tuple[MeshFile, bool]:
    """The file as that many threads read it, and whether they could."""
    could = []

    def walk(self):
        could.append(walk_pieces(self))
        return could[-1]

    walk_pieces = obj._Reader._walk_pieces
    with (
        mock.patch.object(obj, "_MIN_PIECE", 4),
        mock.patch.object(obj, "threads", lambda: n_pieces),
        mock.patch.object(obj._Reader, "_walk_pieces", walk),
    ):
        return obj.read(data), could == [True]


def facts(file: MeshFile) -> list[object]:
    corners = [list(polygon) for polygon in polygons_of(file)]
    output = bytes(file.replaced(moved(file)))
    return [
        file.vertices.tolist(),
        corners,
        file.properties,
        file.references,
        file.warnings,
        output,
    ]


def test_pieces_read_what_one_walk_reads() -> None:
    half = (
        b"o one\nmtllib a.mtl\nv 0 0 0\nv 1 0 0 2\nv 1 1 0\nv 0 1 1e-400 1 1 1\n"
        b"vn 0 0 1\nvn 0 1 0\nvt 0 0\ng x\nf 1/1/1 2/1/2 -2/1/-1\n"
        b"f -4//-2 -2//1 -1//1\n# v \\\nusemtl s \\\n t\n"
    )
    data = half + half.replace(b"one", b"two").replace(b"a.mtl", b"b.mtl")
    whole = facts(obj.read(data))
    assert whole[3] == ("a.mtl", "b.mtl") and len(whole[4]) == 1
    for n_pieces in range(2, 12):
        # A "v" or "vn" in a comment is counted, and one walk reads the text again.
        for text_, is_plain in ((data.replace(b"# v", b"# w"), True), (data, False)):
            file, could = read_in_pieces(text_, n_pieces)
            assert (could, facts(file)[:5]) == (is_plain, whole[:5])
    wrongs = b"v 0 0 x\n|f 1 2 0\n|f 1 2 99\n|vn 1\n|v 0 0 nan\nf 1 2 -1\n|f 1 2"
    for wrong in wrongs.split(b"|"):
        with pytest.raises(InputError) as expected:
            obj.read(data + wrong)
        with pytest.raises(InputError) as found:
            read_in_pieces(data + wrong, 3)
        assert str(found.value) == str(expected.value)


@pytest.mark.parametrize("word", [b" v", b" f", b"vn"])
def test_more_words_than_there_can_be_statements_are_no_places(word: bytes) -> None:
    half = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvn 0 1 0\nf 1 2 3\n"
    data = half + b"#" + 500 * word + b"\n" + half
    walk = mock.patch.object(obj.scan, "scan", wraps=obj.scan.scan)
    with walk as scan:
        file, could = read_in_pieces(data, 4)
    # Only the walk over all: that of a piece would begin beyond the end of its arrays.
    assert (could, scan.call_count, facts(file)) == (False, 1, facts(obj.read(data)))


@given(FILES, st.integers(2, 5))
def test_pieces_of_any_file(data: bytes, n_pieces: int) -> None:
    assert facts(read_in_pieces(data, n_pieces)[0]) == facts(obj.read(data))


@given(FILES, st.integers(0, 99), st.sampled_from([0.0, 0.3, 1.0]))
def test_only_the_numbers_of_what_moved_differ(data: bytes, seed: int, share: float) -> None:
    file = obj.read(data)
    plain = parsed(data)
    assert file.vertices.tolist() == plain.vertices
    assert file.faces.tolist() == plain.triangles()
    assert [list(one) for one in polygons_of(file)] == plain.polygons
    vertices = moved(file, seed, share, size=1e3)
    output = rewritten(file, vertices)
    is_moved = (vertices != file.vertices).any(axis=1)
    if not is_moved.any():
        assert output == data
    assert blanked(output) == blanked(data)
    after = obj.read(output)
    step = 10.0 ** -max(1, len(tokens(output, "v")[0][0]))
    assert np.abs(after.vertices - vertices).max() <= max(0.5, step)
    assert (after.vertices[~is_moved] == file.vertices[~is_moved]).all()
    old, new = tokens(data, "v"), tokens(output, "v")
    assert all(old[k] == new[k] for k in np.flatnonzero(~is_moved))
    used = {
        n
        for polygon, normals in zip(plain.polygons, plain.corner_normals, strict=True)
        for n in normals
        if n >= 0 and is_moved[polygon].any()
    }
    if not share:
        assert tokens(output, "vn") == tokens(data, "vn")
    everyone = {n for normals in plain.corner_normals for n in normals}
    for k, (before, now) in enumerate(zip(tokens(data, "vn"), tokens(output, "vn"), strict=True)):
        assert before == now or (used and k in everyone)


def test_a_position_has_the_decimals_of_its_own_line() -> None:
    ring = [b"v %.3f %.3f 0" % (math.cos(k / 100), math.sin(k / 100)) for k in range(600)]
    ring[7] = b"v 0.997551000253279572 0.069942847337532768 0"
    data = b"\n".join([*ring, b"f 1 2 3"])
    file = obj.read(data)
    new = bytes(file.replaced(file.vertices + 1e-4))
    words = tokens(new, "v")
    assert {len(word.partition(b".")[2]) for word in words[6]} == {7}
    assert {len(word.partition(b".")[2]) for word in words[7]} == {15}
    assert abs(float(words[7][0]) - 0.997651000253279572) < 1e-15
    file.check(new, file.vertices + 1e-4)
    wrong = new.replace(words[7][0], words[7][0][:-3] + b"999")
    with pytest.raises(InternalError, match="another number"):
        file.check(wrong, file.vertices + 1e-4)


V = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
F = b"f 1 2 3\n"

# name: data, code, place
DAMAGED = {
    # nothing there
    "no faces": (V, "E_NO_FACES", ""),
    "only short faces": (V + b"f 1 2\nf 3\n", "E_NO_FACES", ""),
    "only lines": (V + b"l 1 2 3\n", "E_NO_FACES", ""),
    "capitals": ((V + F).upper(), "E_NO_FACES", ""),
    "no vertices": (b"vt 0 0\nvn 0 0 1\n", "E_NO_FACES", ""),
    # not text
    "zero byte": (V + b"\x00" + F, "E_FORMAT", "byte 24, line 4"),
    "zero byte far behind": (V + F + b"#" * 5000 + b"\n\x00", "E_FORMAT", "byte 5033, line 6"),
    "gzip": (b"\x1f\x8b\x08\x00" + V, "E_FORMAT", "bytes 0 to 28"),
    # positions
    "two numbers": (V + b"v 1 2\n" + F, "E_FORMAT", "line 4, vertex 4"),
    "in the plane": (b"# 2-D\nv 0 0\nv 1 0 \nv 0 1\n" + F, "E_FORMAT", "line 2, vertex 1"),
    "a word": (V + b"v 1 zwei 3\n" + F, "E_FORMAT", "line 4, vertex 4"),
    "lonely backslash": (b"v 1 \\ 2 3\n" + V + F, "E_FORMAT", "line 1"),
    "bad w": (V + b"v 1 2 3 w\n" + F, "E_FORMAT", "line 4, vertex 4"),
    "nan": (V + b"v nan 0 0\nf 1 2 4\n", "E_NONFINITE", "line 4, vertex 4"),
    "too large": (V + b"v 0 1e999 0\nf 1 2 4\n", "E_NONFINITE", "line 4, vertex 4"),
    # normals
    "short normal": (V + b"vn 0 1\n" + F, "E_FORMAT", "line 4, normal 1"),
    "bad normal": (V + b"vn 0 0 up\n" + F, "E_FORMAT", "line 4, normal 1"),
    # faces
    "index 0": (V + b"f 0 1 2\n", "E_INDEX", "line 4, face 1"),
    "beyond": (V + F + b"f 1 2 4\n", "E_INDEX", "line 5, face 2"),
    "beyond in a quad": (
        V + b"v 1 1 0\nf 1 2 3\nf 1 2\nf 1 2 3 4\nf 1 2 4 9\n", "E_INDEX", "line 8, face 4",
    ),
    "before the first": (V + b"f -1 -2 -4\n", "E_INDEX", "line 4, face 1"),
    "bad behind short": (V + b"f 1\nf 1 2 x\n", "E_FORMAT", "line 5, face 2"),
    "no corners": (V + b"f\n" + F, "E_FORMAT", "line 4, face 1"),
    "not whole": (V + b"f 1.0 2 3\n" + F, "E_FORMAT", "line 4, face 1"),
    "no vertex": (V + b"f //1 2 3\n" + F, "E_FORMAT", "line 4, face 1"),
    "four numbers": (V + b"f 1/1/1/1 2 3\n" + F, "E_FORMAT", "line 4"),
    # cut off
    "cut vertex": (V + F + b"v 1 2", "E_TRUNCATED", "line 5"),
    "cut face": (V + F + b"f 1 2", "E_TRUNCATED", "line 5"),
    "cut continuation": (V + b"f 1 \\\n2 3 \\", "E_TRUNCATED", "line 5"),
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
        ([b"v 0 0 0", b"v 0 nan 0", b"f 1 1 2"], "line 2"),
    ],
)
def test_lines_are_counted_for_every_line_end(lines: list[bytes], place: str, end: bytes) -> None:
    with pytest.raises(InputError) as caught:
        obj.read(end.join([*lines, b""]))
    assert caught.value.where.split(",")[0] == place


def test_claims_do_not_take_memory() -> None:
    # Counted as statements at first sight, and none of them is one.
    data = V + F + b"#" + b" v" * 300_000 + b" f" * 300_000 + b"\n"
    file = obj.read(data)
    assert (len(file.vertices), len(file.faces)) == (3, 1)
    base = file.vertices.base
    assert base is not None and base.nbytes < 4 * len(data)


@pytest.mark.parametrize("end", [b"\x1a", b"\x1a\n", b"\r\n\x1a\x1a"])
def test_the_end_mark_of_old_systems_is_kept(end):
    data = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n" + end
    file = obj.read(data)
    assert len(file.warnings) == 1 and "1 line without a known statement" in file.warnings[0]
    vertices = file.vertices * 0.5
    output = rewritten(file, vertices)
    assert output.endswith(b"f 1 2 3\n" + end)
