"""Kernels compiled ahead, by processes on the cores that a first run leaves idle.

numba compiles in one thread.  What a run will ask for is known, though: ``needed.json`` lists it
for each kind of file with the default method, and what --auto needs beyond that
(``python -m benchmarks.needed_kernels`` writes it).  So the first listed kernel that the cache does
not have starts a few processes, which compile what else is listed, the longest first, and pass over
what another process has in hand.  What a run has said that it will need (``compiled.expect``) comes
before the kernels for its file, at which it is itself.  They are for the cache alone: they print
nothing, their failures change nothing, and they end with whoever started them.  There is one set of
them for a cache, however many processes begin on it.

``MSAL_COMPILE_AHEAD=0`` in the environment keeps them away.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from msal_cli.core import machine_code
from msal_cli.core.compiled import AUTO
from msal_cli.core.parallel import threads, usable_cores

MOST_HELPERS = 3
"""With more of them the longest kernel bounds the time."""

ROOM_BYTES = 400 << 20
"""Free memory below which nobody helps: numba and one kernel in work take 150 MB."""

_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from msal_cli.core import ahead; ahead.help_on(sys.argv[3:], int(sys.argv[2]))"
)

Wanted = tuple[str, tuple[Any, ...]]
"""A kernel (``module.function``) and the kinds of its arguments (see ``compiled.kind``)."""

_is_begun = threading.Event()


def routes() -> dict[str, list[Wanted]]:
    """What a run needs, by kind of file, and ``AUTO``: each with the longest to compile first."""
    listed = json.loads(Path(__file__).with_name("needed.json").read_text(encoding="utf-8"))
    return {
        route: [
            (name, tuple([one if isinstance(one, str) else tuple(one) for one in kinds]))
            for name, kinds in wanted
        ]
        for route, wanted in listed.items()
    }


def begin(name: str, kinds: tuple[Any, ...], expected: tuple[str, ...] = ()) -> None:
    """Have the rest of a run's kernels compiled, now that it turns out to lack one of them.

    ``expected`` are routes that the run will need beside that of its file.  Only the first call of
    a process does anything; it takes milliseconds and never fails.
    """
    if _is_begun.is_set():
        return
    _is_begun.set()
    count = min(threads(), usable_cores(), MOST_HELPERS + 1) - 1
    if count < 1 or os.environ.get("MSAL_COMPILE_AHEAD") == "0":
        return
    # A process that optimizes has other byte code, and so has other kernels.
    if not sys.executable or sys.flags.optimize or _is_limited() or _free_bytes() < ROOM_BYTES:
        return
    try:
        known = routes().items()
    except (OSError, ValueError):
        return
    of_file = (one for one, wanted in known if one != AUTO and (name, kinds) in wanted)
    wanted_routes = (*expected, *list(of_file)[:1])
    if wanted_routes and machine_code.is_nobody_helping():
        for number in range(count):
            _start(wanted_routes, number)


def _start(wanted_routes: tuple[str, ...], number: int) -> None:
    command = [sys.executable, "-P", "-c", _BOOT, json.dumps(sys.path), str(number)]
    command += wanted_routes
    try:
        helper = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
    except OSError:
        return
    threading.Thread(target=_attend, args=(helper,), name="msal-helper", daemon=True).start()


def _attend(helper: subprocess.Popen[bytes]) -> None:
    """Hold the pipe open until the helper, or this process, ends."""
    helper.wait()
    if helper.stdin is not None:
        helper.stdin.close()


def help_on(wanted_routes: Sequence[str], number: int) -> None:
    """Compile what a run needs and nobody has in hand; what a helper does, and all it does."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # The helper of a helper would be one too many.
    _is_begun.set()
    with machine_code.as_helper(number) as is_needed:
        if not is_needed:
            return
        listed = routes()
        for name, kinds in [one for route in wanted_routes for one in listed[route]]:
            module, _, function = name.partition(".")
            kernel = getattr(importlib.import_module(f"msal_cli.core.{module}"), function)
            try:
                kernel.keep_ahead(kinds)
            except Exception:
                # The run will come upon it, and say so.
                continue


def _end_with_parent() -> None:
    """Nothing is ever sent: the pipe ends when nobody is left to hold its other end."""
    os.read(0, 1)
    # A file half written would stay under its other name.
    with machine_code.WRITING:
        os._exit(0)


def _is_limited() -> bool:
    """Whether this process may not take all the memory it likes; then helpers shall not either."""
    try:
        import resource
    except ImportError:
        return False
    limits = (resource.RLIMIT_DATA, resource.RLIMIT_AS)
    return any(resource.getrlimit(one)[0] != resource.RLIM_INFINITY for one in limits)


def _free_bytes(root: Path = Path("/")) -> float:
    """Memory that the machine and the container have left; infinity where nobody tells."""
    free = [float("inf")]
    try:
        told = (root / "proc/meminfo").read_text().partition("MemAvailable:")[2].split()
        free.append(1024 * int(told[0]))
    except (OSError, ValueError, IndexError):
        pass
    for most, used in (
        ("memory.max", "memory.current"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),
    ):
        try:
            group = root / "sys/fs/cgroup"
            free.append(int((group / most).read_text()) - int((group / used).read_text()))
        except (OSError, ValueError):
            continue
    return min(free)
