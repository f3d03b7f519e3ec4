"""A mesh in memory that is read in pieces like a file."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from msal_cli.codecs.streamed_mesh import FaceChunk
from msal_cli.job.settings import Settings, Task
from msal_cli.tiles import source
from msal_cli.tiles.opening import open_run
from msal_cli.tiles.plan import TilePlan
from msal_cli.tiles.scratch import Scratch
from msal_cli.tiles.stages import reduce_stage, run_task


@dataclass
class FakeMesh:
    """Vertices (n, 3) and triangles (m, 3), uint32."""

    vertices: np.ndarray
    faces: np.ndarray
    are_corners: bool = False
    path: str = "fake.ply"
    format: str = "ply"
    normals: np.ndarray | None = None
    values: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def n_vertices(self) -> int:
        return len(self.vertices)

    @property
    def n_polygons(self) -> int:
        return len(self.faces)

    @property
    def vertex_type(self) -> Any:
        return self.vertices.dtype.type

    def read_vertices(self, start: int, stop: int) -> np.ndarray:
        assert 0 <= start <= stop <= self.n_vertices
        return self.vertices[start:stop]

    @property
    def has_normals(self) -> bool:
        return self.normals is not None

    def read_normals(self, start: int, stop: int) -> np.ndarray:
        assert self.normals is not None
        return self.normals[start:stop].astype(np.float64)

    def read_property(self, name: str, start: int, stop: int) -> np.ndarray:
        return self.values[name][start:stop].astype(np.float64)

    def face_chunks(self, most: int) -> list[FaceChunk]:
        ends = [*range(0, self.n_polygons, most), self.n_polygons]
        return [FaceChunk((a, b), a, (12 * a, 12 * b)) for a, b in itertools.pairwise(ends)]

    def read_triangles(self, chunk: FaceChunk) -> np.ndarray:
        return self.faces[slice(*chunk.polygons)]

    def output_pieces(self, most: int) -> list[tuple[int, int]]:
        return [(0, 12 * self.n_vertices)]


def open_fake(
    monkeypatch: Any,
    folder: Path,
    mesh: FakeMesh,
    *,
    tile_vertices: int = 60,
    chunk_vertices: int = 100,
) -> tuple[TilePlan, Scratch]:
    """Open a run over ``mesh``, which its tasks read too."""
    monkeypatch.setattr(source, "open_source", lambda description: mesh)
    monkeypatch.setattr(source, "identify", lambda description: {})
    scratch = Scratch(folder)
    plan = open_run(
        Task("fake.ply", "out.ply", "fake.ply"),
        Settings("al"),
        scratch,
        tile_vertices=tile_vertices,
        chunk_vertices=chunk_vertices,
    )
    return plan, scratch


CUT_STAGES = ("count", "number", "faces", "weld")


def run_stages(scratch: Scratch, names: tuple[str, ...] = CUT_STAGES) -> None:
    """Run these stages in this process."""
    from msal_cli.tiles.stages import next_stage

    for name in names:
        stage = next_stage(scratch)
        assert stage is not None
        assert stage.name == name
        for index in stage.todo:
            run_task((str(scratch.path), name, index))
        reduce_stage(scratch, name)
