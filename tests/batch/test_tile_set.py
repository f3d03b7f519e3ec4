"""Files that touch, denoised as one mesh; by the command, too, and again."""

import json
from dataclasses import replace

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.batch import tile_set
from msal_cli.batch.schedule import Progress
from msal_cli.batch.tile_set import SetRun
from msal_cli.job.pipeline import denoise_file
from msal_cli.job.settings import Limits, Settings
from tests.batch.tile_files import (
    in_tiles,
    joined,
    mixed,
    noisy_ball,
    noisy_terrain,
    ply,
    read,
    tasks_of,
)
from tests.cli.scans import msal
from tests.ply_files import to_ply

MSAL = Settings("msal", methods.find("msal").validate({}), tile_set=True)


def denoise_set(tasks, settings, max_failures=None, **more):
    """The records of all tasks that were dealt with, in order."""
    records = SetRun(tasks, settings, **more).denoise(max_failures)
    return [records[index] for index in sorted(records)]


def plies(parts, code="<f4"):
    return {f"{i}.ply": ply(*part, code) for i, part in enumerate(parts)}


@pytest.mark.parametrize("code", ["<f4", "<f8"])
def test_the_set_is_the_joined_mesh(tmp_path, code):
    parts = in_tiles(*noisy_ball(single=code == "<f4"), 2)
    records = denoise_set(tasks_of(tmp_path, plies(parts, code)), MSAL)
    assert [one.status for one in records] == ["written"] * 4
    assert [one.tile_gap for one in records] == [0.0] * 4
    (task,) = tasks_of(tmp_path / "joined", {"a.ply": ply(*joined(parts), code)})
    whole = denoise_file(task, replace(MSAL, tile_set=False))
    assert all(one.method == whole.method and one.choice == whole.choice for one in records)
    ours = np.concatenate([read(one.output).vertices for one in records])
    assert ours.tobytes() == read(whole.output).vertices.tobytes()
    assert not np.array_equal(ours, joined(parts)[0])


def test_files_in_other_formats_have_the_same_positions(tmp_path):
    parts = in_tiles(*noisy_terrain(), 3)
    records = denoise_set(tasks_of(tmp_path, mixed(parts)), MSAL)
    assert [one.status for one in records] == ["written"] * 9
    assert [one.tile_gap for one in records] == [0.0] * 9
    assert records[4].tile_set.neighbours == tuple(n for n in mixed(parts) if n != "4.off")
    (task,) = tasks_of(tmp_path / "joined", {"a.ply": ply(*joined(parts), "<f8")})
    whole = read(denoise_file(task, replace(MSAL, tile_set=False)).output).vertices
    start = 0
    for (vertices, faces), record in zip(parts, records, strict=True):
        there = read(record.output)
        corners = there.vertices[there.faces.reshape(-1)]
        wanted = whole[start : start + len(vertices)][faces.reshape(-1)]
        assert np.abs(corners - wanted).max() < 2e-6
        start += len(vertices)


def test_a_border_with_vertices_amid_edges_is_a_warning(tmp_path):
    coarse, faces = noisy_terrain(9, 9)
    fine, fine_faces = noisy_terrain(17, 17)
    # The same field of heights further to the right, with edges half as long; every other vertex
    # of its left side is one of the coarse part.
    fine = fine / (2.0, 2.0, 1.0) + (8.0, 0.0, 0.0)
    left = fine[::17]
    left[::2] = coarse[8::9]
    left[1::2] = (left[:-1:2] + left[2::2]) / 2.0
    fine[::17] = left
    contents = {"coarse.ply": ply(coarse, faces, "<f8"), "fine.ply": ply(fine, fine_faces, "<f8")}
    coarse_record, fine_record = denoise_set(tasks_of(tmp_path, contents), MSAL)
    assert fine_record.tile_set.shared_vertices == 9
    assert (coarse_record.tile_set.unmatched_vertices, fine_record.tile_set.unmatched_vertices) == (
        0,
        8,
    )
    assert "8 border vertices lie at the border of another file" in fine_record.warnings[-1]
    assert not coarse_record.warnings


def test_the_border_to_a_file_that_fails_is_held(tmp_path):
    parts = in_tiles(*noisy_terrain(), 2)
    contents = plies(parts)
    contents["1.ply"] = contents["1.ply"][:-20]
    tasks = tasks_of(tmp_path, contents)
    records = denoise_set(tasks, MSAL)
    assert [one.status for one in records] == ["written", "failed", "written", "written"]
    assert records[1].error.code == "E_TRUNCATED"
    assert "1.ply" in records[0].warnings[-1]
    shared = (parts[0][0][:, None] == parts[1][0][None]).all(axis=2).any(axis=1)
    lone = shared & ~(parts[0][0][:, None] == parts[2][0][None]).all(axis=2).any(axis=1)
    lone &= ~(parts[0][0][:, None] == parts[3][0][None]).all(axis=2).any(axis=1)
    after = read(records[0].output).vertices
    assert lone.any() and np.array_equal(after[lone], parts[0][0][lone])
    assert not np.array_equal(after[shared], parts[0][0][shared])
    assert records[0].tile_set.fixed_border_vertices >= lone.sum()
    assert records[0].tile_set.files == 3


def test_the_first_failure_may_stop_the_set(tmp_path):
    contents = plies(in_tiles(*noisy_terrain(), 2)) | {"1.ply": b"ply\n"}
    tasks = tasks_of(tmp_path, contents)
    records = denoise_set(tasks, MSAL, max_failures=1)
    assert [one.status for one in records] == ["failed"]
    assert not list((tmp_path / "out").iterdir())


def test_too_little_memory_fails_the_set_before_it_is_read(tmp_path):
    tasks = tasks_of(tmp_path, plies(in_tiles(*noisy_terrain(), 2)))
    records = denoise_set(tasks, MSAL, limits=Limits(memory_bytes=50_000_001))
    assert {one.error.code for one in records} == {"E_MEMORY"}


def test_a_file_that_changes_meanwhile_fails(tmp_path):
    parts = in_tiles(*noisy_terrain(), 2)
    tasks = tasks_of(tmp_path, plies(parts))

    def on_event(event):
        if isinstance(event, Progress) and event.stage == "sweeps":
            (tmp_path / "in/2.ply").write_bytes(ply(*parts[1]))

    records = denoise_set(tasks, MSAL, on_event=on_event)
    assert [one.status for one in records] == ["written", "written", "failed", "written"]
    assert records[2].error.code == "E_CHANGED"
    assert records[0].tile_gap == 0.0


def test_locks_and_trust_come_from_all_files(tmp_path):
    parts = in_tiles(*noisy_terrain(), 2)
    contents = {
        f"{i}.ply": to_ply(vertices.astype("<f4"), faces, trust=np.full(len(vertices), 0.5))
        for i, (vertices, faces) in enumerate(parts)
    }
    tasks = tasks_of(tmp_path, contents)
    records = denoise_set(tasks, replace(MSAL, lock=("trust > 0.2",), weights="trust"))
    assert [one.status for one in records] == ["unchanged"] * 4, records[0].error
    contents["3.ply"] = ply(*parts[3])
    records = denoise_set(tasks_of(tmp_path, contents), replace(MSAL, weights="trust"))
    assert [one.status for one in records] == ["written"] * 3 + ["failed"]
    assert records[3].error.code == "E_PROPERTY"


@pytest.fixture
def tiles(tmp_path):
    """A folder of four files that touch, and where their outputs go."""
    folder = tmp_path / "tiles"
    folder.mkdir()
    for name, data in mixed(in_tiles(*noisy_terrain(), 2)).items():
        (folder / name).write_bytes(data)
    return folder, tmp_path / "out"


def denoise_by_command(tiles, *options):
    folder, out = tiles
    return msal("denoise", folder, "-o", out, "--tile-set", "--method", "msal", *options)


def states(tiles):
    return [
        one["status"] for one in json.loads(denoise_by_command(tiles, "--json").stdout)["records"]
    ]


def test_a_set_is_up_to_date_as_a_whole(tiles):
    folder, out = tiles
    assert states(tiles) == ["written"] * 4
    assert states(tiles) == ["up-to-date"] * 4
    vertices, faces = in_tiles(*noisy_terrain(), 2)[0]
    (folder / "0.ply").write_bytes(ply(vertices + (0.0, 0.0, 1e-3), faces))
    assert states(tiles) == ["written"] * 4
    (out / "1.obj").unlink()
    assert states(tiles) == ["written"] * 4
    # A file less is another set.
    (folder / "3.ply").unlink()
    assert states(tiles) == ["written"] * 3


def test_a_dry_run_counts_the_files(tiles, monkeypatch):
    assert denoise_by_command(tiles, "--dry-run").stderr.splitlines()[-1] == "4 files to denoise"
    assert states(tiles) == ["written"] * 4
    last = denoise_by_command(tiles, "--dry-run").stderr.splitlines()[-1]
    assert last.endswith("4 up to date")
    monkeypatch.setattr(tile_set, "memory_of_set", lambda *given: 10**16)
    beyond = denoise_by_command(tiles, "--dry-run", "--fresh")
    assert (beyond.exit_code, f"{beyond.stdout}{beyond.stderr}".count("E_MEMORY")) == (1, 5)


def test_a_file_that_fails_is_mended(tiles):
    folder, _ = tiles
    good = (folder / "0.ply").read_bytes()
    (folder / "0.ply").write_bytes(good[:-10])
    done = denoise_by_command(tiles, "--fail-on", "fixed_border_vertices > 0")
    assert done.exit_code == 3
    assert "held in their place" in done.stderr and "0.ply" in done.stderr
    # The failure would come again, and so would all others.
    assert states(tiles) == ["failed", "up-to-date", "up-to-date", "up-to-date"]
    (folder / "0.ply").write_bytes(good)
    assert states(tiles) == ["written"] * 4
