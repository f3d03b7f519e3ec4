"""STL files written the plain way, byte by byte, independently of the codec."""

import struct
from collections.abc import Sequence

import numpy as np

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float64)
TETRAHEDRON_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def tetrahedron() -> np.ndarray:
    """Corners (4, 9) of a closed tetrahedron, wound outwards."""
    return TETRAHEDRON[TETRAHEDRON_FACES].reshape(-1, 9)


def right_hand_normals(corners: np.ndarray) -> np.ndarray:
    """Unit normals (m, 3) by the right-hand rule, zeros for facets without area."""
    c = np.asarray(corners, dtype=np.float64).reshape(-1, 3, 3)
    n = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
    length = np.linalg.norm(n, axis=1, keepdims=True)
    return np.divide(n, length, out=np.zeros_like(n), where=length > 0)


def binary(
    corners: np.ndarray,
    normals: np.ndarray | None = None,
    attributes: Sequence[int] | None = None,
    header: bytes = b"plain",
    trailing: bytes = b"",
    count: int | None = None,
) -> bytes:
    """A binary STL file of corners (m, 9)."""
    normals = right_hand_normals(corners) if normals is None else normals
    out = header.ljust(80, b"\0") + struct.pack("<I", len(corners) if count is None else count)
    for k, (normal, corner) in enumerate(zip(normals, corners, strict=True)):
        out += struct.pack("<3f", *normal) + struct.pack("<9f", *corner)
        out += struct.pack("<H", 0 if attributes is None else attributes[k])
    return out + trailing


def text(
    corners: np.ndarray,
    normals: np.ndarray | None = None,
    name: str = "part",
    number: str = "{:.6f}",
    newline: str = "\n",
) -> str:
    """One ascii STL solid of corners (m, 9)."""
    normals = right_hand_normals(corners) if normals is None else normals
    lines = [f"solid {name}"]
    for normal, corner in zip(normals, corners, strict=True):
        lines.append("  facet normal " + " ".join(number.format(x) for x in normal))
        lines.append("    outer loop")
        for k in range(3):
            point = " ".join(number.format(x) for x in corner[3 * k : 3 * k + 3])
            lines.append(f"      vertex {point}")
        lines += ["    endloop", "  endfacet"]
    lines.append(f"endsolid {name}")
    return newline.join(lines) + newline
