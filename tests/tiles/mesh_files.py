"""Small mesh files with everything that can be wrong or unusual, for runs by tiles."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from tests.shapes import ball, cube, grid, noisy, torus

Polygons = Sequence[Sequence[int]]
_KINDS = {"f4": "float", "f8": "double"}


def ply(
    vertices,
    polygons: Polygons,
    *,
    kind: str = "f4",
    endian: str = "<",
    normals=None,
    index: str = "i",
    values: dict[str, np.ndarray] | None = None,
) -> bytes:
    """Binary PLY: polygons of any size, normals (n, 3) and scalar properties of vertices."""
    columns = {name: np.asarray(vertices)[:, k] for k, name in enumerate("xyz")}
    if normals is not None:
        columns |= {name: np.asarray(normals)[:, k] for k, name in enumerate(("nx", "ny", "nz"))}
    columns |= values or {}
    table = np.empty(len(vertices), dtype=[(name, endian + kind) for name in columns])
    for name, column in columns.items():
        table[name] = column
    header = ["ply", f"format binary_{'little' if endian == '<' else 'big'}_endian 1.0"]
    header += [f"element vertex {len(vertices)}"]
    header += [f"property {_KINDS[kind]} {name}" for name in columns]
    word = {"i": "int", "I": "uint", "H": "ushort"}[index]
    header += [f"element face {len(polygons)}", f"property list uchar {word} vertex_indices"]
    rows = [struct.pack(f"{endian}B{len(one)}{index}", len(one), *one) for one in polygons]
    return "\n".join([*header, "end_header\n"]).encode() + table.tobytes() + b"".join(rows)


def ply_ascii(vertices, polygons: Polygons) -> bytes:
    """PLY as text."""
    header = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in "xyz"]
    header += [f"element face {len(polygons)}", "property list uchar int vertex_indices"]
    lines = [" ".join(f"{x:.6f}" for x in vertex) for vertex in np.asarray(vertices)]
    lines += [" ".join(map(str, (len(one), *one))) for one in polygons]
    return "\n".join([*header, "end_header", *lines, ""]).encode()


def obj(vertices, polygons: Polygons) -> bytes:
    """OBJ with positions and polygons."""
    lines = ["v " + " ".join(f"{x:.6f}" for x in vertex) for vertex in np.asarray(vertices)]
    lines += ["f " + " ".join(str(i + 1) for i in one) for one in polygons]
    return "\n".join([*lines, ""]).encode()


def stl(vertices, faces) -> bytes:
    """Binary STL with an attribute."""
    kind = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    rows = np.zeros(len(faces), dtype=kind)
    rows["corners"] = np.asarray(vertices)[np.asarray(faces)]
    rows["attribute"] = np.arange(len(faces)) % 7
    return b"made by a test".ljust(80) + struct.pack("<I", len(faces)) + rows.tobytes()


def scan(around: int = 22, across: int = 14, seed: int = 0):
    """A noisy torus."""
    vertices, faces = torus(around, across)
    return noisy(vertices, seed, 0.08), faces


def relief(rows: int = 20, columns: int = 18, seed: int = 0):
    """A noisy open rectangle."""
    vertices, faces = grid(rows, columns)
    return noisy(vertices, seed, 0.15), faces


def shuffled(vertices, faces, seed: int = 3):
    """The same mesh, vertices and faces in a random order, and corners turned."""
    dice = np.random.default_rng(seed)
    order = dice.permutation(len(vertices))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    faces = place[faces][dice.permutation(len(faces))]
    turns = dice.integers(0, 3, len(faces))
    return vertices[order], np.stack([np.roll(f, t) for f, t in zip(faces, turns, strict=True)])


def soup(vertices, faces):
    """Every face with vertices of its own."""
    return vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


def split_along_seams(vertices, faces, seed: int = 5):
    """A third of the faces, patch by patch, have vertices of their own, and some zeros are -0."""
    dice = np.random.default_rng(seed)
    vertices = np.where(np.abs(vertices) < 0.05, 0.0, vertices)
    apart = (np.arange(len(faces)) // 40) % 3 == 1
    corners, inverse = np.unique(faces[apart], return_inverse=True)
    faces = faces.copy()
    faces[apart] = inverse.reshape(-1, 3) + len(vertices)
    copies = vertices[corners]
    copies = np.where((copies == 0.0) & (dice.random(copies.shape) < 0.5), -0.0, copies)
    return np.concatenate([vertices, copies]), faces


def joined(*meshes):
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [np.asarray(one) + start for (_, one), start in zip(meshes, starts[:-1], strict=True)]
    return np.concatenate([one for one, _ in meshes]), np.concatenate(faces)


def with_strays(vertices, faces):
    """Vertices that no face uses, some far away and some at the places of others."""
    far = np.array([[1e6, -1e6, 1e6], [0.0, 0.0, 0.0], [-3e5, 0.0, 1.0]])
    return np.concatenate([far[:1], vertices, vertices[5:9], far[1:]]), faces + 1


def with_useless_faces(vertices, faces, seed: int = 7):
    """Faces with repeated corners, faces twice and in other orders, faces without area."""
    dice = np.random.default_rng(seed)
    n = len(vertices)
    some = dice.integers(0, len(faces), 25)
    repeated = np.stack([faces[some, 0], faces[some, 1], faces[some, 0]], axis=1)
    again = np.concatenate([faces[some], faces[some][:, ::-1], np.roll(faces[some], 1, axis=1)])
    a, b = vertices[faces[some, 0]], vertices[faces[some, 1]]
    flat = np.stack([faces[some, 0], n + np.arange(len(some)), faces[some, 1]], axis=1)
    vertices = np.concatenate([vertices, (a + b) / 2.0])
    faces = np.concatenate([faces, repeated, again, flat])
    return vertices, faces[dice.permutation(len(faces))]


def with_fins(vertices, faces, seed: int = 11):
    """Edges with three and four faces."""
    dice = np.random.default_rng(seed)
    some = np.repeat(dice.integers(0, len(faces), 12), 2)
    tips = vertices[faces[some, 0]] + dice.normal(0.0, 0.3, (len(some), 3))
    fins = np.stack([faces[some, 0], faces[some, 1], len(vertices) + np.arange(len(some))], axis=1)
    return np.concatenate([vertices, tips]), np.concatenate([faces, fins])


def wound_at_random(vertices, faces, share: float = 0.3, seed: int = 13):
    """Some of the faces wound against the others."""
    turned = np.random.default_rng(seed).random(len(faces)) < share
    return vertices, np.where(turned[:, None], faces[:, ::-1], faces)


def moebius(around: int = 60, across: int = 6):
    """A strip that cannot be wound one way."""
    vertices, faces = grid(around, across)
    i, j = np.divmod(np.arange(around * across), across)
    a, w = 2 * np.pi * i / around, (j / (across - 1) - 0.5) * 1.2
    ring = 3.0 + w * np.cos(a / 2)
    vertices = np.stack([ring * np.cos(a), ring * np.sin(a), w * np.sin(a / 2)], axis=1)
    last = (around - 1) * across
    k = np.arange(across - 1)
    ends = [
        np.stack([last + k, last + k + 1, across - 1 - k], axis=1),
        np.stack([last + k + 1, across - 2 - k, across - 1 - k], axis=1),
    ]
    return noisy(vertices, 1, 0.02), np.concatenate([faces, *ends])


def wheel(spokes: int = 90):
    """Fans around two vertices whose one-rings are everything."""
    a = 2 * np.pi * np.arange(spokes) / spokes
    ring = np.stack([np.cos(a), np.sin(a), 0.1 * np.sin(5 * a)], axis=1)
    vertices = np.concatenate([ring, [[0.0, 0.0, 0.5], [0.0, 0.0, -0.5]]])
    k = np.arange(spokes)
    after = (k + 1) % spokes
    top = np.stack([k, after, np.full(spokes, spokes)], axis=1)
    bottom = np.stack([after, k, np.full(spokes, spokes + 1)], axis=1)
    return vertices, np.concatenate([top, bottom])


def polygons_of(vertices, seed: int = 17) -> list[list[int]]:
    """Quads, triangles, pentagons and corners that are repeated, over a torus of 22 by 14."""
    dice = np.random.default_rng(seed)
    out: list[list[int]] = []
    for i in range(22):
        for j in range(14):
            a, b = i * 14 + j, (i + 1) % 22 * 14 + j
            d, c = i * 14 + (j + 1) % 14, (i + 1) % 22 * 14 + (j + 1) % 14
            what = dice.integers(0, 5)
            if what == 0:
                out += [[a, b, c], [a, c, d]]
            elif what == 1:
                out += [[a, b, b, c, d]]
            else:
                out += [[a, b, c, d]]
    return out


def cases() -> dict[str, tuple[str, bytes]]:
    """Suffix and bytes of every file, by what is unusual about it."""
    torus_, relief_ = scan(), relief()
    normals = np.random.default_rng(1).normal(size=torus_[0].shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mixed = polygons_of(torus_[0])
    far = joined(torus_, (torus_[0] * 0.2 + 50.0, torus_[1]), (cube()[0] + 20.0, cube()[1]))
    half = np.where(np.arange(len(torus_[1]))[:, None] < 200, torus_[1][:, ::-1], torus_[1])
    bad = with_strays(*with_useless_faces(*with_fins(*split_along_seams(*torus_))))
    meshes = {
        "closed": torus_,
        "open": relief_,
        "flat": grid(20, 18),
        "shuffled": shuffled(*torus_),
        "soup": soup(*torus_),
        "seams": split_along_seams(*torus_),
        "shuffled seams": shuffled(*split_along_seams(*relief_)),
        "stray vertices": with_strays(*torus_),
        "useless faces": with_useless_faces(*torus_),
        "fins": with_fins(*relief_),
        "components": far,
        "shuffled components": shuffled(*far),
        "wound at random": wound_at_random(*torus_),
        "wound inside out": (torus_[0], torus_[1][:, ::-1]),
        "wound at random, open": wound_at_random(*shuffled(*relief_)),
        "half turned": (torus_[0], half),
        "moebius": moebius(),
        "fans": joined(wheel(), (ball()[0] + 4.0, ball()[1])),
        "everything": shuffled(*wound_at_random(*bad, share=0.1)),
        "far from the origin": (torus_[0] + [1e5, -3e5, 7e5], torus_[1]),
        "thin": (torus_[0] * [1.0, 1.0, 1e-6], torus_[1]),
        "one face": (np.eye(3), np.array([[0, 1, 2]])),
        "all at few places": (np.round(torus_[0] * 2.0) / 2.0, torus_[1]),
    }
    made = {name: (".ply", ply(*mesh)) for name, mesh in meshes.items()}
    made |= {
        "float64": (".ply", ply(*torus_, kind="f8")),
        "float64, far away": (".ply", ply(torus_[0] + 1e7, torus_[1], kind="f8")),
        "big endian": (".ply", ply(*relief_, endian=">")),
        "big endian, float64": (".ply", ply(*torus_, endian=">", kind="f8", index="I")),
        "normals": (".ply", ply(*torus_, normals=normals)),
        "normals and seams": (".ply", ply(*(s := split_along_seams(*relief_)), normals=s[0])),
        "normals, float64, big endian": (
            ".ply",
            ply(*torus_, normals=normals, kind="f8", endian=">", index="H"),
        ),
        "properties": (".ply", ply(*relief_, values={"quality": relief_[0][:, 2]})),
        "polygons": (".ply", ply(torus_[0], mixed)),
        "lines and points among the faces": (
            ".ply",
            ply(torus_[0], [[], [5], *mixed[:99], [7, 8], [], [300, 2], *mixed[99:], [1]]),
        ),
        "polygons, float64": (".ply", ply(torus_[0], mixed, kind="f8", endian=">")),
        "stl": (".stl", stl(*torus_)),
        "stl, open": (".stl", stl(*shuffled(*relief_))),
        "stl, everything": (".stl", stl(*shuffled(*wound_at_random(*bad, share=0.1)))),
    }
    return made


TEXTS = {
    "ascii ply": (".ply", ply_ascii(*scan())),
    "ascii ply, polygons": (".ply", ply_ascii(scan()[0], polygons_of(None))),
    "obj": (".obj", obj(*scan())),
    "obj, polygons": (".obj", obj(scan()[0], polygons_of(None))),
}
"""Files that a run by tiles converts before it reads them in pieces."""
