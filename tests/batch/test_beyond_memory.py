"""Meshes beyond this machine's memory are refused before anything of them is loaded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from msal_cli import machine
from msal_cli.batch import memory_budget as weights
from msal_cli.batch.memory_budget import LARGE_BYTES, estimate_memory
from msal_cli.codecs import header_check
from msal_cli.job.settings import FORECAST, NO_LIMITS, Limits, Settings, Task
from tests.cli.scans import closed_scan, folder_of, msal

PLY = (
    "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\n"
    "property float y\nproperty float z\nelement face {}\n"
    "property list uchar int vertex_indices\nend_header\n"
)


def sparse(path: Path, n_vertices: int, n_faces: int) -> Path:
    """A binary PLY file of as many triangles as its header says, that takes no room on the disk."""
    header = PLY.format(n_vertices, n_faces).encode()
    with path.open("wb") as file:
        file.write(header)
        file.truncate(len(header) + 12 * n_vertices + 13 * n_faces)
    return path


def beyond(path, available, monkeypatch, **limits):
    monkeypatch.setattr(weights, "available_bytes", lambda: available)
    tasks = {7: Task(str(path), "out", "in")}
    return estimate_memory(
        tasks, Settings("msal"), Limits(**limits) if limits else NO_LIMITS
    ).find_oversized()


@pytest.mark.parametrize("least", [10**9, 10_200_000_000])
def test_a_mesh_is_refused_for_what_is_foreseen(tmp_path, monkeypatch, least):
    path = sparse(tmp_path / "a.ply", 50_000_000, 100_000_000)
    failure = beyond(path, least, monkeypatch)[7]
    assert (failure.code, failure.where) == ("E_MEMORY", FORECAST)
    assert f"{least / 1e9:.2f} GB left" in failure.message
    assert "--memory-limit" in failure.hint and "cut the mesh" in failure.hint
    # Fifty million vertices are to fit into 24 GiB, and do so with room to spare.
    assert not beyond(path, 16 * 2**30, monkeypatch)
    assert not beyond(path, None, monkeypatch)


def test_a_small_file_is_never_looked_into(tmp_path, monkeypatch):
    path = sparse(tmp_path / "a.ply", LARGE_BYTES // 50, LARGE_BYTES // 50)
    assert not beyond(path, 1, monkeypatch)
    assert not beyond(tmp_path / "gone.ply", 1, monkeypatch)


def test_what_is_only_guessed_is_halved_and_a_lie_is_left_to_the_reader(tmp_path, monkeypatch):
    text = tmp_path / "a.obj"
    text.write_bytes(b"v 0 0 0\n" * 1_000_000)
    assert not beyond(text, 60_000_000, monkeypatch)
    assert beyond(text, 35_000_000, monkeypatch)
    lie = sparse(tmp_path / "a.ply", 10**6, 10**6)
    with lie.open("r+b") as file:
        file.truncate(12_500_000)
    assert not beyond(lie, 1, monkeypatch)


@pytest.fixture
def folder(tmp_path):
    folder = folder_of(tmp_path / "scans", small=closed_scan())
    sparse(folder / "large.ply", 200_000, 400_000)
    return folder


def test_the_others_of_a_folder_are_done(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(weights, "available_bytes", lambda: 60_000_000)
    monkeypatch.setattr(header_check, "read_whole", None)
    made = msal("denoise", folder, "-o", tmp_path / "out", "-j1")
    assert made.exit_code == 3
    assert "this machine has 60 MB left (E_MEMORY)" in made.stderr
    assert (tmp_path / "out/small.ply").exists() and not (tmp_path / "out/large.ply").exists()


def test_one_file_alone_is_refused_and_a_limit_of_its_own_tries_it(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(weights, "available_bytes", lambda: 60_000_000)
    one = folder / "large.ply"
    made = msal("denoise", one, "-o", tmp_path / "out.ply")
    assert made.exit_code == 1
    assert "E_MEMORY" in made.stderr and "hint: use a machine" in made.stderr
    # Nothing but zeros is no surface, which only reading tells.
    made = msal("denoise", one, "-o", tmp_path / "out.ply", "--memory-limit", "1G")
    assert "E_MEMORY" not in made.stderr and "E_NO_FACES" in made.stderr
    assert not (tmp_path / "out.ply").exists()


@pytest.mark.parametrize(
    "words", [("info", "{0}"), ("compare", "{0}", "{0}"), ("view", "{0}", "-o", "{0}.png")]
)
def test_other_commands_refuse_it_too(folder, monkeypatch, words):
    monkeypatch.setattr(machine, "available_bytes", lambda: 35_000_000)
    made = msal(*(word.format(folder / "large.ply") for word in words))
    assert made.exit_code != 0 and "E_MEMORY" in made.stderr
    assert "this machine has 35 MB left" in made.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux")
def test_the_command_refuses_two_billion_vertices_without_loading_them(tmp_path):
    import resource

    sparse(tmp_path / "huge.ply", 2_000_000_000, 300_000_000)
    command = [sys.executable, "-m", "msal_cli", "denoise", "huge.ply", "-o", "out.ply"]
    made = subprocess.run(
        command,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        # A try to hold the file would fail with another message.
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30)),
    )
    assert made.returncode == 1
    assert "denoising this file takes" in made.stderr and "E_MEMORY" in made.stderr
    assert "Traceback" not in made.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["huge.ply"]
