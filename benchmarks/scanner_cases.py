"""Scans of known truth: all kinds of noise that scanners make, on models that nothing is tuned to.

Noise is that of ``msal noise``, scans are those of ``scan_simulation``; each case has a seed and a
view of its own, from its name, so that every run has the same.
"""

from __future__ import annotations

import functools
import importlib.util
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import ground_truth
from benchmarks.scan_simulation import ScannerSettings, simulate_scan
from benchmarks.true_surface import TrueSurface
from msal_cli import codecs
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.mesh import Mesh, prepare_mesh
from msal_cli.storage import gzip_streams

CLEAN = "clean"
"""The kind without noise: what moves there is harm."""

Source = Callable[[], Mesh]


@dataclass(frozen=True, eq=False)
class Pair:
    """A scan and the true surface, about one origin."""

    noisy: Mesh
    true: Mesh

    @functools.cached_property
    def true_surface(self) -> TrueSurface:
        """The true surface with its normals."""
        return TrueSurface(self.true)

    @property
    def has_same_faces(self) -> bool:
        """Whether faces and vertices of both correspond."""
        return len(self.noisy.vertices) == len(self.true.vertices) and np.array_equal(
            self.noisy.faces, self.true.faces
        )


@dataclass(frozen=True, eq=False)
class Case:
    """One scan: its kind of noise, its model, and how it is made."""

    kind: str
    model: str
    make: Callable[[], Pair]

    @property
    def key(self) -> str:
        """The name in the cache."""
        return f"{self.kind}: {self.model}"


ADDED: dict[str, dict[str, Any]] = {
    "normals 0.2": {"kind": "gaussian-normal"},
    "isotropic 0.2": {"kind": "gaussian"},
    "shared over 1 ring 0.2": {"kind": "correlated", "rings": 1},
    "shared over 2 rings 0.2": {"kind": "correlated", "rings": 2},
    "shared over 3 rings 0.2": {"kind": "correlated", "rings": 3},
    "one direction 0.2": {"kind": "view"},
    "quantised depth 0.5": {"kind": "quantised", "level": 0.0, "step": 0.5},
    "half 0.25": {"kind": "half", "level": 0.25},
    "ramp 0 to 0.4": {"kind": "ramp", "level": 0.4},
    "outliers 5 %": {"kind": "outliers", "level": 0.05, "fraction": 0.05},
    "impulsive 0.4 at 30 %": {"kind": "impulsive", "level": 0.4, "fraction": 0.3},
    "grazing 0.1": {"kind": "grazing", "level": 0.1},
}
"""Noise by the name of the kind; lengths in mean edge lengths, views drawn for each case."""

SIMULATED: dict[str, dict[str, Any]] = {
    "binary voxels": {"scanner": "voxels", "cells": 64},
    "slices 3 apart": {"scanner": "slices", "cells": 64, "slices": 3},
    "CT, white": {"scanner": "ct", "cells": 64, "level": 0.1},
    "CT, correlated": {"scanner": "ct", "cells": 64, "level": 0.15, "correlation": 1.5},
    "depth camera, in steps": {"scanner": "depth", "cells": 144, "level": 0.6, "step": 0.6},
    "depth camera, grazing": {
        "scanner": "depth",
        "cells": 144,
        "level": 2.0,
        "step": 0.0,
        "smoothing": 1.5,
    },
    "fusion of 14 views": {"scanner": "fusion", "cells": 64, "views": 14},
}
"""Simulated scanners by the name of the kind; views drawn for each case."""

UNSEEN = ("joint", "carter", "ratchet", "bumpy_torus", "gargoyle", "paw")
"""Those of ``unseen_shapes`` that take part: nothing was ever tuned to them."""

SCANNED = ("joint", "bumpy_torus", "gargoyle", "fandisk", "bunny", "bracket")
"""Models that simulated scanners see."""

QUICK_MODELS = ("joint", "gargoyle", "bunny")

RANGE_SCANS = ("bun000", "bun045")

REAL = ("laser range scan", "Kinect")
"""Kinds of real scans, of which the folder MSAL_DATA has some."""


def _seed(kind: str, model: str) -> int:
    return zlib.crc32(f"{kind}: {model}".encode())


def draw_direction(seed: int) -> tuple[float, float, float]:
    """A unit vector."""
    x, y, z = np.random.Generator(np.random.PCG64(seed)).standard_normal(3)
    length = float(np.sqrt(x * x + y * y + z * z))
    return (float(x) / length, float(y) / length, float(z) / length)


@functools.cache
def sources() -> dict[str, Source]:
    """The true shape of every model whose file is there, by name; each is made once.

    Those of ``unseen_shapes`` need manifold3d.
    """
    found: dict[str, Source] = {}
    if importlib.util.find_spec("manifold3d") is not None:
        from benchmarks.unseen_shapes import unseen_shapes

        shapes = unseen_shapes()
        found |= {name: functools.cache(shapes[name]) for name in UNSEEN}
    folder = ground_truth.data_folder()
    if folder is not None:
        paths = {
            "fandisk": folder / "clean" / "fandisk.obj",
            "bunny": folder / "textured" / "bunny10k_textured.obj",
        }
        for name, path in paths.items():
            if path.exists():
                found[name] = functools.partial(ground_truth.opened, path)
    samples = ground_truth.sources(quick=True)
    return found | {name: samples[name] for name in ("coin", "bracket", "rock")}


def add_kind(kind: str, model: str, source: Source) -> Pair:
    """The model with noise of one of ``ADDED``."""
    true = source()
    seed = _seed(kind, model)
    noise = AddedNoise(**ADDED[kind], seed=seed, direction=draw_direction(seed))
    return Pair(true.with_vertices(add_noise(true, noise)), true)


def scan_kind(kind: str, model: str, source: Source) -> Pair:
    """The model as one of ``SIMULATED`` makes it."""
    true = source()
    seed = _seed(kind, model)
    settings = ScannerSettings(**SIMULATED[kind], seed=seed, direction=draw_direction(seed))
    scan = simulate_scan(true, settings)
    ready = prepare_mesh(scan.vertices, scan.faces)
    return Pair(ready.mesh, true.with_vertices(true.vertices - ready.origin))


def _clean(source: Source) -> Pair:
    true = source()
    return Pair(true, true)


def _opened_pair(noisy: Path, true: Path) -> Pair:
    """Two files in one frame, whatever their faces."""
    both = [
        codecs.open_mesh(gzip_streams.read_whole(str(path)), path.name) for path in (noisy, true)
    ]
    first, second = (prepare_mesh(one.vertices, one.faces) for one in both)
    shift = second.origin - first.origin
    return Pair(first.mesh, second.mesh.with_vertices(second.mesh.vertices + shift))


def _real() -> Iterator[Case]:
    folder = ground_truth.data_folder()
    if folder is None:
        return
    bunny = folder / "clean" / "stanford-bunny.obj"
    for name in RANGE_SCANS:
        path = folder / "real" / "bunny_range" / f"{name}.ply"
        if path.exists() and bunny.exists():
            yield Case(REAL[0], name, functools.partial(_opened_pair, path, bunny))
    cone = folder / "real" / "kinect_cone"
    if cone.is_dir():
        make = functools.partial(_opened_pair, cone / "Noisy.obj", cone / "Original.obj")
        yield Case(REAL[1], "cone", make)


def cases(
    quick: bool = False, kinds: Iterable[str] | None = None, models: Iterable[str] | None = None
) -> dict[str, list[Case]]:
    """The cases whose files are there, by kind.

    ``quick`` keeps a few models; ``kinds`` and ``models`` keep those whose name has one of the
    words in it.
    """
    found: dict[str, list[Case]] = {}
    shapes = sources()
    for kind in ADDED:
        for name, source in shapes.items():
            make = functools.partial(add_kind, kind, name, source)
            found.setdefault(kind, []).append(Case(kind, name, make))
    for kind in SIMULATED:
        for name in SCANNED:
            if name in shapes:
                make = functools.partial(scan_kind, kind, name, shapes[name])
                found.setdefault(kind, []).append(Case(kind, name, make))
    for case in _real():
        found.setdefault(case.kind, []).append(case)
    for name, source in shapes.items():
        found.setdefault(CLEAN, []).append(Case(CLEAN, name, functools.partial(_clean, source)))
    real = {case.model for case in _real()}
    kept = {
        kind: [
            case
            for case in some
            if _matches(kind, kinds)
            and _matches(case.model, models)
            and (not quick or case.model in QUICK_MODELS or case.model in real)
        ]
        for kind, some in found.items()
    }
    return {kind: some for kind, some in kept.items() if some}


def _matches(name: str, words: Iterable[str] | None) -> bool:
    return words is None or any(word in name for word in words)
