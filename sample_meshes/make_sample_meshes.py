"""Make the sample meshes beside this file: eight models, each clean and with known noise.

    python sample_meshes/make_sample_meshes.py [FOLDER]

Needs numpy only and takes a few seconds.  Every random number comes from a seeded
``numpy.random.RandomState``, whose streams numpy keeps unchanged, and every position is rounded to
1e-5 mm before it is written, so that the files are the same bytes on every machine; the two
compressed ones (.png and .ply.gz) hold the same bytes once they are expanded.

The noise is Gaussian, independent per vertex, along the vertex normal of the clean surface (the
normalised sum of the unit normals of the faces around).  Its standard deviation is the ``noise`` of
``MODELS`` times the mean edge length of the clean surface.
"""

from __future__ import annotations

import gzip
import io
import struct
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import machined
import relief
import shapes
from shapes import Array

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Surface:
    """What a writer needs besides positions: ``faces`` and what only this format carries."""

    vertices: Array
    faces: Array | list[list[int]]
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Model:
    """One sample: how it is made, written and described; ``noise`` is in mean edge lengths."""

    name: str
    suffix: str
    noise: float
    closed: bool
    make: Callable[[], Surface]
    write: Callable[[Surface, Array], bytes]
    what: str
    layout: str


# ---------------------------------------------------------------------------------------------
# Surfaces


def _bracket() -> Surface:
    return Surface(*machined.bracket())


def _dragon_egg() -> Surface:
    return Surface(*shapes.dragon_egg())


def _rock() -> Surface:
    return Surface(*shapes.rock())


def _bear() -> Surface:
    return Surface(*shapes.bear())


def _knot() -> Surface:
    return Surface(*shapes.knot())


def _coin() -> Surface:
    scan = relief.coin()
    return Surface(
        scan.vertices, scan.faces, {"confidence": scan.confidence, "quality": scan.quality}
    )


def _toadstool() -> Surface:
    vertices, faces, colours = shapes.toadstool()
    return Surface(vertices, faces, {"colours": colours})


def _vase() -> Surface:
    vertices, faces, uv, corner_uv, split = shapes.vase()
    return Surface(vertices, faces, {"uv": uv, "corner_uv": corner_uv, "split": split})


# ---------------------------------------------------------------------------------------------
# Writers: each returns the bytes of a file with the surface's faces and the given positions


def _table(rows: int, columns: list[tuple[str, str, Any]]) -> bytes:
    """Packed rows of named, typed columns, each (rows,) or (rows, k)."""
    kinds = [
        (name, kind) if np.ndim(values) < 2 else (name, kind, np.shape(values)[1:])
        for name, kind, values in columns
    ]
    table = np.zeros(rows, dtype=kinds)
    for name, _, values in columns:
        table[name] = values
    return table.tobytes()


def _plain_ply(surface: Surface, vertices: Array) -> bytes:
    faces = np.asarray(surface.faces)
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment angle bracket, millimetres\n"
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = _table(len(vertices), [("x", "<f4", vertices)])
    return header.encode() + body + _table(len(faces), [("n", "u1", 3), ("v", "<i4", faces)])


def _big_endian_ply(surface: Surface, vertices: Array) -> bytes:
    faces = np.asarray(surface.faces)
    normals = np.round(shapes.vertex_normals(vertices, faces), 5) + 0.0
    header = (
        "ply\nformat binary_big_endian 1.0\ncomment dragon egg, millimetres\n"
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property float nx\nproperty float ny\nproperty float nz\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = _table(len(vertices), [("x", ">f4", vertices), ("n", ">f4", normals)])
    return header.encode() + body + _table(len(faces), [("n", "u1", 3), ("v", ">i4", faces)])


def _scan_ply(surface: Surface, vertices: Array) -> bytes:
    faces = np.asarray(surface.faces)
    camera = [
        ("view_p", relief.EYE),
        *((f"{a}_axis", e) for a, e in zip("xyz", np.eye(3), strict=True)),
    ]
    numbers = np.concatenate([v for _, v in camera])
    names = [f"{name}{axis}" for name, _ in camera for axis in "xyz"]
    optics = {"focal": relief.FOCAL, "scalex": relief.PITCH, "scaley": relief.PITCH}
    optics |= {"centerx": (relief.COLUMNS - 1) / 2, "centery": (relief.ROWS - 1) / 2}
    lens = {"k1": 0.0, "k2": 0.0}
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment range scan of a coin, millimetres\n"
        f"obj_info num_cols {relief.COLUMNS}\nobj_info num_rows {relief.ROWS}\n"
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property float confidence\nproperty float quality\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
        # Behind the faces: VTK's reader crashes on an element before them that it does not know.
        "element camera 1\n"
        + "".join(f"property float {name}\n" for name in (*names, *optics))
        + "property int viewportx\nproperty int viewporty\n"
        + "".join(f"property float {name}\n" for name in lens)
        + "end_header\n"
    )
    camera_bytes = np.concatenate([numbers, list(optics.values())]).astype("<f4").tobytes()
    camera_bytes += struct.pack("<iiff", relief.COLUMNS, relief.ROWS, *lens.values())
    extra = surface.extra
    body = _table(
        len(vertices),
        [("x", "<f4", vertices), ("c", "<f4", extra["confidence"]), ("q", "<f4", extra["quality"])],
    )
    body += _table(len(faces), [("n", "u1", 3), ("v", "<i4", faces)])
    return header.encode() + body + camera_bytes


def _colour_ply(surface: Surface, vertices: Array) -> bytes:
    out = io.StringIO()
    out.write("ply\nformat ascii 1.0\ncomment toadstool, millimetres; quads and triangles\n")
    out.write(f"element vertex {len(vertices)}\n")
    out.write("property float x\nproperty float y\nproperty float z\n")
    for name in ("red", "green", "blue", "alpha"):
        out.write(f"property uchar {name}\n")
    out.write(
        f"element face {len(surface.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    for (x, y, z), (r, g, b, a) in zip(vertices, surface.extra["colours"], strict=True):
        out.write(f"{x:.5f} {y:.5f} {z:.5f} {r} {g} {b} {a}\n")
    for face in surface.faces:
        out.write(f"{len(face)} {' '.join(map(str, face))}\n")
    return out.getvalue().encode()


def _packed_ply(surface: Surface, vertices: Array) -> bytes:
    out = io.StringIO()
    out.write("ply\nformat ascii 1.0\ncomment river stone, millimetres\n")
    out.write(f"element vertex {len(vertices)}\n")
    out.write("property double x\nproperty double y\nproperty double z\n")
    out.write(
        f"element face {len(surface.faces)}\nproperty list uchar int vertex_index\nend_header\n"
    )
    for x, y, z in vertices:
        out.write(f"{x:.5f} {y:.5f} {z:.5f}\n")
    for a, b, c in surface.faces:
        out.write(f"3 {a} {b} {c}\n")
    return gzip.compress(out.getvalue().encode(), 9, mtime=0)


def _grouped_obj(surface: Surface, vertices: Array) -> bytes:
    faces = np.asarray(surface.faces)
    normals = np.round(shapes.vertex_normals(vertices, faces), 4) + 0.0
    out = io.StringIO()
    out.write("# bear's head, millimetres\no bear\n")
    for x, y, z in vertices:
        out.write(f"v {x:.5f} {y:.5f} {z:.5f}\n")
    for x, y, z in normals:
        out.write(f"vn {x:.4f} {y:.4f} {z:.4f}\n")
    # Groups follow the clean shape, so that both files have the same text here.
    front = surface.vertices[faces, 1].mean(axis=1) < -18.0
    for name, chosen in (("face", front), ("back", ~front)):
        out.write(f"g {name}\ns {1 if name == 'face' else 2}\n")
        for a, b, c in faces[chosen] + 1:
            out.write(f"f {a}//{a} {b}//{b} {c}//{c}\n")
    return out.getvalue().encode()


def _textured_obj(surface: Surface, vertices: Array) -> bytes:
    extra, out = surface.extra, io.StringIO()
    out.write("# vase, millimetres; quads, triangles at the poles, texture seams\n")
    out.write("mtllib vase.mtl\no vase\n")
    for x, y, z in vertices:
        out.write(f"v {x:.5f} {y:.5f} {z:.5f}\n")
    for u, v in extra["uv"]:
        out.write(f"vt {u:.5f} {v:.5f}\n")
    for number, (face, corners) in enumerate(zip(surface.faces, extra["corner_uv"], strict=True)):
        if number == 0:
            out.write("g outside\nusemtl glaze\ns 1\n")
        if number == extra["split"]:
            out.write("g inside\nusemtl biscuit\ns 1\n")
        pairs = (f"{v + 1}/{t + 1}" for v, t in zip(face, corners, strict=True))
        out.write(f"f {' '.join(pairs)}\n")
    return out.getvalue().encode()


def _soup_stl(surface: Surface, vertices: Array) -> bytes:
    faces = np.asarray(surface.faces)
    corner = vertices.astype(np.float32).astype(float)[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal = np.round(normal / np.sqrt((normal**2).sum(axis=1))[:, None], 6) + 0.0
    header = b"rope knot, millimetres, binary STL".ljust(80)
    table = [("n", "<f4", normal), ("v", "<f4", corner.reshape(-1, 9)), ("a", "<u2", 0)]
    return header + struct.pack("<I", len(faces)) + _table(len(faces), table)


# ---------------------------------------------------------------------------------------------
# The vase's material and picture


def _material() -> bytes:
    text = "# material of the vase\n"
    for name, colour in (("glaze", 1.0), ("biscuit", 0.9)):
        text += f"newmtl {name}\nKa 0.2 0.2 0.2\nKd {colour} {colour} {colour}\n"
        text += "Ks 0.1 0.1 0.1\nNs 20\nillum 2\nmap_Kd vase.png\n\n"
    return text.encode()


def texture() -> Array:
    """(256, 256, 3) uint8: blue painting on white glaze, plain clay for the inside."""
    v, u = np.meshgrid((255.5 - np.arange(256)) / 256, (np.arange(256) + 0.5) / 256, indexing="ij")
    turn = 2 * np.pi * u
    waves = 0.5 + 0.5 * np.sin(5 * turn + 60 * v) * np.sin(5 * turn - 60 * v)
    band = (np.abs(v - 0.30) < 0.10) * (waves > 0.55)
    lines = sum((np.abs(v - at) < 0.008).astype(float) for at in (0.17, 0.43, 0.47, 0.06))
    leaves = np.abs(v - 0.56 - 0.02 * np.sin(10 * turn)) < 0.014 + 0.012 * np.cos(20 * turn)
    blue = np.clip(band + lines + leaves, 0.0, 1.0)[:, :, None]
    colour = (1 - blue) * np.array([243, 241, 234]) + blue * np.array([32, 62, 140])
    clay = np.broadcast_to(np.array([196, 152, 116]), colour.shape)
    return np.round(np.where(v[:, :, None] > 0.70, clay, colour)).astype(np.uint8)


def _png(image: Array) -> bytes:
    height, width, _ = image.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), image.reshape(height, -1)], axis=1)

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    packed = zlib.compress(rows.tobytes(), 9)
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


# ---------------------------------------------------------------------------------------------
# The list, and the work

MODELS = (
    Model(
        "bracket", ".ply", 0.20, True, _bracket, _plain_ply,
        "CAD part: exact planes and cylinders, sharp edges, two bores, varied triangle sizes",
        "PLY, binary little endian, float",
    ),
    Model(
        "dragon_egg", ".ply", 0.12, True, _dragon_egg, _big_endian_ply,
        "fine texture: 330 keeled scales, their steps about ten times the noise",
        "PLY, binary big endian, float, with vertex normals",
    ),
    Model(
        "coin", ".ply", 0.15, False, _coin, _scan_ply,
        "range scan: open, ragged, with holes; a lion in relief",
        "PLY, binary little endian, with a `camera` element, `confidence` and `quality`",
    ),
    Model(
        "bear", ".obj", 0.10, True, _bear, _grouped_obj,
        "uneven sampling: the largest triangle has over 1,000 times the smallest one's area",
        "OBJ with normals, groups and smoothing groups",
    ),
    Model(
        "vase", ".obj", 0.10, True, _vase, _textured_obj,
        "texture seams: more UVs than vertices, quads, two materials",
        "OBJ with `vase.mtl` and `vase.png`",
    ),
    Model(
        "knot", ".stl", 0.20, True, _knot, _soup_stl,
        "triangle soup: every corner is stored on its own and has to stay joined",
        "STL, binary",
    ),
    Model(
        "toadstool", ".ply", 0.15, True, _toadstool, _colour_ply,
        "quads and triangles mixed, vertex colours",
        "PLY, ascii, float, uchar red green blue alpha",
    ),
    Model(
        "rock", ".ply.gz", 0.10, True, _rock, _packed_ply,
        "compressed file; rough at every scale",
        "PLY, ascii, double, gzip",
    ),
)  # fmt: skip


def noisy(surface: Surface, level: float, seed: int) -> Array:
    """(n, 3) positions of ``surface`` with noise of ``level`` mean edge lengths along normals."""
    faces = shapes.triangulated(surface.faces)
    normals = shapes.vertex_normals(surface.vertices, faces)
    length = shapes.edge_lengths(surface.vertices, faces).mean()
    height = np.random.RandomState(seed).standard_normal(len(normals)) * level * length
    return shapes.on_grid(surface.vertices + normals * height[:, None])


def made() -> dict[str, bytes]:
    """Every file of this folder but the scripts: name -> bytes."""
    files = {"vase.mtl": _material(), "vase.png": _png(texture())}
    rows = []
    for seed, model in enumerate(MODELS, start=1):
        surface = model.make()
        files[f"{model.name}_clean{model.suffix}"] = model.write(surface, surface.vertices)
        rough = noisy(surface, model.noise, seed)
        files[f"{model.name}_noisy{model.suffix}"] = model.write(surface, rough)
        mean = shapes.edge_lengths(surface.vertices, shapes.triangulated(surface.faces)).mean()
        rows.append(
            f"| `{model.name}_*{model.suffix}` | {model.what} | {model.layout} "
            f"| {len(surface.vertices):,} | {len(surface.faces):,} "
            f"| {'closed' if model.closed else 'open'} | {model.noise:.2f} | {mean:.3f} |"
        )
    files["README.md"] = (_HEAD + "\n".join(rows) + "\n").encode()
    return files


_HEAD = """# Sample meshes

Eight models, each `_clean` and `_noisy`: the same vertices and faces, so that a result can be
compared with the truth vertex by vertex. All lengths are millimetres. The noise is Gaussian along
the vertex normals; its standard deviation is given in mean edge lengths.

Made by `make_sample_meshes.py` (numpy only, seeded; it writes this page too). Same licence as the
project.

| file | good for | format | vertices | faces | surface | noise (mean edges) | mean edge (mm) |
|---|---|---|--:|--:|---|--:|--:|
"""


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in made().items():
        (folder / name).write_bytes(data)
        print(f"{name:24}{len(data):10,} bytes")


if __name__ == "__main__":
    main()
