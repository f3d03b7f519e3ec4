"""Choices in the making: blends as methods with parameters, sentences, milder and stronger choices.

A mesh with hardly any noise is left as it is.  An explicit wish counts all the same: more smoothing
than the automatic choice means some smoothing, by the mildest setting for the upper end of the
noise's interval.  A wish that does not mean smoothing gets a reason, and the option that smooths
in spite of it.

Less than a choice is a share of what it moves, which moves less and keeps more by construction.
More is a stronger filter, mixed in until vertices move farther.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from msal_cli import methods
from msal_cli.analysis.noise_estimate import NoiseLevel
from msal_cli.arrays import Floats
from msal_cli.auto.candidates import FARTHER, Candidate, wiener_al
from msal_cli.auto.wishes import NONE, Choice, Wishes
from msal_cli.structs import dataclass

PLAIN = ("none", "white", "impulsive", "unknown")
"""Kinds of noise that need no words beside the level."""

MIN_NOISE = 0.05
"""Mean edge lengths: noise that a mesh is smoothed for at least, where smoothing is asked for."""

STRENGTH = 1.2
"""Factor of the assumed noise for each step of ``Wishes.strength``."""

LESS, KEEP_TEXTURE = 0.2, 0.9
"""By how much less each step of ``Wishes.strength`` below 0 moves vertices, in parts of the choice;
and the share of it that keeps texture."""

SHAPE = 1.25
"""The same where the smooth shape is to be kept."""


def wished_share(wishes: Wishes) -> float:
    """How much of a choice without them ``wishes`` ask for, above 0 to 1."""
    share = 1.0 + LESS * min(wishes.strength, 0.0)
    return share * (KEEP_TEXTURE if wishes.keep == "texture" else 1.0)


def describe_noise(noise: NoiseLevel, is_unsure: bool) -> str:
    """Such as ``noise 0.21 e, shared over two rings``; where it ``is_unsure`` whether there is any,
    ``noise of 0.08 e or texture``."""
    if is_unsure:
        return f"noise of {noise.mean_edges:.2g} e or texture"
    if noise.is_impulsive:
        text = f"impulsive noise {noise.rms_edges:.2g} e"
    else:
        text = f"noise {noise.mean_edges:.2g} e"
    character = noise.character
    return text if character.kind in PLAIN else f"{text}, {character.words}"


def describe_rest(estimate: NoiseLevel, noise: NoiseLevel) -> str:
    """Why there is nothing to remove: ``noise``, the ``estimate`` or what was assumed instead, is
    negligible."""
    if noise is not estimate:
        return "assumed to be texture"
    if not estimate.is_unsure:
        return "clean"
    most = max(reading.level for reading in estimate.readings)
    return f"noise of {most:.2g} e or texture"


@dataclass(frozen=True)
class Recipe:
    """A method, or ``NONE``, with all of its parameters, and its label."""

    method: str
    parameters: dict[str, Any]
    label: str


def build_recipe(
    members: Sequence[Candidate],
    weights: Floats,
    noise_edges: float,
    levels: Sequence[float] = (),
    relax: int = 0,
    share: float = 1.0,
) -> Recipe:
    """The blend of ``members`` by weights (k,), in hundredths; the largest first.

    ``noise_edges`` is the noise that members are given, mean edge lengths of the mesh.  With
    ``levels`` of local noise, mean edge lengths, weights are (levels, k).  ``relax`` is how many
    passes even out the triangles before, and ``share`` how much of the way to the result is gone;
    see the method ``blend``.  One member of weight 1 is its method by itself, and no
    weight at all is ``NONE``.
    """
    rows = np.atleast_2d(weights)
    largest = rows.max(axis=0)
    used = sorted(np.flatnonzero(largest).tolist(), key=lambda k: (-largest[k], k))
    if not used or not share:
        return Recipe(NONE, {}, "left as it is")
    settings = [members[k].settings(noise_edges) for k in used]
    first = members[used[0]]
    if (rows[:, used[0]] == 1.0).all() and not relax and share == 1.0:
        return Recipe(first.method, methods.find(first.method).validate(settings[0]), first.label)
    from msal_cli.methods.blend import format_levels, format_members

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
    if share < 1.0:
        label = f"{share:.0%} of what {label} moves"
    return Recipe("blend", methods.find("blend").validate(given), label)


def _percent(weights: Floats) -> str:
    """One weight as 40%, more of them as 0/20/60%."""
    if (weights == weights[0]).all():
        return f"{weights[0]:.0%}"
    return "/".join(f"{100.0 * weight:.0f}" for weight in weights) + "%"


def choose_least(noise: NoiseLevel, wishes: Wishes, why: str, surface: str) -> Choice:
    """The choice for a mesh where ``why`` no filter is worth its harm, such as ``clean``: only a
    wish for more smoothing smooths it."""
    what = f"noise {noise.mean_edges:.2g} e; {why}"
    if wishes.strength <= 0.0 and wishes.keep != "shape":
        is_less = wishes.strength < 0.0 or wishes.keep == "texture"
        is_wish = (wishes.prefer, wishes.keep) != ("balanced", None) and not is_less
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


# More than the choice.  The choice is made once, without the wish.  What is mixed in is weighed by
# what the mixture moves, so that more strength moves vertices farther, whatever the filters do.

MORE = 0.03
"""By how much farther each step of ``Wishes.strength`` above 0 moves vertices, in parts of the
choice.  The noise is nearly gone by then, so it is shape and texture that move: three hundredths
more is what removing a quarter as much again adds."""

STRONGER_TIMES = (1.5, 2.0, 3.0, 5.0, 8.0)
"""Levels of the noise that AL with the Wiener schedule is given, in parts of the estimate."""


def stronger_candidates(level: float) -> list[Candidate]:
    """Filters that move vertices farther than any for noise of ``level`` mean edge lengths."""
    plain = [dataclasses.replace(wiener_al(times * level), times=times) for times in STRONGER_TIMES]
    return [FARTHER, *plain]


def strengthen(base: Floats, moves: Sequence[Floats], strength: float) -> tuple[int, float]:
    """Which of ``moves``, (m, 3) each, to mix into ``base`` (m, 3), and by which weight, so that
    vertices move farther by ``MORE`` of ``base`` for each step of ``strength``.

    Both the mean and the root mean square count.  Of those that reach it, the one that departs
    least from ``base``; if none does, the one that moves them farthest, by a weight in proportion.
    """
    target = (1.0 + MORE * strength) * _mean_and_rms(base)
    found = []
    for k, move in enumerate(moves):
        for percent in range(1, 101):
            change = 0.01 * percent * (move - base)
            if (_mean_and_rms(base + change) >= target).all():
                found.append((float(_mean_and_rms(change)[1]), k, 0.01 * percent))
                break
    if found:
        _, k, weight = min(found)
        return k, weight
    k = int(np.argmax([_mean_and_rms(move)[0] for move in moves]))
    return k, 0.5 * strength


def _mean_and_rms(moves: Floats) -> Floats:
    """Mean and root mean square (2,) of the lengths of ``moves`` (m, 3)."""
    squares = (moves * moves).sum(axis=1)
    return (
        np.array([np.sqrt(squares).mean(), np.sqrt(squares.mean())]) if len(moves) else np.zeros(2)
    )
