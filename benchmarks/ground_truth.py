"""Noisy meshes whose true shape is known, by class: what accuracy is measured on.

The published pairs and clean models of the folder MSAL_DATA, the clean sample meshes, and machined
shapes that are made here, so that no class rests on one source.  Noise is that of ``msal noise``,
with a seed of its own for every case, so every run has the same.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import machined_shapes
from msal_cli import codecs
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.mesh import Mesh, prepare_mesh
from msal_cli.storage import gzip_streams

SAMPLES = Path(__file__).resolve().parents[1] / "sample_meshes"

CLASSES = ("machined", "organic", "texture 0.1", "texture 0.2", "clean")
"""In the order of the tables."""

PAIRS = ("Fandisk0.3", "SharpSphere0.3", "Bunny0.2", "Julius0.2")
"""Folders of published noisy meshes, each with its true one."""

SCULPTURES = ("beast", "falconstatue", "ogre", "scorpion", "springer")
"""Clean models of the folder ``clean`` with fine relief."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Case:
    """One noisy mesh and the truth.

    Attributes
    ----------
    name, of : what tables call it, and its class.
    made : gives the noisy and the true mesh, with the same faces and about one origin.
    """

    name: str
    of: str
    made: Callable[[], tuple[Mesh, Mesh]]


@functools.lru_cache(maxsize=1)
def data_folder() -> Path | None:
    """The folder with pairs/, clean/ and scans/; None where MSAL_DATA names none."""
    folder = os.environ.get("MSAL_DATA")
    return Path(folder) if folder else None


def opened(path: Path) -> Mesh:
    """A mesh file, ready for computing."""
    data = gzip_streams.expand(gzip_streams.read_whole(str(path)), path.name)
    mesh_file = codecs.open_mesh(data, path.name)
    return prepare_mesh(mesh_file.vertices, mesh_file.faces).mesh


def pair(folder: Path) -> tuple[Mesh, Mesh]:
    """The noisy and the true mesh of a folder with Noisy.obj and Original.obj."""
    both = []
    for name in ("Noisy.obj", "Original.obj"):
        both.append(codecs.open_mesh(gzip_streams.read_whole(str(folder / name)), name))
    ready = prepare_mesh(both[0].vertices, both[0].faces)
    return ready.mesh, ready.mesh.with_vertices(both[1].vertices - ready.origin)


def add_plain_noise(
    mesh: Mesh, kind: str, level: float, seed: int, fraction: float = 0.1
) -> Floats:
    """Short for ``add_noise`` where a kind has no other settings."""
    return add_noise(mesh, AddedNoise(kind, level, seed, fraction))


def corrupted(
    true: Mesh, level: float, seed: int, kind: str = "gaussian-normal"
) -> tuple[Mesh, Mesh]:
    """The mesh with noise of ``level`` mean edge lengths, and itself.

    ``impulsive`` noise is on half of the vertices, as in the published models of that kind.
    """
    if level == 0.0:
        return true, true
    return true.with_vertices(add_plain_noise(true, kind, level, seed, fraction=0.5)), true


def _made(name: str) -> Mesh:
    """A machined shape that is made here."""
    vertices, faces = getattr(machined_shapes, name)()
    return prepare_mesh(vertices, faces).mesh


def sources(quick: bool = False) -> dict[str, Callable[[], Mesh]]:
    """Every true shape whose file is there, by name; ``quick`` leaves out those of more than 50,000
    vertices."""
    folder = data_folder()
    found: dict[str, Callable[[], Mesh]] = {}
    for path in sorted(SAMPLES.glob("*_clean.*")):
        if path.name.split(".")[-1] in ("ply", "obj", "stl", "gz"):
            found[path.name.split("_clean")[0]] = functools.partial(opened, path)
    for name in ("star_prism", "stepped_cylinder", "chipped_cube"):
        found[name] = functools.partial(_made, name)
    if folder is not None:
        for name in PAIRS:
            path = folder / "pairs" / name / "Original.obj"
            if path.exists():
                found[name[:-3]] = functools.partial(opened, path)
        clean = {
            "bunny": folder / "clean" / "stanford-bunny.obj",
            "igea": folder / "clean" / "igea.ply",
            "angel": folder / "scans" / "angel.obj",
            "dragon": folder / "scans" / "dragon_vrip_res2.ply.gz",
        } | {name: folder / "clean" / f"{name}.obj" for name in SCULPTURES}
        for name, path in clean.items():
            if path.exists() and not (quick and name in ("igea", "dragon")):
                found[name] = functools.partial(opened, path)
    return found


def cases(quick: bool = False) -> Iterator[Case]:
    """Every case whose files are there, class by class; ``quick`` leaves out those of more than
    50,000 vertices."""
    shapes = sources(quick)
    folder = data_folder()
    if folder is not None:
        for name in PAIRS:
            path = folder / "pairs" / name
            if path.is_dir():
                of = "machined" if name.endswith("0.3") else "organic"
                yield Case(name, of, functools.partial(pair, path))

    seed = 0
    for of, rows in _MADE.items():
        for name, level, *kind in rows:
            seed += 1
            if name not in shapes:
                continue
            source, kind_name = shapes[name], kind[0] if kind else "gaussian-normal"
            label = f"{name} {level:g}" + (f" {kind_name}" if kind else "")

            def made(
                source: Callable[[], Mesh] = source,
                level: float = level,
                seed: int = seed,
                kind_name: str = kind_name,
            ) -> tuple[Mesh, Mesh]:
                return corrupted(source(), level, seed, kind_name)

            yield Case(label.replace(" 0", "") if level == 0.0 else label, of, made)


_TEXTURED = ("bunny", "igea", "dragon", "angel", "dragon_egg", "coin", "rock")

_MADE: dict[str, list[tuple[str, float] | tuple[str, float, str]]] = {
    "machined": [
        ("Fandisk", 0.5),
        ("Fandisk", 0.7),
        ("Fandisk", 0.5, "impulsive"),
        ("SharpSphere", 0.5),
        ("bracket", 0.3),
        ("star_prism", 0.4),
        ("stepped_cylinder", 0.5, "impulsive"),
        ("chipped_cube", 0.4),
    ],
    "organic": [("Bunny", 0.3), ("Julius", 0.3), ("bear", 0.2), ("vase", 0.3), ("toadstool", 0.2)],
    "texture 0.1": [(name, 0.1) for name in _TEXTURED],
    "texture 0.2": [(name, 0.2) for name in _TEXTURED],
    "clean": [
        (name, 0.0) for name in (*_TEXTURED, "Fandisk", "SharpSphere", "Julius", "bracket", "bear")
    ],
}
