"""The candidates: methods and settings, with their costs and labels.

The learned filter is best nearly everywhere; the others contribute to blends on relief and on
organic shapes of benchmarks/ground_truth.py.
"""

import dataclasses
import re
from typing import Any

from msal_cli.light_dataclass import dataclass


@dataclass(frozen=True)
class Candidate:
    """A method and its settings."""

    # method, given: the name of the method, and its parameters without defaults
    method: str
    given: dict[str, Any]
    # time on one core over that of the filter ``msal`` at its defaults on the same mesh: a fifth
    # more than benchmarks/candidate_costs.py measures, since the vertices of scans are in worse
    # order than those of its torus
    cost: float
    # whether it needs the parameter ``noise``, in mean edge lengths
    takes_noise: bool = False
    times: float = 1.0  # factor of the noise that it is given: greater is smoother

    def settings(self, noise_edges: float) -> dict[str, Any]:
        """The parameters for a mesh with this noise, mean edge lengths."""
        if not self.takes_noise:
            return dict(self.given)
        return {"noise": round(self.times * noise_edges, 4), **self.given}

    @property
    def label(self) -> str:
        """Method and settings in words: ``MSAL (K = 0.5, 1 mollification)``."""
        name, words = _LABELS[self.method, self.given.get("schedule")]
        words = re.sub(r"\b1 (\w+)s\b", r"1 \1", words.format(**self.given))
        if self.method == "learned" and "iterations" in self.given:
            words = "{iterations} stages".format(**self.given)
        if self.times != 1.0:
            words = f"noise times {self.times:g}"
        return f"{name} ({words})" if words else name


# By method and schedule: its usual name, and its settings, whose plurals are removed after 1.
_LABELS: dict[tuple[str, Any], tuple[str, str]] = {
    ("al", None): ("AL", "{iterations} sweeps, {mollify} mollifications"),
    ("al", "wiener"): ("AL with Wiener fidelity", "{iterations} sweeps"),
    ("bilateral_non_iterative", None): ("non-iterative bilateral", ""),
    ("hc", None): ("HC", "{iterations} iterations"),
    ("learned", None): ("learned", ""),
    ("msal", None): ("MSAL", "K = {K:g}, {mollify} mollifications"),
    ("msal", "robust"): ("robust MSAL", "K = {K:g}, {iterations} sweeps"),
    ("taubin", None): ("Taubin", ""),
    ("wiener", None): ("Wiener", "caution {caution:g}, sigma_s {similarity:g}"),
    ("windowed_sinc", None): ("windowed sinc", "pass band {pass_band:g}, {iterations} steps"),
}

_SLIDING: dict[str, Any] = {"sliding": "auto"}
"""Tangential displacements (sliding) are removed where the noise is along the normals."""


def _wiener(caution: float, similarity: float) -> Candidate:
    given = {"caution": caution, "similarity": similarity}
    return Candidate("wiener", given, 10.0, takes_noise=True)


def _sinc(iterations: int, pass_band: float, cost: float) -> Candidate:
    return Candidate("windowed_sinc", {"iterations": iterations, "pass_band": pass_band}, cost)


LEARNED = Candidate("learned", dict(_SLIDING), 100.0, takes_noise=True)
"""The best single candidate on nearly each mesh, and used alone on machined parts."""

ROBUST_LEARNED = dataclasses.replace(LEARNED, given={**_SLIDING, "texture": "lost"})
"""The learned filter for noise that is not white, which looks like texture in part."""

BLIND = Candidate("learned", {**_SLIDING, "texture": "lost"}, LEARNED.cost)
"""The learned filter for terraces, which have no level."""

FARTHER = dataclasses.replace(ROBUST_LEARNED, times=2.0)
"""The learned filter for stronger smoothing, or for more noise than the estimate sees because it is
correlated or was smoothed by the scanner."""

STAGES, LARGE_STAGES, SHARP_PASSES = 5, 4, 60
"""Stages of the learned filter on machined parts and on large ones, and its final vertex passes
there.  On parts of ``training.solids`` under white noise of 0.15 to 0.5 the angles after five
stages are 0.78 to 0.84 of those after three, on relief up to 1.08."""


def sharpen(candidate: Candidate, stages: int) -> Candidate:
    """The learned filter with more stages, for a machined part.

    The work before the first stage and after the last one takes as long as two stages.
    """
    given = {**candidate.given, "iterations": stages, "vertex_iterations": SHARP_PASSES}
    return dataclasses.replace(candidate, given=given, cost=candidate.cost * (stages + 2.0) / 5.0)


LINEAR = (
    Candidate("taubin", {}, 1.8),
    Candidate("hc", {"iterations": 3}, 1.2),
    Candidate("hc", {"iterations": 10}, 1.8),
    _sinc(30, 0.05, 5.0),
    _sinc(50, 0.01, 9.0),
)
"""Linear filters, from mild to wide, which do well on correlated noise."""

CANDIDATES: tuple[Candidate, ...] = (
    LEARNED,
    _wiener(0.35, 2.25),
    _wiener(0.75, 2.25),
    _wiener(1.5, 3.2),
    Candidate("bilateral_non_iterative", {}, 12.0),
    _sinc(20, 0.1, 3.5),
    Candidate("al", {"iterations": 1, "mollify": 1}, 0.6),
)

PULLED: tuple[Candidate, ...] = (
    Candidate("msal", {"K": 0.25, "mollify": 1}, 1.1),
    Candidate("msal", {"K": 0.5, "mollify": 1}, 1.1),
)
"""Candidates with a data term, for meshes with trust."""

FEW_SWEEPS, SWEEPS, SHARED_SWEEPS = 4, 6, 10
"""Sweeps of AL with the Wiener schedule for weak noise, which is gone after four; for other noise:
with 10 the angle is 1 % smaller; and for correlated noise: angles are 2 % smaller than with 6, and
1 % larger than with 20."""

FAIR_EDGES, STRONG_EDGES = 0.15, 0.25
"""Noise, mean edge lengths, above which it is not weak, and from which AL mollifies normals twice.
"""


def wiener_al(level: float, rings: int = 0) -> Candidate:
    """AL with the Wiener schedule for noise of ``level`` edge lengths, shared over ``rings``."""
    sweeps = SWEEPS if level > FAIR_EDGES else FEW_SWEEPS
    given = {
        "schedule": "wiener",
        "iterations": SHARED_SWEEPS if rings else sweeps,
        "mollify": 2 if level > STRONG_EDGES else 1,
    }
    return Candidate("al", given, 2.0, takes_noise=True)
