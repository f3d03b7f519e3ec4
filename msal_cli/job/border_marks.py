"""Marks by which files are known to share border vertices, without looking at two files at once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from msal_cli.codecs.mesh_file import Surface
    from msal_cli.job.records import MeshRecord
    from msal_cli.mesh import PreparedMesh

MOST_MARKS = 8
"""Of a file.  Two files with 1,000 border vertices each that share 250 have two marks in common, on
average: so of a set of tiles most are found, and files that share nothing never."""

_FACTORS = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)
_BITS = 48


def mark_border(ready: PreparedMesh, mesh_file: Surface) -> tuple[int, ...]:
    """The least hashes of the positions, in single precision, of a file's border vertices."""
    import numpy as np

    if not ready.defects.boundary_edges:
        return ()
    is_border = ready.mesh.topology.boundary
    if ready.vertex_map is not None:
        is_border = is_border[ready.vertex_map] & (ready.vertex_map >= 0)
    with np.errstate(over="ignore"):
        # Zero has one sign.
        rows = mesh_file.vertices[np.flatnonzero(is_border)].astype(np.float32) + np.float32(0.0)
    words = rows.view(np.uint32).astype(np.uint64)
    marks = np.zeros(len(words), dtype=np.uint64)
    for axis, factor in enumerate(_FACTORS):
        marks = (marks ^ words[:, axis]) * np.uint64(factor)
        marks ^= marks >> np.uint64(29)
    marks >>= np.uint64(64 - _BITS)
    return tuple(np.unique(marks)[:MOST_MARKS].tolist())


def count_touching(records: Iterable[MeshRecord]) -> int:
    """How many files have a mark in common with another."""
    owners: dict[int, list[int]] = {}
    for index, record in enumerate(records):
        for mark in record.border_marks:
            owners.setdefault(mark, []).append(index)
    return len({index for several in owners.values() if len(several) > 1 for index in several})
