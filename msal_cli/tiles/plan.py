"""The plan of a run by tiles: what every task knows, and what the run will take."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from msal_cli.errors import InternalError
from msal_cli.tiles.scratch import Scratch

PLAN = "plan.json"
GLOBALS = "globals.json"

TILE_VERTICES = 1_000_000
"""Vertices of a tile, about."""

CHUNK_VERTICES = 2_000_000
"""Vertices that are read at a time; of faces twice as many."""


@dataclass(frozen=True)
class TilePlan:
    """What is known before the first task.

    Attributes
    ----------
    source : how workers open the input: ``{"kind": "file", "path": ..., "format": ...}`` or, for a
        set of files, ``{"kind": "set", ...}``.
    identity : sizes, times and names of the input: a plan whose input has changed is not used.
    settings : ``dataclasses.asdict`` of ``job.settings.Settings``.
    output : path of the output, or None for a set, whose files have theirs.
    n_vertices, n_polygons : of the file.
    vertex_type : ``float32`` or ``float64``.
    split_axis, split_at : the k-d tree as a heap: inner node i sends positions with
        ``x[split_axis[i]] < split_at[i]`` to node 2i + 1, others to 2i + 2; leaves are the tiles,
        in order from left to right.
    n_tiles : a power of two.
    vertex_chunks : first vertex and the one behind the last, of each chunk.
    face_chunks : those of ``codecs.streamed_mesh.FaceChunk``, as plain lists.
    pieces : those of the output.
    """

    source: dict[str, Any]
    identity: dict[str, Any]
    settings: dict[str, Any]
    output: str | None
    n_vertices: int
    n_polygons: int
    vertex_type: str
    split_axis: list[int]
    split_at: list[float]
    n_tiles: int
    vertex_chunks: list[tuple[int, int]]
    face_chunks: list[list[Any]]
    pieces: list[tuple[int, int]] = field(default_factory=list)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the positions in scratch."""
        return np.dtype(self.vertex_type)

    def save(self, scratch: Scratch) -> None:
        """Write it into the scratch folder."""
        scratch.write_json(PLAN, asdict(self))

    @staticmethod
    def load(scratch: Scratch) -> TilePlan | None:
        """The plan of a scratch folder, None if it has none."""
        values = scratch.read_json(PLAN)
        if values is None:
            return None
        for name in ("vertex_chunks", "pieces"):
            values[name] = [tuple(one) for one in values[name]]
        return TilePlan(**values)


def load_plan(scratch: Scratch) -> TilePlan:
    """The plan of a run that has begun."""
    plan = TilePlan.load(scratch)
    if plan is None:
        raise InternalError(f"{scratch.path} has no plan")
    return plan


def read_globals(scratch: Scratch) -> dict[str, Any]:
    """What the reductions have made so far: tile starts, origin, mean edge length, choice ..."""
    return scratch.read_json(GLOBALS) or {}


def write_globals(scratch: Scratch, **values: Any) -> None:
    """Add to what the reductions have made; only the leader calls this, between stages."""
    scratch.write_json(GLOBALS, read_globals(scratch) | values)
