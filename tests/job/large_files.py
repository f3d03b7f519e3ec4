"""Files that are taken for larger than memory."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.job import larger_than_memory, streamed_faces
from msal_cli.kernels import edge_sketch


def write_ply(path, vertices, faces, kind="f8"):
    """A binary PLY; ``kind`` is the type of its coordinates."""
    name = {"f4": "float", "f8": "double"}[kind]
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    head += "".join(f"property {name} {axis}\n" for axis in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    path.write_bytes(head.encode() + np.asarray(vertices, "<" + kind).tobytes() + rows.tobytes())
    return path


def write_stl(path, vertices, faces):
    """A binary STL."""
    rows = np.zeros(
        len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("word", "<u2")]
    )
    rows["corners"] = vertices[faces]
    count = np.uint32(len(faces)).tobytes()
    path.write_bytes(b"\0" * 80 + count + rows.tobytes())
    return path


@pytest.fixture
def in_pieces(monkeypatch):
    """Every file is taken for larger than memory, and pieces are tiny."""
    monkeypatch.setattr(larger_than_memory, "are_too_large", lambda *_: True)
    monkeypatch.setattr(streamed_faces, "PIECE_FACES", 97)
    monkeypatch.setattr(streamed_faces, "PIECE_VERTICES", 41)
    monkeypatch.setattr(edge_sketch, "PART_BITS", 12)
