"""Two runs on one folder: the second is refused, the dead hold nothing; and shards."""

import hashlib
import os
import socket
import subprocess
import sys
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.batch import lock
from msal_cli.batch.inputs import DiscoveredInput
from msal_cli.batch.lock import MAX_SHARDS, NAME, FolderLock, Shard, lock_owners, parse_shard
from msal_cli.batch.plan import build_plan
from msal_cli.errors import OutputError, UsageError

HOLD = (
    "import sys; from msal_cli.batch.lock import FolderLock, Shard; "
    "numbers = [int(n) for n in sys.argv[2:]]; "
    "one = FolderLock(sys.argv[1], Shard(*numbers) if numbers else None); "
    "print('locked', flush=True); sys.stdin.read()"
)


@contextmanager
def locked_elsewhere(folder, *shard):
    """Another process that has locked a folder, killed at the end."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder), *map(str, shard)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "locked\n"
        yield process
        process.kill()


def unsupported(handle, **how):
    raise OSError(38, "Function not implemented")


def test_a_file_that_its_last_owner_removes_meanwhile_locks_nothing(tmp_path, monkeypatch):
    real, removed = lock._flock, []

    def flock(handle, **how):
        if not removed:
            removed.append((tmp_path / NAME).unlink())
        return real(handle, **how)

    monkeypatch.setattr(lock, "_flock", flock)
    with FolderLock(str(tmp_path)), pytest.raises(UsageError, match="already working"):
        FolderLock(str(tmp_path))


@pytest.mark.parametrize("text", ["", "x", "2147480000 HOST", "-1 HOST", "1 other-machine"])
def test_without_locks_only_the_word_of_the_living_counts(tmp_path, text, monkeypatch, caplog):
    monkeypatch.setattr(lock, "_flock", unsupported)
    (tmp_path / NAME).write_text(text.replace("HOST", socket.gethostname()))
    FolderLock(str(tmp_path)).release()
    assert "cannot be locked" in caplog.text


def test_a_folder_that_cannot_be_written_is_an_output_error(tmp_path):
    with pytest.raises(OutputError):
        FolderLock(str(tmp_path / "missing"))


@pytest.mark.skipif(not hasattr(os, "O_NOFOLLOW"), reason="needs O_NOFOLLOW")
def test_a_link_in_the_place_of_the_lock_does_not_harm_its_target(tmp_path):
    (tmp_path / "precious").write_text("keep")
    (tmp_path / NAME).symlink_to("precious")
    with pytest.raises(OutputError):
        FolderLock(str(tmp_path))
    assert (tmp_path / "precious").read_text() == "keep"


def locks_in(folder):
    return sorted(path.name for path in folder.iterdir())


class TestShards:
    """Shards of one N share a folder; nobody else works there meanwhile."""

    @pytest.fixture(params=[True, False], ids=["locks", "no locks"], autouse=True)
    def system(self, request, monkeypatch):
        # Here nobody comes and goes meanwhile.
        monkeypatch.setattr(lock, "_PAUSE_S", (0.0, 0.0))
        if not request.param:
            monkeypatch.setattr(lock, "_flock", unsupported)

    def test_shards_of_one_n_work_together(self, tmp_path):
        with FolderLock(str(tmp_path), Shard(1, 3)), FolderLock(str(tmp_path), Shard(3, 3)):
            for _ in range(2):
                FolderLock(str(tmp_path), Shard(2, 3)).release()
        FolderLock(str(tmp_path)).release()
        assert locks_in(tmp_path) == []

    @pytest.mark.parametrize(
        ("first", "second"),
        [
            (None, None),
            (None, Shard(1, 4)),
            (Shard(1, 4), None),
            (Shard(1, 4), Shard(1, 4)),
            (Shard(1, 4), Shard(2, 5)),
        ],
        ids=str,
    )
    def test_others_are_refused_and_told_who_is_there(self, tmp_path, first, second):
        with FolderLock(str(tmp_path), first):
            own = NAME if first is None else f"{NAME}-{first.file_part}"
            for _ in range(2):
                with pytest.raises(UsageError, match=f"process {os.getpid()} ") as caught:
                    FolderLock(str(tmp_path), second)
                assert caught.value.code == "E_LOCKED"
                assert ("(shard 1/" in caught.value.message) == (first is not None)
            assert own in locks_in(tmp_path)
        FolderLock(str(tmp_path), second).release()

    @pytest.mark.parametrize(
        ("first", "second"), [((), None), ((2, 4), Shard(2, 4)), ((1, 3), None)], ids=str
    )
    def test_the_second_is_told_who_is_first_and_the_dead_hold_nothing(
        self, tmp_path, first, second
    ):
        with (
            locked_elsewhere(tmp_path, *first) as holder,
            pytest.raises(UsageError, match=f"process {holder.pid} .*'{tmp_path}'"),
        ):
            FolderLock(str(tmp_path), second)
        assert locks_in(tmp_path)
        one = FolderLock(str(tmp_path), second)
        own = NAME if second is None else f"{NAME}-{second.file_part}"
        assert (tmp_path / own).read_text().split() == [str(os.getpid()), socket.gethostname()]
        for _ in range(2):
            one.release()

    def test_who_works_is_told_without_a_trace(self, tmp_path):
        assert lock_owners(str(tmp_path)) == lock_owners(str(tmp_path / "missing")) == ()
        with FolderLock(str(tmp_path)):
            assert lock_owners(str(tmp_path)) == (f"process {os.getpid()}",)
        with FolderLock(str(tmp_path), Shard(1, 2)), FolderLock(str(tmp_path), Shard(2, 2)):
            before = locks_in(tmp_path)
            owners = [f"process {os.getpid()} (shard {k}/2)" for k in (1, 2)]
            assert list(lock_owners(str(tmp_path))) == owners
            assert locks_in(tmp_path) == before


def test_many_shards_that_start_and_end_at_once_are_not_refused(tmp_path):
    """Also not by the looking of the others, or by the last of them, who clears away."""
    code = (
        "import sys; from msal_cli.batch.lock import FolderLock, Shard\n"
        "for _ in range(200): FolderLock(sys.argv[1], Shard(int(sys.argv[2]), 4)).release()"
    )
    processes = [
        subprocess.Popen([sys.executable, "-c", code, str(tmp_path), str(k)]) for k in range(1, 5)
    ]
    assert [process.wait() for process in processes] == [0] * 4


# Shards: every file is in exactly one of them


NAMES = st.text(st.characters(exclude_categories=["Cs"])) | st.binary().map(os.fsdecode)


@given(st.sets(NAMES, max_size=12), st.integers(1, 40))
def test_shards_partition_any_set_of_names(names, count):
    shards = [Shard(number, count) for number in range(1, count + 1)]
    for name in names:
        assert sum(shard.has(name) for shard in shards) == 1


def test_the_hash_is_the_one_that_is_documented():
    digest = hashlib.sha256(b"a/b.ply").hexdigest()
    assert int(digest[:16], 16) == 0xC932A85DD84CE496
    assert Shard(int(digest[:16], 16) % 7 + 1, 7).has("a/b.ply")


def test_a_part_of_a_plan_keeps_the_order_and_knows_the_whole():
    found = [DiscoveredInput(f"in/{n}.ply", f"{n}.ply", "in") for n in range(40)]
    plan = build_plan(found, "out")
    parts = [plan.select_shard(Shard(number, 3)) for number in (1, 2, 3)]
    assert {task for one in parts for task in one.tasks} == set(plan.tasks)
    assert sum(len(one.tasks) for one in parts) == 40
    for one in parts:
        places = [plan.tasks.index(task) for task in one.tasks]
        assert places == sorted(places)
        assert one.whole is plan and one.folders() == ["out"]


@pytest.mark.parametrize("text", ["1/1", "2/4", "4/4", f"{MAX_SHARDS}/{MAX_SHARDS}"])
def test_a_shard_is_what_it_says(text):
    assert str(parse_shard(text)) == text


@pytest.mark.parametrize(
    "text",
    ["", "0/4", "5/4", "1", "1/", "-1/4", "1/4/2", "1.0/4", " 1/4", "1/9999999", "auto",
     "\u0661/4", "1/" + "9" * 5000],
)  # fmt: skip
def test_what_is_no_shard_is_refused(text):
    with pytest.raises(UsageError):
        parse_shard(text)
