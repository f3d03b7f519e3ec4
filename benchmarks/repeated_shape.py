"""What the noise estimate says of clean surfaces whose shape repeats every few vertices.

    python -m benchmarks.repeated_shape

Sheets of 90 x 90 vertices with waves, grooves, knurls and fabric, 2.5 to 8 vertices to a period,
and cylinders of 240 x 120 and of 140 x 70 with threads, scales, bricks and the like; on regular
triangles, and with vertices moved along the surface and random diagonals.  Printed is how many are
said to be noisy, for sure or perhaps, and each of them; then the angle of threads and knurls with
white noise, as it is and after the plain command and ``--auto``.  The tables are in
benchmarks/results/repeated_shape.txt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Literal

import numpy as np

import msal_cli
from benchmarks.ground_truth import add_plain_noise
from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.arrays import Floats
from msal_cli.kernels.geometry import face_normals
from msal_cli.mesh import Mesh, prepare_mesh

Heights = Callable[[Any, Any], Any]


def _ridge(u: Any) -> Any:
    """0.5 at whole numbers, 0 between."""
    return np.abs(u % 1.0 - 0.5)


SHEETS: dict[str, Heights] = {
    "grooves": lambda u, v: _ridge(u),
    "waves": lambda u, v: 0.5 * np.sin(2.0 * np.pi * u),
    "knurls": lambda u, v: np.minimum(_ridge(u), _ridge(v)),
    "slanted": lambda u, v: _ridge(u + 0.7 * v) + _ridge(u - 0.7 * v),
    "fabric": lambda u, v: 0.5 * np.sin(2.0 * np.pi * u) * np.sin(1.6 * np.pi * v),
}
"""Heights over a sheet, by the place in periods."""

PERIODS, HEIGHTS = (2.5, 3.3, 3.75, 4.5, 6.0, 8.0), (0.2, 0.6, 2.0)
"""Vertices to a period, and heights, in spacings."""

CYLINDERS: dict[str, Heights] = {
    "thread": lambda t, z: 0.06 * _ridge(8 * z + t),
    "fine thread": lambda t, z: 0.03 * _ridge(16 * z + t),
    "knurls": lambda t, z: 0.04 * np.minimum(_ridge(30 * t + 8 * z), _ridge(30 * t - 8 * z)),
    "gear": lambda t, z: 0.1 * np.clip(4.0 * (_ridge(24 * t) - 0.25), -0.5, 0.5),
    "bricks": lambda t, z: (
        -0.03 * ((z * 10 % 1.0 < 0.15) | ((t * 30 + 0.5 * np.floor(z * 10)) % 1.0 < 0.1))
    ),
    "scales": lambda t, z: (
        0.03
        * np.maximum(
            0.0,
            1.0 - 2.2 * np.hypot((t * 40 + 0.5 * np.floor(z * 10)) % 1.0 - 0.5, z * 10 % 1 - 0.5),
        )
    ),
    "basket": lambda t, z: 0.03 * np.sin(20.0 * np.pi * z) * np.sign(np.sin(40.0 * np.pi * t)),
    "flutes": lambda t, z: 0.03 * np.abs(np.sin(40.0 * np.pi * t)),
    "chains": lambda t, z: 0.03 * (np.sin(60.0 * np.pi * t) * np.sin(12.0 * np.pi * z) > 0.3),
}
"""Heights over a cylinder of radius 1 and length 3, by turns and length."""

CHOICES: tuple[Literal["auto"] | None, ...] = (None, "auto")
NOISY, LEVELS = ("thread", "knurls", "flutes"), (0.05, 0.1, 0.2)


def _build(
    around: int, along: int, is_moved: bool, seed: int, surface: Callable[[Any, Any], Floats]
) -> Mesh:
    """A mesh over a grid of ``around`` x ``along`` vertices; ``surface`` makes positions of places
    in the grid."""
    draws = np.random.default_rng(seed)
    u, v = np.meshgrid(np.arange(around), np.arange(along), indexing="ij")
    places = np.stack([u, v]).reshape(2, -1).astype(np.float64)
    if is_moved:
        places += draws.uniform(-0.35, 0.35, places.shape)
    corner = (u * along + v)[:-1, :-1].ravel()
    a, b, c, d = corner, corner + along, corner + along + 1, corner + 1
    is_turned = is_moved & (draws.random(len(corner)) < 0.5)
    first = np.stack([a, b, np.where(is_turned, d, c)], axis=1)
    second = np.stack([np.where(is_turned, b, a), c, d], axis=1)
    faces = np.concatenate([first, second]).astype(np.int32)
    return prepare_mesh(surface(*places), faces).mesh


def _sheets() -> Iterator[tuple[str, Mesh]]:
    for name, heights in SHEETS.items():
        for period in PERIODS:
            for height in HEIGHTS:
                for is_moved in (False, True):

                    def surface(u: Floats, v: Floats) -> Floats:
                        z = height * heights(u / period, v / period)  # noqa: B023
                        return np.stack([u, v, z], axis=1)

                    how = "irregular" if is_moved else "regular"
                    label = f"{name}, {period:g} vertices, {height:g} high, {how}"
                    yield label, _build(90, 90, is_moved, 1, surface)


def build_cylinder(name: str, around: int, is_moved: bool) -> Mesh:
    """A cylinder, open along a line, with the shape ``name``."""

    def surface(u: Floats, v: Floats) -> Floats:
        t, z = u / around, v * 6.0 / around
        radius, turn = 1.0 + CYLINDERS[name](t, z), 2.0 * np.pi * t
        return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)

    return _build(around, around // 2, is_moved, 2, surface)


def _cylinders() -> Iterator[tuple[str, Mesh]]:
    for name in CYLINDERS:
        for around in (240, 140):
            for is_moved in (False, True):
                how = "irregular" if is_moved else "regular"
                yield f"{name}, {around} around, {how}", build_cylinder(name, around, is_moved)


def _angle(vertices: Floats, true: Mesh) -> float:
    """Mean angle between face normals, degrees."""
    cosines = (face_normals(vertices, true.faces) * face_normals(true.vertices, true.faces)).sum(1)
    return float(np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))).mean())


def main() -> None:
    """Print the tables."""
    for title, meshes in (("Sheets", _sheets()), ("Cylinders", _cylinders())):
        lines, counts, total = [], {"noise": 0, "unsure": 0}, 0
        for label, mesh in meshes:
            total += 1
            noise = estimate_noise(mesh)
            if not noise.is_negligible:
                counts["unsure" if noise.is_unsure else "noise"] += 1
                how = "perhaps " if noise.is_unsure else ""
                kind = noise.character.kind
                lines.append(f"- {label}: {how}{noise.mean_edges:.2g} e, {kind}")
        print(f"{title}: {total}, noise {counts['noise']}, perhaps noise {counts['unsure']}\n")
        print("\n".join(lines) + "\n")
    print("| with white noise | noisy | plain command | `--auto` |\n|---|--:|--:|--:|")
    for name in NOISY:
        true = build_cylinder(name, 240, True)
        for level in LEVELS:
            noisy = add_plain_noise(true, "gaussian-normal", level, 1)
            found = [noisy]
            found += [msal_cli.denoise(noisy, true.faces, method=one).vertices for one in CHOICES]
            angles = " | ".join(f"{_angle(vertices, true):.2f}" for vertices in found)
            print(f"| {name} {level:g} | {angles} |")


if __name__ == "__main__":
    main()
