"""A noisy closed surface of any size, written in pieces so that it is never in memory whole.

    python -m benchmarks.giant_mesh OUTPUT [--millions 1] [--order rows|blocks|shuffled] [--seed 1]
        [--noise 0.1]

OUTPUT ends in ``.ply`` (binary, float32 positions, lists of uchar and int32) or ``.stl`` (binary).
The surface is a torus with bumps, a fine texture and white noise along the normal, on a grid of
3 ACROSS by ACROSS vertices and twice as many triangles; ACROSS follows from the MILLIONS of
vertices.  The same options give the same bytes.

The order says how vertices and faces follow each other in the file.  ``rows`` is the order of the
grid, as a range scanner writes it.  ``blocks`` permutes runs of 4,096 vertices and of as many
faces, as a fusion in blocks writes them.  ``shuffled`` permutes every vertex and every face.  The
surface itself is the same in all three orders.  Memory stays below 200 MB.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist

import numpy as np

ORDERS = ("rows", "blocks", "shuffled")
_AT_ONCE = 300_000
_BLOCK = 4096
_ROUNDS = 4
_RADIUS = 3.0
"""Of the circle on which the centres of the tube lie; the tube has radius 1."""
_LONGEST_EDGE = np.sqrt(2.0)
_WORD = np.uint64(0xFFFFFFFFFFFFFFFF)

Numbers = np.ndarray


class Permutation:
    """A random permutation of 0 to n - 1 that takes memory for some 2 √n numbers only.

    A Feistel network in mixed radix: a number is left * width + right, and rounds add to one half
    a random number that the other half selects.  Numbers that leave the range go through it again.
    """

    def __init__(self, n: int, seed: int) -> None:
        self._n = n
        self._width = max(1, int(np.ceil(np.sqrt(n))))
        self._height = -(-n // self._width)
        rng = np.random.default_rng(seed)
        sizes = ((self._width, self._height), (self._height, self._width))
        self._tables = [
            rng.integers(0, sizes[k % 2][1], sizes[k % 2][0], dtype=np.int64)
            for k in range(_ROUNDS)
        ]

    def apply(self, numbers: Numbers) -> Numbers:
        """The images of ``numbers``."""
        return self._walk(numbers, self._forward)

    def invert(self, numbers: Numbers) -> Numbers:
        """The numbers whose images are ``numbers``."""
        return self._walk(numbers, self._backward)

    def _walk(self, numbers: Numbers, step) -> Numbers:
        out = step(numbers)
        outside = np.flatnonzero(out >= self._n)
        while len(outside):
            out[outside] = step(out[outside])
            outside = outside[out[outside] >= self._n]
        return out

    def _forward(self, numbers: Numbers) -> Numbers:
        left, right = np.divmod(numbers, self._width)
        for k, table in enumerate(self._tables):
            if k % 2:
                right = self._wrap(right + table[left], self._width)
            else:
                left = self._wrap(left + table[right], self._height)
        return left * self._width + right

    def _backward(self, numbers: Numbers) -> Numbers:
        left, right = np.divmod(numbers, self._width)
        for k in reversed(range(_ROUNDS)):
            table = self._tables[k]
            if k % 2:
                right = self._wrap(right - table[left] + self._width, self._width)
            else:
                left = self._wrap(left - table[right] + self._height, self._height)
        return left * self._width + right

    @staticmethod
    def _wrap(numbers: Numbers, n: int) -> Numbers:
        return np.where(numbers >= n, numbers - n, numbers)


class _Identity:
    """The order of the grid."""

    def apply(self, numbers: Numbers) -> Numbers:
        return numbers

    invert = apply


class _BlockPermutation:
    """Whole blocks change places; the last one, which may be shorter, stays where it is."""

    def __init__(self, n: int, seed: int) -> None:
        self._whole = n // _BLOCK
        self._blocks = Permutation(self._whole, seed)

    def apply(self, numbers: Numbers) -> Numbers:
        return self._move(numbers, self._blocks.apply)

    def invert(self, numbers: Numbers) -> Numbers:
        return self._move(numbers, self._blocks.invert)

    def _move(self, numbers: Numbers, step) -> Numbers:
        block, place = np.divmod(numbers, _BLOCK)
        inside = block < self._whole
        if not inside.any():
            return numbers
        moved = step(np.where(inside, block, 0))
        return np.where(inside, moved, block) * _BLOCK + place


_PERMUTATIONS = {
    "rows": lambda n, seed: _Identity(),
    "blocks": _BlockPermutation,
    "shuffled": Permutation,
}


@dataclass(frozen=True)
class GiantMesh:
    """The surface and its order.

    Attributes
    ----------
    across : vertices around the tube; three times as many go around the torus.
    noise : standard deviation along the normal, mean edge lengths.
    order : one of ``ORDERS``.
    seed : of the noise and of the order.
    """

    across: int
    noise: float = 0.1
    order: str = "rows"
    seed: int = 1

    @property
    def n_vertices(self) -> int:
        """Vertices of the mesh."""
        return 3 * self.across * self.across

    @property
    def n_faces(self) -> int:
        """Triangles of the mesh."""
        return 2 * self.n_vertices

    @functools.cached_property
    def mean_edge_length(self) -> float:
        """That of the smooth torus, nearly; the tube has radius 1."""
        return float(2.0 * np.pi / self.across * (2.0 + _LONGEST_EDGE) / 3.0)

    @functools.cached_property
    def _vertex_order(self):
        return _PERMUTATIONS[self.order](self.n_vertices, self.seed)

    @functools.cached_property
    def _face_order(self):
        return _PERMUTATIONS[self.order](self.n_faces, self.seed + 1)

    @functools.cached_property
    def _waves(self) -> tuple[dict[str, Numbers], dict[str, Numbers]]:
        """Sines and cosines by row and by column of the grid."""
        a = 2.0 * np.pi * np.arange(3 * self.across) / (3 * self.across)
        b = 2.0 * np.pi * np.arange(self.across) / self.across
        return (
            {"cos": np.cos(a), "sin": np.sin(a), "bump": np.sin(9 * a), "grain": np.sin(150 * a)},
            {"cos": np.cos(b), "sin": np.sin(b), "bump": np.cos(4 * b), "grain": np.sin(50 * b)},
        )

    @functools.cached_property
    def _normal_quantiles(self) -> Numbers:
        """The standard normal distribution in 4,096 equal parts, as one number for each."""
        inverse = NormalDist().inv_cdf
        return np.array([inverse((k + 0.5) / 4096) for k in range(4096)])

    def _white_noise(self, vertices: Numbers) -> Numbers:
        """Independent numbers of unit variance, those of a vertex always the same."""
        # The finaliser of MurmurHash3 and SplitMix64.
        word = vertices.astype(np.uint64) + np.uint64(self.seed * 0x9E3779B97F4A7C15 & int(_WORD))
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            word ^= word >> np.uint64(shift)
            word *= np.uint64(factor)
        return self._normal_quantiles[(word >> np.uint64(52)).astype(np.int64)]

    def positions(self, vertices: Numbers) -> Numbers:
        """Positions (n, 3) float32 of vertices (n,) of the grid."""
        i, j = np.divmod(vertices, self.across)
        around, across = self._waves
        height = 0.1 * around["bump"][i] * across["bump"][j]
        height += 0.004 * around["grain"][i] * across["grain"][j]
        height += self.noise * self.mean_edge_length * self._white_noise(vertices)
        tube = 1.0 + height
        ring = _RADIUS + tube * across["cos"][j]
        out = np.empty((len(vertices), 3), dtype="<f4")
        out[:, 0] = ring * around["cos"][i]
        out[:, 1] = ring * around["sin"][i]
        out[:, 2] = tube * across["sin"][j]
        return out

    def corners(self, faces: Numbers) -> Numbers:
        """The corners (n, 3) of triangles (n,) of the grid, as vertices of the grid."""
        cell, is_second = np.divmod(faces, 2)
        i, j = np.divmod(cell, self.across)
        here = i * self.across
        below = np.where(i + 1 == 3 * self.across, 0, here + self.across)
        right = np.where(j + 1 == self.across, 0, j + 1)
        opposite = below + right
        out = np.empty((len(faces), 3), dtype=np.int64)
        out[:, 0] = here + j
        out[:, 1] = np.where(is_second, opposite, below + j)
        out[:, 2] = np.where(is_second, here + right, opposite)
        return out

    def ply_header(self) -> bytes:
        """The header of the PLY file."""
        return (
            f"ply\nformat binary_little_endian 1.0\nelement vertex {self.n_vertices}\n"
            "property float x\nproperty float y\nproperty float z\n"
            f"element face {self.n_faces}\nproperty list uchar int vertex_indices\nend_header\n"
        ).encode()

    def ply_vertices(self) -> Iterator[Numbers]:
        """The positions in the order of the file, in pieces."""
        for numbers in _pieces(self.n_vertices):
            yield self.positions(self._vertex_order.apply(numbers))

    def ply_faces(self) -> Iterator[Numbers]:
        """The rows of faces in the order of the file, in pieces."""
        for numbers in _pieces(self.n_faces):
            rows = np.empty(len(numbers), dtype=[("n", "u1"), ("corners", "<i4", 3)])
            rows["n"] = 3
            corners = self.corners(self._face_order.apply(numbers))
            rows["corners"] = self._vertex_order.invert(corners.reshape(-1)).reshape(-1, 3)
            yield rows

    def stl_facets(self) -> Iterator[Numbers]:
        """The facets in the order of the file, in pieces."""
        kind = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
        for numbers in _pieces(self.n_faces):
            rows = np.zeros(len(numbers), dtype=kind)
            corners = self.corners(self._face_order.apply(numbers))
            rows["corners"] = self.positions(corners.reshape(-1)).reshape(-1, 3, 3)
            a, b, c = (rows["corners"][:, k].astype(np.float64) for k in range(3))
            normals = np.cross(b - a, c - a)
            lengths = np.linalg.norm(normals, axis=1, keepdims=True)
            rows["normal"] = normals / np.where(lengths > 0.0, lengths, 1.0)
            yield rows

    def write(self, path: Path) -> None:
        """Write the mesh; the suffix says the format."""
        with path.open("wb") as file:
            if path.suffix == ".stl":
                file.write(b"a noisy torus".ljust(80) + self.n_faces.to_bytes(4, "little"))
                parts = [self.stl_facets()]
            else:
                file.write(self.ply_header())
                parts = [self.ply_vertices(), self.ply_faces()]
            for part in parts:
                for rows in part:
                    file.write(rows.data.cast("B") if rows.ndim == 2 else rows.tobytes())


def _pieces(n: int) -> Iterator[Numbers]:
    for start in range(0, n, _AT_ONCE):
        yield np.arange(start, min(start + _AT_ONCE, n), dtype=np.int64)


def of_millions(millions: float, order: str = "rows", noise: float = 0.1) -> GiantMesh:
    """The mesh of about so many million vertices."""
    return GiantMesh(max(3, round((millions * 1e6 / 3.0) ** 0.5)), noise, order)


def main(words: list[str] | None = None) -> None:
    """Write one mesh."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path)
    parser.add_argument("--millions", type=float, default=1.0, help="vertices")
    parser.add_argument("--order", choices=ORDERS, default="rows")
    parser.add_argument("--noise", type=float, default=0.1, help="mean edge lengths")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args(words)
    if arguments.output.suffix not in (".ply", ".stl"):
        parser.error("OUTPUT must end in .ply or .stl")
    across = of_millions(arguments.millions).across
    mesh = GiantMesh(across, arguments.noise, arguments.order, arguments.seed)
    began = time.perf_counter()
    mesh.write(arguments.output)
    print(
        f"{arguments.output}: {mesh.n_vertices:,} vertices, {mesh.n_faces:,} triangles, "
        f"{arguments.output.stat().st_size / 1e9:.2f} GB, {time.perf_counter() - began:.0f} s"
    )


if __name__ == "__main__":
    main()
