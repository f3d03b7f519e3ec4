"""Whole batches of objects in memory; and what is secret in a URL is shown nowhere."""

import re

import pytest

from msal_cli import methods
from msal_cli.batch import manifest as manifests
from msal_cli.batch.inputs import NothingMatched, discover_inputs
from msal_cli.batch.lock import Shard
from msal_cli.batch.manifest import PARTS_FOLDER, ObjectManifest, done_line, intent_line
from msal_cli.batch.plan import build_plan
from msal_cli.batch.run import run
from msal_cli.errors import InputError, UsageError
from msal_cli.job.records import MeshRecord
from msal_cli.job.settings import Settings
from msal_cli.storage import objects as remote
from msal_cli.storage.objects import list_objects, read_whole, write_whole
from tests.batch.fakes import InProcess
from tests.batch.test_manifest import read_names
from tests.batch.test_run import obj
from tests.cli.scans import closed_scan, msal, msal_on
from tests.files import denoise_bytes, tree

pytest.importorskip("fsspec", reason="needs the extra: pip install '.[cloud]'")
pytestmark = pytest.mark.usefixtures("empty_store")

NAMES = ("a/0.obj", "a/b/1.obj", "2.obj")


@pytest.fixture
def scans():
    for n, name in enumerate(NAMES):
        write_whole(f"memory://scans/{name}", obj(n).encode())


def settings(**given):
    return Settings("msal", methods.find("msal").validate(given))


def denoised(inputs="memory://scans", output="memory://out", given=None, **options):
    some = [inputs] if isinstance(inputs, str) else inputs
    plan = build_plan(discover_inputs(some, output=output), output, **options)
    return run(plan, settings(**(given or {})), jobs=2)


def states(records):
    return {record.output.partition("out/")[2]: record.status for record in records}


def outputs(folder="memory://out"):
    return {
        name: read_whole(f"{folder}/{name}")
        for name in list_objects(folder)
        if not name.startswith(".")
    }


def expected(names=NAMES):
    """What each object becomes."""
    return {
        name: bytes(denoise_bytes(obj(n).encode(), name, settings())[0])
        for n, name in enumerate(names)
    }


def paths(*inputs, **options):
    return [one.path.partition("scans")[2] for one in discover_inputs(list(inputs), **options)]


# What is found


def test_urls_stand_for_objects_folders_and_patterns(scans):
    for name in (".hidden/x.obj", ".y.obj", "notes.txt", ".msal-manifest/z.obj", "a/.msal-lock"):
        write_whole(f"memory://scans/{name}", b"")
    write_whole("memory://scans2/no.obj", b"")
    assert paths("memory://scans") == ["/2.obj", "/a/0.obj", "/a/b/1.obj"]
    assert paths("memory://scans/") == paths("memory://scans")
    assert paths("memory://scans/a/0.obj") == ["/a/0.obj"]
    assert paths("memory://scans/**/*.obj") == paths("memory://scans")
    assert paths("memory://scans/*/*.obj") == ["/a/0.obj"]
    assert paths("memory://scans/*.obj") == ["/2.obj"]
    assert paths("memory://scans/[ab]") == ["/a/0.obj", "/a/b/1.obj"]
    assert paths("memory://scans/*.txt") == ["/notes.txt"]
    assert paths("memory://scans/notes.txt") == ["/notes.txt"]
    assert paths("memory://scans", include=["a"], exclude=["b"]) == ["/a/0.obj"]
    assert paths("memory://scans", "memory://scans/a/0.obj") == [
        *paths("memory://scans"),
        "/a/0.obj",
    ]
    with pytest.raises(NothingMatched):
        discover_inputs(["memory://scans/*.stl"])


@pytest.mark.parametrize(
    "url", ["memory://none", "memory://none.obj", "memory://", "memory:///*.obj", "nosuch://b/x"]
)
def test_what_is_not_there_is_refused(url):
    with pytest.raises(UsageError):
        discover_inputs([url])
    # Its store does not answer, so the run says why it cannot be read.
    assert paths("http://127.0.0.1:9/scans/a.ply") == ["/a.ply"]


@pytest.mark.parametrize("name", ["scans/", "*.ply"])
def test_a_store_that_does_not_answer_is_one_failure(tmp_path, name):
    scan, url = tmp_path / "a.ply", f"http://127.0.0.1:9/{name}"
    scan.write_bytes(closed_scan())
    made = msal("denoise", scan, url, "-o", tmp_path / "out")
    assert made.exit_code == 3 and (tmp_path / "out/a.ply").exists()
    assert re.search("failed: 1\n  http://127.0.0.1:9.*E_READ", made.stderr)
    assert msal("denoise", url, "http://127.0.0.1:9/b", "-o", tmp_path / "out").exit_code == 2


def test_the_output_below_the_input_is_no_input(scans):
    denoised(output="memory://scans/out")
    assert len(denoised(output="memory://scans/out")) == 3
    assert sorted(outputs("memory://scans/out")) == sorted(NAMES)


# What goes where


def test_an_input_is_never_replaced(scans):
    for output in ("memory://scans", "memory:///scans/"):
        with pytest.raises(UsageError, match="own output"):
            denoised(output=output)
    with pytest.raises(UsageError, match="in-place"):
        build_plan(discover_inputs(["memory://scans"]), None, in_place=True)


def test_objects_of_others_are_not_replaced_without_force(scans):
    write_whole("memory://out/2.obj", b"precious")
    with pytest.raises(UsageError, match="no run of msal denoise put it there"):
        denoised()
    assert read_whole("memory://out/2.obj") == b"precious"
    assert set(states(denoised(force=True)).values()) == {"written"}


def test_odd_names_leave_neither_the_prefix_nor_the_folder(tmp_path):
    plain = ["c d%41#?ü.obj", "e\nf.obj", "[x]*.obj", "q'\".obj"]
    for name in ("../up.obj", "a//b.obj", "a/../../../up.obj", "./g.obj", *plain):
        write_whole(f"memory://scans/{name}", obj(1).encode())
    expected = [
        "%2E%2E/up.obj",
        "a/%2F/b.obj",
        "a/%2E%2E/%2E%2E/%2E%2E/up.obj",
        "%2E/g.obj",
        *plain,
    ]
    assert {record.status for record in denoised()} == {"written"}
    assert sorted(outputs()) == sorted(expected)
    folder = tmp_path / "deep/out"
    assert {record.status for record in denoised(output=str(folder))} == {"written"}
    assert sorted(tree(tmp_path)) == sorted(f"deep/out/{name}" for name in expected)
    assert {record.status for record in denoised(output=str(folder))} == {"up-to-date"}


# What comes out


def test_from_folder_to_store_and_back(scans, tmp_path):
    assert states(denoised(output=str(tmp_path / "out"))) == dict.fromkeys(NAMES, "written")
    here = {name: (tmp_path / "out" / name).read_bytes() for name in NAMES}
    assert here == expected()
    assert states(denoised(output=str(tmp_path / "out"))) == dict.fromkeys(NAMES, "up-to-date")
    for name in NAMES:
        (tmp_path / "scans" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "scans" / name).write_bytes(read_whole(f"memory://scans/{name}"))
    assert states(denoised(str(tmp_path / "scans"))) == dict.fromkeys(NAMES, "written")
    assert outputs() == here
    assert states(denoised(str(tmp_path / "scans"))) == dict.fromkeys(NAMES, "up-to-date")
    (tmp_path / "scans/2.obj").write_text(obj(9))
    again = states(denoised(str(tmp_path / "scans")))
    assert again == dict.fromkeys(NAMES, "up-to-date") | {"2.obj": "written"}


# What is up to date


def test_a_rerun_reads_no_object(scans, monkeypatch):
    denoised()
    reads = []
    real = remote.read_whole
    monkeypatch.setattr(
        remote, "read_whole", lambda url, *size: reads.append(url) or real(url, *size)
    )
    assert states(denoised()) == dict.fromkeys(NAMES, "up-to-date")
    assert all(PARTS_FOLDER in url for url in reads)


def test_what_changed_is_done_again_and_nothing_else(scans):
    current = dict.fromkeys(NAMES, "up-to-date")
    denoised()
    write_whole("memory://scans/2.obj", obj(9).encode())
    assert states(denoised()) == current | {"2.obj": "written"}
    write_whole("memory://out/a/0.obj", b"x" * len(read_whole("memory://out/a/0.obj")))
    assert states(denoised()) == current | {"a/0.obj": "written"}
    remote.remove_objects(["memory://out/a/b/1.obj"])
    assert states(denoised()) == current | {"a/b/1.obj": "written"}
    assert states(denoised()) == current
    assert states(denoised(given={"iterations": 2})) == dict.fromkeys(NAMES, "written")
    assert states(denoised(fresh=True)) == dict.fromkeys(NAMES, "written")


def test_an_object_that_changes_while_it_is_read_is_done_again(scans, monkeypatch):
    plan = build_plan(discover_inputs(["memory://scans"]), "memory://out")
    write_whole("memory://scans/2.obj", obj(9).encode())
    run(plan, settings())
    assert states(denoised()) == dict.fromkeys(NAMES, "up-to-date") | {"2.obj": "written"}


def test_a_killed_run_leaves_whole_objects_and_the_next_does_the_rest(scans, monkeypatch):
    real = remote.write_whole

    def kill(url, *given, **more):
        if url == "memory://out/a/b/1.obj":
            raise KeyboardInterrupt
        return real(url, *given, **more)

    monkeypatch.setattr(remote, "write_whole", kill)
    with pytest.raises(KeyboardInterrupt):
        plan = build_plan(discover_inputs(["memory://scans"]), "memory://out")
        run(plan, settings(), engine=InProcess)
    monkeypatch.undo()
    there = outputs()
    assert there and there.items() < expected().items()
    assert set(states(denoised()).values()) == {"written", "up-to-date"}
    assert outputs() == expected()


# The manifest


def line(name, status="written"):
    record = MeshRecord(input=f"memory://scans/{name}", status=status, input_sha256="1" * 64)
    return done_line(name, "settings", record, record.input)


def write(*batches, shard=None):
    """Open a manifest, append these batches of lines, and close it."""
    manifest = ObjectManifest("memory://out", shard)
    manifest.open()
    for lines in batches:
        manifest.append(lines)
    for _ in range(2):
        manifest.close()


INTENT = intent_line("a", "memory://scans/a")


def parts():
    return sorted(list_objects(f"memory://out/{PARTS_FOLDER}"))


def test_many_parts_become_one_and_no_line_is_lost(monkeypatch):
    monkeypatch.setattr(manifests, "MAX_PARTS", 3)
    for n in range(4):
        write([intent_line(f"{n}", "memory://scans/a")], [line(f"{n}", "failed")], [line(f"{n}")])
    entries = ObjectManifest("memory://out")
    assert len(parts()) < 12
    assert read_names("memory://out") == {"0", "1", "2", "3"}
    assert {entries.get(str(n)).status for n in range(4)} == {"written"}


def test_of_many_shards_one_merges(monkeypatch):
    monkeypatch.setattr(manifests, "MAX_PARTS", 0)
    write([INTENT])
    before = parts()
    for number in (2, 3):
        write(shard=Shard(number, 3))
    assert parts() == before
    write(shard=Shard(1, 3))
    assert len(parts()) == 1
    assert parts() != before
    assert read_names("memory://out") == {"a"}


@pytest.mark.parametrize("killed", ["before", "between"])
def test_a_merge_that_is_killed_loses_nothing(monkeypatch, killed):
    write(*([intent_line(f"{n}", "memory://scans/a")] for n in range(5)))
    monkeypatch.setattr(manifests, "MAX_PARTS", 3)

    def kill(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(remote, "write_whole" if killed == "before" else "remove_objects", kill)
    with pytest.raises(KeyboardInterrupt):
        ObjectManifest("memory://out").open()
    monkeypatch.undo()
    assert read_names("memory://out") == set("01234")


def test_a_part_that_another_run_merges_meanwhile_is_found_again(monkeypatch):
    write([INTENT])
    real, calls = remote.read_many, []

    def late(some):
        calls.append(some)
        if len(calls) == 1:
            raise InputError("there is no such object")
        return real(some)

    monkeypatch.setattr(remote, "read_many", late)
    assert read_names("memory://out") == {"a"}
    assert len(calls) == 2


@pytest.mark.parametrize(
    ("place", "is_output"),
    [
        ("memory://joe:geheim@b/x", True),
        ("memory://joe:geheim@b/x.ply", True),
        ("memory://joe:geheim@b/x.ply", False),
        ("http://127.0.0.1:9/x.ply?signature=geheim", False),
        ("nosuch://joe:geheim@b/x.ply", False),
    ],
)
def test_no_secret_is_shown(tmp_path, place, is_output):
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans/a.ply").write_bytes(closed_scan())
    pair = (tmp_path / "scans/a.ply", place) if is_output else (place, tmp_path / "out")
    made = msal("denoise", pair[0], "-o", pair[1], "-vv", "--report", tmp_path / "r.json")
    assert made.exit_code == 2
    everything = [made.stdout, made.stderr]
    everything += [path.read_text() for path in tmp_path.rglob("*.json*")]
    assert not any("geheim" in text for text in everything)
    assert "Traceback" not in made.stderr


def test_reports_may_go_to_a_store_and_pipes_come_from_one_and_go_there():
    write_whole("memory://p/a.ply", closed_scan())
    report = "memory://reports/r.json"
    made = msal("denoise", "memory://p/a.ply", "-o", "memory://o/", "--report", report)
    assert made.exit_code == 0 and b'"written"' in read_whole(report)
    made = msal("denoise", "memory://p/a.ply", "-o", "-")
    assert (made.exit_code, made.stdout_bytes[:3]) == (0, b"ply")
    assert msal_on(closed_scan(), "denoise", "-", "-o", "memory://p/b.ply").exit_code == 0
    assert read_whole("memory://p/b.ply") == made.stdout_bytes
