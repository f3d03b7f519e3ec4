"""Adding a known amount of noise to a mesh; ``noise_estimate`` estimates how much there is.

Each kind of noise is a field of heights, one number per vertex, with a direction of displacement,
a weight over the surface and, for some kinds, a last step::

    heights   white, or correlated: averaged ``rings`` times over closed one-rings
    direction vertex normals, one axis, or none (each coordinate independently)
    weight    1, or depending on the position or on the angle to the axis
    last step depths are rounded, or single vertices are moved far
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from msal_cli.analysis.measures import share_over_rings
from msal_cli.arrays import Floats
from msal_cli.errors import UsageError
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

KINDS: dict[str, tuple[str, ...]] = {
    "gaussian-normal": (),  # Gaussian along the vertex normals
    "gaussian": (),  # Gaussian in each coordinate
    "uniform": (),  # uniform in each coordinate, for the paper's Table 1 in docs/reproduction.md
    "mixed": (),  # along the normals, and as much along a random tangent, as in the paper's Fig. 7
    "impulsive": ("fraction",),  # along the normals, at a fraction of the vertices only
    "correlated": ("rings",),  # along the normals, averaged over one-rings
    "view": ("rings", "direction"),  # along one direction, as from a single scanner position
    "quantised": ("rings", "direction", "step"),  # as "view", with depths rounded to steps
    "grazing": ("rings", "direction"),  # as "view", stronger where the surface is oblique to it
    "half": ("rings", "direction", "border"),  # along the normals, on the half towards a direction
    "ramp": ("rings", "direction"),  # along the normals, growing from 0 along a direction
    "outliers": ("rings", "fraction"),  # along the normals; a fraction of the vertices far off
}
"""The kinds of noise that ``add_noise`` adds, and the settings of each besides level and seed."""

MAX_RINGS = 100
"""The most averages over one-rings; the noise is then correlated over about 8 rings."""

GRAZING_CAP = 5.0
"""Largest factor of ``grazing`` noise, reached at an angle of incidence of 78 degrees: scanners
drop points at larger angles."""

OUTLIER_REACH = (1.0, 3.0)
"""Minimum and maximum displacement of an outlier, mean edge lengths."""


@dataclass(frozen=True)
class AddedNoise:
    """The noise to add; a kind ignores the settings that it does not use."""

    kind: str  # one of ``KINDS``
    # standard deviation in mean edge lengths: greater is noisier.  Where the noise varies over the
    # surface, that at weight 1: ``grazing`` where the surface faces the scanner, ``ramp`` at its
    # end.  For ``uniform`` the largest displacement of a coordinate
    level: float = 0.2
    seed: int = 0  # from 0; another seed gives other noise of the same kind
    fraction: float = 0.1  # share of the vertices that ``impulsive`` and ``outliers`` move, 0 to 1
    # how many times heights are averaged over closed one-rings: greater is correlated more widely.
    # None is the kind's default, 2 for ``correlated`` and 0 (white) for the others
    rings: int | None = None
    # (3,), of any length: the axis of the view; ``half`` and ``ramp`` are noisier towards it
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    step: float = 0.5  # of ``quantised`` depths, mean edge lengths: greater is coarser
    # width of the zone of ``half`` in which the level grows from 0, a share of the extent along the
    # direction, 0 (sharp) to 1
    border: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(
                f"there is no noise {self.kind!r}", hint=f"known are: {', '.join(KINDS)}"
            )
        rings, length = self.rings, math.hypot(*self.direction)
        for name, is_met, expected in (
            ("level", 0.0 <= self.level < math.inf, "a number from 0"),
            ("seed", self.seed >= 0, "a number from 0"),
            ("fraction", 0.0 <= self.fraction <= 1.0, "a number from 0 to 1"),
            ("rings", rings is None or 0 <= rings <= MAX_RINGS, f"from 0 to {MAX_RINGS}"),
            ("direction", 0.0 < length < math.inf, "a vector with a length"),
            ("step", 0.0 < self.step < math.inf, "a number above 0"),
            ("border", 0.0 <= self.border <= 1.0, "a number from 0 to 1"),
        ):
            if not is_met:
                value = getattr(self, name)
                raise UsageError(f"{name} of the noise is {value!r}, and must be {expected}")

    def describe(self) -> str:
        """The settings that the kind uses, such as "rings 2, direction (0, 0, 1)"."""
        used = {name: getattr(self, name) for name in KINDS[self.kind]}
        if "rings" in used:
            used["rings"] = self.count_rings()
        if "direction" in used:
            used["direction"] = "({:g}, {:g}, {:g})".format(*self.direction)
        return ", ".join(f"{name} {value}" for name, value in used.items())

    def count_rings(self) -> int:
        """``rings``, or the kind's default if it is None; 0 if the kind does not use it."""
        if self.rings is not None and "rings" in KINDS[self.kind]:
            return self.rings
        return 2 if self.kind == "correlated" else 0


def build_noise(
    kind: str, level: float, seed: int, given: Mapping[str, Any], prefix: str = ""
) -> AddedNoise:
    """The noise with the settings ``given``; UsageError for a setting that the kind does not use.
    ``prefix`` precedes names in messages."""
    noise = AddedNoise(kind, level, seed, **given)
    for name in given:
        if name not in KINDS[kind]:
            users = ", ".join(user for user, settings in KINDS.items() if name in settings)
            raise UsageError(
                f"{prefix}{name} means nothing for {kind} noise",
                hint=f"leave it out; it is for {users}",
            )
    return noise


def add_noise(mesh: Mesh, noise: AddedNoise) -> Floats:
    """Positions (n, 3) of the mesh with noise added, the same for the same arguments.

    Vertices that no face uses have no normal, so noise along the normals does not move them.
    """
    draw = np.random.Generator(np.random.PCG64(noise.seed))
    n = len(mesh.vertices)
    edge = mesh.mean_edge_length
    amount = noise.level * edge
    if noise.kind == "gaussian":
        return mesh.vertices + amount * draw.standard_normal((n, 3))
    if noise.kind == "uniform":
        return mesh.vertices + draw.uniform(-amount, amount, (n, 3))
    normals = mesh.vertex_normals()
    heights = draw.standard_normal(n)
    if noise.kind == "impulsive":
        moved = draw.permutation(n)[: round(noise.fraction * n)]
        result = mesh.vertices.copy()
        result[moved] += (amount * heights[moved])[:, None] * normals[moved]
        return result
    if noise.kind == "mixed":
        lengths, angles = draw.standard_normal(n), draw.uniform(0.0, 2.0 * np.pi, n)
        first, second = _tangents(normals)
        across = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
        return mesh.vertices + amount * (heights[:, None] * normals + lengths[:, None] * across)
    heights = amount * share_over_rings(mesh, heights, noise.count_rings())
    axis = np.asarray(noise.direction) / math.hypot(*noise.direction)
    if noise.kind == "quantised":
        positions, step = mesh.vertices + heights[:, None] * axis, noise.step * edge
        depths = (positions * axis).sum(axis=1)
        return np.asarray(positions + (np.round(depths / step) * step - depths)[:, None] * axis)
    if noise.kind in ("view", "grazing"):
        growth = grazing_growth(normals, axis) if noise.kind == "grazing" else 1.0
        return mesh.vertices + (growth * heights)[:, None] * axis
    if noise.kind in ("half", "ramp"):
        heights *= _regional_weights(mesh, noise, axis)
    result = mesh.vertices + heights[:, None] * normals
    if noise.kind == "outliers":
        moved = draw.permutation(n)[: round(noise.fraction * n)]
        directions = draw.standard_normal((len(moved), 3))
        directions /= np.sqrt((directions * directions).sum(axis=1))[:, None]
        lengths = edge * draw.uniform(*OUTLIER_REACH, len(moved))
        result[moved] = mesh.vertices[moved] + lengths[:, None] * directions
    return result


def grazing_growth(normals: Floats, axis: Floats) -> Floats:
    """Factors (n,) of the noise along the unit vector ``axis`` (3,) for unit normals (n, 3).

    1 / abs(cos) of the angle of incidence, at most ``GRAZING_CAP``: the signal that a surface
    returns is proportional to the cosine (Soudarissanane, Lindenbergh, Menenti and Teunissen 2009,
    "Incidence angle influence on the quality of terrestrial laser scanning points").
    """
    cosines = np.abs((normals * axis).sum(axis=1))
    growth: Floats = 1.0 / np.maximum(cosines, 1.0 / GRAZING_CAP)
    return growth


def _regional_weights(mesh: Mesh, noise: AddedNoise, axis: Floats) -> Floats:
    """Factors (n,) of the heights of ``half`` and ``ramp``, by position along the axis."""
    depths = (mesh.vertices * axis).sum(axis=1)
    used = depths[mesh.topology.has_ring]
    low, extent = float(used.min()), float(np.ptp(used))
    if not extent:
        # A flat sheet across the axis has no half and no ramp.
        return np.ones(len(depths))
    shares: Floats = np.clip((depths - low) / extent, 0.0, 1.0)
    if noise.kind == "ramp":
        return shares
    if not noise.border:
        return np.where(shares > 0.5, 1.0, 0.0)
    t = np.clip((shares - 0.5) / noise.border + 0.5, 0.0, 1.0)
    smoothstep: Floats = t * t * (3.0 - 2.0 * t)
    return smoothstep


def _tangents(normals: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (n, 3) each, orthogonal to the normals (n, 3) and to each other."""
    # The cross product with the coordinate axis that is farthest from parallel to the normal.
    axis = np.zeros_like(normals)
    axis[np.arange(len(normals)), np.abs(normals).argmin(axis=1)] = 1.0
    first = np.cross(normals, axis)
    lengths = np.sqrt((first * first).sum(axis=1))
    first /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    return first, np.cross(normals, first)
