"""What the machine and its control groups leave, and what other systems do differently."""

import os
import signal
import sys
from pathlib import Path

import pytest

from msal_cli import machine
from msal_cli.batch import interrupts
from msal_cli.errors import OutputError
from msal_cli.kernels import parallel
from msal_cli.storage import atomic, urls
from tests.files import run_python

MEMINFO = "MemTotal: 100 kB\nMemFree: 10 kB\nMemAvailable:    50 kB\n"
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
affinity = pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="needs affinity")


@pytest.fixture
def lay_out(monkeypatch):
    """Puts folders in the place of /proc and /sys/fs/cgroup; ``files`` are those of the groups."""

    def lay(folder, membership="", files=None, **proc):
        texts = {"proc/self/cgroup": membership}
        texts |= {f"proc/{name}": text for name, text in proc.items()}
        texts |= {f"groups/{name}": text for name, text in (files or {}).items()}
        for name, text in texts.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, errors="surrogateescape")
        monkeypatch.setattr(machine, "PROC", folder / "proc")
        monkeypatch.setattr(machine, "GROUPS", folder / "groups")
        machine._quota.cache_clear()

    yield lay
    machine._quota.cache_clear()


FIRST = {
    "memory/x/memory.limit_in_bytes": "9000\n",
    "memory/x/memory.usage_in_bytes": "8000\n",
    "memory/x/memory.stat": "inactive_file 1\ntotal_inactive_file 500\n",
    "memory/memory.limit_in_bytes": "9223372036854771712\n",
    "memory/memory.usage_in_bytes": "8000\n",
    "cpu/x/memory.max": "1\n",
}
STAT = "anon 1\ninactive_file 4000\nactive_file 700\n"


@pytest.mark.parametrize(
    ("membership", "meminfo", "files", "expected"),
    [
        ("", MEMINFO, {}, 50 * 1024),
        # What is used and not cached is taken off the limit.
        ("0::/a\n", MEMINFO, {"a/memory.max": "30000\n", "a/memory.current": "25000\n"}
         | {"a/memory.stat": STAT}, 9000),
        # The tightest of nested groups counts.
        ("0::/a/b\n", MEMINFO, {"a/b/memory.max": "max\n", "a/b/memory.current": "5\n"}
         | {"a/memory.max": "2000\n", "a/memory.current": "500\n"}, 1500),
        ("4:memory:/x\n3:cpu:/x\n", MEMINFO, FIRST, 1500),
        # Never less than nothing, nor more than the limit.
        ("0::/\n", "", {"memory.max": "30000", "memory.current": "40000"}
         | {"memory.stat": "inactive_file 5000\n"}, 0),
        ("0::/\n", "", {"memory.max": "30000", "memory.current": "0"}
         | {"memory.stat": "inactive_file 5000\n"}, 30000),
        *(("0::/a\n\n:\n", text, {}, None)
          for text in ("", "x", "MemAvailable:", "MemAvailable: x kB", "\udcff")),
    ],
)  # fmt: skip
def test_available_bytes(tmp_path, lay_out, membership, meminfo, files, expected):
    lay_out(tmp_path, membership, files, meminfo=meminfo)
    assert machine.available_bytes() == expected


@linux
def test_this_machine_and_one_without_such_files(tmp_path, lay_out):
    assert 0 < machine.available_bytes() < 1 << 50
    lay_out(tmp_path)
    assert machine.available_bytes() is None


CFS = {
    "cpu,cpuacct/x/cpu.cfs_quota_us": "300000\n",
    "cpu,cpuacct/x/cpu.cfs_period_us": "100000\n",
    "memory/x/cpu.max": "1 100000",
}


@affinity
@pytest.mark.parametrize(
    ("membership", "files", "expected"),
    [
        ("0::/a/b\n", {"a/b/cpu.max": "150000 100000\n", "a/cpu.max": "max 100000\n"}, 2),
        ("0::/a/b\n", {"a/b/cpu.max": "400000 100000\n", "a/cpu.max": "200000 100000\n"}, 2),
        # A container sees its own group at the top.
        ("0::/docker/0123\n", {"cpu.max": "50000 100000"}, 1),
        ("0::/\n", {"cpu.max": "6400000 100000"}, 8),
        ("4:memory:/x\n3:cpu,cpuacct:/x\n", CFS, 3),
        *(("0::/\n", {"cpu.max": text}, 8)
          for text in ("max 100000", "", "x y", "-1 100000", "100000 0", "1")),
        ("nonsense\n\n::\n", {}, 8),
    ],
)  # fmt: skip
def test_the_smaller_of_affinity_and_quota_counts(
    tmp_path, monkeypatch, lay_out, membership, files, expected
):
    lay_out(tmp_path, membership, files)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)))
    monkeypatch.delenv("MSAL_THREADS", raising=False)
    assert machine.usable_cores() == parallel.threads() == expected


@linux
def test_a_peak_is_forgotten():
    block = bytearray(b"x") * 80_000_000
    before = machine.peak_bytes()
    del block
    machine.forget_peak()
    assert machine.peak_bytes() < before - 50_000_000


# What Windows and macOS do differently, simulated here: a module gets another ``os``


class OtherOs:
    """``os`` of another system: of another name, or without some of its functions."""

    def __init__(self, *missing, **changed):
        self._missing = missing
        self.__dict__.update(changed)

    def __getattr__(self, name):
        if name in self._missing:
            raise AttributeError(name)
        return getattr(os, name)


@pytest.fixture
def windows(monkeypatch):
    """Have a module take the system for Windows."""

    def change(module, *missing, **changed):
        monkeypatch.setattr(module, "os", OtherOs(*missing, name="nt", **changed))

    return change


@pytest.mark.parametrize(("refusals", "is_written"), [(0, True), (3, True), (4, False)])
def test_a_file_that_is_open_elsewhere_is_replaced_a_little_later(
    tmp_path, windows, monkeypatch, refusals, is_written
):
    windows(atomic)
    waits, left = [], [refusals]
    monkeypatch.setattr(atomic.time, "sleep", waits.append)
    replace = Path.replace

    def refuse(self, target):
        if left[0]:
            left[0] -= 1
            raise PermissionError(13, "Access is denied")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", refuse)
    path = tmp_path / "a.ply"
    path.write_bytes(b"old")
    if is_written:
        atomic.write_whole(path, b"new")
    else:
        with pytest.raises(OutputError, match="Access is denied") as caught:
            atomic.write_whole(path, b"new")
        assert "permissions" in caught.value.hint
    assert path.read_bytes() == (b"new" if is_written else b"old")
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]
    assert len(waits) == min(refusals, 3)


def test_a_new_file_is_renamed_where_that_does_not_replace(tmp_path, windows, monkeypatch):
    windows(atomic, "link")
    rename = Path.rename

    def rename_as_on_windows(self, target):
        if target.exists():
            raise FileExistsError(17, "Cannot create a file when that file already exists")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", rename_as_on_windows)
    assert atomic.write_new(tmp_path / "a.ply", b"one")
    assert not atomic.write_new(tmp_path / "a.ply", b"two")
    assert (tmp_path / "a.ply").read_bytes() == b"one"
    assert len(os.listdir(tmp_path)) == 1


@pytest.mark.parametrize(
    ("name", "there"),
    [("CON.ply", "%43ON.ply"), ("con", "%63on"), ("scans/aux.scan.ply", "scans/%61ux.scan.ply")]
    + [("com1.ply", "%63om1.ply"), ("com1 .ply", "%63om1 .ply"), ("concert.ply", "concert.ply")]
    + [("com10.ply", "com10.ply"), ("a./b.ply", "a%2E/b.ply"), ("a /b.ply ", "a%20/b.ply%20")]
    + [("..\\x/c:y", "..%5Cx/c%3Ay"), ("a\nb?.ply", "a%0Ab%3F.ply")],
)
def test_an_object_of_any_name_becomes_a_file_of_windows(name, there, windows):
    assert urls.escape_name(name, is_local=True) == name
    windows(urls)
    assert urls.escape_name(name, is_local=True) == there
    assert urls.escape_name(name, is_local=False) == name


def test_a_drive_is_no_protocol(windows):
    assert not urls.is_url("C:\\scans\\a.ply")
    assert not urls.is_url("C:/scans/a.ply")
    windows(urls)
    assert urls.normalize_url("file:///C:/scans/a.ply") == "C:/scans/a.ply"


@pytest.mark.skipif(os.name != "posix", reason="it is what Windows does")
def test_a_run_in_this_process_ends_late_without_set_blocking(windows):
    def pipe():
        listening, telling = os.pipe()
        # Linux, unlike Windows, wants it so.
        os.set_blocking(telling, False)
        return listening, telling

    windows(interrupts, "set_blocking", pipe=pipe)
    received = []
    with interrupts.catch_signals(received.append), interrupts.end_if_late(lambda: None):
        signal.raise_signal(signal.SIGTERM)
    assert received == [signal.SIGTERM]


def test_the_program_starts_without_modules_of_posix():
    code = (
        "import sys\n"
        "sys.modules.update(dict.fromkeys(('fcntl', 'resource', 'pwd', 'grp', 'termios')))\n"
        "import msal_cli.cli.denoise, msal_cli.cli.watch, msal_cli.batch.run\n"
        "import msal_cli.batch.lock, msal_cli.batch.workers, msal_cli.job.pipeline"
    )
    run_python(code)


def test_ctrl_break_ends_a_run_like_other_signals(monkeypatch):
    # SIGBREAK is 21 on Windows; here another number plays its part.
    number = int(getattr(signal, "SIGUSR1", signal.SIGTERM))
    monkeypatch.setattr(signal, "SIGBREAK", number, raising=False)
    received = []
    with interrupts.catch_signals(received.append):
        signal.raise_signal(number)
    assert received == [number]
    with pytest.raises(interrupts.Terminated) as caught:
        interrupts.raise_for(number)
    assert caught.value.exit_status == 128 + number
