"""The arctangent of many quotients at once, by arithmetic that compilers turn into vectors."""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled


@compiled
def arctangents(numerators, denominators, count):
    """Replace ``numerators[:count]`` by the angles of (denominator, numerator), none below zero.

    Angles are in radians, 0 to pi / 2, within some 1e-15; 0 where both are zero.
    """
    for at in range(count):
        y = numerators[at]
        x = denominators[at]
        # The angle from the nearer axis, as a tangent of at most 1.
        low = min(y, x)
        high = max(y, x)
        t = low / (high if high > 0.0 else 1.0)
        # Halved twice, so that the series ends soon: tan(a / 2) = t / (1 + sqrt(1 + t t)).
        t = t / (1.0 + np.sqrt(1.0 + t * t))
        t = t / (1.0 + np.sqrt(1.0 + t * t))
        s = -t * t
        p = 1.0 / 21.0
        p = p * s + 1.0 / 19.0
        p = p * s + 1.0 / 17.0
        p = p * s + 1.0 / 15.0
        p = p * s + 1.0 / 13.0
        p = p * s + 1.0 / 11.0
        p = p * s + 1.0 / 9.0
        p = p * s + 1.0 / 7.0
        p = p * s + 1.0 / 5.0
        p = p * s + 1.0 / 3.0
        p = p * s + 1.0
        angle = 4.0 * t * p
        numerators[at] = angle if y <= x else 0.5 * np.pi - angle
