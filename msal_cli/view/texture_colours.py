"""Textures of OBJ and PLY files as colours of their vertices: the mean of the image at each corner.

An image finer than the vertices is shown as coarse as they are.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from msal_cli.arrays import Floats, Longs
from msal_cli.codecs.colour_values import UNPAINTED, Colours, to_bytes
from msal_cli.codecs.mesh_file import HasVertexProperties, MeshFile
from msal_cli.codecs.named_files import read_beside
from msal_cli.errors import ContentError
from msal_cli.view.textures import Texture, read_texture, sample_texture

_MOST_LIBRARY_BYTES = 16 << 20
_MOST_IMAGES = 256
_CONTINUED = re.compile(rb"\\\r?\n")
_TEXTURE_FILE = re.compile(rb"^comment TextureFile[ \t]+([^\r\n]+)", re.MULTILINE)
_PLACE_NAMES = (("texture_u", "texture_v"), ("s", "t"), ("u", "v"))

Notes = dict[str, None]


@dataclass
class _Corners:
    """Vertex and texture numbers (from 0, -1 for none) and material of each corner."""

    vertices: list[int] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    materials: list[int] = field(default_factory=list)


@dataclass
class _Material:
    colour: tuple[float, ...] = UNPAINTED
    image: str = ""


def obj_colours(mesh_file: MeshFile, folder: Path | None, notes: Notes) -> Colours | None:
    """Colours (n, 3) by the images ``map_Kd`` of an OBJ file's materials; None without any."""
    if not mesh_file.references:
        return None
    data = bytes(mesh_file.replaced(mesh_file.vertices))
    materials = _read_libraries(mesh_file.references, folder, notes)
    images = _read_images({one.image for one in materials.values() if one.image}, folder, notes)
    if not images:
        return None
    n_vertices = len(mesh_file.vertices)
    corners, places, names = _walk_obj(data)
    vertices = np.array(corners.vertices, dtype=np.int64)
    at = np.array(corners.places, dtype=np.int64)
    used = np.array(corners.materials, dtype=np.int64)
    colours = np.full((len(vertices), 3), np.nan)
    for number, name in enumerate(names):
        own = np.flatnonzero(used == number)
        material = materials.get(name, _Material())
        texture = images.get(material.image)
        if texture is None:
            colours[own] = material.colour
            continue
        own = own[(at[own] >= 0) & (at[own] < len(places))]
        colours[own] = sample_texture(texture, places[at[own]] * (1.0, -1.0) + (0.0, 1.0))
    return _mean_at_vertices(vertices, colours, n_vertices)


def ply_colours(mesh_file: MeshFile, folder: Path | None, notes: Notes) -> Colours | None:
    """Colours (n, 3) by the first image that a PLY file names and the texture coordinates of its
    vertices; None without both."""
    data = memoryview(mesh_file.replaced(mesh_file.vertices)).cast("B")
    head = bytes(data[: 1 << 16])
    names = _TEXTURE_FILE.findall(head[: max(head.find(b"end_header"), 0)])
    if not names or not isinstance(mesh_file, HasVertexProperties):
        return None
    pair = next(
        (
            pair
            for pair in _PLACE_NAMES
            if all(f"vertex.{one} " in f"{' '.join(mesh_file.properties)} " for one in pair)
        ),
        None,
    )
    if pair is None:
        notes["texture coordinates of faces are not shown"] = None
        return None
    name = names[0].decode("utf-8", "replace").strip()
    texture = _read_images({name}, folder, notes).get(name)
    if texture is None:
        return None
    if len(names) > 1:
        notes["only the first of several textures is shown"] = None
    u, v = (mesh_file.vertex_property(one) for one in pair)
    colours = sample_texture(texture, np.stack([u, 1.0 - v], axis=1))
    return _mean_at_vertices(np.arange(len(colours)), colours, len(colours))


def _mean_at_vertices(vertices: Longs, colours: Floats, n_vertices: int) -> Colours:
    """Means (n, 3) of the colours (k, 3) at the vertices of the corners (k,)."""
    is_known = np.isfinite(colours[:, 0]) & (vertices >= 0) & (vertices < n_vertices)
    places, known = vertices[is_known], colours[is_known]
    count = np.bincount(places, minlength=n_vertices)
    means = np.tile(np.array(UNPAINTED, dtype=np.float64), (n_vertices, 1))
    for k in range(3):
        sums = np.bincount(places, weights=known[:, k], minlength=n_vertices)
        means[count > 0, k] = sums[count > 0] / count[count > 0]
    return to_bytes(means)


def _walk_obj(data: bytes) -> tuple[_Corners, Floats, list[str]]:
    """The corners of all faces, the texture coordinates (t, 2) and the names of materials."""
    corners, rows, names = _Corners(), [], [""]
    numbers = {"": 0}
    n_vertices = material = 0
    for line in _CONTINUED.sub(b" ", data).splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            n_vertices += 1
        elif words[0] == b"vt":
            rows.append((float(words[1]), float(words[2]) if len(words) > 2 else 0.0))
        elif words[0] == b"usemtl":
            name = b" ".join(words[1:]).decode("utf-8", "replace")
            material = numbers.setdefault(name, len(numbers))
            if material == len(names):
                names.append(name)
        elif words[0] in (b"f", b"fo"):
            for word in words[1:]:
                if word.startswith(b"#"):
                    break
                parts = word.split(b"/")
                corners.vertices.append(_from_zero(parts[0], n_vertices))
                has_place = len(parts) > 1 and parts[1]
                corners.places.append(_from_zero(parts[1], len(rows)) if has_place else -1)
                corners.materials.append(material)
    return corners, np.array(rows, dtype=np.float64).reshape(-1, 2), names


def _from_zero(word: bytes, count: int) -> int:
    number = int(word)
    return number - 1 if number > 0 else max(count + number, -1)


def _read_libraries(
    names: tuple[str, ...], folder: Path | None, notes: Notes
) -> dict[str, _Material]:
    """The materials of the .mtl files among what an OBJ file names."""
    materials: dict[str, _Material] = {}
    for name in names:
        if not name.lower().endswith(".mtl"):
            continue
        try:
            text = read_beside(name, folder, _MOST_LIBRARY_BYTES).decode("utf-8", "replace")
        except ContentError as failure:
            notes[str(failure)] = None
            continue
        current = _Material()
        for line in text.splitlines():
            key, _, rest = line.strip().partition(" ")
            if key == "newmtl":
                current = materials.setdefault(rest.strip(), _Material())
            elif key == "Kd" and len(rest.split()) >= 3:
                current.colour = tuple(255.0 * float(one) for one in rest.split()[:3])
            elif key.lower() == "map_kd":
                # Options come first; a name may have spaces.
                current.image = (
                    rest.strip() if not rest.lstrip().startswith("-") else (rest.split()[-1])
                )
    return materials


def _read_images(names: set[str], folder: Path | None, notes: Notes) -> dict[str, Texture]:
    images = {}
    for name in sorted(names)[:_MOST_IMAGES]:
        try:
            images[name] = read_texture(name, folder)
        except ContentError as failure:
            notes[str(failure)] = None
    return images
