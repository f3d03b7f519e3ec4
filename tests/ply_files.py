"""PLY files made by hand, so that arrays and files hold the very same numbers."""

import numpy as np

XYZ = ("float x", "float y", "float z")


def to_ply(vertices, faces, **properties) -> bytes:
    """Positions in their own type, and double properties of vertices."""
    kind = {"f4": "float", "f8": "double", "i2": "short"}[vertices.dtype.str[1:]]
    columns = [(name, vertices.dtype.str, kind) for name in "xyz"]
    columns += [(name, "<f8", "double") for name in properties]
    table = np.empty(len(vertices), dtype=[(name, code) for name, code, _ in columns])
    for axis, name in enumerate("xyz"):
        table[name] = vertices[:, axis]
    for name, values in properties.items():
        table[name] = values
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, faces
    named = [f"{kind} {name}" for name, _, kind in columns]
    head = _head("binary_little_endian", named, len(vertices), len(faces))
    return head + table.tobytes() + rows.tobytes()


def to_ascii_ply(properties, rows, faces=((0, 1, 2),), comment="") -> bytes:
    """Vertices with these properties, such as "float x", a text of numbers for each; and faces."""
    head = _head("ascii", properties, len(rows), len(faces), [f"comment {comment}"] * bool(comment))
    corners = [f"3 {a} {b} {c}" for a, b, c in faces]
    return head + "\n".join([*rows, *corners, ""]).encode()


def _head(encoding: str, properties, n_vertices: int, n_faces: int, comments=()) -> bytes:
    lines = ["ply", f"format {encoding} 1.0", *comments, f"element vertex {n_vertices}"]
    lines += [f"property {one}" for one in properties]
    lines += [f"element face {n_faces}", "property list uchar int vertex_indices", "end_header"]
    return "\n".join(lines).encode() + b"\n"


def positions_of(data: bytes, like, n_properties: int = 0):
    """The positions (n, 3) in a file that ``to_ply`` made, or that has its layout."""
    start = data.index(b"end_header\n") + len(b"end_header\n")
    width = 3 * like.dtype.itemsize + 8 * n_properties
    rows = np.frombuffer(data, np.uint8, len(like) * width, start).reshape(-1, width)
    return np.ascontiguousarray(rows[:, : 3 * like.dtype.itemsize]).view(like.dtype)
