"""What can be asked about a process from outside, on every system."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path


def is_alive(pid: int) -> bool:
    """Whether a process of this machine has this id, be it ours or not.

    One that has ended and waits for its parent to ask how does not count: where the first process
    of a container never asks, it would wait for ever.
    """
    if pid <= 0:
        return False
    if sys.platform == "win32":
        return _is_alive_on_windows(pid)
    if (fields := _linux_status(pid)) is not None:
        return fields[0] not in "ZX"
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def start_time(pid: int) -> float | None:
    """When a process began, in seconds as of ``time.time``; None where that is not known."""
    fields = _linux_status(pid)
    if fields is None or len(fields) < 20:
        return None
    try:
        ran_s = time.clock_gettime(time.CLOCK_BOOTTIME) - int(fields[19]) / os.sysconf("SC_CLK_TCK")
    except (AttributeError, OSError, ValueError):
        return None
    return time.time() - ran_s


def _linux_status(pid: int) -> list[str] | None:
    """The fields of ``/proc/PID/stat`` from the state on; None if there are none."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(errors="replace")
    except OSError:
        return None
    return text.rpartition(")")[2].split() or None


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


def describe_exit(code: int) -> str:
    """How a process ended, in words, from the exit code that ``subprocess`` gives."""
    if code < 0:
        try:
            return f"was killed by {signal.Signals(-code).name}"
        except ValueError:
            return f"was killed by signal {-code}"
    if code >= 0x80000000:
        return f"ended with the exception 0x{code:08X}"
    return f"ended with exit status {code}"


def is_near_memory_limit(pid: int) -> bool:
    """Whether a process on Linux uses nearly all the memory that RLIMIT_DATA grants it."""
    if not sys.platform.startswith("linux"):
        return False
    import resource

    try:
        limit = resource.prlimit(pid, resource.RLIMIT_DATA)[0]
    except (OSError, ValueError):
        return False
    return limit != resource.RLIM_INFINITY and memory_bytes(pid, "VmData") > 0.85 * limit


def memory_bytes(pid: int | str, name: str) -> int:
    """A figure of ``/proc/PID/status`` such as ``VmRSS``; 0 where it is not known."""
    try:
        with open(f"/proc/{pid}/status", "rb") as file:
            for line in file:
                if line.startswith(name.encode() + b":"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    return 0
