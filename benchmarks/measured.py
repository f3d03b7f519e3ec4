"""One command, measured from its fork to its exit, on the cores that it is given.

The measuring is done by a small process of its own, this file run as a script: Linux counts
the memory of the process that forks to the peak of the one that is forked, so that whatever
forks must be smaller than what it measures.
"""

from __future__ import annotations

import json
import os
import sys
import time

# Whatever starts threads in any of the tools.
_THREAD_VARIABLES = (
    "MSAL_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VTK_SMP_MAX_THREADS",
)


class Ran:
    """What one run took.

    seconds : wall-clock time from fork to exit.
    cpu_seconds : processor time of the process and of those that it waited for.
    peak_bytes : resident memory at the peak, of the largest process among these; some 10 MB, what
        the measuring process holds, is the least that can be measured.
    status : exit status; negative, the signal that ended it.
    said : the end of what it wrote on standard error.
    """

    def __init__(self, figures_of_run: dict[str, float], said: str) -> None:
        self.seconds = figures_of_run["seconds"]
        self.cpu_seconds = figures_of_run["cpu_seconds"]
        self.peak_bytes = int(figures_of_run["peak_bytes"])
        self.status = int(figures_of_run["status"])
        self.said = said

    @property
    def fault(self) -> str:
        """Why it failed, in a line; empty if it did not."""
        if not self.status:
            return ""
        lines = self.said.strip().splitlines()
        how = f"signal {-self.status}" if self.status < 0 else f"exit status {self.status}"
        return f"{how}: {lines[-1][:80]}" if lines else how


def run(command: list[str], is_pinned: bool) -> Ran:
    """Run a command, on one core only if ``is_pinned``, and tell what it took."""
    import subprocess

    environment = dict(os.environ)
    # Modules that are compiled anew at every start take a third of a second.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    for name in _THREAD_VARIABLES:
        environment.pop(name, None)
        if is_pinned:
            environment[name] = "1"
    words = [sys.executable, "-I", "-S", __file__, "pinned" if is_pinned else "free", *command]
    ran = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    return Ran(json.loads(ran.stdout), ran.stderr)


def _measure(command: list[str], is_pinned: bool) -> dict[str, float]:
    began = time.perf_counter()
    pid = os.fork()
    if not pid:
        try:
            if is_pinned and hasattr(os, "sched_setaffinity"):
                os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.execvp(command[0], command)
        except OSError as error:
            os.write(2, f"{command[0]}: {error}\n".encode())
        finally:
            os._exit(127)
    _, status, used = os.wait4(pid, 0)
    seconds = time.perf_counter() - began
    unit = 1 if sys.platform == "darwin" else 1024
    return {
        "seconds": seconds,
        "cpu_seconds": used.ru_utime + used.ru_stime,
        "peak_bytes": used.ru_maxrss * unit,
        "status": os.waitstatus_to_exitcode(status),
    }


if __name__ == "__main__":
    print(json.dumps(_measure(sys.argv[2:], sys.argv[1] == "pinned")))
