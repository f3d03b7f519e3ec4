"""Trials of ``--auto`` beside the classes: what each wish does, and noise of other kinds."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks import ground_truth, scans
from benchmarks.accuracy_outcomes import AUTO
from benchmarks.ground_truth import Case
from msal_cli.auto import Wishes
from msal_cli.mesh import Mesh, prepare_mesh

WISHES = {
    AUTO: Wishes(),
    f"{AUTO} --keep texture": Wishes(keep="texture"),
    f"{AUTO} --keep edges": Wishes(keep="edges"),
    f"{AUTO} --keep shape": Wishes(keep="shape"),
    f"{AUTO} --strength -2": Wishes(strength=-2.0),
    f"{AUTO} --strength -1": Wishes(strength=-1.0),
    f"{AUTO} --strength 1": Wishes(strength=1.0),
    f"{AUTO} --strength 2": Wishes(strength=2.0),
}
"""By their options."""

WISHED = ("Fandisk0.3", "bracket 0.3", "vase 0.3", "dragon_egg 0.1", "rock 0.2")
"""Cases that every wish is tried on: closed surfaces, so that volumes mean something."""

NOISES = (
    ("gaussian-normal", 0.05),
    ("gaussian-normal", 0.3),
    ("gaussian-normal", 0.5),
    ("gaussian", 0.1),
    ("gaussian", 0.2),
    ("mixed", 0.2),
)
"""Kind and level of the noise that is put on the models of ``other_models``."""

FIRST_SEED = 1000
"""Of these noises, apart from those of the classes."""

OF = "other"
"""In place of a class."""


def other_models() -> dict[str, Callable[[], Mesh]]:
    """True shapes that are in no class, by name."""
    shapes = ground_truth.sources(quick=True)
    found = {"torus": _torus, "knot": shapes["knot"]}
    folder = ground_truth.data_folder()
    path = folder / "textured" / "bunny10k_textured.obj" if folder else None
    if path is not None and path.exists():
        found["coarse bunny"] = functools.partial(ground_truth.opened, path)
    return found


def other_cases() -> Iterator[Case]:
    """Every model of ``other_models`` with every noise of ``NOISES``."""
    seed = FIRST_SEED
    for name, source in other_models().items():
        for kind, level in NOISES:
            seed += 1

            def made(
                source: Callable[[], Mesh] = source,
                level: float = level,
                seed: int = seed,
                kind: str = kind,
            ) -> tuple[Mesh, Mesh]:
                return ground_truth.corrupted(source(), level, seed, kind)

            suffix = "" if kind == "gaussian-normal" else f" {kind}"
            yield Case(f"{name} {level:g}{suffix}", OF, made)


def _torus() -> Mesh:
    made = scans.scan("torus", 160, 60, 0.0, seed=0)
    return prepare_mesh(made.vertices.astype(np.float64), made.faces).mesh
