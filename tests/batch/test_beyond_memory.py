"""Meshes beyond the memory: arrays in files give the same bytes, and what fits nowhere is refused
before anything of it is loaded."""

import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from msal_cli import denoise_file as denoise_mesh_file
from msal_cli import machine
from msal_cli.cli.streams import denoise_stream
from msal_cli.codecs.header import BASE_BYTES
from msal_cli.job import room
from msal_cli.job.comparison import compare_files, inspect_file
from msal_cli.job.pipeline import denoise_file, start_record
from msal_cli.job.room import FORECAST, forecast, foresee
from msal_cli.job.settings import ADAPTIVE, AUTO, NO_LIMITS, Limits, Settings, Task
from msal_cli.kernels import array_files, spatial_order
from msal_cli.kernels.parallel import over_ranges
from tests.batch.tile_files import cut, mixed, read
from tests.cli.scans import closed_scan, folder_of, msal
from tests.files import tree, write_sparse
from tests.ply_files import to_ply
from tests.shapes import grid

linux = pytest.mark.skipif(not array_files.can_use_files(), reason="needs Linux")


def sparse(path: Path, n_vertices: int, n_faces: int) -> Path:
    """A binary PLY file of as many triangles as its header says, that takes no room on the disk."""
    header = to_ply(np.empty((0, 3), "<f4"), np.empty((0, 3)))
    header = header.replace(b"vertex 0", b"vertex %d" % n_vertices)
    header = header.replace(b"face 0", b"face %d" % n_faces)
    return write_sparse(path, header, len(header) + 12 * n_vertices + 13 * n_faces)


def waves(path: Path, n: int) -> Path:
    """A noisy surface of n by n vertices, as a binary PLY."""
    vertices, faces = grid(n, n)
    noise = np.random.default_rng(3).standard_normal(n * n)
    vertices[:, 2] = n / 20 * np.sin(vertices[:, 1] / n * 6) + 0.3 * noise
    path.write_bytes(to_ply(vertices.astype("<f4"), faces))
    return path


# Files


def handler_of(array) -> str:
    try:
        from numpy._core.multiarray import get_handler_name
    except ImportError:
        from numpy.core.multiarray import get_handler_name
    return get_handler_name(array)


@pytest.fixture
def small(monkeypatch):
    """Files of any size are looked into."""
    monkeypatch.setattr(room, "LARGE_BYTES", 0)


@linux
def test_arrays_of_all_threads_live_in_files_without_a_name(tmp_path):
    def work(start, stop, out):
        out[start // 1000] = np.ones(4000)

    made = [None] * 2
    with array_files.arrays_in_files(str(tmp_path), 10_000):
        over_ranges(work, 2000, made, smallest=1000)
        changed = np.zeros(5000)
        changed.resize(9000)
        tiny = np.ones(10)
        counted = array_files.count_scratch()
        assert not list(tmp_path.iterdir())
    assert {handler_of(one) for one in (*made, changed)} == {"msal_array_files"}
    assert counted.current_bytes == 2 * 32_000 + 72_000
    assert (changed == 0).all() and (made[0] == made[1]).all()
    assert made[1].sum() == 4000 and tiny.sum() == 10
    del made, changed
    assert array_files.count_scratch().current_bytes == 0
    assert handler_of(np.ones(5000)) == "default_allocator"


def forget_peak(folder: Path) -> None:
    """Have no arrays in files, from which on the peak is counted anew."""
    with array_files.arrays_in_files(str(folder), 1 << 40):
        pass
    assert array_files.count_scratch().peak_bytes < 1000


SETTINGS = {
    **{name: Settings(name) for name in ("msal", "bilateral_normal", "l0", "learned")},
    "plain": Settings(ADAPTIVE),
    "auto": Settings(AUTO),
    "held": Settings("msal", max_move="0.1", despike=True),
}


def same_bytes(source: Path, settings: Settings, tmp_path: Path) -> None:
    """Fail unless an output is the same with arrays in files, of which none is left."""
    usual, beyond = tmp_path / "usual", tmp_path / "beyond"
    done = denoise_file(Task(str(source), str(usual / source.name), source.name), settings)
    assert (done.error, done.status) == (None, "written")
    task = Task(str(source), str(beyond / source.name), source.name)
    before = array_files.count_scratch().current_bytes
    # In the middle between what arrays in files take and what those in memory do.
    limit = (forecast(task, settings).memory_bytes + BASE_BYTES) // 2
    done = denoise_file(task, settings, limits=Limits(memory_bytes=limit))
    assert (done.error, done.status) == (None, "written")
    assert tree(beyond) == tree(usual)
    scratch = array_files.count_scratch()
    assert scratch.peak_bytes > source.stat().st_size
    # Tables that are read once may stay.
    assert scratch.current_bytes - before < 1_000_000


@linux
@pytest.mark.parametrize("name", SETTINGS)
def test_every_way_of_denoising_gives_the_same_bytes(name, tmp_path, small):
    same_bytes(
        waves(tmp_path / "a.ply", 30 if name in ("auto", "l0") else 60), SETTINGS[name], tmp_path
    )


@linux
def test_python_and_standard_output_have_arrays_in_files_too(tmp_path, small, monkeypatch):
    with pytest.raises(BrokenPipeError), room.use_scratch(room.Scratch(str(tmp_path), 1 << 30, 0)):
        raise BrokenPipeError
    source = waves(tmp_path / "a.ply", 60)
    need = forecast(Task(str(source), "", ""), Settings("msal")).memory_bytes
    monkeypatch.setattr(machine, "available_bytes", lambda: (need + BASE_BYTES) // 2)
    used = []
    monkeypatch.setattr(room, "use_scratch", lambda scratch: used.append(scratch) or nullcontext())
    denoise_mesh_file(source, tmp_path / "b.ply", method="msal")
    denoise_stream(Task(str(source), "-", ""), Settings("msal"), lambda *done: None)
    assert len(used) == 2 and None not in used


@linux
@pytest.mark.parametrize("name", ["a.obj", "a.stl", "a.off", "a.vtk", "a.ply.gz"])
def test_every_format_gives_the_same_bytes(name, tmp_path, small):
    source = waves(tmp_path / "a.ply", 60)
    whole = Task(str(source), str(tmp_path / "in" / name), name)
    assert denoise_file(whole, Settings("taubin")).error is None
    same_bytes(tmp_path / "in" / name, Settings("msal"), tmp_path)


@linux
@pytest.mark.parametrize("n", [30, 60])
def test_stl_in_random_order_gives_the_same_bytes(n, tmp_path, small, monkeypatch):
    source = waves(tmp_path / "a.ply", n)
    whole = Task(str(source), str(tmp_path / "in/a.stl"), "a.stl")
    assert denoise_file(whole, Settings("taubin")).error is None
    source = tmp_path / "in/a.stl"
    data = source.read_bytes()
    facets = np.frombuffer(data[84:], "V50")
    if n == 30:  # no two corners at one position
        facets = facets[::20]
    facets = np.random.default_rng(1).permutation(facets)
    source.write_bytes(data[:80] + len(facets).to_bytes(4, "little") + facets.tobytes())
    monkeypatch.setattr(spatial_order, "is_random", lambda faces: len(faces) > 0)
    monkeypatch.setattr(spatial_order, "BLOCK_BYTES", 10_000)
    same_bytes(source, Settings("umbrella"), tmp_path)


@linux
def test_a_tile_set_gives_the_same_bytes(tmp_path, small):
    folder = tmp_path / "in"
    folder.mkdir()
    mesh = read(waves(tmp_path / "a.ply", 60))
    parts = cut(mesh.vertices, mesh.faces, mesh.faces[:, 0] >= 1800)
    for name, data in mixed(parts).items():
        (folder / name).write_bytes(data)
    for name, limit in (("usual", ()), ("beyond", ("--memory-limit", "53M"))):
        options = ("-o", tmp_path / name, "--tile-set", "--method", "msal", *limit)
        assert msal("denoise", folder, *options).exit_code == 0
    assert tree(tmp_path / "beyond") == tree(tmp_path / "usual")
    assert array_files.count_scratch().peak_bytes


@linux
def test_info_and_compare_say_the_same(tmp_path, small, monkeypatch):
    source = waves(tmp_path / "a.ply", 60)
    usual = inspect_file(str(source))
    other = compare_files(str(source), str(source))
    rooms = iter((700_000, 1_200_000))
    monkeypatch.setattr(machine, "available_bytes", lambda: BASE_BYTES + next(rooms))
    assert inspect_file(str(source)) == usual
    assert compare_files(str(source), str(source)) == other


SWEEP = ("sweep", "--columns", "K=0.3,0.6", "--size", "64", "--reference", "a.ply")


@linux
@pytest.mark.parametrize(("words", "suffix"), [(("noise",), "ply"), (SWEEP, "png")])
def test_other_commands_write_the_same_bytes(tmp_path, small, monkeypatch, words, suffix):
    monkeypatch.chdir(tmp_path)
    source = waves(tmp_path / "a.ply", 30 if words == SWEEP else 60)
    # As much as one of the files of a sweep takes: the other is counted, too.
    swept = forecast(Task(str(source), "", source.name), Settings(AUTO)).memory_bytes
    available = swept if words == SWEEP else BASE_BYTES + 700_000
    usual, beyond = (tmp_path / f"{name}.{suffix}" for name in ("usual", "beyond"))
    assert msal(*words, "a.ply", "-o", usual).exit_code == 0
    monkeypatch.setattr(machine, "available_bytes", lambda: available)
    forget_peak(tmp_path)
    assert msal(*words, "a.ply", "-o", beyond).exit_code == 0
    assert array_files.count_scratch().peak_bytes > source.stat().st_size
    assert beyond.read_bytes() == usual.read_bytes()


@linux
def test_a_disk_that_is_full_is_an_error_and_leaves_nothing(tmp_path):
    import resource

    source = waves(tmp_path / "a.ply", 330)
    command = [sys.executable, "-m", "msal_cli", "denoise", str(source), "-o", "out/a.ply"]
    made = subprocess.run(
        [*command, "--memory-limit", "62M", "--method", "msal", "--scratch", str(tmp_path)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20)),
    )
    assert made.returncode == 1
    assert f"cannot be kept in '{tmp_path}': File too large (E_WRITE)" in made.stderr
    assert [one.name for one in tmp_path.iterdir()] == ["a.ply"]


# Refusals


def beyond(path, available, monkeypatch, limits=NO_LIMITS, output="out/a.ply"):
    monkeypatch.setattr(machine, "available_bytes", lambda: available)
    task = Task(str(path), output, "in")
    record = foresee(start_record("in", Settings("msal")), task, Settings("msal"), limits)
    return record.error, record.planned


@linux
def test_what_is_foreseen_says_where_a_mesh_will_be(tmp_path, monkeypatch):
    path = sparse(tmp_path / "a.ply", 50_000_000, 100_000_000)
    monkeypatch.setattr(os, "statvfs", lambda _: os.statvfs_result((4096, 4096, *[10**8] * 8)))
    # Fifty million vertices are to fit into 24 GiB, and do so with room to spare.
    error, planned = beyond(path, 16 * 2**30, monkeypatch)
    assert (error, planned.scratch_bytes) == (None, None)
    usual_s = planned.seconds
    error, planned = beyond(path, 10**9, monkeypatch)
    assert error is None and planned.memory_bytes == 10**9
    assert (
        45 < usual_s < 60 and usual_s + 45 < planned.seconds and 9e9 < planned.scratch_bytes < 14e9
    )
    error, _ = beyond(path, 3 * 10**8, monkeypatch)
    assert (error.code, error.where) == ("E_MEMORY", FORECAST)
    assert "this machine has 300 MB left" in error.message
    monkeypatch.setattr(os, "statvfs", lambda _: os.statvfs_result((4096, 4096, *[10**6] * 8)))
    error, _ = beyond(path, 10**9, monkeypatch)
    assert error.code == "E_WRITE" and "where 4.09 GB are free" in error.message
    assert beyond(path, None, monkeypatch)[0] is None


@linux
@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="needs files in memory")
def test_files_in_memory_are_no_scratch(tmp_path, monkeypatch):
    path = sparse(tmp_path / "a.ply", 500_000, 1_000_000)
    error, _ = beyond(path, 10**8, monkeypatch, Limits(scratch="/dev/shm"))
    assert error.code == "E_MEMORY" and "name a folder on a disk by --scratch" in error.hint


def test_the_others_of_a_folder_are_done(tmp_path, monkeypatch):
    monkeypatch.setattr(array_files, "can_use_files", lambda: False)
    folder = folder_of(tmp_path / "scans", small=closed_scan())
    sparse(folder / "large.ply", 200_000, 400_000)
    made = msal("denoise", folder, "-o", tmp_path / "out", "-j1", "--memory-limit", "60M")
    assert made.exit_code == 3
    assert "denoising this file takes up to" in made.stderr and "(E_MEMORY)" in made.stderr
    assert (tmp_path / "out/small.ply").exists() and not (tmp_path / "out/large.ply").exists()


@pytest.mark.parametrize(
    "words", [("info", "{0}"), ("compare", "{0}", "{0}"), ("view", "{0}", "-o", "{0}.png")]
)
def test_other_commands_refuse_it_too(tmp_path, monkeypatch, words):
    sparse(tmp_path / "large.ply", 200_000, 400_000)
    monkeypatch.setattr(machine, "available_bytes", lambda: 35_000_000)
    made = msal(*(word.format(tmp_path / "large.ply") for word in words))
    assert made.exit_code != 0 and "E_MEMORY" in made.stderr
    assert "this machine has 35 MB left" in made.stderr
