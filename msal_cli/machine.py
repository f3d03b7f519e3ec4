"""What this process may use and has used: cores, memory, and the control groups that limit both."""

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
    """The folders of the groups that ``controller`` (``"cpu"``, ``"memory"``) holds this process
    to, innermost first; both versions of control groups, and nothing where there are none."""
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
        # A container often sees its own group at the top although the host's path is given.
        for folder in [inner, *inner.parents]:
            if not folder.is_relative_to(base):
                break
            yield folder


def usable_cores() -> int:
    """Cores by affinity and by the quota of the control group (containers), at least 1."""
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    quota = _quota()
    # A quota of 1.5 cores is used up better by two workers than by one.
    return max(1, cores if quota is None else min(cores, -(-quota // 1000)))


def in_background(task: Callable[[], Value]) -> Callable[[], Value]:
    """Begin ``task`` in a thread of its own; call what is returned for its result, or exception.

    Where the system gives no more threads the task runs at once.
    """
    future: Future[Value] = Future()

    def run() -> None:
        try:
            future.set_result(task())
        except BaseException as failure:
            future.set_exception(failure)

    # Where numpy keeps arrays is a matter of the context, which threads do not inherit.
    thread = threading.Thread(target=contextvars.copy_context().run, args=(run,), daemon=True)
    try:
        thread.start()
    except RuntimeError:
        run()
    return future.result


# Every large kernel needs it, and a quota is not changed while a process runs.
@functools.cache
def _quota() -> int | None:
    """The tightest quota of this process's control groups in thousandths of a core, if any."""
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
    """Memory that may be taken without anything being killed or swapped; None if it is not known.

    The least of what the machine has left and what every control group leaves.  Cached files
    count as free: the system drops them when memory is needed.
    """
    kilobytes = _entry(PROC / "meminfo", "MemAvailable:")
    limits = [None if kilobytes is None else 1024 * kilobytes]
    limits += map(_of_group, _group_folders("memory"))
    return min((limit for limit in limits if limit is not None), default=None)


def _of_group(folder: Path) -> int | None:
    for most, used, cached in (
        ("memory.max", "memory.current", "inactive_file"),
        ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ):
        limit, usage = _number(folder / most), _number(folder / used)
        if limit is not None and usage is not None:
            free = limit - usage + (_entry(folder / "memory.stat", cached) or 0)
            return max(0, min(limit, free))
    return None


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        # "max" is no limit.
        return None


def _entry(path: Path, name: str) -> int | None:
    """The number behind ``name`` in a file of names and numbers."""
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
    """The largest resident size of this process so far; None where it is not known."""
    if sys.platform == "win32":
        return _peak_on_windows()
    # What getrusage gives on Linux counts the process that started this one, too.
    peak = memory_bytes("VmHWM")
    if peak:
        return peak
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def forget_peak() -> None:
    """Have ``peak_bytes`` begin again with what there is now; only on Linux."""
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as file:
        file.write("5")


def memory_bytes(name: str) -> int:
    """A figure of ``/proc/self/status`` such as ``VmRSS``; 0 where it is not known."""
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
    ask = kernel.K32GetProcessMemoryInfo
    ask.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_ulong)
    if not ask(kernel.GetCurrentProcess(), ctypes.byref(counters), counters.size):
        return None
    # The first of the eight is the peak of the working set.
    return int(counters.field_0)


def is_out_of_memory(error: BaseException | None) -> bool:
    """Whether an error, or what it was raised from, comes of memory that was not given."""
    while error is not None:
        said = str(error)
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if isinstance(error, ImportError) and "allocate memory" in said:
            return True
        if isinstance(error, RuntimeError) and "can't start new thread" in said:
            return True
        error = error.__cause__
    return False


def megabytes(n_bytes: int, *, rounded_up: bool = True) -> str:
    """``499 MB`` or ``3.21 GB``, rounded so that what is refused never looks as if it fitted."""
    unit, digits = (10**6, 0) if n_bytes <= 999 * 10**6 else (10**9, 2)
    step = unit // 10**digits
    steps = -(-n_bytes // step) if rounded_up else n_bytes // step
    return f"{steps} MB" if unit == 10**6 else f"{steps / 100:.2f} GB"


# Other processes


def is_alive(pid: int) -> bool:
    """Whether a process of this machine has this id, be it ours or not.

    One that has ended and waits for its parent to ask how does not count: where the first process
    of a container never asks, it would wait for ever.
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
    # os.kill would end the process there, whatever the signal.
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
    """A time in nanoseconds since 1970 in UTC, ISO 8601, to the millisecond."""
    try:
        when = datetime.fromtimestamp(time_ns / 1e9, UTC)
    except (OverflowError, ValueError, OSError):
        when = datetime.fromtimestamp(0, UTC)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")
