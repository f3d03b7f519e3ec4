"""On which side of a plane, or of a line, points lie: signs that are exact.

Determinants are computed in double precision first.  Where one is smaller than its rounding error
may be (Shewchuk 1997, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric
Predicates", section 4: the bound of the first stage), its sign is found with whole numbers of any
length, which every double is a multiple of a power of two of.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats

Signs = NDArray[np.int8]

# Somewhat more than the 7.8e-16 and 3.4e-16 of the paper, times the permanent.
_SPACE_ERROR = 1e-15
_PLANE_ERROR = 5e-16

# Below this, products may have vanished.
_TINY = 1e-290


def space_signs(a: Floats, b: Floats, c: Floats, d: Floats) -> Signs:
    """The sign of (b - a) x (c - a) . (d - a) for points (n, 3): 1 where d is on the side of the
    plane abc from which a, b, c run counter-clockwise, 0 where it is in the plane."""
    det, permanent = _space_determinants(b - a, c - a, d - a)
    signs: Signs = np.sign(det).astype(np.int8)
    unsure = np.flatnonzero(~(np.abs(det) > _SPACE_ERROR * permanent + _TINY))
    if len(unsure):
        a, b, c, d = _whole_numbers(a[unsure], b[unsure], c[unsure], d[unsure])
        exact, _ = _space_determinants(b - a, c - a, d - a)
        signs[unsure] = _signs_of_objects(exact)
    return signs


def plane_signs(a: Floats, b: Floats, c: Floats) -> Signs:
    """The sign of the signed area of triangles abc for points (n, 2): 1 counter-clockwise, 0 where
    they are on a line."""
    det, permanent = _plane_determinants(b - a, c - a)
    signs: Signs = np.sign(det).astype(np.int8)
    unsure = np.flatnonzero(~(np.abs(det) > _PLANE_ERROR * permanent + _TINY))
    if len(unsure):
        a, b, c = _whole_numbers(a[unsure], b[unsure], c[unsure])
        exact, _ = _plane_determinants(b - a, c - a)
        signs[unsure] = _signs_of_objects(exact)
    return signs


def _space_determinants(u: Any, v: Any, w: Any) -> tuple[Any, Any]:
    """The determinants of rows u, v, w (n, 3), and the sums of the sizes of their terms."""
    ux, uy, uz = u.T
    vx, vy, vz = v.T
    wx, wy, wz = w.T
    yz, zy, zx, xz, xy, yx = uy * vz, uz * vy, uz * vx, ux * vz, ux * vy, uy * vx
    det = (yz - zy) * wx + (zx - xz) * wy + (xy - yx) * wz
    permanent = (
        (abs(yz) + abs(zy)) * abs(wx)
        + (abs(zx) + abs(xz)) * abs(wy)
        + (abs(xy) + abs(yx)) * abs(wz)
    )
    return det, permanent


def _plane_determinants(u: Any, v: Any) -> tuple[Any, Any]:
    left, right = u[:, 0] * v[:, 1], u[:, 1] * v[:, 0]
    return left - right, abs(left) + abs(right)


def _whole_numbers(*points: Floats) -> NDArray[Any]:
    """The points, all times one power of two, as Python's whole numbers."""
    coordinates = np.stack(points)
    mantissas, exponents = np.frexp(coordinates)
    numbers = np.ldexp(mantissas, 53).astype(np.int64)
    exponents = np.where(numbers == 0, exponents.max(), exponents)
    shifts = exponents - exponents.min()
    whole: NDArray[Any] = np.left_shift(numbers.astype(object), shifts.astype(object))
    return whole


def _signs_of_objects(values: NDArray[Any]) -> Signs:
    return (values > 0).astype(np.int8) - (values < 0).astype(np.int8)
