"""More than the choice: a stronger filter mixed in until vertices move farther.

The choice is made once, without the wish.  What is mixed in is weighed by what the mixture moves,
so that more strength moves vertices farther, whatever the filters do.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.auto.candidates import FARTHER, Candidate, wiener_al

if TYPE_CHECKING:
    from collections.abc import Sequence

MORE = 0.03
"""By how much farther each step of ``Wishes.strength`` above 0 moves vertices, in parts of the
choice.  The noise is nearly gone by then, so it is shape and texture that move: three hundredths
more is what removing a quarter as much again adds."""

TIMES = (1.5, 2.0, 3.0, 5.0, 8.0)
"""Levels of the noise that AL with the Wiener schedule is given, in parts of the estimate."""


def stronger_candidates(level: float) -> list[Candidate]:
    """Filters that move vertices farther than any for noise of ``level`` mean edge lengths."""
    plain = [dataclasses.replace(wiener_al(times * level), times=times) for times in TIMES]
    return [FARTHER, *plain]


def strengthen(base: Floats, moves: Sequence[Floats], strength: float) -> tuple[int, float]:
    """Which of ``moves``, (m, 3) each, to mix into ``base`` (m, 3), and by which weight, so that
    vertices move farther by ``MORE`` of ``base`` for each step of ``strength``.

    Both the mean and the root mean square count.  Of those that reach it, the one that departs
    least from ``base``; if none does, the one that moves them farthest, by a weight in proportion.
    """
    target = (1.0 + MORE * strength) * _sizes(base)
    found = []
    for k, move in enumerate(moves):
        for percent in range(1, 101):
            change = 0.01 * percent * (move - base)
            if (_sizes(base + change) >= target).all():
                found.append((float(_sizes(change)[1]), k, 0.01 * percent))
                break
    if found:
        _, k, weight = min(found)
        return k, weight
    k = int(np.argmax([_sizes(move)[0] for move in moves]))
    return k, 0.5 * strength


def _sizes(moves: Floats) -> Floats:
    """Mean and root mean square (2,) of the lengths of ``moves`` (m, 3)."""
    squares = (moves * moves).sum(axis=1)
    return (
        np.array([np.sqrt(squares).mean(), np.sqrt(squares.mean())]) if len(moves) else np.zeros(2)
    )
