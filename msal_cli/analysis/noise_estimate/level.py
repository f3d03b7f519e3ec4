"""Records of the estimated noise of a mesh: its level and its kind."""

from __future__ import annotations

import dataclasses
import math

from msal_cli.light_dataclass import dataclass

SPIKES, MIN_SPIKES = 0.07, 0.005
"""Spikes count as noise from this root mean square, mean edge lengths, and share of the vertices.
"""

UNEVEN, MIN_UNEVEN = 2.0, 0.05
"""Noise is uneven above this ratio of the levels of the most and the least noisy region, if the
former is above the second number, mean edge lengths."""

KINDS = (
    "none",
    "white",
    "isotropic",
    "correlated",
    "view",
    "quantised",
    "uneven",
    "outliers",
    "impulsive",
    "staircase",
    "unknown",
)

NOISE, TEXTURE = "noise", "texture"
"""The kinds of a ``Reading``: what the roughness of a mesh may be."""

MIN_PROBABILITY = 0.9
"""Probability from which a kind of reading is not in doubt."""

RING_COUNTS = ("no ring", "one ring", "two rings", "three rings", "four rings or more")


@dataclass(frozen=True)
class NoiseCharacter:
    """The kind of the noise and its parameters."""

    kind: str  # one of ``KINDS``; the most specific, if more than one fits
    rings: int = 0  # over how many rings noise is correlated, 0 (white) to 4 (or more)
    direction: str = "normals"  # ``"normals"``, ``"isotropic"`` (in all directions) or ``"axis"``
    # unit vector, up to its sign, if the direction is ``"axis"``; else None
    axis: tuple[float, float, float] | None = None
    # step of quantised depths or height of terraces, mean edge lengths; 0 for other kinds
    step: float = 0.0
    outliers: float = 0.0  # share of the vertices that lie far off
    confidence: float = 1.0  # probability of the kind, 0 to 1; below 0.5 it is a guess
    basis: str = ""  # the reason for the kind, in words

    @property
    def words(self) -> str:
        """The character in words, to follow the level; empty if there is no noise."""
        if self.kind in ("none", "unknown"):
            return "of a kind that cannot be determined" if self.kind == "unknown" else ""
        shared = f"shared over {RING_COUNTS[self.rings]}"
        words = {
            "white": "independent at each vertex, along the normals",
            "isotropic": "independent at each vertex, in all directions",
            "correlated": shared,
            "view": "along the view",
            "quantised": f"depths in steps of {self.step:.2g} e along the view",
            "uneven": "uneven over the surface",
            "outliers": f"{100.0 * self.outliers:.2g} % outliers",
            "impulsive": "impulses at some vertices",
            "staircase": f"terraces of {self.step:.2g} e",
        }[self.kind]
        return f"{words}; {shared}" if self.rings and self.kind != "correlated" else words


NO_CHARACTER = NoiseCharacter("none")


@dataclass(frozen=True)
class Reading:
    """One explanation of the roughness of a mesh."""

    kind: str  # ``NOISE`` or ``TEXTURE``
    level: float  # of the noise, mean edge lengths; 0 if all of it is texture
    probability: float  # 0 to 1


@dataclass(frozen=True)
class NoiseLevel:
    """The noise of a mesh: its standard deviation along the direction of its character, which is
    the normals, an axis, or each coordinate if the noise is isotropic."""

    mean_edges: float  # the level in mean edge lengths of the noisy mesh
    # low, high: its interval, mean edge lengths: from the level if all that may be texture is
    # texture to the level if none of it is, widened by the sampling error
    low: float
    high: float
    file_units: float  # the same level in file units
    # root mean square including spikes, which the level leaves out, mean edge lengths
    rms_edges: float
    # share of the vertices, 0 to 1, whose residual exceeds the 99 % quantile of Gaussian noise:
    # 0.01 for Gaussian noise, 0.02 and more for impulsive noise
    tail: float
    is_negligible: bool  # whether there is no noise, or too little to matter
    # lowest, highest: levels of the least and the most noisy region, mean edge lengths
    lowest: float
    highest: float
    regions: int  # how many regions were compared
    character: NoiseCharacter = NO_CHARACTER
    # explanations of the roughness, each kind at most once, most probable first
    readings: tuple[Reading, ...] = ()

    @property
    def is_unsure(self) -> bool:
        """Whether it may be noise or texture: neither has ``MIN_PROBABILITY``."""
        probabilities = [reading.probability for reading in self.readings]
        return max(probabilities, default=1.0) < MIN_PROBABILITY

    def assume(self, kind: str | None, edge: float) -> NoiseLevel:
        """The noise given that the reading of this ``kind`` is true; unchanged if it is not unsure.

        ``edge`` is the mean edge length, file units.
        """
        if kind is None or not self.is_unsure:
            return self
        level = next(reading.level for reading in self.readings if reading.kind == kind)
        ratio = level / self.mean_edges if self.mean_edges > 0.0 else 1.0
        has_spikes = are_spikes(self.rms_edges, self.tail)
        character = NO_CHARACTER
        if level > 0.0:
            is_named = self.character.kind != "none"
            character = self.character if is_named else NoiseCharacter("unknown", confidence=0.0)
        return dataclasses.replace(
            self,
            mean_edges=level,
            low=level,
            high=max(level, self.rms_edges if has_spikes else 0.0),
            file_units=level * edge,
            rms_edges=max(level, self.rms_edges),
            is_negligible=level == 0.0 and not has_spikes,
            lowest=ratio * self.lowest,
            highest=ratio * self.highest,
            character=character,
            readings=(Reading(kind, level, 1.0),),
        )

    def is_below(self, edges: float) -> bool:
        """Whether the level (of the most noisy region, if it is uneven) and spikes are below
        ``edges`` mean edge lengths."""
        has_spikes = are_spikes(self.rms_edges, self.tail) and self.rms_edges >= edges
        level = max(self.mean_edges, self.highest) if self.is_uneven else self.mean_edges
        return level < edges and not has_spikes

    @property
    def is_impulsive(self) -> bool:
        """Whether single vertices have much more noise than the others."""
        return self.character.kind in ("impulsive", "outliers")

    @property
    def is_uneven(self) -> bool:
        """Whether some regions have much more noise than others."""
        return are_uneven(self.lowest, self.highest)

    @property
    def of_noisy_part(self) -> float:
        """The level in noisy regions, mean edge lengths: if the noise is uneven, the geometric mean
        of the overall and the highest level."""
        return math.sqrt(self.mean_edges * self.highest) if self.is_uneven else self.mean_edges


def are_spikes(rms: float, tail: float) -> bool:
    """Whether spikes with this root mean square, mean edge lengths, count as noise; the tip of a
    cone or two corners do not."""
    return rms >= SPIKES and tail >= MIN_SPIKES


def are_uneven(lowest: float, highest: float) -> bool:
    """Whether levels of regions, mean edge lengths, differ too much for one noise."""
    return highest > MIN_UNEVEN and highest > UNEVEN * lowest
