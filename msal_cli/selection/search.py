"""The search: candidates on a part of the mesh, their errors estimated, the best blend of them.

1. The noise is estimated.  Where there is none to speak of nothing is done.
2. Every candidate that the budget allows runs on a part of the mesh, and on probes of it, and
   Stein's lemma gives the error of any blend of them; the best blend is a first result.
3. If that has sharp edges between smooth parts, or noise could hide them, dear filters join in,
   and they and the best are tried again.
4. The best ones rehearse: the best result yet stands for the truth, with noise put on it.
5. The blend that is best by both estimates is taken, without members that hardly count.  Stein's
   counts the more the less sure it is what is noise and what is texture.

Everything is a function of the mesh and the wishes: probes have fixed seeds, and costs are those
of a table.  The constants were chosen on the classes of benchmarks/ground_truth.py, by
benchmarks/accuracy.py; docs/accuracy.md has other models as a check.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli import methods
from msal_cli.mesh import Mesh
from msal_cli.noise_estimate import NoiseLevel, estimated
from msal_cli.noise_model import NoiseModel
from msal_cli.selection import NONE, Choice, Wishes
from msal_cli.selection.candidates import CANDIDATES, ROBUST, SMOOTHER, Candidate
from msal_cli.selection.patches import Part, representative
from msal_cli.selection.recipe import recipe
from msal_cli.selection.risk import PROBES, Risk, Stein, rehearsed
from msal_cli.selection.surface import CLEAN, MACHINED, kind_of
from msal_cli.selection.weighing import FLOOR, best_weights, rounded

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from msal_cli.selection import OnStep

Floats = NDArray[np.float64]

RUN = 1.7
"""What a default run costs beyond its filter, in filters of its kind over the same mesh: reading,
measuring and writing.  benchmarks/auto_seconds.py measures 2.7 at a million vertices, where the
filter takes 0.13 s; less is reckoned with, since candidates cost more on scans in a worse order."""

START = 1_000_000
"""Vertices that the filter would do while a run starts."""

SEARCH = 0.4
"""Part of the budget that may go into looking at candidates."""

LEAST_PART, MOST_PART = 8_000, 16_000
"""Vertices that candidates are tried on; on fewer the estimates scatter too much."""

REHEARSING = 14
"""The best candidates by themselves that rehearse beside the members of the first blend."""

LEAST_WEIGHT = 0.04
"""Members below this weight are left out."""

DOUBT, GREAT_DOUBT = 0.15, 0.5
"""By which part of the way to the lower end of its interval the noise is taken for less, where
that way is up to ``WIDE`` of the level, and where it is all of it: texture could be part of it."""

WIDE = 0.3
"""Width of the interval below the level, in parts of it, up to which it is a usual one."""

SURE, UNSURE = 0.13, 0.23
"""The same width, up to which a rehearsal is believed alone, and from which on
Stein's risk counts as much."""

HEAVY = 0.35
"""Noise in mean edge lengths under which no first result shows whether there are sharp edges."""

STRENGTH = 1.2
"""Factor of the noise that is reckoned with for each step of ``Wishes.strength``."""

_SLOPES = {"balanced": 0.5, "positions": 0.25, "normals": 0.75, "volume": 0.4}
_DRIFT = {"volume": 1000.0}
# What is to be kept: factor of the noise, share of the slopes.
_KEEP = {"texture": (0.9, 0.5), "edges": (1.0, 0.7), "shape": (1.25, 0.4)}


def chosen(mesh: Mesh, wishes: Wishes, on_step: OnStep | None = None) -> Choice:
    """See ``selection.chosen``."""
    noise = estimated(mesh)
    if noise.is_negligible or not mesh.links.has_ring.any():
        if on_step is not None:
            on_step(1, 1)
        reason = f"noise {noise.mean_edges:.2g} e; {CLEAN}; left as it is"
        return Choice(NONE, {}, reason, CLEAN, noise)
    return _Search(mesh, wishes, noise, on_step).chosen()


class _Search:
    """One search: what is known of the mesh, and the budget that is left."""

    def __init__(
        self, mesh: Mesh, wishes: Wishes, noise: NoiseLevel, on_step: OnStep | None
    ) -> None:
        self.mesh, self.wishes, self.noise = mesh, wishes, noise
        self._on_step = on_step
        self.is_impulsive = noise.is_impulsive
        edges = noise.rms_edges if self.is_impulsive else noise.mean_edges
        doubt = DOUBT + (GREAT_DOUBT - DOUBT) * max(self._width - WIDE, 0.0) / (1.0 - WIDE)
        edges -= doubt * (noise.mean_edges - noise.low)
        factor, self.slopes = _KEEP.get(wishes.keep or "", (1.0, _SLOPES[wishes.prefer]))
        if wishes.keep is not None and wishes.prefer != "balanced":
            self.slopes = _SLOPES[wishes.prefer]
        self.drift = _DRIFT.get(wishes.prefer, 0.0)
        self.level = edges * factor * STRENGTH**wishes.strength * mesh.mean_edge_length
        n = len(mesh.vertices)
        # In filters of the default run over one vertex.
        self.allowance = (wishes.budget - 1.0) * ((RUN + 1.0) * n + START) + n
        self._done = self._total = 0

    def chosen(self) -> Choice:
        """The best blend, or single method, that the budget allows."""
        usable = [one for one in CANDIDATES if self._is_usable(one)]
        # A budget of one run leaves nothing for looking around.
        usable = usable or [min(CANDIDATES, key=lambda one: one.cost)]
        at_first = [one for one in usable if not one.is_last_resort]
        dear = [one for one in usable if one.is_last_resort]
        part = representative(self.mesh, self._part_size(at_first))
        look = self._by_rehearsals if self.is_impulsive else self._by_stein
        members, risks, surface, tried = look(part, at_first, dear)
        final = self._pruned(members, risks)
        self._finish()
        return self._choice(members, final, risks, surface, tried)

    def _by_stein(
        self, part: Part, at_first: list[Candidate], dear: list[Candidate]
    ) -> tuple[list[Candidate], list[Risk], str, int]:
        """The shortlist, its risks by Stein's lemma and by a rehearsal, the kind of surface, and
        how many candidates were looked at."""
        once = len(at_first) + len(dear) + REHEARSING
        self._total = (1 + PROBES) * once + 2 * REHEARSING + len(at_first)
        first = part.mesh.vertices + self._run(SMOOTHER, part.mesh)(part.mesh)
        looked, tried = at_first, len(at_first)
        risk, moves = self._judged(part, first, looked)
        weights = self._best([risk])
        first = part.mesh.vertices + _blend(weights, moves)
        surface = kind_of(part.mesh.moved(first))
        is_sharp = bool(dear) and self._may_be_sharp(surface)
        if is_sharp:
            # Along better directions: under the noise in which edges are sharp they matter.
            looked = [at_first[k] for k in self._shortlist(risk, weights)] + dear
            tried += len(dear)
            risk, moves = self._judged(part, first, looked)
            weights = self._best([risk])
            first = part.mesh.vertices + _blend(weights, moves)
        shortlist = self._shortlist(risk, weights)
        members = [looked[k] for k in shortlist]
        risk = risk.of(shortlist)
        again = self._rehearsed(part, first, members)
        if not is_sharp:
            better = part.mesh.vertices + _blend(self._best([risk, again]), moves[shortlist])
            again = self._rehearsed(part, better, members)
        return members, [risk.counted(self._doubt), again], surface, tried

    def _by_rehearsals(
        self, part: Part, at_first: list[Candidate], dear: list[Candidate]
    ) -> tuple[list[Candidate], list[Risk], str, int]:
        """The same for impulsive noise, of which Stein's lemma knows nothing: two rehearsals, the
        second one on what the first has chosen."""
        first = part.mesh.vertices + self._run(ROBUST, part.mesh)(part.mesh)
        surface = kind_of(part.mesh.moved(first))
        looked = at_first + dear if self._may_be_sharp(surface) else at_first
        self._total = 2 * len(looked)
        risk = self._rehearsed(part, first, looked)
        weights = self._best([risk])
        shortlist = self._shortlist(risk, weights)
        members = [looked[k] for k in shortlist]
        moves = np.zeros_like(first)
        for weight, member in zip(weights[shortlist], members, strict=True):
            if weight > 0.0:
                moves += weight * self._run(member, part.mesh)(part.mesh)
        again = self._rehearsed(part, part.mesh.vertices + moves, members)
        return members, [again], surface, len(looked)

    @property
    def _doubt(self) -> float:
        """How much Stein's risk counts beside a rehearsal, 0 to 1.

        A rehearsal scatters less, but takes for noise whatever the first result has taken away:
        the wider the noise's interval, the more of that may be texture.
        """
        return min(max((self._width - SURE) / (UNSURE - SURE), 0.0), 1.0)

    @property
    def _width(self) -> float:
        """How far below its level the noise may be, in parts of the level."""
        level = self.noise.mean_edges
        return (level - self.noise.low) / level if level > 0.0 else 0.0

    def _may_be_sharp(self, surface: str) -> bool:
        return surface == MACHINED or self._noise_edges(self.mesh) >= HEAVY

    def _rehearsed(self, part: Part, first: Floats, members: Sequence[Candidate]) -> Risk:
        """The risk of members on ``first`` (m, 3) with the mesh's noise put on it."""
        runs = [self._run(member, part.mesh) for member in members]
        return rehearsed(part, first, runs, NoiseModel(self.level), self.is_impulsive, self._step)

    def _is_usable(self, candidate: Candidate) -> bool:
        """Whether one may be chosen: its run over the mesh fits, and trust has an effect."""
        spare = self.allowance * (1.0 - SEARCH)
        if self.mesh.trust is not None:
            method = methods.find(candidate.method)
            return method.has_data_term(method.settled(candidate.given))
        return candidate.cost * len(self.mesh.vertices) <= spare

    def _part_size(self, candidates: Sequence[Candidate]) -> int:
        """Vertices of the part on which all candidates together keep within the budget."""
        cost = sum(candidate.cost for candidate in candidates) * (PROBES + 2)
        size = SEARCH * self.allowance / max(cost, 1.0)
        return int(min(max(size, LEAST_PART), MOST_PART))

    def _run(self, candidate: Candidate, mesh: Mesh) -> Callable[[Mesh], Floats]:
        """What the candidate moves a mesh like ``mesh`` by."""
        method = methods.find(candidate.method)
        settled = method.settled(candidate.settings(self._noise_edges(mesh)))

        def run(other: Mesh) -> Floats:
            moves: Floats = method.denoised(other, settled).vertices - other.vertices
            return moves

        return run

    def _noise_edges(self, mesh: Mesh) -> float:
        """The noise in mean edge lengths, with as many digits as are worth writing down."""
        return float(round(self.level / mesh.mean_edge_length, 4))

    def _judged(
        self, part: Part, first: Floats, candidates: Sequence[Candidate]
    ) -> tuple[Risk, Floats]:
        """Stein's risk of candidates, and what they move the part by (k, m, 3), with the noise
        along the normals that the part has at ``first`` (m, 3)."""
        normals = part.mesh.moved(first).vertex_normals("uniform")
        judge = Stein(part, NoiseModel(self.level), normals)
        for candidate in candidates:
            judge.add(self._run(candidate, part.mesh), self._step)
        return judge.risk(), judge.moves

    def _best(self, risks: Sequence[Risk]) -> Floats:
        if self.mesh.trust is not None:
            # Trust scales the pull of one method, not a blend.
            weights = np.zeros(len(risks[0].drift))
            weights[int(np.argmin(self._scores(risks)))] = 1.0
            return weights
        # Rounded at once: what the last digits of a solver are must not show in what follows.
        return rounded(best_weights(risks, self.slopes, self.drift))

    def _scores(self, risks: Sequence[Risk]) -> Floats:
        """How the candidates do by themselves; less is better."""
        score = np.zeros(len(risks[0].drift))
        for risk in risks:
            places = np.log(np.maximum(risk.positions.singles(), FLOOR))
            tilts = np.log(np.maximum(risk.slopes.singles(), FLOOR))
            score += risk.importance * ((1.0 - self.slopes) * places + self.slopes * tilts)
        return score

    def _shortlist(self, risk: Risk, weights: Floats) -> list[int]:
        """Who rehearses: the members of the first blend, and the best by themselves."""
        best = np.argsort(self._scores([risk]), kind="stable")[:REHEARSING]
        return sorted({*np.flatnonzero(weights >= 0.01).tolist(), *best.tolist()})

    def _pruned(self, members: Sequence[Candidate], risks: Sequence[Risk]) -> Floats:
        """The best weights, rounded, of few members whose runs over the mesh fit the budget."""
        spare = self.allowance * (1.0 - SEARCH) / len(self.mesh.vertices)
        costs = np.array([member.cost for member in members])
        kept = list(range(len(members)))
        while True:
            weights = self._best([risk.of(kept) for risk in risks])
            used = weights >= LEAST_WEIGHT
            if not used.any():
                break
            cost = costs[kept]
            if cost[used].sum() > spare and len(kept) > 1:
                # The least useful for what it takes; those that had no weight may get some then.
                del kept[int(np.argmin(np.where(used, weights / cost, np.inf)))]
            elif not used.all():
                kept = [k for k, is_used in zip(kept, used, strict=True) if is_used]
            else:
                break
        result = np.zeros(len(members))
        result[kept] = weights
        return result

    def _choice(
        self,
        members: Sequence[Candidate],
        weights: Floats,
        risks: Sequence[Risk],
        surface: str,
        tried: int,
    ) -> Choice:
        edge = self.mesh.mean_edge_length
        unit = self.level / edge
        counted = [risk for risk in risks if risk.importance > 0.0]
        # Stein's estimate scatters about small errors, and may be below zero.
        alone = np.maximum(np.max([risk.positions.singles() for risk in counted], axis=0), 0.0)
        together = max(*(risk.positions.at(weights) for risk in counted), 0.0)
        order = np.argsort(self._scores(risks), kind="stable").tolist()
        beside = [k for k in order if weights[k] < 1.0][:3]
        made = recipe(members, weights, self._noise_edges(self.mesh))
        what = "impulsive noise" if self.is_impulsive else "noise"
        level = self.noise.rms_edges if self.is_impulsive else self.noise.mean_edges
        return Choice(
            made.method,
            made.parameters,
            f"{what} {level:.2g} e; {surface}; {made.label}",
            surface,
            self.noise,
            together**0.5 * unit,
            tried,
            tuple((members[k].label, float(alone[k]) ** 0.5 * unit) for k in beside),
        )

    def _step(self) -> None:
        self._done += 1
        if self._on_step is not None:
            self._on_step(min(self._done, self._total - 1), self._total)

    def _finish(self) -> None:
        if self._on_step is not None:
            self._on_step(self._total, self._total)


def _blend(weights: Floats, moves: Floats) -> Floats:
    """Moves (m, 3) of a blend."""
    moved: Floats = np.einsum("k,kij->ij", weights, moves)
    return moved
