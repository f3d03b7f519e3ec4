"""The settings that the tables of accuracy.py choose among: every method's default, and a grid.

Whatever has the parameter ``sliding`` is there with it kept and undone.  ``published`` settings are
those of filters as their papers have them; the others are this package's own: the Wiener filter and
schedule, the schedule by quantiles, blends, and sliding that is undone.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from msal_cli import methods

OWN_METHODS = ("wiener", "blend")

_GRID: dict[str, tuple[dict[str, tuple[Any, ...]], ...]] = {
    "al": ({"iterations": (1, 2, 3, 4, 5, 6), "mollify": (1, 2)},),
    "msal": (
        {"K": (0.25, 0.35, 0.5, 0.7, 1.0), "iterations": (2, 4, 6), "mollify": (1, 2)},
        {"schedule": ("robust",), "K": (0.35, 0.5, 0.7, 0.85), "iterations": (2, 4)},
        {"schedule": ("wiener",)},
    ),
    "bilateral_normal": (
        {"similarity": (0.2, 0.25, 0.3, 0.35, 0.45, 0.6, 0.8), "iterations": (1, 2, 3, 5, 10, 20)},
        {"variant": ("global",), "similarity": (0.35, 0.6)},
    ),
    "guided_normal": (
        {"similarity": (0.2, 0.25, 0.3, 0.35, 0.45, 0.6), "iterations": (2, 5, 10, 20)},
        {"similarity": (0.2, 0.25, 0.3), "iterations": (60,)},
    ),
    "normal_diffusion": (
        {"similarity": (0.0, 0.3, 0.5), "normal_iterations": (5, 15), "iterations": (1, 2, 3, 5)},
    ),
    "bilateral": ({"variant": ("one_ring", "fleishman"), "iterations": (2, 3, 5)},),
    "taubin": ({"iterations": (10, 30, 50)},),
    "umbrella": ({"iterations": (1, 3)},),
    "normal_threshold": (
        {"threshold": (0.3, 0.5), "iterations": (5, 20), "vertex_iterations": (10,)},
    ),
    "wiener": ({"caution": (0.35, 0.75, 1.5), "similarity": (2.25, 3.2)},),
}
"""Products of values by method, beside the defaults."""

_DEAR = ("l0", "static_dynamic")
_DEAR_ITERATIONS = 20

_COARSE: dict[str, tuple[dict[str, tuple[Any, ...]], ...]] = {
    "al": ({"iterations": (1, 2, 4), "mollify": (2,)},),
    "msal": ({"K": (0.25, 0.5, 1.0), "mollify": (1, 2)},),
    "bilateral_normal": ({"similarity": (0.3, 0.45, 0.8), "iterations": (2, 5, 20)},),
    "guided_normal": ({"similarity": (0.3, 0.45, 0.6), "iterations": (2, 5, 20)},),
    "normal_diffusion": (
        {"similarity": (0.0, 0.5), "normal_iterations": (5, 15), "iterations": (1, 3)},
    ),
    "wiener": ({"caution": (0.35, 1.5)},),
}
"""For the table of robustness."""


@dataclass(frozen=True)
class Setting:
    """A method, and the parameters that are not at their defaults."""

    method: str
    given: dict[str, Any]

    @property
    def text(self) -> str:
        """The key in the cache: ``msal K=0.7 mollify=2``."""
        return " ".join([self.method, *(f"{word}={value}" for word, value in self.given.items())])

    @property
    def label(self) -> str:
        """For tables."""
        return " ".join([f"`{self.method}`", *self.text.split()[1:]])

    @property
    def is_default(self) -> bool:
        """Whether every parameter is at its default."""
        return not self.given

    @property
    def is_published(self) -> bool:
        """Whether it is a filter that others published."""
        return (
            self.method not in OWN_METHODS
            and self.given.get("schedule") not in ("robust", "wiener")
            and self.given.get("sliding", "kept") == "kept"
        )

    @property
    def is_dear(self) -> bool:
        """Whether it takes minutes on large meshes, which go without it."""
        iterations = self.given.get("iterations", 0)
        is_long = self.method == "guided_normal" and iterations >= _DEAR_ITERATIONS
        return self.method in _DEAR or is_long or "global" in self.given.values()


def defaults() -> list[Setting]:
    """Every method at its default."""
    return [Setting(name, {}) for name in methods.names()]


def grid(coarse: bool = False) -> list[Setting]:
    """The defaults and all settings of the grid, each once, even where a default is among them."""
    found: list[Setting] = []
    seen: set[tuple[Any, ...]] = set()
    for setting in _with_sliding([*defaults(), *_products(_COARSE if coarse else _GRID)]):
        settled = (setting.method, *methods.find(setting.method).validate(setting.given).items())
        if settled not in seen:
            seen.add(settled)
            found.append(setting)
    return found


def _products(spread: dict[str, tuple[dict[str, tuple[Any, ...]], ...]]) -> Iterator[Setting]:
    for method, products in spread.items():
        for product in products:
            for values in itertools.product(*product.values()):
                yield Setting(method, dict(zip(product, values, strict=True)))


def _with_sliding(settings: list[Setting]) -> Iterator[Setting]:
    for setting in settings:
        yield setting
        if any(one.name == "sliding" for one in methods.find(setting.method).parameters):
            yield Setting(setting.method, {**setting.given, "sliding": "undone"})
