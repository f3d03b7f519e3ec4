"""The search of ``--auto``: candidates run on a part of the mesh, and their best blend is chosen.

1. The noise is estimated.  If it is negligible, the mesh is not changed.
2. The learned filter runs on a part of the mesh.  If its result is machined, it is the choice.
3. Else each candidate runs on a simulation: that result is taken as the truth, and noise is added
   to it.  This gives the error of any blend of the candidates.
4. The best blend is chosen, without members of small weight.

Noise of kinds that cannot be sampled has a shorter search: the learned filter and wide linear ones,
on a simulation that adds what the learned filter has removed.

The result is a function of the mesh and the wishes only: random numbers have fixed seeds, and costs
are those of a table.  The constants were chosen on the classes of benchmarks/ground_truth.py, by
benchmarks/accuracy.py; docs/accuracy.md tests them on other models.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from msal_cli import methods
from msal_cli.analysis.noise_estimate import NOISE, NoiseLevel, estimate_noise
from msal_cli.arrays import Floats
from msal_cli.auto import NONE, Choice, OnStep, Wishes, blends
from msal_cli.auto.candidates import (
    BLIND,
    CANDIDATES,
    FARTHER,
    LARGE_STAGES,
    LEARNED,
    LINEAR,
    PULLED,
    ROBUST_LEARNED,
    STAGES,
    Candidate,
    sharpen,
)
from msal_cli.auto.risk import MIRRORED, CandidateRuns, Risk, SimulatedRisk
from msal_cli.auto.samples import (
    CLEAN,
    DRAWN_KINDS,
    MACHINED,
    ORGANIC,
    PART,
    TEXTURED,
    Part,
    is_seen_from_one_side,
    select_patch,
    surface_kind,
)
from msal_cli.mesh import Mesh

LARGE, MOST_COST = 200_000, 1.3 * LEARNED.cost
"""Number of vertices from which the total cost of the members of a blend is limited, and that
limit, hardly more than the learned filter alone.  On smaller meshes that filter may run twice, for
the noise and for twice the noise: angles are 1 % smaller."""

MIN_WEIGHT = 0.04
"""Members below this weight are left out."""

DOUBT, GREAT_DOUBT, WIDE, UNEVEN_WIDTH = 0.15, 0.5, 0.3, 0.18
"""The assumed level of noise is below the estimate, because part of it may be texture: by this
share of the distance to the lower end of its interval, if that distance is up to ``WIDE`` of the
level, as usual, and if it is all of the level.  For uneven noise the last share is assumed."""

MOST = 0.5
"""Sum of weights from which those of a machined part are scaled to 1, because flat faces have no
shape that full weights would remove."""

MIN_LEARNED = 0.5
"""Sum of weights of the learned filter below which, under correlated noise, the other weights are
halved and it gets the rest: such noise, mirrored, looks like shape."""

WEAK, SURE = 0.1, 0.13
"""Level of white noise, mean edge lengths, below which a range scan may have more that is
correlated, and the width of the interval up to which it does not."""

HARM = "every filter would add more error than it takes away"

# For each ``Wishes.keep`` the factor of the noise, and the weight of slopes.
_KEEP = {"edges": (1.0, 0.7), "shape": (blends.SHAPE, 0.4)}


def choose_method(mesh: Mesh, wishes: Wishes, on_step: OnStep = lambda done, total: None) -> Choice:
    """Choose the best method or blend for ``mesh``.

    Fixed vertices do not move.  If the mesh has ``Mesh.trust``, only methods with a data term,
    which the trust scales, are candidates.
    """
    edge = mesh.mean_edge_length
    estimate = estimate_noise(mesh)
    noise = estimate.assume(wishes.assume, edge)
    is_unsure = noise.is_unsure
    if noise.is_negligible:
        on_step(1, 1)
        what = blends.describe_rest(estimate, noise)
        return blends.choose_least(noise, wishes, what, CLEAN)
    return _Search(mesh, wishes, noise.assume(NOISE, edge), on_step, is_unsure).choose()


class _Search:
    """One search and its state."""

    def __init__(
        self, mesh: Mesh, wishes: Wishes, noise: NoiseLevel, on_step: OnStep, is_unsure: bool
    ) -> None:
        self.wishes, self.noise, self.is_unsure = wishes, noise, is_unsure
        self._on_step = on_step
        edges = noise.rms_edges if noise.is_impulsive else noise.mean_edges
        doubt = DOUBT + (GREAT_DOUBT - DOUBT) * max(self._width - WIDE, 0.0) / (1.0 - WIDE)
        edges -= doubt * self._width * noise.mean_edges
        factor, self.slopes = _KEEP.get(wishes.keep or "", (1.0, 0.5))
        self.wished = factor
        self.level = self.unit = edges * factor * mesh.mean_edge_length
        is_large = len(mesh.vertices) >= LARGE
        self.most_cost = MOST_COST if is_large else np.inf
        self.stages = LARGE_STAGES if is_large else STAGES
        self._done = self._total = 0
        # Its levels are without the wishes.
        self.case = blends.build_case(mesh, noise)
        self.mesh = self.case.mesh
        self.model = self.case.model.at_level(self.level)

    def choose(self) -> Choice:
        """The best blend, or single method."""
        usable: Sequence[Candidate] = CANDIDATES if self.mesh.trust is None else PULLED
        study, surface = self._trials(), ORGANIC
        pilot = usable[0]
        if pilot is LEARNED:
            kind = self.noise.character.kind
            is_drawn, is_blind = self.is_unsure or self._is_drawn, kind == "staircase"
            pilot = BLIND if is_blind else LEARNED if is_drawn else ROBUST_LEARNED
            surface = surface_kind(study.result(pilot))
            if is_blind:
                usable = [BLIND]
            elif not is_drawn:
                return self._choose_by_mirror(surface)
            elif surface == MACHINED:
                # The learned filter restores texture only under noise known to be white.
                single = ROBUST_LEARNED if kind == "unknown" else LEARNED
                usable = [sharpen(single, self.stages)]
        self._total = len(usable) + 1
        judges = [study.simulate(usable, pilot, self._step)]
        return self._choice(study, usable, judges, surface)

    def _choose_by_mirror(self, surface: str) -> Choice:
        """The best blend of the learned filter and wide linear ones, by mirrored noise.

        The pilot is the result of the learned filter; on texture, of which it may remove too much,
        also that of a linear one, with the same weight.  Linear filters blur machined parts.
        """
        # The level is reduced in doubt of texture only for noise that can be sampled.
        edge = self.mesh.mean_edge_length
        self.level = max(self.level, self.noise.of_noisy_part * self.wished * edge)
        self.model = self.model.at_level(self.level)
        study = self._trials()
        members: tuple[Candidate, ...] = (ROBUST_LEARNED, FARTHER, *LINEAR)
        if surface == MACHINED:
            members = (sharpen(ROBUST_LEARNED, self.stages), FARTHER)
        pilots = [members[0]]
        if surface == TEXTURED:
            pilots.append(LINEAR[0])
        elif surface == ORGANIC and not self.noise.is_uneven:
            pilots = [FARTHER]
        self._total = len(pilots) * len(members) + 1
        mirrors = [study.simulate(members, pilot, self._step, MIRRORED) for pilot in pilots]
        self.unit = mirrors[0].level
        return self._choice(study, members, mirrors, surface)

    def _by_level(self, part: Part, judges: Sequence[SimulatedRisk], weights: Floats) -> Floats:
        """Weights (levels, k) for each level of local noise, of the members with weight in
        ``weights`` (k,); a single row if the noise is uniform."""
        levels = self.case.levels
        rows = np.tile(weights, (max(len(levels), 1), 1))
        kept = np.flatnonzero(weights)
        if not levels or not len(kept):
            return rows
        for row, judged in zip(
            rows, blends.level_masks(part, self.case.local, levels), strict=True
        ):
            if judged.sum() >= blends.MIN_JUDGED:
                some = self._best([judge.risk(judged).of(kept.tolist()) for judge in judges])
                row[kept] = np.where(some >= MIN_WEIGHT, some, 0.0)
        # At the highest level weights are scaled to sum 1: simulations have few vertices there.
        loudest = rows[-1] if rows[-1].any() else weights
        rows[-1] = blends.round_weights(loudest / loudest.sum())
        return rows

    def _trials(self, most: int = PART) -> CandidateRuns:
        part = select_patch(self.mesh, most)
        return CandidateRuns(part, self.model.on_part(part.numbers))

    @property
    def _is_drawn(self) -> bool:
        """Whether samples of the model resemble the noise, which seems to be all white."""
        noise = self.noise
        is_weak = noise.mean_edges < WEAK and self._width > SURE and not noise.is_uneven
        is_range_scan = is_weak and is_seen_from_one_side(self.mesh)
        return noise.character.kind in (*DRAWN_KINDS, "unknown") and not is_range_scan

    @property
    def _width(self) -> float:
        """Width of the interval below the level of noise, as a share of the level."""
        if self.noise.is_uneven:
            # The interval reaches to the quietest region.
            return UNEVEN_WIDTH
        level = self.noise.mean_edges
        return (level - self.noise.low) / level if level > 0.0 else 0.0

    def _is_usable(self, candidate: Candidate) -> bool:
        """Whether a candidate has a data term, if the mesh has trust."""
        method = methods.find(candidate.method)
        return self.mesh.trust is None or method.has_data_term(method.validate(candidate.given))

    def _noise_edges(self) -> float:
        """The level of noise in mean edge lengths, rounded for recipes."""
        return float(round(self.level / self.mesh.mean_edge_length, 4))

    def _best(self, risks: Sequence[Risk]) -> Floats:
        if self.mesh.trust is not None:
            # Trust scales the pull of one method, not a blend.
            weights = np.zeros(len(risks[0].positions.gain))
            weights[int(np.argmin(self._scores(risks)))] = 1.0
            return weights
        # Rounded at once, so that rounding errors of the solver have no effect on what follows.
        return blends.round_weights(blends.best_weights(risks, self.slopes))

    def _scores(self, risks: Sequence[Risk]) -> Floats:
        """Score (k,) of each single candidate; smaller is better."""
        score = np.zeros(len(risks[0].positions.gain))
        for risk in risks:
            places, tilts = (
                np.log(np.maximum(measure.singles(), blends.FLOOR))
                for measure in (risk.positions, risk.slopes)
            )
            score += (1.0 - self.slopes) * places + self.slopes * tilts
        return score

    def _prune(self, members: Sequence[Candidate], risks: Sequence[Risk]) -> Floats:
        """The best weights (k,), rounded, without small ones, of members up to ``most_cost``."""
        costs = np.array([member.cost for member in members])
        kept = list(range(len(members)))
        while True:
            weights = self._best([risk.of(kept) for risk in risks])
            used = weights >= MIN_WEIGHT
            if not used.any():
                break
            cost = costs[kept]
            if cost[used].sum() > self.most_cost and len(kept) > 1:
                # Without the member of the smallest weight over cost others may get one.
                del kept[int(np.argmin(np.where(used, weights / cost, np.inf)))]
            elif not used.all():
                kept = [k for k, is_used in zip(kept, used, strict=True) if is_used]
            else:
                break
        result = np.zeros(len(members))
        result[kept] = weights
        return result

    def _adjust(self, members: Sequence[Candidate], weights: Floats, surface: str) -> Floats:
        """Correct the weights (k,) of members by the kind of noise and surface."""
        if members[0] is BLIND:
            return np.ones(1)
        total = float(weights.sum())
        if surface == MACHINED and total >= MOST:
            return blends.round_weights(weights / total)
        is_robust = members[0].given.get("texture") == ROBUST_LEARNED.given["texture"]
        if is_robust and self.noise.character.rings:
            is_learned = np.array([member.method == LEARNED.method for member in members])
            if weights[is_learned].sum() < MIN_LEARNED:
                halved = 0.5 * weights
                halved[0] += 1.0 - halved.sum()
                return blends.round_weights(halved)
        return weights

    def _choice(
        self,
        study: CandidateRuns,
        members: Sequence[Candidate],
        judges: Sequence[SimulatedRisk],
        surface: str,
    ) -> Choice:
        """The choice of the best blend of ``members`` by the simulations ``judges``."""
        risks = [judge.risk() for judge in judges]
        weights = self._adjust(members, self._prune(members, risks), surface)
        rows = self._by_level(study.part, judges, weights)
        share = self.wishes.share * (blends.hedge(risks, weights) if self.is_unsure else 1.0)
        # To keep only the smooth shape, one step stronger.
        strength = self.wishes.strength + (1.0 if self.wishes.keep == "shape" else 0.0)
        is_strengthened = strength > 0.0 and bool(rows.any())
        blended: Sequence[Candidate] = members
        if is_strengthened:
            used = np.flatnonzero(rows.any(axis=0)).tolist()
            spare = self.most_cost - sum(members[k].cost for k in used)
            stronger = [
                candidate
                for candidate in blends.stronger_candidates(self._noise_edges())
                if candidate.cost <= spare and self._is_usable(candidate)
            ]
            study = self._trials(blends.STRENGTH_PART)
            blended, rows = blends.mix_in_stronger(
                study, members, rows, stronger, strength, self.case
            )
        share = round(share, 3)
        self._on_step(self._total, self._total)
        edge = self.mesh.mean_edge_length
        unit = self.unit / edge
        alone = np.maximum(np.max([risk.positions.singles() for risk in risks], axis=0), 0.0)
        together = None
        if not is_strengthened:
            squares = [risk.positions.at(share * weights) for risk in risks]
            together = max(*squares, 0.0) ** 0.5 * unit
        order = np.argsort(self._scores(risks), kind="stable").tolist()
        beside = [k for k in order if rows[:, k].min() < 1.0][:3]
        noise = self._noise_edges()
        method, parameters, label = blends.build_recipe(blended, rows, noise, share, self.case)
        choice = Choice(
            method,
            parameters,
            f"{blends.describe_noise(self.noise, self.is_unsure)}; {surface}; {label}",
            surface,
            self.noise,
        )
        if method == NONE:
            what = f"noise {self.noise.mean_edges:.2g} e; {surface}; {HARM}"
            choice = blends.choose_least(self.noise, self.wishes, what, surface)
        return dataclasses.replace(
            choice,
            risk=together,
            tried=len(members),
            runners_up=tuple((members[k].label, float(alone[k]) ** 0.5 * unit) for k in beside),
        )

    def _step(self) -> None:
        self._done += 1
        self._on_step(self._done, self._total)
