"""PLY files made by hand, so that arrays and files hold the very same numbers."""

from __future__ import annotations

import numpy as np


def to_ply(vertices, faces, encoding="binary_little_endian", **properties) -> bytes:
    """Positions in their own type, float32 or float64, and double properties of vertices."""
    kind = {"f4": "float", "f8": "double"}[vertices.dtype.str[1:]]
    columns = [(name, vertices.dtype.str, kind) for name in "xyz"]
    columns += [(name, "<f8", "double") for name in properties]
    table = np.empty(len(vertices), dtype=[(name, code) for name, code, _ in columns])
    for axis, name in enumerate("xyz"):
        table[name] = vertices[:, axis]
    for name, values in properties.items():
        table[name] = values
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, faces
    header = ["ply", f"format {encoding} 1.0", f"element vertex {len(vertices)}"]
    header += [f"property {kind} {name}" for name, _, kind in columns]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    top = "\n".join(header).encode() + b"\n"
    if encoding == "ascii":
        lines = [" ".join(f"{number:.9g}" for number in row) for row in table.tolist()]
        lines += [f"3 {a} {b} {c}" for a, b, c in faces]
        return top + "\n".join(lines).encode() + b"\n"
    return top + table.tobytes() + rows.tobytes()


def positions_of(data: bytes, like, n_properties: int = 0):
    """The positions (n, 3) in a file that ``to_ply`` made, or that has its layout."""
    start = data.index(b"end_header\n") + len(b"end_header\n")
    width = 3 * like.dtype.itemsize + 8 * n_properties
    rows = np.frombuffer(data, np.uint8, len(like) * width, start).reshape(-1, width)
    return np.ascontiguousarray(rows[:, : 3 * like.dtype.itemsize]).view(like.dtype)
