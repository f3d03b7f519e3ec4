"""Cores and memory: what this process may use, within its control groups, and has used."""

import contextlib
import contextvars
import errno
import functools
import os
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

Value = TypeVar("Value")

PROC, GROUPS = Path("/proc"), Path("/sys/fs/cgroup")


def _group_folders(controller: str) -> Iterator[Path]:
    """The folders of this process's control groups (version 1 or 2) for ``controller``, which is
    ``"cpu"`` or ``"memory"``, innermost first."""
    try:
        lines = (PROC / "self/cgroup").read_text(errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = (line.split(":", 2) + ["", ""])[:3]
        base = GROUPS / controllers
        if controllers and controller not in controllers.split(","):
            continue
        inner = base / path.lstrip("/")
        # In a container the path is often the host's, while its own group is mounted at the root.
        for folder in [inner, *inner.parents]:
            if not folder.is_relative_to(base):
                break
            yield folder


def usable_cores() -> int:
    """Cores that affinity and the CPU quotas of control groups allow, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    quota = _quota()
    # Rounded up: two workers make better use of a quota of 1.5 cores than one.
    return max(1, cores if quota is None else min(cores, -(-quota // 1000)))


def in_background(task: Callable[[], Value]) -> Callable[[], Value]:
    """Start ``task`` in a thread of its own.  The function returned waits for its end, and returns
    its result or raises its exception.

    If no thread can be started, the task runs before this returns.
    """
    future: Future[Value] = Future()

    def run() -> None:
        try:
            future.set_result(task())
        except BaseException as failure:
            future.set_exception(failure)

    # numpy's memory handler is a context variable, and threads do not inherit the context.
    thread = threading.Thread(target=contextvars.copy_context().run, args=(run,), daemon=True)
    try:
        thread.start()
    except RuntimeError:
        run()
    return future.result


# Cached because each large kernel asks; quotas rarely change while a process runs.
@functools.cache
def _quota() -> int | None:
    """The smallest CPU quota of this process's control groups, in thousandths of a core."""
    quotas = map(_quota_of, _group_folders("cpu"))
    return min((quota for quota in quotas if quota is not None), default=None)


def _quota_of(folder: Path) -> int | None:
    try:
        if (folder / "cpu.max").exists():
            quota, period = (folder / "cpu.max").read_text().split()
        else:
            quota = (folder / "cpu.cfs_quota_us").read_text()
            period = (folder / "cpu.cfs_period_us").read_text()
        microseconds, per = int(quota), int(period)
    except (OSError, ValueError):
        return None
    return 1000 * microseconds // per if microseconds > 0 and per > 0 else None


def available_bytes() -> int | None:
    """Memory that can be allocated without swapping or an out-of-memory kill; None if unknown.

    This is the minimum of what is available in the machine and in each control group.  Cached files
    count as available, because the system drops them when memory is needed.
    """
    kilobytes = _entry(PROC / "meminfo", "MemAvailable:")
    limits = [None if kilobytes is None else 1024 * kilobytes]
    limits += map(_available_in_group, _group_folders("memory"))
    return min((limit for limit in limits if limit is not None), default=None)


def _available_in_group(folder: Path) -> int | None:
    for maximum, used, cached in (
        ("memory.max", "memory.current", "inactive_file"),
        ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ):
        limit, usage = _number(folder / maximum), _number(folder / used)
        if limit is not None and usage is not None:
            free = limit - usage + (_entry(folder / "memory.stat", cached) or 0)
            return max(0, min(limit, free))
    return None


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        # "max" means that there is no limit.
        return None


def _entry(path: Path, name: str) -> int | None:
    """The number that follows ``name`` on a line of a file; None if there is none."""
    try:
        lines = path.read_text(errors="replace").splitlines()
    except OSError:
        return None
    for line in lines:
        words = line.split()
        if len(words) >= 2 and words[0] == name and words[1].isdigit():
            return int(words[1])
    return None


def peak_bytes() -> int | None:
    """The peak resident set size of this process; None if unknown."""
    if sys.platform == "win32":
        return _peak_on_windows()
    # On Linux the value of getrusage may be the peak of the process that started this one.
    peak = memory_bytes("VmHWM")
    if peak:
        return peak
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def forget_peak() -> None:
    """Reset ``peak_bytes`` to the current resident set size; works on Linux only."""
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as file:
        file.write("5")


def memory_bytes(name: str) -> int:
    """A field of ``/proc/self/status`` such as ``VmRSS``, in bytes; 0 if unknown."""
    return 1024 * (_entry(PROC / "self/status", f"{name}:") or 0)


def _peak_on_windows() -> int | None:
    import ctypes

    class Counters(ctypes.Structure):
        _fields_ = (
            ("size", ctypes.c_ulong),
            ("page_faults", ctypes.c_ulong),
            *((f"field_{n}", ctypes.c_size_t) for n in range(8)),
        )

    counters = Counters()
    counters.size = ctypes.sizeof(Counters)
    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
    kernel.GetCurrentProcess.restype = ctypes.c_void_p
    get_info = kernel.K32GetProcessMemoryInfo
    get_info.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_ulong)
    if not get_info(kernel.GetCurrentProcess(), ctypes.byref(counters), counters.size):
        return None
    # PeakWorkingSetSize is the first of the eight fields.
    return int(counters.field_0)


def is_out_of_memory(error: BaseException | None) -> bool:
    """Whether an error, or one of its causes, is a failed allocation of memory."""
    while error is not None:
        message = str(error)
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if isinstance(error, ImportError) and "allocate memory" in message:
            return True
        if isinstance(error, RuntimeError) and "can't start new thread" in message:
            return True
        error = error.__cause__
    return False


def megabytes(n_bytes: int, *, rounded_up: bool = True) -> str:
    """A size as text, ``499 MB`` or ``3.21 GB``.

    Round a requirement up and a limit down, so that what exceeds the limit looks larger than it.
    """
    unit, digits = (10**6, 0) if n_bytes <= 999 * 10**6 else (10**9, 2)
    step = unit // 10**digits
    steps = -(-n_bytes // step) if rounded_up else n_bytes // step
    return f"{steps} MB" if unit == 10**6 else f"{steps / 100:.2f} GB"


# Other processes


def is_alive(pid: int) -> bool:
    """Whether a process with this id runs on this machine.

    Zombies do not count: where process 1 of a container does not reap them, they stay for ever.
    """
    if pid <= 0:
        return False
    if sys.platform == "win32":
        return _is_alive_on_windows(pid)
    with contextlib.suppress(OSError, IndexError):
        status = Path(f"/proc/{pid}/stat").read_text(errors="replace")
        return status.rpartition(")")[2].split()[0] not in "ZX"
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def _is_alive_on_windows(pid: int) -> bool:
    # os.kill with any signal would end the process on Windows.
    import ctypes

    query_limited_information, still_active = 0x1000, 259
    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
    handle = kernel.OpenProcess(query_limited_information, False, pid)
    if not handle:
        return False
    code = ctypes.c_ulong()
    is_known = kernel.GetExitCodeProcess(handle, ctypes.byref(code))
    kernel.CloseHandle(handle)
    return bool(is_known) and code.value == still_active


def iso_timestamp(time_ns: int) -> str:
    """A time in nanoseconds since 1970 as ISO 8601 text in UTC, to the millisecond."""
    try:
        when = datetime.fromtimestamp(time_ns / 1e9, UTC)
    except (OverflowError, ValueError, OSError):
        when = datetime.fromtimestamp(0, UTC)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")
