"""What every codec that patches promises, checked on a file; numbers for files of any kind."""

import re
from random import Random

import numpy as np

from msal_cli.codecs import open_mesh
from msal_cli.codecs.mesh_file import MeshFile
from tests.shapes import noisy

NUMBER = re.compile(rb"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?(?![\w.])")


def rewritten(file: MeshFile, vertices) -> bytes:
    """The bytes of a file with new positions (n, 3), which its own check accepts."""
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    return output


def patched(data: bytes, name: str, moved=None):
    """The file read, its new positions (all but the last moved), and the bytes with them."""
    file = open_mesh(data, name)
    assert file.replaced(file.vertices.copy()) is data
    if moved is None:
        moved = noisy(file.vertices, 3)
        moved[-1] = file.vertices[-1]
    output = rewritten(file, moved)
    again = open_mesh(output, name)
    assert np.abs(again.vertices - moved).max() <= 2e-7 * np.abs(moved).max()
    assert np.array_equal(again.vertices[-1], file.vertices[-1])
    assert np.array_equal(again.faces, file.faces)
    return file, moved, output


def texts_between_numbers(data: bytes) -> list[bytes]:
    """A text without its numbers: blanks, comments, words."""
    return NUMBER.split(data)


def changed_lines(before: bytes, after: bytes) -> list[int]:
    """Numbers of the lines that differ; there are as many lines."""
    pairs = list(zip(before.splitlines(), after.splitlines(), strict=True))
    return [k for k, (a, b) in enumerate(pairs) if a != b]


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


def polygons_of(file: MeshFile) -> list[np.ndarray]:
    """The corners of each polygon, int32."""
    corners, sizes = file.polygons()
    return np.split(corners.astype(np.int32), np.cumsum(sizes[:-1]))
