"""STL, binary and ascii: corners, normals, forms of text, breaks of the format that others read."""

import re
import struct
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from msal_cli.codecs import header, stl
from msal_cli.job import comparison, pipeline
from msal_cli.job.settings import Task
from tests.codecs import plain_stl
from tests.codecs.patching import rewritten, texts_between_numbers
from tests.codecs.plain_stl import tetrahedron
from tests.job.test_pipeline import settings

COORDINATES = st.floats(-1e6, 1e6, width=32)


def soups(max_facets: int = 6):
    shapes = st.integers(1, max_facets).map(lambda m: (m, 9))
    return arrays.arrays(np.float64, shapes, elements=COORDINATES)


def facets_of(data: bytes) -> list[tuple]:
    """Every facet as (normal, corners, attribute), unpacked one by one."""
    (count,) = struct.unpack_from("<I", data, 80)
    facets = []
    for k in range(count):
        numbers = struct.unpack_from("<12fH", data, 84 + 50 * k)
        facets.append((numbers[:3], numbers[3:12], numbers[12]))
    return facets


def corners_of(file) -> np.ndarray:
    """The corners (m, 9) in file order."""
    return file.vertices[file.faces].reshape(-1, 9)


def moved(file, amount=0.25):
    vertices = file.vertices.copy()
    vertices[:3] += amount * np.arange(1, 10).reshape(3, 3)
    return vertices


def require_corners(file, corners):
    """The corners are read exactly, and vertices are numbered in the order of the file."""
    assert np.array_equal(corners_of(file), corners)
    assert len(np.unique(file.vertices, axis=0)) == len(file.vertices)
    assert not np.signbit(file.vertices[file.vertices == 0.0]).any()
    first = np.unique(file.faces, return_index=True)[1]
    assert (np.diff(first) > 0).all()
    assert file.n_polygons == len(corners)
    assert file.merged_vertices == 3 * len(corners) - len(file.vertices)
    assert file.faces.dtype == np.int32
    assert file.vertices.dtype == np.float64


@given(
    soups(),
    arrays.arrays(np.float64, (18, 3), elements=COORDINATES),
    st.lists(st.integers(0, 0xFFFF), min_size=6, max_size=6),
)
def test_corners_are_exact_and_only_positions_and_normals_change(corners, others, attributes):
    m = len(corners)
    data = plain_stl.binary(
        corners, attributes=attributes[:m], header=b"COLOR=\x01\x02\x03\xff", trailing=b"tail"
    )
    file = stl.read(data)
    require_corners(file, corners)
    vertices = others[: len(file.vertices)]
    output = rewritten(file, vertices)
    others = vertices[file.faces].reshape(-1, 9)
    assert output[:84] == data[:84]
    assert output[-4:] == b"tail"
    before, after = facets_of(data), facets_of(output)
    for k in range(m):
        assert after[k][1] == tuple(others[k])
        assert after[k][2] == attributes[k]
        if (corners[k] == others[k]).all():
            assert after[k] == before[k]


# Hand-worked cases


@pytest.mark.parametrize(
    ("stored", "expected"),
    [
        ((0, 0, 1), (1, 0, 0)),
        ((0, 0, 5e-30), (1, 0, 0)),  # any length
        ((0, 0, 3e38), (1, 0, 0)),
        ((0, 0, -1), (-1, 0, 0)),  # opposed the winding and still does
        ((0, 0, 0), (0, 0, 0)),
        ((-0.0, 0, 0), (-0.0, 0, 0)),
        ((1, 0, 0), (1, 0, 0)),  # across the old facet: the right-hand rule
    ],
)
def test_the_sense_of_a_stored_normal_is_kept(stored, expected):
    corners = np.array([[0, 0, 0, 1, 0, 0, 0, 1, 0]], dtype=float)
    data = plain_stl.binary(corners, normals=np.array([stored]))
    file = stl.read(data)
    turned = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    output = rewritten(file, turned)
    assert output[84:96] == struct.pack("<3f", *expected)


@pytest.mark.parametrize("bits", [0x7FC00000, 0x7FA00001, 0xFFC00123, 0x7F800000, None])
def test_a_normal_that_is_no_number_is_kept_and_so_is_one_without_an_area(bits):
    data = bytearray(plain_stl.binary(tetrahedron()))
    if bits is not None:
        struct.pack_into("<I", data, 84, bits)
    file = stl.read(bytes(data))
    vertices = moved(file)
    if bits is None:
        vertices[:3] = [[0, 0, 0], [1, 1, 1], [2, 2, 2]]
    output = rewritten(file, vertices)
    assert output[84:96] == data[84:96]


def test_a_binary_file_that_begins_with_solid_is_binary():
    data = plain_stl.binary(tetrahedron(), header=b"solid made by an exporter")
    file = stl.read(data)
    assert file.encoding == "binary_little_endian"
    longer = stl.read(data + b"\0" * 7)
    assert longer.encoding == "binary_little_endian"
    assert longer.n_polygons == 4


# Re-encoding


def test_vertices_are_counted_after_welding_and_corners_beside_them(tmp_path):
    path = tmp_path / "a.stl"
    path.write_bytes(plain_stl.binary(tetrahedron()))
    task = Task(str(path), str(tmp_path / "b.stl"), "a.stl")
    done = pipeline.denoise_file(task, settings("al", iterations=1))
    assert done.status == "written"
    for record in (comparison.inspect_file(str(path)), done):
        assert (record.vertices, record.corners, record.welded_vertices) == (4, 12, 8)
        assert record.unreferenced_vertices == 0
    compared = comparison.compare_files(str(path), str(tmp_path / "b.stl"))
    assert (compared.vertices_before, compared.corners_before) == (4, 12)
    assert (compared.vertices_after, compared.corners_after) == (4, 12)


BINARY = plain_stl.binary(tetrahedron(), attributes=[1, 2, 3, 4], header=b"COLOR=rgba")
TEXT = plain_stl.text(tetrahedron()).encode()


def with_float(at: int, value: float) -> bytes:
    data = bytearray(BINARY)
    struct.pack_into("<f", data, at, value)
    return bytes(data)


def line(number: int, new: str) -> bytes:
    lines = TEXT.decode().split("\n")
    lines[number - 1] = new
    return "\n".join(lines).encode()


DAMAGED = {
    "cut within a facet": (BINARY[:100], "E_TRUNCATED", "byte 100"),
    "count one too many": (plain_stl.binary(tetrahedron(), count=5), "E_TRUNCATED",
        f"byte {len(BINARY)}"),
    "no facets": (plain_stl.binary(np.zeros((0, 9))), "E_NO_FACES", ""),
    "count of zero with facets": (plain_stl.binary(tetrahedron(), count=0), "E_NO_FACES", ""),
    "NaN corner": (with_float(96, float("nan")), "E_NONFINITE", "facet 0, corner 0"),
    "big endian": (BINARY[:80] + BINARY[83:79:-1] + BINARY[84:], "E_TRUNCATED", "byte 284"),
    "utf-16": (TEXT.decode().encode("utf-16"), "E_FORMAT", "byte 0"),
    "only a name": (b"solid a\n", "E_TRUNCATED", "facet 0, line 2"),
    "no endsolid": (TEXT[: TEXT.index(b"endsolid")], "E_TRUNCATED", "facet 4, line 30"),
    "on one line": (b" ".join(TEXT.split()), "E_FORMAT", "line 1"),
    "cut in a keyword": (TEXT[: TEXT.index(b"outer") + 2], "E_TRUNCATED", "facet 0, line 3"),
    "cut in an exponent": (line(4, "vertex 0 0 1e")[:79], "E_TRUNCATED", ""),
    "no solid line": (TEXT[TEXT.index(b"facet") :], "E_FORMAT", "facet 0, line 1"),
    "two normal numbers": (line(2, "facet normal 0 0"), "E_FORMAT", "facet 0, line 3"),
    "four normal numbers": (line(2, "facet normal 0 0 1 1"), "E_FORMAT", "facet 0, line 2"),
    "a comma for a point": (line(5, "vertex 0,5 0 0"), "E_FORMAT", "facet 0, line 5"),
    "a word for a fourth coordinate": (line(4, "vertex 0 0 0 -x"), "E_FORMAT", "facet 0, line 4"),
    "no endfacet": (line(8, ""), "E_FORMAT", "facet 0, line 9"),
    "text behind the end": (TEXT + b"thank you\n", "E_FORMAT", "facet 4, line 31"),
    "NaN in text": (line(5, "vertex 0 NaN 0"), "E_NONFINITE", "facet 0, corner 1, line 5"),
}  # fmt: skip


@pytest.mark.parametrize("mark", [b"\xff\xfe", b"\xfe\xff"])
def test_a_binary_file_may_begin_like_utf_16(mark):
    assert len(stl.read(mark + BINARY[2:]).faces) == 4


def corner_tokens(data: bytes) -> list[list[bytes]]:
    """The three words behind each ``vertex``, in order."""
    words = data.split()
    at = [k for k, word in enumerate(words) if word.lower() == b"vertex"]
    return [words[k + 1 : k + 4] for k in at]


SPACES = [" ", "  ", "\t", " \t ", "\n", "\r\n", "\n\n  "]
FORMS = ["{}", "{:.9g}", "{:.3f}", "{:e}", "{:+.5E}", "{:.0f}", "{:.20f}"]


def texts(random: Random, corners: np.ndarray) -> bytes:
    """Any ascii STL that the format allows, with these corners."""
    case, form = random.choice([str.lower, str.upper, str.title]), random.choice(FORMS)
    newline = random.choice(["\n", "\r\n", "\r"])

    def gap() -> str:
        return random.choice(SPACES)

    parts = [random.choice(["", " \n", "\ufeff"]), case("solid"), " a name", newline]
    for corner in corners:
        parts += [case("facet"), gap(), case("normal")]
        for _ in range(3):
            parts += [gap(), random.choice(["0", "1.0", "-1e0", "nan", "-nan(ind)"])]
        parts += [gap(), case("outer"), gap(), case("loop")]
        for k in range(9):
            if k % 3 == 0:
                parts += [gap(), case("vertex")]
            parts += [gap(), form.format(corner[k])]
        parts += [gap(), case("endloop"), gap(), case("endfacet"), gap()]
    parts += [case("endsolid"), " a name", random.choice(["", newline, newline + "\0"])]
    return "".join(parts).encode()


TEXTS = st.builds(texts, st.randoms(use_true_random=True), soups(4))


@given(TEXTS, st.integers(0, 2**32 - 1))
def test_every_form_of_text_is_read_exactly_and_only_tokens_that_moved_change(data, seed):
    file = stl.read(data)
    expected = np.array([[float(word) for word in words] for words in corner_tokens(data)])
    assert np.array_equal(corners_of(file), expected.reshape(-1, 9))
    assert bytes(file.replaced(file.vertices.copy())) == data
    rng = np.random.default_rng(seed)
    extent = max(1e-3, float(np.ptp(file.vertices)))
    step = np.where(rng.random(file.vertices.shape) < 0.5, 0.0, 0.01 * extent)
    vertices = file.vertices + step
    output = rewritten(file, vertices)
    assert texts_between_numbers(output) == texts_between_numbers(data)
    before, after = corner_tokens(data), corner_tokens(output)
    for k, i in enumerate(file.faces.reshape(-1)):
        for axis in range(3):
            if vertices[i, axis] == file.vertices[i, axis]:
                assert after[k][axis] == before[k][axis]
            else:
                # 1e-7 of the diagonal, or the digits of the file, whichever is finer.
                assert abs(float(after[k][axis]) - vertices[i, axis]) <= 1e-7 * extent


def test_several_solids_with_names():
    one, two = plain_stl.text(tetrahedron(), name="left leg"), plain_stl.text(tetrahedron() + 5)
    text = one + "\n" + two.replace("part", "") + "solid empty\nendsolid empty\n"
    file = stl.read(text.encode())
    assert (file.encoding, file.n_polygons) == ("ascii", 8)
    assert file.properties[-3:] == ("3 solids", "solid 'left leg'", "solid 'empty'")
    assert file.losses_by_encoding() == ["3 solids", "solid 'empty'"]
    vertices = moved(file)
    output = rewritten(file, vertices)
    assert output.count(b"solid left leg") == 2


PART = plain_stl.text(tetrahedron(), name="part").encode()
NORMAL = re.compile(rb"facet normal[^\n]*")
ANY_NUMBER = re.compile(rb"(?<=\s)-?\d+(?:\.\d+)?(?:e-?\d+)?")
NO_NORMAL = "facet has no normal, and none is added"
BAD_NORMAL = "facet has a normal that is not three finite numbers: it is kept, not recomputed"


def normal_lines(data: bytes) -> list[bytes]:
    return [one.strip() for one in data.splitlines() if re.match(rb"\s*facet", one, re.I)]


def checked(data: bytes) -> tuple[stl.StlTextFile, bytes]:
    """The file, and its text with all positions moved."""
    file = stl.read(data)
    assert np.array_equal(file.vertices, stl.read(PART).vertices)
    assert bytes(file.replaced(file.vertices.copy())) == data
    vertices = file.vertices[:, [1, 2, 0]] * [0.5, 0.25, 2.0] + 0.125
    output = rewritten(file, vertices)
    assert np.array_equal(stl.read(output).vertices, vertices)
    return file, output


@pytest.mark.parametrize(
    ("line", "warning"),
    [
        (b"facet normal 0 0 0", ""),
        (b"facet", NO_NORMAL),
        (b"facet normal", NO_NORMAL),
        (b"FACET NORMAL \t", NO_NORMAL),
        (b"facet normal nan nan nan", BAD_NORMAL),
        (b"facet normal -nan(ind) -nan(ind) -nan(ind)", BAD_NORMAL),
        (b"facet normal 1.#QNAN -1.#IND 1.#INF", BAD_NORMAL),
        (b"facet normal 1e999 0 0", BAD_NORMAL),
        (b"facet normal 0,0 0,0 1,0", BAD_NORMAL),
        (b"facet normal ***** 0 0", BAD_NORMAL),
        (b"facet normal 0 0 \xff\xfe", BAD_NORMAL),
        (b"facet normal 0 0 up", BAD_NORMAL),
    ],
)
def test_a_normal_that_is_missing_or_no_number_is_kept(line, warning):
    file, output = checked(NORMAL.sub(line, PART, count=1))
    assert file.warnings == ((f"1 {warning}",) if warning else ())
    before, after = normal_lines(PART), normal_lines(output)
    assert after[0] == line.strip()
    # The others are recomputed as ever.
    plain = normal_lines(checked(PART)[1])
    assert after[1:] == plain[1:] != before[1:]


def test_a_file_without_normals():
    data = NORMAL.sub(b"facet", PART)
    file, output = checked(data)
    assert file.warnings == ("4 facets have no normal, and none is added",)
    assert "facet normals" not in file.properties
    assert b"normal" not in output
    binary = stl.read(file.encoded(file.vertices, "binary", "same"))
    assert not binary.normals.any()
    assert np.array_equal(binary.vertices, file.vertices)


@pytest.mark.parametrize(
    "data",
    [
        PART.replace(b"endfacet", b"end facet").replace(b"endloop", b"End\tLoop"),
        PART.replace(b"endsolid part", b"end solid"),
        PART.replace(b"solid part", b"solid a\x01\x1b[0m", 1),
        PART.replace(b"solid part", b"solid a\0\0", 1),
        PART.replace(b"solid part", b"SOLID caf\xe9 \xff (1) [x]", 1),
    ],
)
def test_ends_in_two_words_and_odd_names(data):
    file, output = checked(data)
    assert file.warnings == ()
    assert output.splitlines()[0] == data.splitlines()[0]
    assert output.splitlines()[-1] == data.splitlines()[-1]


@pytest.mark.parametrize(
    ("word", "words"),
    [
        (rb"facet normal[^\n]*", rb"\g<0> extra"),
        (rb"outer loop", rb"\g<0> xyz 7"),
        (rb"vertex[^\n]*", rb"\g<0>\t; a corner"),
        (rb"endloop", rb"\g<0> # 1"),
        (rb"endfacet", rb"\g<0> foo facet"),
        (rb"endfacet", rb"END FACET foo"),
        (rb"endsolid[^\n]*", rb"\g<0> extra words"),
        (rb"(?<!d)solid[^\n]*", rb"\g<0>... facet normal"),
    ],
)
@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_words_behind_statements_are_kept(word, words, end):
    data = re.sub(word, words, PART).replace(b"\n", end)
    file, output = checked(data)
    assert file.warnings == ()
    assert ANY_NUMBER.sub(b"", output) == ANY_NUMBER.sub(b"", data)


def test_the_shortest_facets_have_room():
    facet = b"facet outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet "
    data = b"solid\n" + facet * 500 + b"endsolid"
    file = stl.read(data)
    assert len(file.faces) == 500
    assert header.of_beginning(data, len(data), "a.stl").memory_bytes
