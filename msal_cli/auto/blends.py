"""Blends of candidates: the weights with the smallest estimated error, weights by local level of
noise, blends as methods with parameters and labels, and weaker and stronger ones.

A mesh with hardly any noise is not changed, unless more smoothing than the automatic choice is
requested: then it gets some, by the mildest setting for the upper end of the noise's interval.  For
other wishes the reason names the option that smooths nevertheless.

Less smoothing than the choice is a share of its displacements, which moves less and keeps more by
construction.  For more, a stronger filter is mixed in until vertices move farther.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from msal_cli import methods
from msal_cli.analysis.noise_estimate import NoiseLevel, local_levels
from msal_cli.arrays import Flags, Floats
from msal_cli.auto import NONE, Choice, Wishes
from msal_cli.auto.candidates import FARTHER, Candidate, wiener_al
from msal_cli.auto.risk import CandidateRuns, Risk, count_relaxing
from msal_cli.auto.samples import NoiseModel, Part, build_model
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods._sliding import even_out, move_to_lines

FLOOR = 0.02
"""Estimated errors below this share of the input's count as equal, because they scatter as much."""

ROUNDS, RIDGE, TOLERANCE = 8, 1e-4, 1e-9
"""Iterations that update the weights of positions and slopes by the errors reached; regularization
of the weights, by which nearly equal filters share a weight; and difference of gradients above
which a weight enters the active set."""


def best_weights(risks: Sequence[Risk], slopes: float) -> Floats:
    """Weights (k,) >= 0 with sum <= 1 of the k filters; the rest is the weight of the input.

    They minimize the sum over ``risks`` of

        (1 - slopes) log(error of positions) + slopes log(error of slopes)

    so that equal relative changes of either count equally.  The minimum is found by a sequence of
    quadratic problems, each weighted by 1 / error of the previous one.

    Parameters
    ----------
    slopes : 0 to 1, the weight of slopes; positions have the rest.
    """
    count = len(risks[0].positions.gain)
    shares = [(1.0 - slopes, slopes)] * len(risks)
    weights = np.zeros(count)
    for _ in range(ROUNDS):
        gram = RIDGE * np.eye(count)
        gain = np.zeros(count)
        for risk, (of_positions, of_slopes) in zip(risks, shares, strict=True):
            gram += of_positions * risk.positions.gram + of_slopes * risk.slopes.gram
            gain += of_positions * risk.positions.gain + of_slopes * risk.slopes.gain
        weights = least_over_simplex(gram, gain)
        shares = [
            (
                (1.0 - slopes) / max(risk.positions.at(weights), FLOOR),
                slopes / max(risk.slopes.at(weights), FLOOR),
            )
            for risk in risks
        ]
        total = sum(sum(pair) for pair in shares)
        shares = [(places / total, tilts / total) for places, tilts in shares]
    return weights


def hedge(risks: Sequence[Risk], weights: Floats) -> float:
    """The share of a blend, 0 to 1, with the smallest error in the worse case, noise or texture:
    the smaller one of positions and slopes, in the mean of the ``risks``.

    In units of the squared noise, a share s of a blend with weights w (k,) has the squared error
    s^2 w'Mw if all that it removes is texture, and 1 - 2 s w'b + s^2 w'Mw if it is noise.  The
    larger of both is minimized; for a filter that removes noise and nothing else s is 1/2.
    """
    share = 1.0
    for measure in ("positions", "slopes"):
        counted = [getattr(risk, measure) for risk in risks]
        gain = float(np.mean([weights @ quadratic.gain for quadratic in counted]))
        moved = float(np.mean([weights @ quadratic.gram @ weights for quadratic in counted]))
        if gain <= 0.0 or moved <= 0.0:
            return 0.0
        share = min(share, round(min(0.5 / gain, gain / moved), 2))
    return share


def least_over_simplex(gram: Floats, gain: Floats) -> Floats:
    """The w (k,) with w >= 0 and sum(w) <= 1 that minimizes w'Mw - 2 w'b; M is positive definite.

    An active set method: weights enter one by one where the gradient is steepest, and leave when
    they would become negative.
    """
    count = len(gain)
    # The input is one more filter with zero displacements, so that the sum of all weights is 1.
    matrix = np.zeros((count + 1, count + 1))
    matrix[:count, :count] = gram
    vector = np.append(gain, 0.0)
    weights = np.zeros(count + 1)
    weights[count] = 1.0
    inside = [count]
    for _ in range(8 * (count + 1)):
        gradient = matrix @ weights - vector
        level = float(weights @ gradient)
        entering = int(np.argmin(gradient))
        if gradient[entering] >= level - TOLERANCE or entering in inside:
            break
        inside.append(entering)
        while True:
            wanted = _least_on(matrix, vector, inside)
            if (wanted >= 0.0).all():
                weights[:] = 0.0
                weights[inside] = wanted
                break
            now = weights[inside]
            falling = wanted < 0.0
            steps = now[falling] / (now[falling] - wanted[falling])
            step = float(steps.min())
            weights[inside] = now + step * (wanted - now)
            leaving = np.flatnonzero(falling)[int(np.argmin(steps))]
            weights[inside[leaving]] = 0.0
            del inside[leaving]
    return np.maximum(weights[:count], 0.0)


def _least_on(matrix: Floats, vector: Floats, inside: Sequence[int]) -> Floats:
    """The minimum with sum 1 where only the weights ``inside`` may differ from 0, of any sign."""
    rows = np.array(inside)
    n = len(rows)
    system = np.zeros((n + 1, n + 1))
    system[:n, :n] = matrix[np.ix_(rows, rows)]
    # The row of the input is zero; this keeps the system regular.
    system[np.arange(n), np.arange(n)] += 1e-12
    system[:n, n] = 1.0
    system[n, :n] = 1.0
    solved: Floats = np.linalg.solve(system, np.append(vector[rows], 1.0))[:n]
    return solved


def round_weights(weights: Floats, steps: int = 100) -> Floats:
    """The weights rounded to 1 / ``steps``, with the rounded sum of all.

    Recipes are then short and free of rounding errors: remainders are compared in millionths.
    """
    exact = np.round(weights * steps, 6)
    parts = np.floor(exact)
    missing = round(round(float(weights.sum()) * steps, 6)) - int(parts.sum())
    # The largest remainders first; equal ones in their order.
    order = np.argsort(np.round(parts - exact, 6), kind="stable")
    parts[order[: max(missing, 0)]] += 1
    hundredths: Floats = parts / steps
    return hundredths


# Levels of local noise, each with its own weights


QUANTILES, MIN_JUDGED = (0.1, 0.5, 0.9), 200
"""Quantiles of the local levels that have their own weights, and the vertices that each needs."""

MIN_RATIO, MIN_GAP = 1.25, 0.01
"""Smallest ratio of consecutive levels, and smallest additional difference in mean edge lengths."""


def spread_levels(local: Floats) -> tuple[float, ...]:
    """Levels of quiet, usual and noisy regions by local levels (n,); empty if nearly equal."""
    found: list[float] = []
    for level in np.quantile(local, QUANTILES).tolist():
        if not found or level > MIN_RATIO * found[-1] + MIN_GAP:
            found.append(float(round(level, 3)))
    return tuple(found) if len(found) > 1 else ()


def level_masks(part: Part, local: Floats, levels: Sequence[float]) -> list[Flags]:
    """For each level the vertices (m,) of a part that are evaluated for it: those whose local
    level, ``local`` (n,) over the whole mesh, is nearest to it."""
    nearest = np.abs(local[part.numbers][:, None] - np.array(levels)).argmin(axis=1)
    return [part.judged & (nearest == level) for level in range(len(levels))]


# What is known of a mesh before candidates run on it

SURE_LINE = 0.95
"""Confidence in noise along an axis from which vertices move only along it: most scans along the
view have more; a raw scan with white noise, where it does harm, has 0.90."""


@dataclass(frozen=True, eq=False)
class Case:
    """A mesh as methods get it, and the noise on it."""

    mesh: Mesh  # with its triangles relaxed by ``relax`` passes, for isotropic noise
    model: NoiseModel  # the noise, along the normals or an axis
    # local, levels: local levels (n,), and those with their own weights; empty for uniform noise
    local: Floats
    levels: tuple[float, ...]
    # relax, evened: passes that relaxed the triangles, and displacements by them (n, 3), file units
    relax: int
    evened: Floats
    line: tuple[float, float, float] | None  # axis of the noise; None if none is certain


def build_case(mesh: Mesh, noise: NoiseLevel) -> Case:
    """The case for a mesh: its noise model, relaxed triangles and local levels."""
    model = build_model(mesh, noise)
    relax, local = 0, np.empty(0)
    levels: tuple[float, ...] = ()
    # Trust scales the pull of one method, not a blend.
    if mesh.trust is None:
        # Relaxing the triangles removes tangential noise; the rest is along the normals.
        relax = count_relaxing(mesh, model)
        if model.shares is not None:
            local = local_levels(mesh)
            levels = spread_levels(local[mesh.topology.has_ring])
    relaxed, character = even_out(mesh, relax), noise.character
    line = character.axis if character.confidence >= SURE_LINE else None
    evened = relaxed.vertices - mesh.vertices
    return Case(relaxed, model.along_normals(), local, levels, relax, evened, line)


# Blends as methods, and in words


PLAIN = ("none", "white", "impulsive", "unknown")
"""Kinds of noise that are described by the level alone."""

MIN_NOISE = 0.05
"""Smallest level of noise, mean edge lengths, for which a mesh is smoothed on request."""

STRENGTH, SHAPE = 1.2, 1.25
"""Factors of the assumed noise for each step of ``Wishes.strength``, and if the smooth shape is to
be kept."""


def describe_noise(noise: NoiseLevel, is_unsure: bool) -> str:
    """The noise in words, such as ``noise 0.21 e, shared over two rings``; if it ``is_unsure``
    whether there is any, ``noise of 0.08 e or texture``."""
    if is_unsure:
        return f"noise of {noise.mean_edges:.2g} e or texture"
    if noise.is_impulsive:
        text = f"impulsive noise {noise.rms_edges:.2g} e"
    else:
        text = f"noise {noise.mean_edges:.2g} e"
    character = noise.character
    return text if character.kind in PLAIN else f"{text}, {character.words}"


def describe_rest(estimate: NoiseLevel, noise: NoiseLevel) -> str:
    """The reason in words for negligible ``noise``, which is the ``estimate`` or was assumed
    instead: ``noise 0 e; clean``."""
    if noise is estimate and estimate.is_unsure:
        most = max(reading.level for reading in estimate.readings)
        return f"noise of {most:.2g} e or texture"
    why = "clean" if noise is estimate else "assumed to be texture"
    return f"noise {noise.mean_edges:.2g} e; {why}"


def build_recipe(
    members: Sequence[Candidate],
    weights: Floats,
    noise_edges: float,
    share: float = 1.0,
    case: Case | None = None,
) -> tuple[str, dict[str, Any], str]:
    """The blend of ``members`` by weights (k,) in hundredths, the largest first, as a method or
    ``NONE``, all of its parameters, and its label.

    ``noise_edges`` is the noise that members are given, mean edge lengths of the mesh, and
    ``share`` the part of the displacements that is applied.  A ``case`` with levels has weights
    (levels, k); its triangles are relaxed first, and vertices move along its line; see the method
    ``blend``.  A single member of weight 1 becomes its method alone, and zero weights become
    ``NONE``.
    """
    levels, relax, line = (case.levels, case.relax, case.line) if case else ((), 0, None)
    rows = np.atleast_2d(weights)
    largest = rows.max(axis=0)
    used = sorted(np.flatnonzero(largest).tolist(), key=lambda k: (-largest[k], k))
    if not used or not share:
        return NONE, {}, "left as it is"
    settings = [members[k].settings(noise_edges) for k in used]
    first = members[used[0]]
    if (rows[:, used[0]] == 1.0).all() and not relax and share == 1.0 and line is None:
        return first.method, methods.find(first.method).validate(settings[0]), first.label
    from msal_cli.methods.blend import format_levels, format_line, format_members

    if len(rows) > 1 and (rows == rows[0]).all():
        rows, levels = rows[:1], ()
    listed = [
        (rows[:, k].tolist(), members[k].method, given)
        for k, given in zip(used, settings, strict=True)
    ]
    given = {
        "members": format_members(listed),
        "levels": format_levels(levels),
        "relax": relax,
        "line": "" if line is None else format_line(line),
        "share": share,
    }
    label = " + ".join(f"{_percent(rows[:, k])} {members[k].label}" for k in used)
    rest = 1.0 - rows.sum(axis=1)
    if rest.max() > 0.005:
        label += f" + {_percent(rest)} as it was"
    if levels:
        label += " where the noise is " + "/".join(f"{level:.2g}" for level in levels) + " e"
    if relax:
        label += ", after triangles were evened out"
    if line is not None:
        label += ", along the view"
    if share < 1.0:
        label = f"{share:.0%} of what {label} moves"
    return "blend", methods.find("blend").validate(given), label


def _percent(weights: Floats) -> str:
    """Equal weights as 40%, others as 0/20/60%."""
    if (weights == weights[0]).all():
        return f"{weights[0]:.0%}"
    return "/".join(f"{100.0 * weight:.0f}" for weight in weights) + "%"


def choose_least(noise: NoiseLevel, wishes: Wishes, what: str, surface: str | None) -> Choice:
    """The choice for a mesh that each filter would harm: no change, unless the ``wishes`` are for
    more smoothing.  ``what`` begins the reason, such as ``noise 0 e; clean``."""
    if wishes.strength <= 0.0 and wishes.keep != "shape":
        is_wish = wishes.keep == "edges" and wishes.strength == 0.0
        hint = "; --strength 1 smooths it all the same" if is_wish else ""
        return Choice(NONE, {}, f"{what}; left as it is{hint}", surface, noise)
    level = max(noise.high, noise.mean_edges, MIN_NOISE) * STRENGTH**wishes.strength
    level *= SHAPE if wishes.keep == "shape" else 1.0
    level = round(level, 4)
    candidate = wiener_al(level)
    return Choice(
        candidate.method,
        methods.find(candidate.method).validate(candidate.settings(level)),
        f"{what}; smoothed for noise of {level:.2g} e, as requested; {candidate.label}",
        surface,
        noise,
    )


# More smoothing than the choice.  The choice is made once, without the wish.  The weight of the
# filter that is mixed in is found by the displacements of the mixture, so strength always counts.

MORE, STRONGER_TIMES = 0.03, (1.5, 2.0, 3.0, 5.0, 8.0)
"""Relative increase of the displacements for each step of ``Wishes.strength`` above 0: the noise is
nearly gone, and 3 % more removes a quarter more of shape and texture.  And levels of noise that AL
with the Wiener schedule is given for it, over the estimate."""

STRENGTH_PART = 32_000
"""Vertices of the part on which displacements are compared, as many as there is time for: on a
smaller part they may grow and on the mesh become less."""


def stronger_candidates(level: float) -> list[Candidate]:
    """Filters that move vertices farther than those for noise of ``level`` mean edge lengths."""
    plain = [dataclasses.replace(wiener_al(times * level), times=times) for times in STRONGER_TIMES]
    return [FARTHER, *plain]


def strengthen(base: Floats, moves: Sequence[Floats], strength: float) -> tuple[int, float]:
    """Choose one of ``moves``, (m, 3) each, to mix into ``base`` (m, 3), so that displacements grow
    by the share ``MORE`` for each step of ``strength``; returns its index and weight.

    Both the mean and the root mean square have to grow.  Of the moves that reach this, the one
    whose mixture differs least from ``base`` is chosen.  If none does, it is the one with the
    largest mean, by the weight with which the mean is half of ``strength`` of the way to that, or 0
    if its mean is not larger than that of ``base``.
    """
    least = _mean_and_rms(base)
    target = (1.0 + MORE * strength) * least
    weights = [_weight_to_reach(base, move, target) for move in moves]
    found = [
        (float(_mean_and_rms(weight * (move - base))[1]), k, weight)
        for k, (move, weight) in enumerate(zip(moves, weights, strict=True))
        if weight is not None
    ]
    if found:
        _, k, weight = min(found)
        return k, weight
    means = [_mean_and_rms(move)[0] for move in moves]
    k = int(np.argmax(means))
    if means[k] <= least[0]:
        return k, 0.0
    # A mixture of two filters may move vertices less than either.
    wanted = least[0] + 0.5 * strength * (means[k] - least[0])
    return k, _weight_to_reach(base, moves[k], np.array([wanted, 0.0])) or 1.0


def _weight_to_reach(base: Floats, move: Floats, target: Floats) -> float | None:
    """The smallest weight of ``move``, in hundredths from 0.01, with which the mean and root mean
    square of the displacements reach ``target`` (2,); None if no weight does."""
    for percent in range(1, 101):
        weight = 0.01 * percent
        if (_mean_and_rms(base + weight * (move - base)) >= target).all():
            return weight
    return None


def _mean_and_rms(moves: Floats) -> Floats:
    """Mean and root mean square (2,) of the lengths of ``moves`` (m, 3)."""
    if not len(moves):
        return np.zeros(2)
    squares = (moves * moves).sum(axis=1)
    return np.array([np.sqrt(squares).mean(), np.sqrt(squares.mean())])


def mix_in_stronger(
    runs: CandidateRuns,
    members: Sequence[Candidate],
    rows: Floats,
    stronger: Sequence[Candidate],
    strength: float,
    case: Case,
) -> tuple[list[Candidate], Floats]:
    """Add one of the ``stronger`` candidates to the ``members`` and their weights (levels, k), so
    that vertices move as much farther as the ``strength`` asks for.

    ``runs`` are on a part of the mesh of the ``case``, of ``STRENGTH_PART`` vertices.
    """
    if not stronger:
        return list(members), rows
    part = runs.part
    before = case.evened[part.numbers]
    scanned = part.mesh.with_vertices(part.mesh.vertices - before)
    base = np.zeros_like(before)
    for k in np.flatnonzero(rows.any(axis=0)).tolist():
        weight = rows[0, k]
        if case.levels:
            weight = np.interp(case.local[part.numbers], case.levels, rows[:, k])[:, None]
        base += weight * runs.moves(members[k])

    def whole(moves: Floats) -> Floats:
        """What vertices move from the scan, with all that a blend does."""
        moves = before + moves
        if case.line is not None:
            start = scanned.vertices
            moves = move_to_lines(scanned, start + moves, np.array(case.line)) - start
        return moves[part.judged]

    k, share = strengthen(whole(base), [whole(runs.moves(each)) for each in stronger], strength)
    mixed = np.hstack([(1.0 - share) * rows, np.full((len(rows), 1), share)])
    weights = np.stack([round_weights(row, 1000) for row in mixed])
    return [*members, stronger[k]], weights
