"""The search: candidates on parts of the mesh, their errors estimated, the best blend of them.

1. The noise is estimated.  Where there is none to speak of nothing is done, see ``choices``.
2. Every candidate that the budget allows runs on a small part of the mesh and on a probe of it, and
   Stein's lemma gives the error of any blend of them; the best blend is a first result.
3. The members of that and the best by themselves are tried on a larger part.  If the first result
   has sharp edges between smooth parts, or noise could hide them, expensive filters join in.
4. A simulation: the best result so far is taken as the truth, and noise is added to it.
5. The blend that is best by both estimates is taken, without members that hardly count.  Stein's
   counts the more the less sure it is what is noise and what is texture.

Everything is a function of the mesh and the wishes: probes have fixed seeds, and costs are those
of a table.  The constants were chosen on the classes of benchmarks/ground_truth.py, by
benchmarks/accuracy.py; docs/accuracy.md has other models as a check.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from msal_cli import methods
from msal_cli.analysis.noise_estimate import NoiseLevel, estimate_noise
from msal_cli.analysis.noise_estimate.local import local_levels
from msal_cli.arrays import Flags, Floats
from msal_cli.auto.blend_weights import FLOOR, best_weights, round_weights
from msal_cli.auto.candidates import CANDIDATES, FARTHER, LEARNED, ROBUST, SMOOTHER, Candidate
from msal_cli.auto.choices import SHAPE, STRENGTH, build_recipe, choose_least, describe_noise
from msal_cli.auto.levels import FEWEST_JUDGED, RELAX, level_masks, may_follow, spread_levels
from msal_cli.auto.noise_model import ISOTROPIC, build_model
from msal_cli.auto.risk import DEALT, DRAWN, MIRRORED, PROBES, Risk, SimulatedRisk, SteinRisk
from msal_cli.auto.sample_patch import Part, select_patch
from msal_cli.auto.surface_kind import (
    CLEAN,
    MACHINED,
    ORGANIC,
    TEXTURED,
    is_seen_from_one_side,
    surface_kind,
)
from msal_cli.auto.trials import CandidateRuns
from msal_cli.auto.wishes import NONE, Choice, Wishes, allow_all
from msal_cli.mesh import Mesh
from msal_cli.methods._triangles import even_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.auto.wishes import Allowed, OnStep


RUN = 1.7
"""What a default run costs beyond its filter, in filters of its kind over the same mesh: reading,
measuring and writing.  benchmarks/auto_seconds.py measures 2.7 at a million vertices, where the
filter takes 0.13 s; a smaller value is used, since candidates cost more on scans in a worse
order."""

START = 1_000_000
"""Vertices that the filter would do while a run starts."""

SEARCH = 0.4
"""Part of the budget that may go into looking at candidates."""

GLANCE = 4_000
"""Vertices that all candidates are tried on: enough to tell which are worth a longer look."""

PART = 6_000
"""Vertices that the best are tried on; on fewer the estimates scatter too much."""

LONGER_LOOK, SECOND_LOOK = 6, 3
"""The best single candidates that are simulated in addition to the members of the first blend, and
of the second."""

LEAST_WEIGHT = 0.04
"""Members below this weight are left out."""

DOUBT, GREAT_DOUBT = 0.15, 0.5
"""By which part of the way to the lower end of its interval the noise is taken for less, where
that way is up to ``WIDE`` of the level, and where it is all of it: texture could be part of it."""

WIDE = 0.3
"""Width of the interval below the level, in parts of it, up to which it is a usual one."""

SURE, UNSURE = 0.13, 0.23
"""The same width, up to which only the simulation counts, and from which on Stein's risk counts as
much."""

UNEVEN_WIDTH = 0.18
"""The same width, as it is taken for noise that is not the same everywhere."""

HEAVY = 0.35
"""Noise in mean edge lengths under which no first result shows whether there are sharp edges."""

PLAIN_KINDS, SURE_KIND = ("white", "isotropic"), 0.7
"""Kinds whose noise is drawn on any surface, and the confidence of the estimate from which on it is
believed."""

STAIRCASE = "staircase"
DOUBTFUL_KINDS = ("correlated", "view", "quantised", STAIRCASE)
"""Those that a scanner's noise is taken for when it is like none; below ``SURE_KIND``, and on
texture, which their levels include, no draw of the kind is like it.  Terraces cannot be drawn."""

WEAK = 0.1
"""White noise in mean edge lengths below which a range scan may have more that neighbours share."""

STAIRS = 0.3
"""Noise in mean edge lengths that terraces are taken for at least: learned filters flatten them."""

HARM = "every filter would add more error than it takes away"

_SLOPES = {"balanced": 0.5, "positions": 0.25, "normals": 0.75, "volume": 0.4}
_DRIFT = {"volume": 1000.0}
# What is to be kept: factor of the noise, share of the slopes.
_KEEP = {"texture": (0.9, 0.5), "edges": (1.0, 0.7), "shape": (SHAPE, 0.4)}


def search(
    mesh: Mesh, wishes: Wishes, on_step: OnStep | None = None, is_allowed: Allowed = allow_all
) -> Choice:
    """The best method or blend for ``mesh``; see ``auto.choose_method``."""
    noise = estimate_noise(mesh)
    if noise.is_negligible or not mesh.topology.has_ring.any():
        if on_step is not None:
            on_step(1, 1)
        return choose_least(noise, wishes, CLEAN, CLEAN)
    return _Search(mesh, wishes, noise, on_step, is_allowed).choose()


class _Search:
    """One search: what is known of the mesh, and the budget that is left."""

    def __init__(
        self,
        mesh: Mesh,
        wishes: Wishes,
        noise: NoiseLevel,
        on_step: OnStep | None,
        is_allowed: Allowed,
    ) -> None:
        self.levels: tuple[float, ...]
        self.mesh, self.wishes, self.noise = mesh, wishes, noise
        self._on_step, self._is_allowed = on_step, is_allowed
        self.is_impulsive = noise.is_impulsive
        self.added = DEALT if self.is_impulsive else DRAWN
        edges = noise.rms_edges if self.is_impulsive else noise.mean_edges
        doubt = DOUBT + (GREAT_DOUBT - DOUBT) * max(self._width - WIDE, 0.0) / (1.0 - WIDE)
        edges -= doubt * self._width * noise.mean_edges
        factor, self.slopes = _KEEP.get(wishes.keep or "", (1.0, _SLOPES[wishes.prefer]))
        if wishes.keep is not None and wishes.prefer != "balanced":
            self.slopes = _SLOPES[wishes.prefer]
        self.drift = _DRIFT.get(wishes.prefer, 0.0)
        if noise.character.kind == STAIRCASE:
            edges = max(edges, STAIRS)
        self.wished = factor * STRENGTH**wishes.strength
        self.level = edges * self.wished * mesh.mean_edge_length
        n = len(mesh.vertices)
        # In filters of the default run over one vertex.
        self.allowance = (wishes.budget - 1.0) * ((RUN + 1.0) * n + START) + n
        self._done = self._total = 0
        self.pilot, self._is_machined = LEARNED, False
        self.model = build_model(mesh, noise).at_level(self.level)
        self.relax = 0
        if self.model.direction == ISOTROPIC and mesh.trust is None:
            # Jagged triangles first, and what is left of the noise is along the normals.
            self.relax = RELAX
            self.mesh = even_out(mesh, RELAX)
            self.model = self.model.along_normals()
        # Of the mesh as the blend gets it, and without the wishes.
        self.local, self.levels = np.empty(0), ()
        if self.model.shares is not None and mesh.trust is None and may_follow(is_allowed):
            self.local = local_levels(mesh)
            self.levels = spread_levels(self.local[mesh.topology.has_ring])
        self._whole: CandidateRuns | None = None

    def choose(self) -> Choice:
        """The best blend, or single method, that the budget allows."""
        usable = [one for one in CANDIDATES if self._is_usable(one)]
        # A budget of one run leaves nothing for trials.
        usable = usable or [min(CANDIDATES, key=lambda one: one.cost)]
        later = [one for one in usable if one is LEARNED]
        last = [one for one in usable if one.is_last_resort]
        at_first = [one for one in usable if one not in (*later, *last)] or usable
        if LEARNED in later and (self._is_of_other_kind or self._is_range_scan):
            family = self._mirror()
            if family:
                at_first, later, last = list(family), [], []
        self._total = 2 * len(at_first) + 5 * (LONGER_LOOK + len(later + last)) + 1
        glance = self._trials(GLANCE)
        risk = self._look(glance, at_first)
        weights = self._best([risk])
        surface = surface_kind(glance.part.mesh.with_vertices(glance.positions(at_first, weights)))
        shortlist = self._shortlist(risk, weights, LONGER_LOOK)
        members = [at_first[k] for k in shortlist]
        weights = weights[shortlist]
        tried = len(at_first)
        is_sharp = self._may_be_sharp(surface)
        later += last if is_sharp else []
        later = [one for one in later if one not in members]
        members += later
        weights = np.concatenate([weights, np.zeros(len(later))])
        tried += len(later)
        study = self._trials(PART)
        if self.added == MIRRORED:
            first = study.positions([self.pilot], np.ones(1))
        else:
            first = study.positions(members, weights)
        again = study.simulate(members, first)
        weights = self._best([again.risk()])
        # Only the best are simulated twice.
        shortlist = self._shortlist(again.risk(), weights, SECOND_LOOK)
        n_simulated = len(members)
        members, weights = [members[k] for k in shortlist], weights[shortlist]
        judges: list[tuple[SteinRisk | SimulatedRisk, float]] = []
        if self._is_gaussian and self._doubt > 0.0 and not is_sharp:
            judges.append((study.by_stein(members, first, PROBES), self._doubt))
            both = [judges[0][0].risk().counted(self._doubt), again.risk().of(shortlist)]
            weights = self._best(both)
        if self.added != MIRRORED:
            first = study.positions(members, weights)
        # The same members on the same mesh would give the same.
        is_known = self.added == MIRRORED and len(members) == n_simulated
        last_one = again if is_known else study.simulate(members, first)
        judges.append((last_one, 1.0))
        self.unit = last_one.level if self.added == MIRRORED else self.level
        risks = _risks(judges)
        final = self._prune(members, risks)
        rows = self._by_level(study.part, judges, final)
        self._finish()
        return self._choice(members, final, rows, risks, surface, tried)

    def _look(self, glance: CandidateRuns, candidates: Sequence[Candidate]) -> Risk:
        """The risk of all candidates, by Stein's lemma where it holds."""
        if self._is_gaussian:
            first = glance.positions([SMOOTHER], np.ones(1))
            return glance.by_stein(candidates, first, 1).risk()
        pilot = self.pilot if self.added == MIRRORED else ROBUST
        first = glance.positions([pilot], np.ones(1))
        return glance.simulate(candidates, first).risk()

    def _by_level(
        self, part: Part, judges: Sequence[tuple[SteinRisk | SimulatedRisk, float]], weights: Floats
    ) -> Floats:
        """Weights (levels, k) of the members that ``weights`` (k,) has, for places of each level
        of local noise; one row where noise is the same everywhere."""
        rows = np.tile(weights, (max(len(self.levels), 1), 1))
        kept = np.flatnonzero(weights)
        if not self.levels or not len(kept):
            return rows
        for row, judged in zip(rows, level_masks(part, self.local, self.levels), strict=True):
            if judged.sum() >= FEWEST_JUDGED:
                some = self._best([risk.of(kept.tolist()) for risk in _risks(judges, judged)])
                row[kept] = np.where(some >= LEAST_WEIGHT, some, 0.0)
        return rows

    def _trials(self, size: int) -> CandidateRuns:
        """Runs on a sample of about so many vertices; kept where that is the whole mesh."""
        part = select_patch(self.mesh, size)
        if self._whole is not None and part.numbers is None:
            return self._whole
        trials = CandidateRuns(part, self.model.on_part(part.numbers), self.added, self._step)
        if part.numbers is None:
            self._whole = trials
        return trials

    @property
    def _is_gaussian(self) -> bool:
        """Whether Stein's lemma holds for the noise."""
        return self.added == DRAWN and self.model.is_gaussian

    @property
    def _is_of_other_kind(self) -> bool:
        """Whether the noise is not surely white, and may differ from its model."""
        character = self.noise.character
        is_plain = character.kind in PLAIN_KINDS and character.confidence >= SURE_KIND
        return not is_plain and not self.is_impulsive

    @property
    def _is_range_scan(self) -> bool:
        """Whether weak white noise is but the part of a scanner's that neighbours do not share."""
        noise = self.noise
        is_weak = noise.mean_edges < WEAK and self._width > SURE and not self.is_impulsive
        return is_weak and not noise.is_uneven and is_seen_from_one_side(self.mesh)

    def _mirror(self) -> Sequence[Candidate]:
        """Let simulations add what the learned filter removes, where that is noise.

        On a machined surface it is, of whatever kind.  Elsewhere it is believed to be where no draw
        of the noise is like it.  Smooth surfaces bear a farther reach, and what keeps more of the
        scan only keeps noise: candidates are returned that are then the only ones, or none.
        """
        trials = self._trials(GLANCE)
        moved = trials.positions([LEARNED], np.ones(1))
        surface = surface_kind(trials.part.mesh.with_vertices(moved))
        character, is_other = self.noise.character, self._is_of_other_kind
        is_doubtful = (
            is_other
            and character.kind in DOUBTFUL_KINDS
            and not self.noise.is_uneven
            and (
                character.confidence < SURE_KIND
                or character.kind == STAIRCASE
                or surface == TEXTURED
            )
        )
        self._is_machined = is_other and surface == MACHINED
        is_smooth = surface == ORGANIC and (is_doubtful or self._is_range_scan)
        if not (self._is_machined or is_doubtful or is_smooth):
            return ()
        self.added, self._whole = MIRRORED, None
        # The added noise does not follow the level: doubt about texture does not reduce it.
        edge = self.mesh.mean_edge_length
        self.level = max(self.level, self.noise.mean_edges * self.wished * edge)
        self.model = self.model.at_level(self.level)
        if not is_smooth:
            return ()
        # The level along an axis is that of all the noise.
        is_whole = character.kind in ("view", "quantised")
        family = (LEARNED, FARTHER[0]) if is_whole else FARTHER
        self.pilot = family[0]
        return family

    @property
    def _doubt(self) -> float:
        """Weight of Stein's risk against that of a simulation, 0 to 1.

        A simulation scatters less, but treats all that the first result removed as noise:
        the wider the noise's interval, the more of that may be texture.
        """
        return min(max((self._width - SURE) / (UNSURE - SURE), 0.0), 1.0)

    @property
    def _width(self) -> float:
        """How far below its level the noise may be, in parts of the level."""
        if self.noise.is_uneven:
            # The interval reaches to the quietest region.
            return UNEVEN_WIDTH
        level = self.noise.mean_edges
        return (level - self.noise.low) / level if level > 0.0 else 0.0

    def _may_be_sharp(self, surface: str) -> bool:
        return surface == MACHINED or self._is_machined or self._noise_edges(self.mesh) >= HEAVY

    def _is_usable(self, candidate: Candidate) -> bool:
        """Whether one may be chosen: its run over the mesh fits, and trust has an effect."""
        spare = self.allowance * (1.0 - SEARCH)
        method = methods.find(candidate.method)
        if self.mesh.trust is not None:
            return method.has_data_term(method.validate(candidate.given))
        if not self._is_allowed(method, method.validate(candidate.settings(WEAK))):
            return False
        return candidate.cost * len(self.mesh.vertices) <= spare

    def _noise_edges(self, mesh: Mesh) -> float:
        """The noise in mean edge lengths, with as many digits as are worth writing down."""
        return float(round(self.level / mesh.mean_edge_length, 4))

    def _best(self, risks: Sequence[Risk]) -> Floats:
        if self.mesh.trust is not None:
            # Trust scales the pull of one method, not a blend.
            weights = np.zeros(len(risks[0].drift))
            weights[int(np.argmin(self._scores(risks)))] = 1.0
            return weights
        # Rounded at once: what the last digits of a solver are must not show in what follows.
        return round_weights(best_weights(risks, self.slopes, self.drift))

    def _scores(self, risks: Sequence[Risk]) -> Floats:
        """How the candidates do by themselves; less is better."""
        score = np.zeros(len(risks[0].drift))
        for risk in risks:
            places, tilts = risk.log_errors(FLOOR)
            score += risk.importance * ((1.0 - self.slopes) * places + self.slopes * tilts)
        return score

    def _shortlist(self, risk: Risk, weights: Floats, count: int) -> list[int]:
        """The members of a first blend, and so many of the best by themselves."""
        best = np.argsort(self._scores([risk]), kind="stable")[:count]
        return sorted({*np.flatnonzero(weights >= 0.01).tolist(), *best.tolist()})

    def _prune(self, members: Sequence[Candidate], risks: Sequence[Risk]) -> Floats:
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
        rows: Floats,
        risks: Sequence[Risk],
        surface: str,
        tried: int,
    ) -> Choice:
        edge = self.mesh.mean_edge_length
        unit = self.unit / edge
        counted = [risk for risk in risks if risk.importance > 0.0]
        # Stein's estimate scatters about small errors, and may be below zero.
        alone = np.maximum(np.max([risk.positions.singles() for risk in counted], axis=0), 0.0)
        together = max(*(risk.positions.at(weights) for risk in counted), 0.0)
        order = np.argsort(self._scores(risks), kind="stable").tolist()
        beside = [k for k in order if weights[k] < 1.0][:3]
        made = build_recipe(members, rows, self._noise_edges(self.mesh), self.levels, self.relax)
        choice = Choice(
            made.method,
            made.parameters,
            f"{describe_noise(self.noise)}; {surface}; {made.label}",
            surface,
            self.noise,
        )
        if made.method == NONE:
            choice = choose_least(self.noise, self.wishes, f"{surface}; {HARM}", surface, True)
        return dataclasses.replace(
            choice,
            risk=together**0.5 * unit,
            tried=tried,
            runners_up=tuple((members[k].label, float(alone[k]) ** 0.5 * unit) for k in beside),
        )

    def _step(self) -> None:
        self._done += 1
        if self._on_step is not None:
            self._on_step(min(self._done, self._total - 1), self._total)

    def _finish(self) -> None:
        if self._on_step is not None:
            self._on_step(self._total, self._total)


def _risks(
    judges: Sequence[tuple[SteinRisk | SimulatedRisk, float]], judged: Flags | None = None
) -> list[Risk]:
    """The risks by weighted estimators, over the ``judged`` vertices (m,)."""
    return [judge.risk(judged).counted(importance) for judge, importance in judges]
