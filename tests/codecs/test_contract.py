"""What every codec promises, whatever the format: over small files of all formats.

The files are the seeds of the mutants, which use every path of a reader.  What only one format has
is tested beside that format.
"""

import functools
import gc
import itertools
import math
import struct

import numpy as np
import pytest

from msal_cli.codecs import open_mesh, slots
from msal_cli.errors import ContentError, InternalError, MsalError, TruncatedError
from msal_cli.kernels import parallel
from tests.codecs.patching import rewritten, texts_between_numbers
from tests.frozen import corpus_sums
from tests.fuzz.seeds import seeds

FORMATS = tuple(one for one in corpus_sums.formats() if seeds(one) and one != "gz")
TEXTS = ("obj", "off")
LARGEST = 4000  # bytes of the files that are tried

AT_MOST = 5  # files of a format of which there are many that differ little


def is_read(format: str, data: bytes) -> bool:
    """Whether it is a mesh: some seeds are of forms that are not read any more."""
    try:
        return len(data) <= LARGEST and len(open_mesh(data, f"a.{format}").faces) > 0
    except MsalError:
        return False


def cases(format: str):
    files = [data for data in seeds(format) if is_read(format, data)]
    chosen = files if format in corpus_sums.FUZZED else files[-AT_MOST:]
    return [pytest.param(format, data, id=f"{format}-{k}") for k, data in enumerate(chosen)]


def one_number_to_a_line() -> bytes:
    """A VTK file whose positions go over the bounds of any pieces of it."""
    rows = [(k, 0.5 * k * k, k % 2) for k in range(24)]
    numbers = "\n".join(f"{number}" for row in rows for number in row)
    faces = "\n".join(f"3 {k} {k + 1} {k + 2}" for k in range(22))
    head = "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA"
    return f"{head}\nPOINTS 24 float\n{numbers}\nPOLYGONS 22 88\n{faces}\n".encode()


def with_unplaced() -> dict[str, bytes]:
    """Files whose second vertex has no finite position, and no face."""
    points = [[0, 0, 0], [1, math.nan, -math.inf], [1, 0, 0], [0, 1, 0]]
    lines = ["{} {} {}\n".format(*point) for point in points]
    head = "".join(f"property double {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex 4\n{head}element face 1\n"
    head += "property list uchar int vertex_index\nend_header\n"
    return {
        "off": "".join(["OFF\n4 1 0\n", *lines, "3 3 0 2\n"]).encode(),
        "obj": "".join([*("v " + line for line in lines), "f 4 1 3\n"]).encode(),
        "ply": head.encode() + np.array(points).tobytes() + struct.pack("<B3i", 3, 3, 0, 2),
    }


CASES = [one for format in FORMATS for one in cases(format)]
CASES += [pytest.param(*pair, id=f"{pair[0]}-unplaced") for pair in with_unplaced().items()]
CASES.append(pytest.param("vtk", one_number_to_a_line(), id="vtk-over-lines"))
FIRST = [cases(format)[0] for format in FORMATS]


def moved(file, every: int = 2):
    """New positions: every second vertex by up to a hundredth of the extent."""
    vertices = file.vertices.copy()
    extent = np.ptp(vertices, axis=0).max()
    shift = 0.01 * extent * np.sin(np.arange(0, len(vertices), every)[:, None] + np.arange(3.0))
    vertices[::every] += shift
    return np.rint(vertices) if any("whole numbers" in one for one in file.warnings) else vertices


@pytest.fixture
def share_work(monkeypatch):
    """Let four threads share the work on a file, piece by piece, however small it is."""

    def share():
        monkeypatch.setenv("MSAL_THREADS", "4")
        for name, size in (("_PARTS", 1), ("_RECORDS", 2), ("_CHUNK", 64)):
            monkeypatch.setattr(slots, name, size)
        for name in ("MIN_COUNT", "MIN_RANGE"):
            monkeypatch.setattr(parallel, name, 1)

    return share


def tolerance(file, vertices) -> float:
    """How far a position may be from the one asked for, once it is written."""
    largest = np.abs(vertices).max()
    step = {"float32": 6e-8 * largest, "float64": 0.0, "integer": 0.5}
    return max(step.get(file.precision, 0.0), 1e-7 * largest)


@pytest.mark.parametrize(("format", "data"), CASES)
def test_nothing_moved_gives_back_the_very_bytes(format, data):
    file = open_mesh(data, f"a.{format}")
    assert bytes(file.replaced(file.vertices.copy())) == data
    file.check(data, file.vertices)
    assert bytes(file.encoded(file.vertices, "same", "same")) == data


@pytest.mark.parametrize(("format", "data"), CASES)
def test_what_is_written_is_the_same_mesh_with_other_positions(format, data, share_work):
    file = open_mesh(data, f"a.{format}")
    vertices = moved(file)
    vertices[0, 0] = -0.0
    wanted = vertices.copy()
    output = rewritten(file, vertices)
    assert np.array_equal(vertices, wanted), "the array that was given is left alone"
    assert bytes(file.encoded(vertices, "same", "same")) == output
    again = open_mesh(output, f"a.{format}")
    # Minus zero is where zero is: its bytes stay.
    assert bytes(again.replaced(again.vertices + 0.0)) == output
    later = again.vertices.copy()
    later[1] = later[2]
    assert bytes(again.replaced(later)) == bytes(again.replaced(later + 0.0))
    # An STL whose corners come to lie together has fewer vertices.
    if len(again.vertices) == len(vertices):
        for asked in (vertices, file.as_stored(vertices)):
            assert np.abs(again.vertices - asked).max() <= tolerance(file, vertices)
        assert np.array_equal(again.vertices[1::2], file.vertices[1::2]), "bits of what stayed"
        assert np.array_equal(again.faces, file.faces)
        for now, before in zip(again.polygons(), file.polygons(), strict=True):
            assert np.array_equal(now, before)
    for name in ("format", "encoding", "precision", "n_polygons", "properties", "references"):
        assert getattr(again, name) == getattr(file, name), name
    assert len(again.warnings) == len(file.warnings)
    if format in TEXTS:
        assert texts_between_numbers(output) == texts_between_numbers(data)
    share_work()
    assert bytes(open_mesh(data, f"a.{format}").replaced(vertices)) == output


@pytest.mark.parametrize(("format", "data"), CASES)
def test_the_check_sees_every_wrong_byte_that_matters(format, data, share_work):
    """What it lets pass is the same mesh: a last digit, the sign of a zero, a normal of nearly the
    same direction."""
    file = open_mesh(data, f"a.{format}")
    vertices = moved(file)
    output = bytes(file.replaced(vertices))
    rng = np.random.default_rng(len(data))
    places = range(len(output))
    if len(output) > 100:
        places = np.sort(rng.choice(len(output), 100, replace=False)).tolist()
    n_passed = 0
    for at in places:
        if at == places[-12]:
            share_work()
        wrong = bytearray(output)
        wrong[at] ^= 1 << int(rng.integers(8))
        try:
            file.check(bytes(wrong), vertices)
        except Exception:  # archives and descriptions are not understood at all
            continue
        n_passed += 1
        again = open_mesh(bytes(wrong), f"a.{format}")
        assert np.abs(again.vertices - vertices).max() <= 2 * tolerance(file, vertices)
        assert np.array_equal(again.faces, file.faces)
        if format in TEXTS:
            assert texts_between_numbers(bytes(wrong)) == texts_between_numbers(output)
    assert n_passed < 0.2 * len(places)
    for wrong in (output[:-1], output + b"\n", data):
        if wrong != output:
            with pytest.raises(InternalError):
                file.check(wrong, vertices)


@pytest.mark.parametrize(("format", "data"), CASES)
def test_every_prefix_is_refused_or_is_a_mesh(format, data):
    step = max(1, len(data) // 100)
    for size in range(0, len(data), step):
        try:
            file = open_mesh(data[:size], f"a.{format}")
        except MsalError as error:
            assert error.message, size
            assert size or isinstance(error, TruncatedError)
            continue
        assert np.isfinite(file.vertices).all()
        assert file.faces.min() >= 0 and file.faces.max() < len(file.vertices)
        assert bytes(file.replaced(file.vertices.copy())) == data[:size]


@pytest.mark.parametrize(("format", "data"), FIRST)
def test_what_cannot_be_a_position_is_refused(format, data):
    file = open_mesh(data, f"a.{format}")
    for bad in (np.nan, np.inf, -np.inf):
        vertices = file.vertices.copy()
        vertices[1, 2] = bad
        with pytest.raises((InternalError, ContentError)):
            rewritten(file, vertices)
        with pytest.raises((InternalError, ContentError)):
            file.check(data, vertices)
    for work in (file.replaced, functools.partial(file.check, data)):
        with pytest.raises(InternalError):
            work(file.vertices[:-1])
    vertices = file.vertices.copy()
    vertices[1, 2] = 1e300
    if file.precision == "float32" and file.encoding.startswith("binary"):
        with pytest.raises(ContentError) as caught:
            file.replaced(vertices)
        assert caught.value.code == "E_RANGE"


@pytest.mark.parametrize(("format", "data"), FIRST)
def test_a_file_is_freed_with_its_last_reference(format, data):
    """A cycle of references would keep the arrays of large files in memory until a collection."""
    gc.collect()
    gc.freeze()  # what there is need not be looked through again
    gc.disable()
    try:
        file = open_mesh(data, f"a.{format}")
        vertices = moved(file)
        rewritten(file, vertices)
        del file
        gc.set_debug(gc.DEBUG_SAVEALL)
        gc.collect()
        left = {type(one).__name__ for one in gc.garbage if type(one).__module__[:4] == "msal"}
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.unfreeze()
        gc.enable()
    assert not left


@pytest.mark.parametrize(("format", "data"), FIRST)
@pytest.mark.parametrize("kind", [bytearray, memoryview, lambda data: memoryview(bytearray(data))])
def test_every_kind_of_buffer_is_read_and_left_alone(format, data, kind):
    buffer = kind(data)
    file, plain = open_mesh(buffer, f"a.{format}"), open_mesh(data, f"a.{format}")
    vertices = moved(plain)
    assert np.array_equal(file.vertices, plain.vertices)
    output = bytes(file.replaced(vertices))
    assert output == bytes(plain.replaced(vertices))
    file.check(memoryview(output), vertices)
    assert bytes(buffer) == data


@pytest.mark.parametrize(("format", "data"), CASES)
def test_another_encoding_is_the_same_mesh_or_is_refused(format, data):
    file = open_mesh(data, f"a.{format}")
    vertices = moved(file)
    for encoding, precision in itertools.product(("ascii", "binary"), ("float32", "float64")):
        try:
            output = bytes(file.encoded(vertices, encoding, precision))
        except MsalError as error:
            assert error.code in ("E_UNSUPPORTED", "E_RANGE"), error
            continue
        again = open_mesh(output, f"a.{format}")
        assert again.encoding.startswith(encoding)
        assert again.n_polygons == file.n_polygons
        if len(again.vertices) == len(vertices):
            assert np.abs(again.vertices - vertices).max() <= tolerance(again, vertices)
            assert np.array_equal(again.faces, file.faces)
