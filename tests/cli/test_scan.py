"""`msal scan`: files, folders, streams, volumes, and wrong use."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from msal_cli import codecs
from msal_cli.analysis.simulation import SCANNERS
from msal_cli.analysis.simulation.volume_files import TYPES
from msal_cli.cli.scan import _SCANNERS, _TYPES
from tests.cli.scans import BAD_SCAN, folder_of, msal, msal_on, ply_text
from tests.shapes import ball, cube

pytest.importorskip("skimage")
pytest.importorskip("fcpw")

CELLS = ("--resolution", "12")


@pytest.fixture
def part(tmp_path):
    return folder_of(tmp_path / "a folder", part=ply_text(*ball(24, 12))) / "part.ply"


def opened(path):
    return codecs.open_mesh(path.read_bytes(), path.name)


def test_the_command_offers_every_scanner_and_type():
    assert tuple(SCANNERS) == _SCANNERS
    assert tuple(TYPES) == _TYPES


@pytest.mark.parametrize("scanner", SCANNERS)
def test_a_scan_and_its_truth(part, scanner):
    target, truth = part.with_name("scan.ply"), part.with_name("truth.ply")
    made = msal("scan", part, "-o", target, "--truth", truth, "--scanner", scanner, *CELLS)
    assert (made.exit_code, made.stdout) == (0, "")
    assert f"scan.ply: {scanner}, cells of 0.16" in made.stderr
    scan, true = opened(target), opened(truth)
    assert np.array_equal(scan.faces, true.faces)
    radii = np.linalg.norm(true.vertices, axis=1)
    assert 0.95 < radii.min() <= radii.max() < 1.0 + 1e-5
    assert not np.array_equal(scan.vertices, true.vertices)


def test_the_same_seed_gives_the_same_bytes(part):
    names = (("a", 1), ("b", 1), ("c", 2))
    for name, seed in names:
        words = ["--scanner", "ct", *CELLS, "--seed", seed]
        assert msal("scan", part, "-o", part.with_name(f"{name}.ply"), *words).exit_code == 0
    a, b, c = (part.with_name(f"{name}.ply").read_bytes() for name, _ in names)
    assert a == b != c


def test_a_folder_becomes_a_mirrored_tree_and_so_does_the_truth(tmp_path):
    folder = folder_of(tmp_path / "in", a=ply_text(*ball(24, 12)), bad=BAD_SCAN)
    folder_of(folder / "below", b=ply_text(*cube()))
    words = ["-o", tmp_path / "out", "--truth", tmp_path / "true", "--to", "obj", *CELLS]
    made = msal("scan", folder, *words)
    assert (made.exit_code, "bad.ply" in made.stderr) == (3, True)
    for name in ("out", "true"):
        written = [one.relative_to(tmp_path / name) for one in (tmp_path / name).rglob("*.obj")]
        assert sorted(map(str, written)) == ["a.obj", "below/b.obj"]
    again = msal("scan", folder, *words)
    assert (again.exit_code, "--force" in again.stderr) == (2, True)
    assert msal("scan", folder, *words, "--force").exit_code == 3


@pytest.mark.parametrize("source", ["part.ply", "-"])
def test_the_truth_has_the_format_of_its_own_name(part, source):
    target, truth = part.with_name("scan.obj"), part.with_name("new folder") / "truth.stl"
    source = part if source != "-" else source
    words = ["-o", target, "--truth", truth, *CELLS]
    assert msal_on(part.read_bytes(), "scan", source, *words).exit_code == 0
    assert opened(target).format == "obj"
    assert opened(truth).format == "stl"
    wrong = msal_on(part.read_bytes(), "scan", "-", "-o", target, "--truth", "truth.foo", *CELLS)
    assert (wrong.exit_code, "truth.foo" in wrong.stderr) == (2, True)
    both = msal_on(part.read_bytes(), "scan", "-", "-o", target, "--to", "stl", *CELLS)
    assert (both.exit_code, "say two formats" in both.stderr) == (2, True)


def test_digits_that_the_format_loses_are_a_warning(tmp_path):
    """Survey coordinates in STL: half a metre is the least step there."""
    vertices, faces = ball(24, 12)
    source = folder_of(tmp_path, far=ply_text(vertices, faces)) / "far.ply"
    text = source.read_text().replace("property float", "property double").splitlines()
    start = text.index("end_header") + 1
    for at in range(start, start + len(vertices)):
        x, y, z = map(float, text[at].split())
        text[at] = f"{x + 4650000} {y} {z}"
    source.write_text("\n".join(text) + "\n")
    for suffix, is_lost in (("stl", True), ("ply", False), ("obj", False)):
        made = msal("scan", source, "-o", tmp_path / f"scan.{suffix}", *CELLS)
        assert (made.exit_code, "rounds positions to 0.5" in made.stderr) == (0, is_lost)


def test_what_is_no_mesh_and_may_be_a_volume(tmp_path):
    (tmp_path / "v.npz").write_bytes(b"PK\x03\x04 and so on")
    made = msal("scan", tmp_path / "v.npz", "-o", tmp_path / "a.ply")
    assert (made.exit_code, "a volume is a .npy file" in made.stderr) == (1, True)


def test_streams(part):
    target = part.with_name("scan.ply")
    msal("scan", part, "-o", target, *CELLS)
    made = msal_on(part.read_bytes(), "scan", "-", "-o", "-", *CELLS)
    assert (made.exit_code, made.stdout_bytes) == (0, target.read_bytes())


def test_a_name_that_ends_in_gz_is_compressed(part):
    plain, packed = part.with_name("scan.ply"), part.with_name("scan.ply.gz")
    for target in (plain, packed):
        assert msal("scan", part, "-o", target, *CELLS).exit_code == 0
    assert gzip.decompress(packed.read_bytes()) == plain.read_bytes()


@pytest.mark.parametrize("suffix", ["obj", "stl", "off", "glb", "vtu", "3mf"])
def test_every_usual_format_is_written(part, suffix):
    target = part.with_name(f"scan.{suffix}")
    assert msal("scan", part, "-o", target, *CELLS).exit_code == 0
    plain = part.with_name("scan.ply")
    msal("scan", part, "-o", plain, *CELLS)
    assert len(opened(target).faces) == len(opened(plain).faces)


def test_a_volume_becomes_a_mesh(tmp_path):
    volume = np.zeros((5, 6, 7), dtype=np.int16)
    volume[1:4, 2:4, 2:5] = 1000
    np.save(tmp_path / "v.npy", volume)
    volume.tofile(tmp_path / "v.raw")
    words = ["--iso", "300", "--spacing", "0.5,0.5,1.5"]
    made = msal("scan", tmp_path / "v.npy", "-o", tmp_path / "a.ply", *words)
    assert (made.exit_code, "the surface at the value 300" in made.stderr) == (0, True)
    streamed = msal_on((tmp_path / "v.npy").read_bytes(), "scan", "-", *words)
    assert streamed.stdout_bytes == (tmp_path / "a.ply").read_bytes()
    words += ["--dims", "7,6,5", "--type", "int16"]
    assert msal("scan", tmp_path / "v.raw", "-o", tmp_path / "b.ply", *words).exit_code == 0
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    span = np.ptp(opened(tmp_path / "a.ply").vertices, axis=0)
    assert span == pytest.approx([0.5 * 3.4, 0.5 * 2.4, 1.5 * 3.4], rel=1e-5)


def test_an_open_mesh_is_closed_with_a_warning(tmp_path):
    vertices, faces = ball(24, 12)
    lid = vertices[faces].mean(axis=1)[:, 2] > 0.8
    source = folder_of(tmp_path, open=ply_text(vertices, faces[~lid])) / "open.ply"
    made = msal("scan", source, "-o", tmp_path / "scan.ply", *CELLS)
    assert (made.exit_code, "scan.ply: the mesh is open: 1 hole" in made.stderr) == (0, True)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--scanner", "laser"], "laser"),
        (["--resolution", "2"], "give another --resolution"),
        (["--resolution", "1.5"], "0.8e"),
        (["--resolution", "nane"], "0.8e"),
        (["--scanner", "ct", "--level", "-1"], "level"),
        (["--scanner", "ct", "--level", "much"], "much"),
        (["--level", "0.1"], "it is for --scanner ct, depth, fusion"),
        (["--scanner", "depth", "--views", "3"], "it is for --scanner fusion"),
        (["--slices", "0"], "slices"),
        (["--direction", "0,0,0"], "direction"),
        (["--iso", "3"], "--iso is for volumes"),
        (["--type", "int8"], "--type needs --dims"),
        (["--dims", "4,4"], "512,512,100"),
        (["--to", "xyz"], "no such format"),
    ],
)
def test_wrong_values_touch_nothing(part, words, named):
    target = part.with_name("scan.ply")
    made = msal("scan", part, "-o", target, *words)
    assert (made.exit_code, target.exists()) == (2, False)
    assert named in made.stderr


@pytest.mark.parametrize(
    "words", [["--seed", "1"], ["--scanner", "ct"], ["--truth", "t.ply"], ["--type", "int8"]]
)
def test_what_is_not_for_volumes_is_refused(tmp_path, words):
    np.save(tmp_path / "v.npy", np.eye(4)[None] * np.ones((4, 1, 1)))
    made = msal("scan", tmp_path / "v.npy", "-o", tmp_path / "a.ply", *words)
    assert (made.exit_code, (tmp_path / "a.ply").exists()) == (2, False)
    assert words[0] in made.stderr


def test_files_that_are_no_volume(tmp_path):
    (tmp_path / "v.npy").write_bytes(b"solid\n")
    made = msal("scan", tmp_path / "v.npy", "-o", tmp_path / "a.ply")
    assert (made.exit_code, "E_FORMAT" in made.stderr, "v.npy" in made.stderr) == (1, True, True)


@pytest.mark.parametrize(
    ("scanner", "named"), [("ct", "fills no voxel"), ("fusion", "the cameras see no surface")]
)
def test_a_mesh_that_a_scanner_does_not_see(tmp_path, scanner, named):
    """A sheet has no inside, and a needle is in no camera's way."""
    sheet = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    needle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    source = folder_of(tmp_path, a=ply_text(needle if scanner == "fusion" else sheet, [[0, 1, 2]]))
    words = ["-o", tmp_path / "scan.ply", "--scanner", scanner, *CELLS]
    made = msal("scan", source / "a.ply", *words)
    assert (made.exit_code, (tmp_path / "scan.ply").exists()) == (1, False)
    assert named in made.stderr
    assert "finer --resolution" in made.stderr


def test_inputs_and_the_truth_are_not_overwritten(part):
    before = part.read_bytes()
    target = part.with_name("scan.ply")
    assert msal("scan", part, "-o", part).exit_code == 2
    assert msal("scan", part, "-o", target, "--truth", part).exit_code == 2
    assert msal("scan", part, "-o", target, "--truth", target).exit_code == 2
    beside = target.parent / "." / ".." / target.parent.name / target.name
    assert msal("scan", part, "-o", target, "--truth", beside).exit_code == 2
    made = msal_on(before, "scan", "-", "-o", target, "--truth", beside, *CELLS)
    assert (made.exit_code, "a file of its own" in made.stderr) == (2, True)
    for output in ("-", target):
        made = msal("scan", part, "-o", output, "--truth", "-")
        assert (made.exit_code, "is standard output" in made.stderr) == (2, True)
    assert msal("scan", part).exit_code == 2
    assert (part.read_bytes(), target.exists()) == (before, False)
