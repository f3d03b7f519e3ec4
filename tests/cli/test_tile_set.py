"""``msal denoise --tile-set``: from the command line to reports, gates and later runs."""

from __future__ import annotations

import json

import pytest

from tests.batch.tile_files import in_tiles, mixed, noisy_terrain, ply
from tests.cli.scans import msal


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


def test_records_name_the_neighbours(tiles):
    records = records_of(tiles)
    assert records[1]["tile_set"]["neighbours"] == ["0.ply", "2.stl", "3.ply"]
    assert [one["tile_gap"] for one in records] == [0.0] * 4
    again = msal("report", tiles[1], "--json")
    assert [one["tile_set"] for one in json.loads(again.stdout)["records"]] == [
        one["tile_set"] for one in records
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
