"""Run as a program of its own: finds the arrays of a MED file (HDF5) and prints where they lie.

The file comes through standard input.  Before it is looked at, the process gives up the right to
open anything: no further file descriptor (which the system holds for the HDF5 library, too), no
file of any size, limited memory and time.  An audit hook refuses what Python itself would open;
it is a second fence, not the first, since C code does not ask it.
"""

from __future__ import annotations

import io
import json
import sys
from typing import Any

_KINDS = {
    "PO1": 1,
    "SE2": 2,
    "TR3": 3,
    "QU4": 4,
    "TE4": 4,
    "PY5": 5,
    "PE6": 6,
    "HE8": 8,
    "SE3": 3,
    "TR6": 6,
    "TR7": 7,
    "QU8": 8,
    "QU9": 9,
    "POG": 0,
    "TE10": 10,
    "HE20": 20,
}
_REFUSED = ("open", "socket.", "subprocess.", "os.", "shutil.", "ctypes.", "import")


class _Unsupported(Exception):  # noqa: N818 - it leaves this process as a word
    """A feature that is not read."""


def _confine(n_bytes: int, seconds: int) -> None:
    """Take away what reading needs no longer."""
    try:
        import resource
    except ImportError:
        pass  # there are no such limits on Windows
    else:
        for limit, value in (
            (resource.RLIMIT_AS, (2 << 30) + 4 * n_bytes),
            (resource.RLIMIT_CPU, seconds),
            (resource.RLIMIT_FSIZE, 0),
            (resource.RLIMIT_CORE, 0),
            (resource.RLIMIT_NOFILE, 0),
        ):
            hard = resource.getrlimit(limit)[1]
            most = value if hard == resource.RLIM_INFINITY else min(value, hard)
            resource.setrlimit(limit, (most, most))
    sys.addaudithook(_refuse)


def _refuse(event: str, arguments: tuple[Any, ...]) -> None:
    if event.startswith(_REFUSED):
        raise PermissionError(f"{event} is not allowed here")


def _member(group: Any, name: str) -> Any:
    """A member of a group that lies in this very file."""
    import h5py

    link = group.get(name, getlink=True)
    if link is None:
        raise KeyError(f"there is no {name}")
    if not isinstance(link, h5py.HardLink):
        raise _Unsupported(f"{name} is a link to somewhere else")
    return group[name]


def _place(dataset: Any, name: str) -> dict[str, Any]:
    """Where the numbers of a data set lie in the file."""
    if dataset.external or dataset.is_virtual:
        raise _Unsupported(f"the numbers of {name} are in another file")
    offset = dataset.id.get_offset()
    if dataset.chunks is not None or offset is None or dataset.ndim != 1:
        raise _Unsupported(f"the numbers of {name} are compressed or in pieces")
    return {"at": int(offset), "count": int(dataset.size), "type": dataset.dtype.str}


def _describe(data: bytes) -> dict[str, Any]:
    import h5py

    with h5py.File(io.BytesIO(data), "r") as file:
        meshes = _member(file, "ENS_MAA")
        names = list(meshes)
        if len(names) != 1:
            raise _Unsupported(f"the file has {len(names)} meshes, not one")
        mesh = _member(meshes, names[0])
        dimension = int(mesh.attrs.get("ESP", 3))
        steps = [name for name in mesh if "NOE" in mesh[name]] if "NOE" not in mesh else []
        if len(steps) > 1:
            raise _Unsupported(f"the mesh has {len(steps)} time steps, not one")
        step = _member(mesh, steps[0]) if steps else mesh
        cells = []
        elements = _member(step, "MAI")
        for name in elements:
            place = _place(_member(_member(elements, name), "NOD"), name)
            cells.append({"kind": name, "corners": _KINDS.get(name, 0), **place})
        points = _place(_member(_member(step, "NOE"), "COO"), "the points")
        fields = list(_member(file, "CHA")) if "CHA" in file else []
        return {"dimension": dimension, "points": points, "cells": cells, "fields": fields}


def main() -> None:
    seconds = int(sys.argv[1])
    import h5py

    # What is imported late is imported before the fence.
    with h5py.File(io.BytesIO(), "w") as file:
        file["a"] = [1.0]
        list(file["a"].attrs)
    data = sys.stdin.buffer.read()
    _confine(len(data), seconds)
    try:
        answer: dict[str, Any] = _describe(data)
    except _Unsupported as failure:
        answer = {"unsupported": str(failure)}
    except MemoryError:
        answer = {"memory": True}
    except Exception as failure:
        answer = {"damaged": " ".join(str(failure).split())}
    sys.stdout.write(json.dumps(answer))
    sys.stdout.flush()


if __name__ == "__main__":
    main()
