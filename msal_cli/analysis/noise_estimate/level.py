"""What is known of the noise of a mesh: how much, and of what kind."""

from __future__ import annotations

import dataclasses
import math

from msal_cli.light_dataclass import dataclass

SURE = 0.025
"""Mean edge lengths: upper end of the interval below which there is certainly no noise."""

SPIKES = 0.07
"""Mean edge lengths, root mean square, from which single spikes are noise to speak of."""

MIN_SPIKES = 0.005
"""Share of the vertices that must be spikes for that."""

UNEVEN = 2.0
"""Ratio of the most to the least noisy region from which noise is not the same everywhere."""

MIN_UNEVEN = 0.05
"""Mean edge lengths that the most noisy region needs for that."""

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
"""What the roughness of a mesh can be: kinds of ``Reading``."""


MIN_PROBABILITY = 0.9
"""Probability of a kind of reading from which it is not in doubt."""

RING_COUNTS = ("no ring", "one ring", "two rings", "three rings", "four rings or more")


@dataclass(frozen=True)
class NoiseCharacter:
    """What the noise is like."""

    kind: str  # one of ``KINDS``; the most telling, where more than one fits
    rings: int = 0  # over how many rings neighbours share noise, 0 (not at all) to 4 (that or more)
    direction: str = "normals"  # ``"normals"``, ``"isotropic"`` (in all directions) or ``"axis"``
    # unit vector of an axis, up to its sign; else None
    axis: tuple[float, float, float] | None = None
    # of quantised depths, or height of the terraces; mean edge lengths, 0 for none
    step: float = 0.0
    outliers: float = 0.0  # share of the vertices that lie far off
    confidence: float = 1.0  # of the kind, 0 to 1; below 0.5 a guess
    basis: str = ""  # what it rests on, in words

    @property
    def words(self) -> str:
        """The character in plain words, for a line after the level; empty for none."""
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
    """One way to explain the roughness of a mesh."""

    kind: str  # ``NOISE`` or ``TEXTURE``
    level: float  # of the noise that there is then, mean edge lengths; 0 where all of it is texture
    probability: float  # 0 to 1


@dataclass(frozen=True)
class NoiseLevel:
    """The noise of a mesh: its standard deviation along the direction of its character.

    That is along the normals, along an axis, or by coordinate where it is isotropic."""

    mean_edges: float  # in mean edge lengths of the mesh as it is
    # low, high: an interval for it, mean edge lengths: from where all that may be texture is, to
    # where none is, and beyond by the sampling error
    low: float
    high: float
    file_units: float  # the same level in file units
    # root mean square with single spikes, which the level leaves out, mean edge lengths
    rms_edges: float
    # share of the vertices, 0 to 1, further out among the others than 99 in 100 are with Gaussian
    # noise; 0.01 for that, 0.02 and more for impulsive noise
    tail: float
    is_negligible: bool  # whether there is no noise to speak of
    # lowest, highest: levels of the least and the most noisy region, mean edge lengths
    lowest: float
    highest: float
    regions: int  # how many regions were compared
    character: NoiseCharacter = NO_CHARACTER  # what kind of noise it is
    readings: tuple[Reading, ...] = ()  # the ways to explain the roughness, the most probable first

    @property
    def is_unsure(self) -> bool:
        """Whether it may be noise or texture: neither has ``MIN_PROBABILITY``."""
        return bool(self.readings) and all(
            sum(reading.probability for reading in self.readings if reading.kind == kind)
            < MIN_PROBABILITY
            for kind in (NOISE, TEXTURE)
        )

    def assume(self, kind: str | None, edge: float) -> NoiseLevel:
        """The noise if all readings of another ``kind`` are wrong: with ``NOISE`` of the highest
        level of its readings, with ``TEXTURE`` of the lowest; unchanged where it is not unsure.

        ``edge`` is the mean edge length, file units.
        """
        levels = [reading.level for reading in self.readings if reading.kind == kind]
        if kind is None or not levels or not self.is_unsure:
            return self
        level = max(levels) if kind == NOISE else min(levels)
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
        """Whether neither the level, nor that of any region where they differ, nor single spikes
        reach so many mean edge lengths."""
        has_spikes = are_spikes(self.rms_edges, self.tail) and self.rms_edges >= edges
        level = max(self.mean_edges, self.highest) if self.is_uneven else self.mean_edges
        return level < edges and not has_spikes

    @property
    def is_impulsive(self) -> bool:
        """Whether single vertices have much more noise than the others."""
        return self.character.kind in ("impulsive", "outliers")

    @property
    def is_uneven(self) -> bool:
        """Whether some regions have noise that others have not."""
        return are_uneven(self.lowest, self.highest)

    @property
    def of_noisy_part(self) -> float:
        """The level where there is noise, mean edge lengths: between that of all and the highest
        where some regions have hardly any."""
        return math.sqrt(self.mean_edges * self.highest) if self.is_uneven else self.mean_edges


def are_spikes(rms: float, tail: float) -> bool:
    """Whether spikes with this root mean square, in mean edge lengths, are noise to speak of; the
    tip of a cone or two corners are not."""
    return rms >= SPIKES and tail >= MIN_SPIKES


def are_uneven(lowest: float, highest: float) -> bool:
    """Whether levels of regions, in mean edge lengths, are not those of one noise."""
    return highest > MIN_UNEVEN and highest > UNEVEN * lowest
