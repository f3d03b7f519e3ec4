"""One mesh by tiles: the same bytes as in memory, whatever ends a run before."""

from __future__ import annotations

import gzip
import json
import os
import signal
import tempfile
from pathlib import Path

import pytest

from msal_cli import machine
from msal_cli.batch import tile_scratch, tile_tasks
from msal_cli.errors import OutputError
from msal_cli.tiles import estimates
from msal_cli.tiles.scratch import Scratch
from tests.batch import giants
from tests.batch.giants import in_memory, n_finished, scan, scratch_of
from tests.cli.scans import msal

METHOD = ("--method", "al", "-n", "1")
MSAL = ("--method", "msal", "-n", "2")


@pytest.fixture(autouse=True)
def small_tiles(monkeypatch):
    giants.use_small_tiles(monkeypatch)


@pytest.fixture
def tmp_path(tmp_path):
    """A folder in memory, where there is one: workers would wait for the disk at every task."""
    if not Path("/dev/shm").is_dir():
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        yield Path(folder)


@pytest.fixture
def source(tmp_path):
    (tmp_path / "in").mkdir()
    return scan(tmp_path / "in" / "a.ply")


@pytest.fixture
def output(tmp_path):
    (tmp_path / "out").mkdir()
    return tmp_path / "out" / "b.ply"


def tiled(source, output, *words):
    return msal("denoise", source, "-o", output, "--tiled", *words)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def record_of(made):
    (record,) = json.loads(made.stdout)["records"]
    return record


@pytest.mark.parametrize("suffix", [".ply", ".stl"])
def test_the_same_bytes_and_the_same_record(source, output, suffix):
    if suffix == ".stl":
        source = giants.binary_stl(source.with_suffix(suffix))
        output = output.with_suffix(suffix)
    expected = in_memory(source, *MSAL)
    alone = record_of(
        msal("denoise", source, "-o", source.with_name("c" + suffix), "--json", *MSAL)
    )
    made = tiled(source, output, "--json", "-j2", *MSAL)
    assert made.exit_code == 0, made.stderr
    assert output.read_bytes() == expected
    assert names(output.parent) == [output.name]
    record = record_of(made)
    tiles = record.pop("tiles")
    assert alone.pop("tiles") is None
    assert (tiles["number"], tiles["jobs"], tiles["rings"]) == (4, 2, 3)
    assert tiles["choice_vertices"] is None and tiles["resumed_tasks"] == 0
    assert tiles["scratch_bytes"] > 100_000
    for name in ("seconds", "vertices_per_second", "peak_memory_bytes", "output"):
        assert record.pop(name) is not None and alone.pop(name) is not None
    assert record["displacement"].pop("p95") == pytest.approx(
        alone["displacement"].pop("p95"), 1e-3
    )
    record["displacement"].pop("p95_edges"), alone["displacement"].pop("p95_edges")
    assert numbers(record) == pytest.approx(numbers(alone), rel=1e-9, abs=1e-9)
    assert texts(record) == texts(alone)


def numbers(record, prefix=""):
    """All numbers of a record by their paths."""
    found = {}
    for name, value in record.items():
        if isinstance(value, dict):
            found |= numbers(value, f"{prefix}{name}.")
        elif isinstance(value, int | float):
            found[prefix + name] = value
    return found


def texts(record):
    """All else but the names of what is in records."""
    return {name: one for name, one in record.items() if not isinstance(one, int | float | dict)}


def as_text(source, suffix):
    """The mesh of ``source`` as another file: a text, or compressed."""
    path = source.with_name("text" + suffix)
    data = source.read_bytes() if suffix == ".ply.gz" else giants.text(source, suffix[:4]).encode()
    path.write_bytes(gzip.compress(data, mtime=0) if suffix.endswith(".gz") else data)
    return path


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".ply.gz", ".obj.gz"])
def test_texts_and_compressed_files_give_the_same_bytes(source, output, suffix):
    source = as_text(source, suffix)
    output = output.with_name("b" + suffix)
    alone = source.with_name("alone" + suffix)
    assert msal("denoise", source, "-o", alone, "-q", *METHOD).exit_code == 0
    made = tiled(source, output, "--json", *METHOD)
    assert made.exit_code == 0, made.stderr
    assert output.read_bytes() == alone.read_bytes() != source.read_bytes()
    assert names(output.parent) == [output.name]
    record = record_of(made)
    assert record["tiles"]["number"] == 4
    assert record["format"] == suffix.split(".")[1]


def test_a_conversion_is_kept_with_the_tasks_of_a_killed_run(source, output):
    source, output = as_text(source, ".obj"), output.with_suffix(".obj")
    process = giants.start_slowly("denoise", source, "-o", output, "--tiled", *METHOD)
    giants.wait_for(lambda: n_finished(output) >= 6, process)
    process.kill()
    process.communicate()
    numbers_of_text = scratch_of(output) / "text" / "facts.json"
    inode = numbers_of_text.stat().st_ino
    made = tiled(source, output, "--dry-run", *METHOD)
    assert made.exit_code == 0 and "about" in made.stdout
    assert numbers_of_text.stat().st_ino == inode
    made = tiled(source, output, "--json", *METHOD)
    assert record_of(made)["tiles"]["resumed_tasks"] >= 6
    assert names(output.parent) == ["b.obj"]


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl"])
def test_a_fault_of_a_text_is_named_and_leaves_nothing(source, output, suffix):
    source, output = as_text(source, suffix), output.with_suffix(suffix)
    data = source.read_bytes()
    source.write_bytes(data[: len(data) // 2] + b"\nx y z\n" + data[len(data) // 2 :])
    alone = msal("denoise", source, "-o", output, "-q", *METHOD)
    made = tiled(source, output, "-q", *METHOD)
    assert made.exit_code == alone.exit_code == 1
    assert "line" in made.stderr and "Traceback" not in made.stderr
    assert made.stderr == alone.stderr
    assert names(output.parent) == []


def test_too_little_space_for_a_text_is_known_before(source, output, monkeypatch):
    source, output = as_text(source, ".obj"), output.with_suffix(".obj")
    size = source.stat().st_size
    for free in (size, 3 * size):
        monkeypatch.setattr(tile_scratch, "free_bytes", lambda path, free=free: free)
        made = tiled(source, output, *METHOD)
        assert made.exit_code == 1 and "nothing was begun" in made.stderr
        assert names(output.parent) == []


def test_a_dry_run_of_a_text_does_not_convert_it(source, output):
    source, output = as_text(source, ".obj"), output.with_suffix(".obj")
    made = tiled(source, output, "--dry-run", *METHOD)
    assert made.exit_code == 0, made.stderr
    assert "tiles" in made.stdout and "about" in made.stdout
    assert names(output.parent) == []


def test_a_choice_and_what_a_user_reads(source, output):
    expected = in_memory(source)
    made = tiled(source, output)
    assert made.exit_code == 0, made.stderr
    assert output.read_bytes() == expected
    assert "4 tiles with" in made.stderr and "of scratch space" in made.stderr


def test_a_clean_mesh_is_unchanged(tmp_path, output):
    source = scan(tmp_path / "clean.ply", level=0.0)
    made = tiled(source, output, "--json")
    assert record_of(made)["status"] == "unchanged"
    assert output.read_bytes() == source.read_bytes()


def test_a_killed_run_goes_on(source, output):
    expected = in_memory(source, *METHOD)
    process = giants.start_slowly("denoise", source, "-o", output, "--tiled", "-j2", *METHOD)
    giants.wait_for(lambda: n_finished(output) >= 9, process)
    process.kill()
    process.communicate()
    kept = n_finished(output)
    assert not output.exists() and kept >= 9
    made = tiled(source, output, "--json", *METHOD)
    assert made.exit_code == 0, made.stderr
    assert "going on with the tiles of an earlier run" in made.stderr
    # Those that workers finished before they knew that their parent was gone.
    assert kept <= record_of(made)["tiles"]["resumed_tasks"] <= kept + 2
    assert output.read_bytes() == expected
    assert names(output.parent) == ["b.ply"]


def test_ctrl_c_keeps_what_is_finished(source, output):
    expected = in_memory(source, *METHOD)
    process = giants.start_slowly("denoise", source, "-o", output, "--tiled", *METHOD)
    giants.wait_for(lambda: n_finished(output) >= 6, process)
    process.send_signal(signal.SIGINT)
    _, printed = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "the same command goes on from there" in printed and "Traceback" not in printed
    assert not output.exists()
    made = tiled(source, output, "--json", *METHOD)
    assert record_of(made)["tiles"]["resumed_tasks"] >= 6
    assert output.read_bytes() == expected


@pytest.mark.slow
def test_other_settings_begin_anew(source, output):
    process = giants.start_slowly("denoise", source, "-o", output, "--tiled", *METHOD)
    giants.wait_for(lambda: n_finished(output) >= 6, process)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=20)
    assert process.returncode == 143
    made = tiled(source, output, "--json", "--method", "umbrella")
    assert record_of(made)["tiles"]["resumed_tasks"] == 0
    assert output.read_bytes() == in_memory(source, "--method", "umbrella")
    assert names(output.parent) == ["b.ply"]


def test_tasks_from_before_a_restart_of_the_machine_are_not_trusted(tmp_path, monkeypatch):
    scratch, identity = Scratch(tmp_path), {"tile_vertices": 5}
    monkeypatch.setattr(machine, "boot_id", lambda: "before")
    tile_scratch.begin(scratch, identity)
    assert tile_scratch.can_go_on(scratch, identity)
    monkeypatch.setattr(machine, "boot_id", lambda: "after")
    assert not tile_scratch.can_go_on(scratch, identity)
    # Another machine that shares the folder cannot know.
    monkeypatch.setattr(tile_scratch, "machine_tag", lambda: "another")
    assert tile_scratch.can_go_on(scratch, identity)


def test_a_lost_worker_costs_its_task(source, output, monkeypatch, tmp_path):
    expected = in_memory(source, *METHOD)
    monkeypatch.setenv(giants.DEATH_MARK, str(tmp_path / "died"))
    monkeypatch.setattr(tile_tasks, "run_tile_task", giants.die_once)
    made = tiled(source, output, "-q", "-j2", *METHOD)
    assert made.exit_code == 0, made.stderr
    assert (tmp_path / "died").exists()
    assert output.read_bytes() == expected


@pytest.mark.slow
def test_workers_that_always_die_fail_the_file(source, output, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(tile_tasks, "run_tile_task", giants.die_always)
        made = tiled(source, output, "-q", "-j2", *METHOD)
    assert made.exit_code == 1
    assert "E_CRASH" in made.stderr and "goes on from there" in made.stderr
    assert not output.exists()
    assert n_finished(output) > 6
    made = tiled(source, output, "-q", *METHOD)
    assert output.read_bytes() == in_memory(source, *METHOD)


@pytest.mark.parametrize("fault", ["index", "nan", "truncated"])
def test_a_fault_of_the_file_is_named_and_leaves_nothing(source, output, fault):
    data = bytearray(source.read_bytes())
    if fault == "index":
        data[-4:] = (99_999).to_bytes(4, "little")
    elif fault == "nan":
        start = data.index(b"end_header\n") + 11
        data[start + 12 * 1000 : start + 12 * 1000 + 4] = b"\0\0\xc0\x7f"
    else:
        del data[-5:]
    source.write_bytes(data)
    alone = msal("denoise", source, "-o", output, "-q", *METHOD)
    made = tiled(source, output, "-q", *METHOD)
    assert made.exit_code == 1
    word = {"index": "E_INDEX", "nan": "E_NONFINITE", "truncated": "E_TRUNCATED"}[fault]
    assert word in made.stderr and "Traceback" not in made.stderr
    if fault != "truncated":
        assert made.stderr == alone.stderr
    assert names(output.parent) == []


def test_too_little_space_is_known_before(source, output, monkeypatch):
    monkeypatch.setattr(tile_scratch, "free_bytes", lambda path: 1000)
    made = tiled(source, output, *METHOD)
    assert made.exit_code == 1
    assert "E_WRITE" in made.stderr and "--scratch" in made.stderr
    assert "nothing was begun" in made.stderr
    assert names(output.parent) == []


@pytest.mark.slow
def test_a_scratch_folder_of_ones_own(source, output, tmp_path):
    place = tmp_path / "fast"
    process = giants.start_slowly(
        "denoise", source, "-o", output, "--tiled", "--scratch", place, *METHOD
    )
    path = tile_scratch.scratch_path(str(output), str(place))
    giants.wait_for(lambda: (path / "plan.json").exists(), process)
    assert names(output.parent) == []
    process.communicate(timeout=60)
    assert process.returncode == 0
    assert names(place) == [] and names(output.parent) == ["b.ply"]


def test_two_runs_on_one_scratch_folder_are_refused(source, output):
    with tile_scratch.lock_scratch(scratch_of(output)):
        made = tiled(source, output, *METHOD)
    assert made.exit_code == 1
    assert "E_LOCKED" in made.stderr
    assert str(os.getpid()) in made.stderr


def give_mark(folder):
    """Have a folder look like one of msal's, as far as an archive can."""
    (folder / "made-by-msal").write_text("inode 12345\n")
    return folder


@pytest.mark.skipif(os.name != "posix", reason="needs links and modes of POSIX")
@pytest.mark.parametrize("kind", ["link", "relative link", "archive", "open to all", "file"])
def test_what_only_has_the_name_of_the_scratch_folder_is_left_alone(source, output, kind):
    path = scratch_of(output)
    victim = output.parent.parent / "victim"
    victim.mkdir()
    (victim / "precious.txt").write_text("precious")
    if kind == "archive":
        path.mkdir(0o700)
        (give_mark(path) / "output.bin").symlink_to(victim / "precious.txt")
    elif kind == "open to all":
        path.mkdir()
        path.chmod(0o777)
        (path / "made-by-msal").write_text(f"inode {path.stat().st_ino}\n")
    elif kind == "file":
        path.write_text("precious")
    else:
        path.symlink_to(victim if kind == "link" else Path("..") / victim.name)
    made = tiled(source, output, *METHOD)
    assert made.exit_code == 1
    assert "E_WRITE" in made.stderr and "not a scratch folder that you made" in made.stderr
    assert names(victim) == ["precious.txt"] and not output.exists()
    assert (victim / "precious.txt").read_text() == "precious"
    assert os.path.lexists(path)


@pytest.mark.skipif(os.name != "posix", reason="needs modes of POSIX")
def test_no_other_user_can_look_into_the_scratch_folder(output):
    with tile_scratch.lock_scratch(scratch_of(output)) as scratch:
        assert scratch.path.stat().st_mode & 0o777 == 0o700
        (scratch.path / "plan.json").write_text("{}")
        tile_scratch.clear(scratch)
    # It is taken again.
    with tile_scratch.lock_scratch(scratch_of(output)) as scratch:
        assert not scratch.has("plan.json")


@pytest.mark.skipif(os.name != "posix", reason="needs modes of POSIX")
def test_an_output_is_as_private_as_its_input(source, output):
    source.chmod(0o600)
    assert tiled(source, output, *METHOD).exit_code == 0
    assert output.stat().st_mode & 0o777 == 0o600


def test_a_folder_of_another_user_is_not_taken(output, monkeypatch):
    with tile_scratch.lock_scratch(scratch_of(output)):
        pass
    monkeypatch.setattr(os, "geteuid", lambda: 12345, raising=False)
    with pytest.raises(OutputError, match="not a scratch folder that you made"):
        tile_scratch.lock_scratch(scratch_of(output)).__enter__()


@pytest.mark.slow
def test_one_giant_among_small_files(tmp_path, monkeypatch):
    giants.use_small_tiles(monkeypatch, 20_000)
    monkeypatch.setattr(estimates, "FEWEST_TILE_VERTICES", 20_000)
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("a", "c"):
        scan(folder / f"{name}.ply", 12, 8)
    scan(folder / "b.ply", 1200, 600)
    limit = ("--memory-limit", "200M")
    made = msal("denoise", folder, "-o", tmp_path / "out", "--json", *limit, *METHOD)
    assert made.exit_code == 0, made.stderr
    records = json.loads(made.stdout)["records"]
    assert [record["tiles"] is not None for record in records] == [False, True, False]
    for record in records:
        alone = in_memory(Path(record["input"]), *METHOD)
        assert Path(record["output"]).read_bytes() == alone
    again = msal("denoise", folder, "-o", tmp_path / "out", "--json", *limit, *METHOD)
    known = [record["status"] for record in json.loads(again.stdout)["records"]]
    assert known == ["up-to-date"] * 3


def test_in_place_keeps_the_original(source):
    before, expected = source.read_bytes(), in_memory(source, *METHOD)
    made = msal("denoise", source, "--in-place", "--tiled", *METHOD)
    assert made.exit_code == 0, made.stderr
    assert source.read_bytes() == expected
    assert source.with_name("a.ply.orig").read_bytes() == before
    again = msal("denoise", source, "--in-place", "--tiled", "--json", *METHOD)
    assert record_of(again)["status"] == "up-to-date"
    assert source.read_bytes() == expected


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--method", "l0"), "l0 with these parameters needs the whole mesh"),
        (("--despike",), "--despike needs the whole mesh"),
        (("--encoding", "ascii"), "another format or encoding"),
        (("--fields", "lambda"), "--fields needs"),
    ],
)
def test_what_tiles_cannot_do_is_refused_with_the_reason(source, output, words, reason):
    made = tiled(source, output, *words)
    assert made.exit_code == 1
    assert reason in made.stderr and "E_UNSUPPORTED" in made.stderr
    assert names(output.parent) == []


def test_a_refusal_for_memory_says_why_tiles_are_no_way(tmp_path, output):
    source = scan(tmp_path / "large.ply", 400, 200)
    made = msal("denoise", source, "-o", output, "--memory-limit", "60M", "--method", "l0")
    assert made.exit_code == 1
    assert "E_MEMORY" in made.stderr and "by tiles" in made.stderr
    assert "l0 with these parameters needs the whole mesh" in made.stderr


def test_a_stream_is_not_for_tiles(source):
    made = msal("denoise", source, "-o", "-", "--tiled")
    assert made.exit_code == 2
    assert "--tiled is for files" in made.stderr


def test_a_dry_run_knows_a_billion_triangles_by_their_header(tmp_path, monkeypatch):
    giants.use_small_tiles(monkeypatch, 1_000_000)
    path = tmp_path / "city.ply"
    giants.binary_ply(path, *((giants.np.zeros((3, 3)), [(0, 1, 2)])))
    n, m = 500_000_000, 1_000_000_000
    head = path.read_bytes().partition(b"end_header\n")[0] + b"end_header\n"
    head = head.replace(b"vertex 3", b"vertex %d" % n).replace(b"face 1", b"face %d" % m)
    path.write_bytes(head)
    os.truncate(path, len(head) + 12 * n + 13 * m)
    made = msal("denoise", path, "-o", tmp_path / "out.ply", "--dry-run", "--json", *METHOD)
    assert made.exit_code == 0, made.stderr
    tiles = record_of(made)["tiles"]
    assert tiles["number"] == 512
    assert 100e9 < tiles["scratch_bytes"] < 300e9
    assert tiles["memory_bytes"] < 4e9
    assert tiles["expected_seconds"] > 300
    assert names(tmp_path) == ["city.ply"]
    listed = msal("denoise", path, "-o", tmp_path / "out.ply", "--dry-run", *METHOD)
    assert "512 tiles" in listed.stdout and "of scratch space" in listed.stdout
