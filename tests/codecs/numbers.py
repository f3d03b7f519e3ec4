"""Random numbers for files: ordinary ones and edge cases."""

from __future__ import annotations

from random import Random


def any_float(random: Random, most: float) -> float:
    """A number of any size up to ``most``."""
    edges = [0.0, 1.0, -1.0, most, -most, 0.1, 1 / 3, 5e-324, -(2.0**-126), 1e-5, 2.0**-149]
    if random.random() < 0.25:
        return random.choice(edges)
    return random.uniform(-1, 1) * most * random.choice([1.0, 1.0, 1e-3, 1e-6, 1e-12])


def any_integer(random: Random, low: int, high: int) -> int:
    """An integer from ``low`` to ``high``."""
    small = [n for n in (-1, 0, 1, 255) if low <= n <= high]
    return random.choice([low, high, *small, *(random.randint(low, high) for _ in range(6))])
