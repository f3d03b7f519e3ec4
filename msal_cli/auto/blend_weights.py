"""Weights of a blend whose estimated error is least, and the levels of noise that they follow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from msal_cli.arrays import Flags, Floats
from msal_cli.auto.risk import Risk
from msal_cli.auto.sample_patch import Part

FLOOR = 0.02
"""Estimated errors below this share of the input's count as equal: they are mostly scatter."""

ROUNDS = 8
"""Rounds in which the shares of places and slopes follow the errors that are reached."""

RIDGE = 1e-4
"""Added to squared weights: filters that do nearly the same share a weight."""

TOLERANCE = 1e-9
"""Of gradients, by which a weight is let in."""


def best_weights(risks: Sequence[Risk], slopes: float, drift: float = 0.0) -> Floats:
    """Weights (k,) >= 0 of sum <= 1 for the k filters; what is left belongs to the input.

    What is least is the sum over ``risks``, each times its importance, of

        (1 - slopes) log(error of positions) + slopes log(error of slopes)

    so that a tenth off either counts alike however large they are.  It is found as a chain of
    quadratic problems, each with the shares 1 / error of the one before.

    Parameters
    ----------
    slopes : 0 to 1, how much slopes count beside positions.
    drift : how much the squared mean move of the surface counts, in parts of the positions' error.
    """
    count = len(risks[0].drift)
    shares = [(risk.importance * (1.0 - slopes), risk.importance * slopes) for risk in risks]
    weights = np.zeros(count)
    for _ in range(ROUNDS):
        gram = RIDGE * np.eye(count)
        gain = np.zeros(count)
        for risk, (of_positions, of_slopes) in zip(risks, shares, strict=True):
            gram += of_positions * risk.positions.gram + of_slopes * risk.slopes.gram
            gram += of_positions * drift * np.outer(risk.drift, risk.drift)
            gain += of_positions * risk.positions.gain + of_slopes * risk.slopes.gain
        weights = least_over_simplex(gram, gain)
        shares = [
            (
                risk.importance * (1.0 - slopes) / max(risk.positions.at(weights), FLOOR),
                risk.importance * slopes / max(risk.slopes.at(weights), FLOOR),
            )
            for risk in risks
        ]
        total = sum(sum(pair) for pair in shares)
        shares = [(places / total, tilts / total) for places, tilts in shares]
    return weights


def hedge(gain: float, moved: float) -> float:
    """The share of a result that is not much worse whether it removes noise or texture, 0 to 1.

    In parts of the squared noise, a share s of a blend with ``gain`` w'b and ``moved`` w'Mw has the
    squared error s^2 w'Mw if all that it removes is texture, and 1 - 2 s w'b + s^2 w'Mw if it is
    noise.  The larger of both is least; of a filter that removes noise and nothing else a half.
    """
    if gain <= 0.0 or moved <= 0.0:
        return 0.0
    return round(min(0.5 / gain, gain / moved, 1.0), 2)


def least_over_simplex(gram: Floats, gain: Floats) -> Floats:
    """The w (k,) with w >= 0 and sum(w) <= 1 for which w'Mw - 2 w'b is least; M positive definite.

    An active set: weights enter one by one where that helps most, and leave where they would
    become negative.
    """
    count = len(gain)
    # The input is one more filter, which does nothing: then the sum is 1.
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
    """The least where only ``inside`` may differ from zero, and adds up to 1, signs aside."""
    rows = np.array(inside)
    n = len(rows)
    system = np.zeros((n + 1, n + 1))
    system[:n, :n] = matrix[np.ix_(rows, rows)]
    # The input's row is empty; this keeps the system regular.
    system[np.arange(n), np.arange(n)] += 1e-12
    system[:n, n] = 1.0
    system[n, :n] = 1.0
    solved: Floats = np.linalg.solve(system, np.append(vector[rows], 1.0))[:n]
    return solved


def round_weights(weights: Floats, steps: int = 100) -> Floats:
    """The same in whole hundredths, with the sum that the sum itself rounds to.

    What is written down is short, and last digits of the arithmetic do not show in it: parts of a
    step are compared in millionths.
    """
    exact = np.round(weights * steps, 6)
    parts = np.floor(exact)
    missing = round(round(float(weights.sum()) * steps, 6)) - int(parts.sum())
    # The largest remainders first; equal ones in order.
    order = np.argsort(np.round(parts - exact, 6), kind="stable")
    parts[order[: max(missing, 0)]] += 1
    hundredths: Floats = parts / steps
    return hundredths


# Levels of local noise for which a blend has weights of their own


QUANTILES = (0.1, 0.5, 0.9)
"""Of local levels, for which weights are chosen."""

MIN_RATIO, MIN_GAP = 1.25, 0.01
"""By how much they have to differ, as a ratio and in mean edge lengths."""

MIN_JUDGED = 200
"""Vertices that a level of local noise needs for weights of its own."""


def spread_levels(local: Floats) -> tuple[float, ...]:
    """Levels of local noise (n,) for quiet, usual and loud places; none if they differ little."""
    found: list[float] = []
    for level in np.quantile(local, QUANTILES).tolist():
        if not found or level > MIN_RATIO * found[-1] + MIN_GAP:
            found.append(float(round(level, 3)))
    return tuple(found) if len(found) > 1 else ()


def level_masks(part: Part, local: Floats, levels: Sequence[float]) -> list[Flags]:
    """Which vertices (m,) of a part are judged for each of the levels: those whose local noise,
    ``local`` (n,) over the whole mesh, is nearest to it."""
    own = local if part.numbers is None else local[part.numbers]
    nearest = np.abs(own[:, None] - np.array(levels)).argmin(axis=1)
    return [part.judged & (nearest == level) for level in range(len(levels))]
