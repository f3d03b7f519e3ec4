"""The surface of a PLY file: polygons and strips as triangles, and the normals of its faces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.codecs import ply_grid
from msal_cli.codecs.ply_header import Element, Header
from msal_cli.codecs.ply_sections import Fixed, Section
from msal_cli.errors import ContentError, FormatError, TooLargeError

Triangles = NDArray[np.int32]

CORNERS = ("vertex_indices", "vertex_index")
"""Names that a list of corners goes by."""

MOST_VERTICES = 2**31 - 1
"""Vertices that 32-bit indices can tell apart."""

_FLAT = 1e-12
"""Polygon area over the product of its edges, at and below which it has no usable normal."""


@dataclass(frozen=True)
class Surface:
    """Triangles of all faces, in file order, and behind them those of all strips.

    triangles : (m, 3) int32; the first ones, face by face, are the faces' fans.
    lengths : corners of every face: one number where all agree, else (n_faces,) int64.
    n_faces : faces in the element ``face``, also those of fewer than three corners.
    n_strip_triangles : triangles of strips or of a range grid.
    grid : the samples (rows, columns) of a range grid whose triangles these are, else None.
    """

    triangles: Triangles
    lengths: int | Longs
    n_faces: int
    n_strip_triangles: int
    warnings: tuple[str, ...]
    faces: Section | None
    list_name: str
    grid: Ints | None = None

    @property
    def n_polygons(self) -> int:
        """Faces as the file counts them, and the triangles of its strips."""
        return self.n_faces + self.n_strip_triangles

    def _fans(self) -> tuple[Triangles, NDArray[np.integer[Any]]]:
        """The triangles (t, 3) that are cut from faces, and the face (t,) of each."""
        cut = self.triangles[: len(self.triangles) - self.n_strip_triangles]
        pieces = np.maximum(np.asarray(self.lengths) - 2, 0)
        return cut, np.repeat(np.arange(self.n_faces), pieces)

    def touched(self, moved: Flags) -> Flags:
        """Which faces (n_faces,) have a corner among the ``moved`` vertices (n,)."""
        cut, face = self._fans()
        result = np.zeros(self.n_faces, dtype=bool)
        result[face[moved[cut].any(axis=1)]] = True
        return result

    def face_normals(
        self, old_vertices: Floats, vertices: Floats, moved: Flags, old_normals: Floats
    ) -> tuple[Floats, Flags]:
        """Normals (n_faces, 3) of the faces after a move, and which of them changed (n_faces,).

        A polygon's normal is the direction of the sum of its triangles' area vectors, with the
        sense that the stored normal had.  A stored normal that is zero or not finite is kept,
        and so is that of a face without moved corners or with no area.
        """
        cut, face = self._fans()
        usable = np.isfinite(old_normals).all(axis=1) & (old_normals != 0.0).any(axis=1)
        # Faces whose area overflows or underflows keep their normals.
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            before, _ = _area_vectors(old_vertices, cut, face, self.n_faces)
            after, scale = _area_vectors(vertices, cut, face, self.n_faces)
            length = np.sqrt((after * after).sum(axis=1))
            changed = self.touched(moved) & usable & (length > _FLAT * scale)
            changed &= np.isfinite(length)
            opposed = (before * np.where(usable[:, None], old_normals, 0.0)).sum(axis=1) < 0.0
        sense = np.where(opposed, -1.0, 1.0)[:, None]
        unit = np.where(changed[:, None], after, 0.0) / np.where(changed, length, 1.0)[:, None]
        return np.where(changed[:, None], unit * sense, old_normals), changed

    def polygons(self) -> list[Any] | Triangles:
        """The faces with all their corners: (m, k) int32 where all agree, else a list."""
        strips = self.triangles[len(self.triangles) - self.n_strip_triangles :]
        if self.faces is None or isinstance(self.lengths, int):
            if self.faces is None or self.lengths == 3 or not self.n_faces:
                return self.triangles
            corners = self.faces.items(self.list_name)[0].astype(np.int32)
            whole = corners.reshape(self.n_faces, self.lengths)
            if self.lengths < 3:
                return strips
            return [*whole, *strips] if len(strips) else whole
        corners = self.faces.items(self.list_name)[0].astype(np.int32)
        cuts = np.cumsum(self.lengths)[:-1]
        return [one for one in np.split(corners, cuts) if len(one) > 2] + list(strips)


def _area_vectors(
    vertices: Floats, triangles: Triangles, face: NDArray[np.integer[Any]], n_faces: int
) -> tuple[Floats, Floats]:
    """Doubled area vectors (n_faces, 3) and, for scale, the summed products of edges (n_faces,)."""
    first = vertices[triangles[:, 0]]
    u = vertices[triangles[:, 1]] - first
    w = vertices[triangles[:, 2]] - first
    cross = np.cross(u, w)
    sums = [np.bincount(face, weights=cross[:, k], minlength=n_faces) for k in range(3)]
    edges = np.sqrt((u * u).sum(axis=1) * (w * w).sum(axis=1))
    scale: Floats = np.bincount(face, weights=edges, minlength=n_faces).astype(np.float64)
    return np.stack(sums, axis=1), scale


def corner_list(element: Element) -> str:
    """The name of the element's list of corners, empty where it has none.

    Raises FormatError where the property of that name is no list.
    """
    for name in CORNERS:
        one = element.find(name)
        if one is not None:
            if not one.is_list:
                raise FormatError(
                    f"property '{name}' of element '{element.name}' is not a list",
                    where=f"line {one.line + 1}",
                )
            return name
    return ""


def find_surface(sections: Mapping[str, Section], header: Header, vertices: Floats) -> Surface:
    """The surface in the elements ``face`` and ``tristrips``, or between the samples of a range
    grid where these have no triangles.

    Raises ContentError (``E_INDEX`` with the face, ``E_NO_FACES``), FormatError (a corner is not
    a whole number, a range grid of unknown size) and TooLargeError.
    """
    n_vertices = len(vertices)
    if n_vertices > MOST_VERTICES:
        raise TooLargeError(
            f"{n_vertices} vertices are more than the {MOST_VERTICES} that are read"
        )
    warnings: list[str] = []
    triangles = np.empty((0, 3), dtype=np.int32)
    strips = triangles
    lengths: int | Longs = 0
    faces = sections.get("face")
    name = corner_list(faces.element) if faces is not None else ""
    if faces is not None and name:
        if all(faces.element.find(one) for one in CORNERS):
            warnings.append(warn_of_two_lists(name))
        triangles, lengths = _polygon_triangles(faces, name, n_vertices)
        few = faces.element.count if isinstance(lengths, int) else int((lengths < 3).sum())
        if isinstance(lengths, int) and lengths >= 3:
            few = 0
        if few:
            warnings.append(warn_of_few(few))
    strip_section = sections.get("tristrips")
    strip_name = corner_list(strip_section.element) if strip_section is not None else ""
    if strip_section is not None and strip_name:
        strips = _strip_triangles(strip_section, strip_name, n_vertices)
    grid = sections.get(ply_grid.NAME)
    samples = None
    if not len(triangles) and not len(strips) and grid is not None and corner_list(grid.element):
        samples = _grid_samples(grid, header, n_vertices)
        strips = ply_grid.triangulate_grid(samples, vertices)
    if not len(triangles) and not len(strips):
        face = sections.get("face")
        raise no_faces(face.element if face is not None else None, n_vertices)
    return Surface(
        triangles=np.concatenate([triangles, strips]) if len(strips) else triangles,
        lengths=lengths,
        n_faces=faces.element.count if faces is not None and name else 0,
        n_strip_triangles=len(strips),
        warnings=tuple(warnings),
        faces=faces if name else None,
        list_name=name,
        grid=samples,
    )


def _grid_samples(section: Section, header: Header, n_vertices: int) -> Ints:
    """The samples (rows, columns) of a range grid, -1 for none."""
    shape = ply_grid.grid_shape(header, section.element)
    name = corner_list(section.element)
    items, lengths = section.items(name)
    if (lengths > 1).any():
        raise FormatError(
            "a sample of the range grid has more than one vertex",
            where=section.where(int(np.argmax(lengths > 1))),
            hint="each sample is a list of no vertex or one",
        )
    corners = _as_indices(items, section, name).reshape(-1)
    if len(corners) and int(corners.view(np.uint32).max()) >= n_vertices:
        raise bad_index(
            section, name, int(np.argmax(corners.view(np.uint32) >= n_vertices)), n_vertices
        )
    samples = np.full(section.element.count, -1, dtype=np.int32)
    samples[lengths > 0] = corners
    return samples.reshape(shape)


def warn_of_few(n_few: int) -> str:
    """What a user should know of faces that have no triangle."""
    return f"{n_few} faces have fewer than three corners and are only carried along"


def warn_of_two_lists(name: str) -> str:
    """What a user should know of faces with two lists, of which ``name`` is read."""
    return f"faces have both {CORNERS[0]} and {CORNERS[1]}; {name} is used"


def no_faces(face: Element | None, n_vertices: int) -> ContentError:
    """The error for a file without triangles; ``face`` is its element of that name."""
    if face is not None and face.count and not corner_list(face):
        return ContentError(
            "the faces have no list 'vertex_indices' or 'vertex_index'",
            where="element face",
            hint="export the mesh with its faces' corners under one of these names",
            code="E_NO_FACES",
        )
    if face is not None and face.count:
        return ContentError(
            "no face has three corners or more", where="element face", code="E_NO_FACES"
        )
    return ContentError(
        f"the file has {n_vertices} vertices but no faces: it is a point cloud",
        hint="make a surface of the points first (for example by Poisson reconstruction)",
        code="E_NO_FACES",
    )


def _polygon_triangles(
    section: Section, name: str, n_vertices: int
) -> tuple[Triangles, int | Longs]:
    """The triangles of polygons and the polygons' numbers of corners, checked."""
    if isinstance(section, Fixed):
        column = section.column(name)
        lengths: int | Longs = column.shape[1]
        corners = _as_indices(column, section, name).reshape(-1)
    else:
        items, each = section.items(name)
        is_uniform = len(each) > 0 and bool((each == each[0]).all())
        lengths = int(each[0]) if is_uniform else np.asarray(each, dtype=np.int64)
        corners = _as_indices(items, section, name)
    # Seen as unsigned, a negative index is a very large one.
    if len(corners) and int(corners.view(np.uint32).max()) >= n_vertices:
        at = int(np.argmax(corners.view(np.uint32) >= n_vertices))
        raise bad_index(section, name, at, n_vertices)
    if not isinstance(lengths, int):
        from msal_cli.kernels.ply_scan import fans

        triangles = np.empty((int(np.maximum(lengths - 2, 0).sum()), 3), dtype=np.int32)
        fans(corners, lengths, triangles)
        return triangles, lengths
    if lengths < 3:
        return np.empty((0, 3), dtype=np.int32), lengths
    whole = corners.reshape(-1, lengths)
    if lengths == 3:
        return whole, lengths
    cut = np.empty((len(whole), lengths - 2, 3), dtype=np.int32)
    cut[:, :, 0] = whole[:, :1]
    cut[:, :, 1] = whole[:, 1:-1]
    cut[:, :, 2] = whole[:, 2:]
    return cut.reshape(-1, 3), lengths


def _strip_triangles(section: Section, name: str, n_vertices: int) -> Triangles:
    from msal_cli.kernels.ply_scan import unroll_strips

    items, lengths = section.items(name)
    corners = _as_indices(items, section, name)
    # -1 ends a strip; as an unsigned 32-bit number it is the largest one.
    beyond = (corners.view(np.uint32) >= n_vertices) & (corners != -1)
    if beyond.any():
        raise bad_index(section, name, int(np.argmax(beyond)), n_vertices)
    triangles = np.empty((len(corners), 3), dtype=np.int32)
    count = unroll_strips(corners, lengths, triangles)
    return triangles[:count].copy()


def _as_indices(items: NDArray[np.generic], section: Section, name: str) -> Triangles:
    """Corners as int32; what does not fit is made an index that no mesh has."""
    kind, size = items.dtype.kind, items.dtype.itemsize
    if kind == "f":
        values = items.astype(np.float64)
        whole = np.isfinite(values) & (np.rint(values) == values)
        if not whole.all():
            raise broken_index(section, name, int(np.argmin(whole.reshape(-1))))
        items = np.clip(values, -2.0, 2.0**31 - 1.0)
    elif size == 8 and items.size:
        items = items.astype(items.dtype.newbyteorder("="), copy=False)
        low, high = (0 if kind == "u" else -2), MOST_VERTICES
        if items.min() < low or items.max() > high:
            items = np.clip(items, low, high)
    is_plain = size == 4 and kind in "iu" and items.dtype.isnative and items.size > 0
    if is_plain and items.ndim == 2 and items.strides[1] == size:
        # Record by record, not number by number.  An index beyond int32 becomes a negative one.
        return np.ascontiguousarray(items.view(f"V{items.shape[1] * size}")).view(np.int32)
    return np.ascontiguousarray(items.astype(np.int32, copy=False))


def _record_of(section: Section, name: str, item: int) -> int:
    """The record that holds the list item of that number."""
    lengths = section.items(name)[1]
    return int(np.searchsorted(np.cumsum(lengths), item, side="right"))


def broken_index(section: Section, name: str, item: int) -> FormatError:
    """The error for a list item that is no whole number."""
    record = _record_of(section, name, item)
    return FormatError("a corner is not a whole number", where=section.where(record))


def bad_index(section: Section, name: str, item: int, n_vertices: int) -> ContentError:
    """The error for a list item that is no vertex."""
    record = _record_of(section, name, item)
    value = section.items(name)[0].reshape(-1)[item].item()
    return ContentError(
        f"{section.element.name} {record} names vertex {value}, but the vertices go from 0 to "
        f"{n_vertices - 1}",
        where=section.where(record),
        hint="the file is damaged or was written with wrong indices; export it again",
        code="E_INDEX",
    )
