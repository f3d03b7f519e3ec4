"""``msal denoise --tile-set``: from the command line to reports, gates and later runs."""

from __future__ import annotations

import json

import pytest

from tests.cli.scans import msal
from tests.tiles.tile_files import in_tiles, mixed, noisy_terrain, ply


@pytest.fixture
def tiles(tmp_path):
    """A folder of four files that touch, and where their outputs go."""
    folder = tmp_path / "tiles"
    folder.mkdir()
    for name, data in mixed(in_tiles(*noisy_terrain(), 2)).items():
        (folder / name).write_bytes(data)
    return folder, tmp_path / "out"


def denoise(tiles, *options):
    folder, out = tiles
    return msal("denoise", folder, "-o", out, "--tile-set", "--method", "msal", *options)


def records_of(tiles, *options):
    return json.loads(denoise(tiles, "--json", *options).stdout)["records"]


def states(tiles, *options):
    return [one["status"] for one in records_of(tiles, *options)]


def test_the_summary_says_what_became_of_the_set(tiles):
    done = denoise(tiles, "--fail-on", "tile_gap > 0")
    assert done.exit_code == 0, done.stderr
    assert "tile set: 4 files as one mesh; largest gap between shared vertices 0" in done.stderr


def test_records_name_the_neighbours(tiles):
    records = records_of(tiles)
    assert records[1]["tile_set"]["neighbours"] == ["0.ply", "2.stl", "3.ply"]
    assert [one["tile_gap"] for one in records] == [0.0] * 4
    again = msal("report", tiles[1], "--json")
    assert [one["tile_set"] for one in json.loads(again.stdout)["records"]] == [
        one["tile_set"] for one in records
    ]


def test_without_the_option_there_is_no_gap_to_speak_of(tiles):
    folder, out = tiles
    done = msal("denoise", folder, "-o", out, "--json", "--fail-on", "tile_gap > 0")
    assert done.exit_code == 4
    assert "--tile-set" in done.stderr or "--tile-set" in done.stdout
    assert all(one["tile_gap"] is None for one in json.loads(done.stdout)["records"])


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
    assert states(tiles, "--weld", "0.01e") == ["written"] * 3


def test_a_file_that_fails_is_mended(tiles):
    folder, _ = tiles
    good = (folder / "0.ply").read_bytes()
    (folder / "0.ply").write_bytes(good[:-10])
    done = denoise(tiles, "--fail-on", "fixed_border_vertices > 0")
    assert done.exit_code == 3
    assert "held in their place" in done.stderr and "0.ply" in done.stderr
    # The failure would come again, and so would all others.
    assert states(tiles) == ["failed", "up-to-date", "up-to-date", "up-to-date"]
    (folder / "0.ply").write_bytes(good)
    assert states(tiles) == ["written"] * 4


def test_a_file_that_an_earlier_run_has_read_holds_its_own_border_only(tiles):
    folder, _ = tiles
    good = (folder / "3.ply").read_bytes()
    (folder / "3.ply").write_bytes(b"ply")
    unknown = [one["tile_set"] for one in records_of(tiles)]
    assert unknown[3] is None
    (folder / "3.ply").write_bytes(good)
    assert [one["tile_set"]["fixed_border_vertices"] for one in records_of(tiles)] == [0] * 4
    (folder / "3.ply").write_bytes(b"ply")
    for _ in range(2):
        records = records_of(tiles, "--fresh")
        known = [one["tile_set"]["fixed_border_vertices"] for one in records]
        assert records[3]["status"] == "failed" and known[3] == 0
        # The corner that all share is within the others; what only 3.ply had is held.
        assert 0 < known[1] < unknown[1]["fixed_border_vertices"]


def test_a_file_that_is_gone_is_missed(tiles):
    folder, _ = tiles
    denoise(tiles)
    (folder / "3.ply").unlink()
    done = denoise(tiles)
    assert "gone may share them" in done.stderr and "3.ply" in done.stderr
    assert states(tiles) == ["up-to-date"] * 3
    assert [one["tile_set"]["fixed_border_vertices"] for one in records_of(tiles, "--fresh")] == [
        0
    ] * 3


def test_fail_fast_writes_nothing(tiles):
    folder, out = tiles
    (folder / "2.stl").write_bytes(b"")
    done = denoise(tiles, "--fail-fast")
    assert done.exit_code != 0
    assert not [one for one in out.iterdir() if not one.name.startswith(".")]


def test_a_dry_run_lists_neighbours_and_memory(tiles):
    done = denoise(tiles, "--dry-run")
    assert "touches 0.ply, 2.stl, 3.ply" in done.stdout
    assert "as one mesh they take up to" in done.stderr
    done = denoise(tiles, "--dry-run", "--tiled")
    assert "as one mesh they are denoised in 1 tile, 1 at a time" in done.stderr
    assert not tiles[1].exists()


def test_fields_and_checks_go_with_a_set(tiles):
    _, out = tiles
    records = records_of(tiles, "--fields", "displacement,lambda", "--check", "self-intersections")
    assert [one["status"] for one in records] == ["written"] * 4
    assert (out / "0.fields.ply").exists()
    assert all(one["self_intersections"]["created"] == 0 for one in records)


@pytest.mark.parametrize("options", [("--weld", "1.1e"), ("--weld", "9", "--dry-run")])
def test_too_long_a_weld_is_refused(tiles, options):
    done = denoise(tiles, *options)
    assert done.exit_code == 2 and "is longer than the edges" in done.stderr
    assert not list(tiles[1].glob("?.*"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--shard", "1/2"), "--shard deals out files"),
        (("--timeout", "5"), "--timeout is for one file"),
        (("--weld", "0"), "--weld 0: this is no length above 0"),
    ],
)
def test_what_does_not_go_with_a_set(tiles, options, words):
    done = denoise(tiles, *options)
    assert done.exit_code == 2 and words in done.stderr


def test_a_weld_needs_a_set_and_a_set_needs_an_output(tiles):
    folder, out = tiles
    done = msal("denoise", folder, "-o", out, "--weld", "0.1e")
    assert done.exit_code == 2 and "--weld needs --tile-set" in done.stderr
    done = msal("denoise", folder, "--in-place", "--tile-set")
    assert done.exit_code == 2 and "--in-place cannot be used with --tile-set" in done.stderr


def test_one_file_is_a_set_too(tiles):
    folder, out = tiles
    done = msal("denoise", folder / "0.ply", "-o", out / "a.ply", "--tile-set", "-n", "3", "--json")
    (record,) = json.loads(done.stdout)["records"]
    assert record["status"] == "written" and record["tile_set"]["neighbours"] == []


def outputs_of(tiles):
    return {one.name: one.read_bytes() for one in tiles[1].glob("?.*")}


def test_by_tiles_the_outputs_are_the_same(tiles):
    assert states(tiles, "--weld", "0.01e") == ["written"] * 4
    in_memory = outputs_of(tiles)
    records = records_of(tiles, "--weld", "0.01e", "--tiled", "--fresh", "-j", "2")
    assert [one["status"] for one in records] == ["written"] * 4
    assert all(one["tiles"]["number"] == 1 and one["tile_gap"] == 0.0 for one in records)
    assert outputs_of(tiles) == in_memory
    assert not list(tiles[1].glob(".msal-tiles-*"))
    assert states(tiles, "--weld", "0.01e") == ["up-to-date"] * 4


def test_a_set_by_tiles_goes_on_where_it_was_interrupted(tiles, monkeypatch):
    from msal_cli.tiles import set_run

    def interrupted(*arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(set_run, "write_member", interrupted)
        assert denoise(tiles, "--tiled").exit_code == 130
    assert len(list(tiles[1].glob(".msal-tiles-*"))) == 1 and not outputs_of(tiles)
    records = records_of(tiles, "--tiled")
    assert [one["status"] for one in records] == ["written"] * 4
    assert records[0]["tiles"]["resumed_tasks"] > 0
    assert not list(tiles[1].glob(".msal-tiles-*"))


def test_what_needs_the_whole_mesh_is_not_done_by_tiles(tiles):
    done = denoise(tiles, "--tiled", "--fields", "lambda", "--json")
    assert {one["error"]["code"] for one in json.loads(done.stdout)["records"]} == {"E_UNSUPPORTED"}
    assert not outputs_of(tiles)


def test_a_run_without_the_option_says_that_files_touch(tiles):
    folder, out = tiles
    done = msal("denoise", folder, "-o", out, "--method", "msal")
    assert "4 files share border vertices: --tile-set denoises them as one" in done.stderr
    assert "share border vertices" not in denoise(tiles, "--fresh").stderr
