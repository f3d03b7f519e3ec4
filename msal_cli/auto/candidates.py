"""What is looked at for every mesh: methods and settings, what they cost, and their names.

The learned filter is best nearly everywhere; the others have a share in blends on relief and on
organic shapes of benchmarks/ground_truth.py.
"""

import dataclasses
import re
from typing import Any

from msal_cli.light_dataclass import dataclass


@dataclass(frozen=True)
class Candidate:
    """One method with its settings."""

    # method, given: the method's name, and the parameters that are not at their defaults
    method: str
    given: dict[str, Any]
    # time for a mesh, in runs of the filter ``msal`` at its defaults over the same mesh, on one
    # core: a fifth more than benchmarks/candidate_costs.py measures, since the vertices of scans
    # are in worse order than those of its torus
    cost: float
    # it has a parameter ``noise``, in mean edge lengths, that it must be given
    takes_noise: bool = False
    times: float = 1.0  # how many times the noise it is given, to reach farther

    def settings(self, noise_edges: float) -> dict[str, Any]:
        """The parameters for a mesh with that noise, mean edge lengths of the mesh."""
        if not self.takes_noise:
            return dict(self.given)
        return {"noise": round(self.times * noise_edges, 4), **self.given}

    @property
    def label(self) -> str:
        """In words: ``MSAL (K = 0.5, 1 mollification)``."""
        name, words = _LABELS[self.method, self.given.get("schedule")]
        words = re.sub(r"\b1 (\w+)s\b", r"1 \1", words.format(**self.given))
        if self.method == "learned" and "iterations" in self.given:
            words = "{iterations} stages".format(**self.given)
        if self.times != 1.0:
            words = f"noise times {self.times:g}"
        return f"{name} ({words})" if words else name


# By method and schedule: what people call it, and its settings in words, with plurals; one of them
# is made singular.
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
"""Vertices that slid along the surface are taken back, where the noise is across it."""


def _wiener(caution: float, similarity: float) -> Candidate:
    given = {"caution": caution, "similarity": similarity}
    return Candidate("wiener", given, 10.0, takes_noise=True)


def _sinc(iterations: int, pass_band: float, cost: float) -> Candidate:
    return Candidate("windowed_sinc", {"iterations": iterations, "pass_band": pass_band}, cost)


LEARNED = Candidate("learned", dict(_SLIDING), 100.0, takes_noise=True)
"""The best by itself on nearly every mesh, and alone on machined parts."""

ROBUST_LEARNED = dataclasses.replace(LEARNED, given={**_SLIDING, "texture": "lost"})
"""The same for noise that is not white, which looks like texture in part."""

BLIND = Candidate("learned", {**_SLIDING, "texture": "lost"}, LEARNED.cost)
"""The same without a level, which terraces do not have."""

FARTHER = dataclasses.replace(ROBUST_LEARNED, times=2.0)
"""The same for noise that reaches farther than the estimate sees: neighbours share it, or a scanner
has smoothed it."""

STAGES, LARGE_STAGES, SHARP_PASSES = 5, 4, 60
"""Stages of the learned filter on machined parts and on large ones, and its last passes there.  On
parts of ``training.solids`` under white noise of 0.15 to 0.5 five leave 0.78 to 0.84 of the angle
that three do, on relief up to 1.08 of it."""


def sharpen(candidate: Candidate, stages: int) -> Candidate:
    """The learned filter with more stages, for a machined part.

    What it does before the first stage and after the last one takes as long as two of them.
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
"""Linear filters, mild to wide, which do well where neighbours share noise."""

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
"""Candidates with a pull to the scanned positions, for meshes with trust in them."""

STRONG_EDGES = 0.25
"""Noise in mean edge lengths from which AL mollifies normals twice."""

FEW_SWEEPS, SWEEPS, FAIR_EDGES = 4, 6, 0.15
"""Sweeps of AL with the Wiener schedule, the second number above that noise, in mean edge lengths.
More hardly matter: 10 reduce the angle by 1 %, and weak noise is gone after four."""

SHARED_SWEEPS = 10
"""The same for noise that neighbours share: 2 % less of an angle than six, 20 have 1 % less."""


def wiener_al(level: float, rings: int = 0) -> Candidate:
    """AL with the Wiener schedule, for noise of ``level`` mean edge lengths that neighbours share
    over so many ``rings``."""
    sweeps = SWEEPS if level > FAIR_EDGES else FEW_SWEEPS
    given = {
        "schedule": "wiener",
        "iterations": SHARED_SWEEPS if rings else sweeps,
        "mollify": 2 if level > STRONG_EDGES else 1,
    }
    return Candidate("al", given, 2.0, takes_noise=True)
