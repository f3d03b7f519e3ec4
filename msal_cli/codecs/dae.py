"""COLLADA files (``.dae``): positions and normals replaced inside the original bytes.

Read are the triangles, polygons, strips and fans of every mesh; materials, texture coordinates,
animations, skins, cameras and all else are kept without being looked into.  Several meshes are
denoised where the scene places them first, since two of them may coincide in their own frames.
"""

from __future__ import annotations

from urllib.parse import unquote

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.codecs.dae_scene import frames_of
from msal_cli.codecs.frames import PLACEMENT, is_placed
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.ply_writer import corners_of
from msal_cli.codecs.slots import Tokens
from msal_cli.codecs.surface_cells import strip_triangles
from msal_cli.codecs.text_lines import float_lines, integer_lines
from msal_cli.codecs.tokens import Words, require_indices
from msal_cli.codecs.xml_offsets import Element, parse_tree
from msal_cli.errors import EXPORT_AGAIN, FormatError, MsalError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_SURFACES = ("triangles", "polylist", "polygons", "tristrips", "trifans")
_WORDS = {"TEXCOORD": "texture coordinates", "COLOR": "vertex colours"}


def parse(data: Buffer) -> Layout:
    """Read a COLLADA file.

    Raises UnsupportedError for polygons with holes, and positions of other than three coordinates;
    TooLargeError for more elements than any mesh needs.
    """
    root = parse_tree(data, "COLLADA")
    if root.name != "COLLADA":
        raise FormatError("the file is no COLLADA", where="line 1", hint=EXPORT_AGAIN)
    meshes: list[tuple[str, _Mesh]] = []
    library = root.find("library_geometries")
    for geometry in library.all("geometry") if library is not None else ():
        element = geometry.find("mesh")
        mesh = _Mesh(data, element) if element is not None else None
        if mesh is not None and len(mesh.sizes):
            meshes.append((geometry.attributes.get("id", ""), mesh))
    if not meshes:
        return _empty(root)
    parts = [mesh for _, mesh in meshes]
    starts = np.cumsum([0, *(len(part.positions.values) for part in parts)])
    normals = [one for part in parts for one in part.normals]
    first_normals = np.cumsum([0, *(sum(len(n.values) for n in part.normals) for part in parts)])
    entries = [
        np.where(part.normal_of_corner < 0, -1, part.normal_of_corner + first)
        for part, first in zip(parts, first_normals, strict=False)
    ]
    words = dict.fromkeys(word for part in parts for word in part.properties)
    names = [name for name, _ in meshes]
    if len(parts) > 1:
        words = {f"{len(parts)} parts": None, **words}
    elif _is_placed(data, root, names[0]):
        words[PLACEMENT] = None
    return Layout(
        "ascii",
        "text",
        tuple(part.positions for part in parts),
        np.concatenate([part.corners + at for part, at in zip(parts, starts, strict=False)]),
        np.concatenate([part.sizes for part in parts]),
        tuple(normals),
        np.concatenate(entries) if normals else None,
        frames=tuple(frames_of(data, root, names)) if len(parts) > 1 else (),
        properties=tuple(words),
        warnings=tuple(dict.fromkeys(one for part in parts for one in part.warnings)),
        references=_images(data, root),
    )


def _is_placed(data: Buffer, root: Element, name: str) -> bool:
    """Whether the scene turns, scales or shifts a mesh; not if its transform cannot be read, which
    a mesh in its own frame does not need."""
    try:
        with np.errstate(all="ignore"):
            return is_placed(frames_of(data, root, [name])[0])
    except (MsalError, np.linalg.LinAlgError):
        return False


def _empty(root: Element) -> Layout:
    kinds = sorted({one.name for one in root.inner() if one.name in ("lines", "linestrips")})
    none = np.zeros(0, dtype=np.int64)
    empty = Tokens(np.zeros(0, dtype=np.uint8), none, none)
    return Layout("ascii", "text", (empty,), none, none, held=", ".join(kinds))


def _images(data: Buffer, root: Element) -> tuple[str, ...]:
    """Textures, as paths from the file."""
    library = root.find("library_images")
    found = []
    for image in library.all("image") if library is not None else ():
        one = image.find("init_from", "ref") or image.find("init_from")
        if one is not None:
            text = bytes(memoryview(data)[one.inside : one.stop]).decode("utf-8", "replace").strip()
            if text and ":" not in text and "<" not in text:
                found.append(unquote(text))
    return tuple(dict.fromkeys(found))


class _Mesh:
    """A ``mesh``: its positions, polygons and normals."""

    def __init__(self, data: Buffer, element: Element) -> None:
        self._data = data
        self._sources = {one.attributes.get("id", ""): one for one in element.all("source")}
        self._arrays: dict[str, Tokens] = {}
        self._normal_starts: dict[str, int] = {}
        self.normals: list[Tokens] = []
        self.properties: list[str] = []
        self.warnings: list[str] = []
        vertices = element.find("vertices")
        inputs = list(vertices.all("input")) if vertices is not None else []
        self._per_vertex = {one.attributes.get("semantic", ""): _source(one) for one in inputs}
        corners, sizes, entries = [_NONE], [_NONE], [_NONE]
        surfaces = [one for one in element.children if one.name in _SURFACES]
        if surfaces:
            if "POSITION" not in self._per_vertex:
                raise FormatError("a mesh has no positions", where=f"byte {element.start}")
            self.positions = self._array(self._per_vertex["POSITION"], is_normals=False)
        for one in surfaces:
            own = self._polygons(one)
            for all_of_them, part in zip((corners, sizes, entries), own, strict=True):
                all_of_them.append(part)
            if one.attributes.get("material"):
                self.properties.append("materials")
        self.corners, self.sizes, self.normal_of_corner = map(
            np.concatenate, (corners, sizes, entries)
        )
        if surfaces:
            require_indices(self.corners, len(self.positions.values))

    def _array(self, name: str, *, is_normals: bool) -> Tokens:
        """The rows of a source of three numbers each."""
        if name in self._arrays:
            return self._arrays[name]
        source = self._sources.get(name)
        array = source.find("float_array") if source is not None else None
        accessor = source.find("technique_common", "accessor") if source is not None else None
        if array is None or accessor is None:
            raise FormatError(f"there is no source {name[:40]!r}", hint=EXPORT_AGAIN)
        count, stride, offset = (
            _number(accessor, key, default)
            for key, default in (("count", "0"), ("stride", "1"), ("offset", "0"))
        )
        if stride < 3:
            raise UnsupportedError(f"positions or normals of {stride} numbers", hint="export in 3D")
        words = Words(self._data, array.inside, array.stop)
        words.require(offset + count * stride if count else 0, f"{count} rows of {name[:40]!r}")
        rows = offset + stride * np.arange(count, dtype=np.int64)
        self._arrays[name] = words.float_rows(rows, unit_length=is_normals)
        return self._arrays[name]

    def _polygons(self, surface: Element) -> tuple[Longs, Longs, Longs]:
        """Corners, sizes and normals of the polygons of one element."""
        offsets: dict[str, int] = {}
        width = 1
        normals = self._per_vertex.get("NORMAL", "")
        for one in surface.all("input"):
            semantic, offset = one.attributes.get("semantic", ""), _number(one, "offset", "0")
            width = max(width, offset + 1)
            offsets.setdefault(semantic, offset)
            if semantic == "NORMAL":
                normals = _source(one)
            if semantic in _WORDS:
                self.properties.append(_WORDS[semantic])
        if "VERTEX" not in offsets:
            raise FormatError("polygons without vertices", where=f"byte {surface.start}")
        if surface.find("ph") is not None:
            raise UnsupportedError("polygons with holes are not read", hint="export triangles")
        lists = [
            Words(self._data, one.inside, one.stop).integers(slice(None))
            for one in surface.all("p")
        ]
        rows = np.concatenate([_NONE, *lists])
        if any(len(one) % width for one in lists):
            raise FormatError(
                "the indices of polygons are cut", where=f"byte {surface.start}", hint=EXPORT_AGAIN
            )
        rows = rows.reshape(-1, width)
        counts = np.array([len(one) // width for one in lists], dtype=np.int64)
        place, sizes = self._corners(surface, counts)
        corners = rows[place, offsets["VERTEX"]]
        entries = np.full(len(corners), -1, dtype=np.int64)
        if normals:
            first = self._first_normal(normals)
            entries = rows[place, offsets.get("NORMAL", offsets["VERTEX"])]
            require_indices(entries, len(self._arrays[normals].values), "corner")
            entries = entries + first
        return corners, sizes, entries

    def _first_normal(self, name: str) -> int:
        """The number of normals in front of those of a source."""
        if name not in self._normal_starts:
            self._normal_starts[name] = sum(len(one.values) for one in self.normals)
            self.normals.append(self._array(name, is_normals=True))
            self.properties.append("point.normals")
        return self._normal_starts[name]

    def _corners(self, surface: Element, counts: Longs) -> tuple[Longs, Longs]:
        """Which rows are the corners of polygons, and how many each has; ``counts`` are the rows
        of each ``p``."""
        n_rows = int(counts.sum())
        if surface.name == "triangles":
            sizes = np.full(n_rows // 3, 3, dtype=np.int64)
        elif surface.name == "polylist":
            vcount = surface.find("vcount")
            words = Words(self._data, vcount.inside, vcount.stop) if vcount is not None else None
            sizes = words.integers(slice(None)) if words is not None else _NONE
        elif surface.name == "polygons":
            sizes = counts
        else:
            triangles = strip_triangles(counts, is_fan=surface.name == "trifans")
            return triangles.reshape(-1), np.full(len(triangles), 3, dtype=np.int64)
        is_wrong = (sizes < 0) | (sizes > n_rows)
        if is_wrong.any() or int(sizes.sum()) != n_rows:
            raise FormatError(
                "the polygons have not as many corners as they say",
                where=f"byte {surface.start}",
                hint=EXPORT_AGAIN,
            )
        is_face = sizes >= 3
        if not is_face.all():
            self.warnings.append("polygons of fewer than three corners are kept and left out")
        return np.flatnonzero(np.repeat(is_face, sizes)), sizes[is_face]


_NONE = np.zeros(0, dtype=np.int64)


def _source(one: Element) -> str:
    return one.attributes.get("source", "").removeprefix("#")


def _number(element: Element, name: str, default: str) -> int:
    word = element.attributes.get(name, default).strip()
    if not (word.isascii() and word.isdigit()) or len(word) > 9:
        raise FormatError(f"{name} is no number", where=f"byte {element.start}", hint=EXPORT_AGAIN)
    return int(word)


_TEMPLATE = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>1970-01-01T00:00:00</created><modified>1970-01-01T00:00:00</modified>\
<up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="mesh"><mesh>
<source id="positions"><float_array id="numbers" count="{n_numbers}">
{positions}</float_array><technique_common><accessor source="#numbers" count="{n_vertices}" \
stride="3"><param name="X" type="float"/><param name="Y" type="float"/>\
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="vertices"><input semantic="POSITION" source="#positions"/></vertices>
<triangles count="{n_faces}"><input semantic="VERTEX" source="#vertices" offset="0"/><p>
{faces}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="node">\
<instance_geometry url="#mesh"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>
"""


def written(points: Floats, faces: Ints, *, single: bool) -> bytes:
    """A new file of points (n, 3) and triangles (m, 3)."""
    return _TEMPLATE.format(
        n_numbers=points.size,
        positions=float_lines(points, single=single).decode(),
        n_vertices=len(points),
        n_faces=len(faces),
        faces=integer_lines(*corners_of(faces)).decode(),
    ).encode()
