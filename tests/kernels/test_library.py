"""Kernels come from the library, or are compiled in a checkout, or are an error; threads."""

import subprocess
import sys
import threading

import numpy as np
import pytest

from msal_cli.errors import InternalError
from msal_cli.kernels import geometry, library, parallel, welding, z_buffer
from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.faces import face_rings
from msal_cli.kernels.geometry import normals_and_flat_faces, surface_change
from msal_cli.kernels.library import Kernel, arg_type
from msal_cli.kernels.linear_systems import RowMatrix, conjugate_gradients
from msal_cli.kernels.parallel import MIN_COUNT, at_once, is_worth_it
from tests.shapes import grid, noisy, torus


@pytest.fixture
def kernel():
    """A kernel as a new process sees it."""
    return Kernel(welding._mark.function)


def mark(kernel, dtype=np.int32):
    marks = np.zeros(3, dtype=bool)
    kernel(np.zeros(3, dtype=dtype), marks)
    return marks.sum()


def test_other_types_are_an_error_with_their_names(kernel):
    message = r"has no welding._mark\(f4\[::1\], b1\[::1\]\)$"
    with pytest.raises(InternalError, match=message) as error:
        mark(kernel, np.float32)
    assert error.value.code == "E_INTERNAL"
    assert "signatures.txt" in error.value.hint


@pytest.mark.parametrize("name", ["TABLE", "LIBRARY"])
def test_a_library_that_is_not_there_is_an_error(kernel, monkeypatch, tmp_path, name):
    monkeypatch.setattr(library, name, tmp_path / "none")
    for function in (library._entries, library.open_library):
        monkeypatch.setattr(library, function.__name__, function.__wrapped__)
    with pytest.raises(InternalError, match="the library of compiled kernels") as error:
        mark(kernel)
    assert "install msal again" in error.value.hint


@pytest.mark.parametrize(
    "array, text",
    [
        (np.zeros((2, 3)), "f8[:, ::1]"),
        (np.zeros((2, 3), order="F"), "f8[::1, :]"),
        (np.zeros((2, 3))[:, ::2], "f8[:, :]"),
        (np.zeros(3, dtype=np.bool_), "b1[::1]"),
        (np.zeros(6, dtype=np.int32)[::2], "i4[:]"),
        (np.zeros(3, dtype=">u2"), "swapped u2[::1]" if sys.byteorder == "little" else "u2[::1]"),
        (np.zeros(9, dtype=np.uint8)[1:9].view(np.float32), "f4[::1]"),
    ],
)
def test_types_of_arrays(array, text):
    assert library.signature("a.b", (arg_type(array), "i8")) == f"a.b({text}, i8)"


def test_threads_that_start_together_load_once(kernel, monkeypatch):
    loaded = []
    real = library.load
    monkeypatch.setattr(library, "load", lambda *given: loaded.append(given) or real(*given))
    marks = [np.zeros(3, dtype=bool) for _ in range(8)]
    items = np.zeros(3, dtype=np.int32)
    threads = [threading.Thread(target=kernel, args=(items, marked)) for marked in marks]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(loaded) == 1 and [marked.sum() for marked in marks] == [1] * 8


_REFUSE_CODE_IN_DATA = """
import ctypes, sys
PR_SET_MDWE, REFUSE_EXEC_GAIN = 65, 1
if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_MDWE, REFUSE_EXEC_GAIN, 0, 0, 0):
    sys.exit(77)
import numpy as np
from msal_cli.kernels import welding
marks = np.zeros(3, dtype=bool)
welding._mark(np.zeros(3, dtype=np.int32), marks)
print(marks.sum())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a feature of Linux")
def test_kernels_run_where_memory_that_was_written_is_never_executed():
    command = [sys.executable, "-c", _REFUSE_CODE_IN_DATA]
    ran = subprocess.run(command, capture_output=True, text=True)
    if ran.returncode == 77:
        pytest.skip("Linux before 6.3 has no PR_SET_MDWE")
    assert ran.stdout == "1\n", ran.stderr


@pytest.mark.parametrize("cores", ["1", "3"])
def test_results_come_in_the_order_of_the_tasks(cores, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", cores)
    assert at_once(MIN_COUNT, lambda: 1, lambda: "two", lambda: None) == [1, "two", None]
    assert at_once(1, lambda: 1) == [1]


def test_many_items_and_cores_are_shared(monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", "2")
    meeting = threading.Barrier(2, timeout=20.0)
    # Neither passes before the other has come.
    at_once(MIN_COUNT, meeting.wait, meeting.wait)
    assert not is_worth_it(MIN_COUNT - 1)
    monkeypatch.setenv("MSAL_THREADS", "1")
    assert not is_worth_it(MIN_COUNT)


@pytest.mark.parametrize("cores", ["1", "2"])
def test_the_first_failure_is_raised(cores, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", cores)

    def fail(word):
        raise ValueError(word)

    with pytest.raises(ValueError, match="one"):
        at_once(MIN_COUNT, lambda: 0, lambda: fail("one"), lambda: fail("two"))


def link(vertices, faces):
    links = connectivity(len(vertices), faces)
    return links.ring_start, links.ring, links.boundary, links.boundary_edges


def list_face_rings(vertices, faces):
    return face_rings(faces, connectivity(len(vertices), faces), "vertex")


def compute_normals(vertices, faces):
    faces = faces.copy()
    faces[::1000, 1] = faces[::1000, 0]
    shuffled = np.random.default_rng(0).permutation(len(faces))
    return [
        part
        for order in (slice(None), shuffled)
        for part in normals_and_flat_faces(vertices, faces[order], "uniform")
    ]


def solve(vertices, faces):
    """I + 5 times the graph Laplacian."""
    n = len(vertices)
    links = connectivity(n, faces)
    diagonal = 1.0 + 5.0 * np.diff(links.ring_start)
    matrix = RowMatrix(diagonal, links.ring_start, links.ring, np.full(len(links.ring), -5.0))
    goal = {"tolerance": 1e-6, "most_iterations": 1000}
    return [conjugate_gradients(diagonal, matrix.times, vertices, np.zeros((n, 3)), **goal)]


def draw(vertices, faces):
    points = np.random.default_rng(1).uniform(0, 300, (600, 3))
    return z_buffer.nearest_faces(points, faces[:900] % 600, 300, 300)


@pytest.mark.parametrize("shape", [torus(190, 93), grid(140, 131)], ids=["torus", "grid"])
@pytest.mark.parametrize(
    "work",
    [
        *(link, list_face_rings, compute_normals, solve, draw),
        lambda vertices, faces: surface_change(vertices, noisy(vertices, 2), faces),
    ],
)
def test_threads_do_not_change_a_bit(work, shape, monkeypatch):
    # Not multiples of chunks, and enough rows for three ranges that end amid chunks.
    for module in (parallel, geometry):
        monkeypatch.setattr(module, "MIN_RANGE", 5_000)
    monkeypatch.setattr(parallel, "MIN_COUNT", 5_000)
    vertices, faces = noisy(shape[0], 1), shape[1]
    results = []
    for count in ("1", "2", "3"):
        monkeypatch.setenv("MSAL_THREADS", count)
        results.append([np.asarray(part).tobytes() for part in work(vertices, faces)])
    assert results[0] == results[1] == results[2]
