"""PLY files: positions and normals replaced inside the original bytes.

Supported are ascii and both binary encodings, any elements and properties in any order, polygons
(``vertex_indices`` or ``vertex_index`` of ``face``), triangle strips (``tristrips``) and range
grids (``range_grid``).  An output is a copy of the file in which only ``x y z`` of moved vertices,
and the normals ``nx ny nz`` of vertices around them, differ.

A range grid, as in the Stanford archive, is a raw scan: a list of no vertex or one for each
sample, row by row; ``obj_info num_cols`` and ``num_rows`` give its size.  Neighbouring samples are
joined as by Turk and Levoy ("Zippered polygon meshes from range images", 1994): four make two
triangles along the shorter diagonal, three make one, and no triangle has an edge longer than four
times the spacing of samples, so that a surface is not joined with what is behind it.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.codecs import mesh_file, ply_header
from msal_cli.codecs.ply_body import Section, find_sections
from msal_cli.codecs.slots import require_range
from msal_cli.codecs.text_slots import plan_patches, replace_statements
from msal_cli.errors import (
    ContentError,
    FormatError,
    InputError,
    TooLargeError,
    bad_index,
    format_count,
    no_faces,
)
from msal_cli.kernels.text import as_bytes
from msal_cli.kernels.welding import repeated_corners
from msal_cli.light_dataclass import dataclass, field
from msal_cli.storage.regular import Buffer

GRID = "range_grid"

MAX_SPACINGS = 4.0  # longest edge that joins two samples, in median edge lengths

_FIRST, _SECOND = [[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]
"""The two triangles of four corners, along the first and along the second diagonal."""


def triangulate_grid(samples: Ints, vertices: Floats) -> Ints:
    """Triangles (m, 3) between neighbouring samples.

    samples (rows, columns) are vertices, -1 where the scanner saw nothing; vertices (n, 3).
    Raises ContentError (``E_NO_FACES``) if no three samples are neighbours.
    """
    around = (samples[:-1, :-1], samples[:-1, 1:], samples[1:, 1:], samples[1:, :-1])
    corners = np.stack([part.reshape(-1) for part in around], axis=1)
    is_there = corners >= 0
    n_there = is_there.sum(axis=1)
    pairs = np.full((len(corners), 2, 3), -1, dtype=np.int32)
    whole = corners[n_there == 4]
    diagonals = _squares(vertices, whole[:, :2], whole[:, 2:])
    is_first = (diagonals[:, 0] < diagonals[:, 1])[:, None, None]
    pairs[n_there == 4] = np.where(is_first, whole[:, _FIRST], whole[:, _SECOND])
    # In order, beginning after the missing corner.
    of_three = n_there == 3
    missing = np.argmin(is_there[of_three], axis=1)
    order = (missing[:, None] + np.arange(1, 4)) % 4
    pairs[of_three, 0] = np.take_along_axis(corners[of_three], order, axis=1)
    triangles = pairs.reshape(-1, 3)
    triangles = triangles[triangles[:, 0] >= 0]
    if not len(triangles):
        raise no_faces(
            "no three samples of the range grid are neighbours",
            f"element {GRID}",
            "the scan has no surface; check num_rows and num_cols",
        )
    squares = _squares(vertices, triangles, np.roll(triangles, 1, axis=1))
    with np.errstate(over="ignore"):
        longest = MAX_SPACINGS**2 * np.median(squares)
    return np.ascontiguousarray(triangles[squares.max(axis=1) <= longest])


def _squares(vertices: Floats, starts: Ints, stops: Ints) -> Floats:
    """The squared lengths of edges between vertices of these numbers, all (n, k)."""
    with np.errstate(over="ignore"):
        edges = vertices[stops] - vertices[starts]
        squares: Floats = (edges * edges).sum(axis=2)
    return squares


CORNERS = ("vertex_indices", "vertex_index")  # names of a list of corners
MAX_VERTICES = 2**31 - 1  # vertices that 32-bit indices can distinguish


class Surface(NamedTuple):
    """Triangles of all faces, in file order, and after them those of all strips.

    triangles : (m, 3) int32.
    corners, sizes : polygons as in ``Layout``, empty if all are triangles.
    n_polygons : faces, including those with fewer than three corners, and triangles of strips or of
        a range grid.
    grid : the samples (rows, columns) of a range grid with these triangles, else None.
    """

    triangles: Ints
    corners: Ints
    sizes: Longs | Ints
    n_polygons: int
    warnings: list[str]
    grid: Ints | None


def corner_list(element: ply_header.Element) -> str:
    """The name of the element's list of corners, empty if it has none.

    Raises FormatError if the property of that name is not a list.
    """
    for name in CORNERS:
        prop = element.find(name)
        if prop is not None:
            if not prop.is_list:
                raise FormatError(
                    f"property '{name}' of element '{element.name}' is not a list",
                    where=f"line {prop.line + 1}",
                )
            return name
    return ""


def find_surface(
    sections: Mapping[str, Section], header: ply_header.Header, vertices: Floats
) -> Surface:
    """The surface of the elements ``face`` and ``tristrips``, or of a range grid if these have no
    triangles.

    Raises ContentError (``E_INDEX`` with the face, ``E_NO_FACES``), FormatError (a corner is not
    a whole number, a range grid of unknown size) and TooLargeError.
    """
    n_vertices = len(vertices)
    if n_vertices > MAX_VERTICES:
        raise TooLargeError(f"{n_vertices:,} vertices exceed the {MAX_VERTICES:,} that are read")
    warnings: list[str] = []
    corners = np.empty(0, dtype=np.int32)
    triangles = strips = corners.reshape(0, 3)
    lengths: Longs | Ints = np.empty(0, dtype=np.int64)
    sizes = lengths
    samples = None
    lists = {
        element: (section, name)
        for element, section in sections.items()
        if element in ("face", "tristrips", GRID) and (name := corner_list(section.element))
    }
    if "face" in lists:
        faces, name = lists["face"]
        if all(faces.element.find(name) for name in CORNERS):
            warnings.append(f"faces have both {CORNERS[0]} and {CORNERS[1]}; {name} is used")
        corners, lengths = _read_corners(faces, name, n_vertices)
        triangles = mesh_file.cut_polygons(corners, lengths)
        sizes, is_face = lengths, lengths >= 3
        if not is_face.all():
            n_small = int(np.count_nonzero(~is_face))
            small = format_count(n_small, "face")
            warnings.append(f"{small} of fewer than three corners, kept and left out")
            corners, sizes = corners[np.repeat(is_face, lengths)], lengths[is_face]
    if "tristrips" in lists:
        strips = unroll_strips(*_read_corners(*lists["tristrips"], n_vertices, has_ends=True))
    if not len(triangles) and not len(strips):
        if GRID not in lists:
            raise _no_faces_error(sections.get("face"), n_vertices)
        samples = _grid_samples(*lists[GRID], header, n_vertices)
        strips = triangulate_grid(samples, vertices)
    if len(strips):
        triangles = np.concatenate([triangles, strips])
        corners = np.concatenate([corners, strips.reshape(-1)])
        sizes = np.concatenate([sizes, np.full(len(strips), 3)])
    if len(corners) == 3 * len(sizes):
        corners, sizes = corners[:0], sizes[:0]
    n_polygons = len(lengths) + len(strips)
    return Surface(triangles, corners, sizes, n_polygons, warnings, samples)


def _grid_samples(section: Section, name: str, header: ply_header.Header, n_vertices: int) -> Ints:
    count = section.element.count
    words = [header.infos.get(info, "") for info in ("num_rows", "num_cols")]
    shape = [int(word) for word in words if word.isdecimal() and len(word) < 10]
    if len(shape) < 2 or shape[0] * shape[1] != count:
        shown = " and ".join(word[:30] or "missing" for word in words)
        raise FormatError(
            f"num_rows and num_cols of the range grid of {count:,} samples are {shown}",
            where="header",
            hint="write 'obj_info num_rows R' and 'obj_info num_cols C' below the format line; "
            f"R times C are {count}",
        )
    lengths = section.items(name)[1]
    if (lengths > 1).any():
        raise FormatError(
            "a sample of the range grid has more than one vertex",
            where=section.where(int(np.argmax(lengths > 1))),
            hint="each sample is a list of no vertex or one",
        )
    samples = np.full(count, -1, dtype=np.int32)
    samples[lengths > 0] = _read_corners(section, name, n_vertices)[0]
    return samples.reshape(shape)


def _no_faces_error(faces: Section | None, n_vertices: int) -> ContentError:
    if faces is None or not faces.element.count:
        return no_faces(
            f"the file has {format_count(n_vertices, 'vertex')} but no faces: it is a point cloud",
            hint="make a surface of the points first (for example by Poisson reconstruction)",
        )
    message, hint = "no face has three corners or more", ""
    if not corner_list(faces.element):
        message = "the faces have no list 'vertex_indices' or 'vertex_index'"
        hint = "export the mesh with its faces' corners under one of these names"
    return no_faces(message, "element face", hint)


def unroll_strips(corners: Ints, lengths: Longs | Ints) -> Ints:
    """Triangles (m, 3) of strips of these ``lengths`` (s,): -1 begins another one, each second
    triangle is flipped, and those that name a vertex twice are dropped."""
    begins = np.zeros(len(corners) + 1, dtype=np.int64)
    for firsts in (np.cumsum(lengths), np.flatnonzero(corners < 0) + 1):
        begins[firsts] = firsts
    places = (np.arange(len(corners)) - np.maximum.accumulate(begins[:-1]))[2:]
    a, b, c = corners[:-2], corners[1:-1], corners[2:]
    is_odd = places % 2 == 1
    triangles = np.stack([np.where(is_odd, b, a), np.where(is_odd, a, b), c], axis=1)
    return triangles[(places >= 2) & (c >= 0) & ~repeated_corners(triangles)]


def _read_corners(
    section: Section, name: str, n_vertices: int, *, has_ends: bool = False
) -> tuple[Ints, Longs | Ints]:
    """The corners (c,) of an element's lists, and how many each record has (count,).

    Raises ContentError (``E_INDEX``) for a corner that is no vertex (with ``has_ends``, -1 is
    allowed: it ends a strip), FormatError for one that is not a whole number.
    """
    items, lengths = section.items(name)

    def record_of(item: int) -> int:
        return int(np.searchsorted(np.cumsum(lengths), item, side="right"))

    if items.dtype.kind == "f":
        values = items.astype(np.float64)
        whole = np.isfinite(values) & (np.rint(values) == values)
        if not whole.all():
            record = record_of(int(np.argmin(whole.reshape(-1))))
            raise FormatError("a corner is not a whole number", where=section.where(record))
    corners = _as_indices(items)
    # As unsigned, a negative index is a very large one.
    if len(corners) and int(corners.view(np.uint32).max()) >= n_vertices:
        is_wrong = (corners.view(np.uint32) >= n_vertices) & ~(has_ends & (corners == -1))
        if is_wrong.any():
            item = int(np.argmax(is_wrong))
            record = record_of(item)
            raise bad_index(
                f"{section.element.name} {record} names vertex {items.reshape(-1)[item].item()}, "
                f"but the vertices go from 0 to {n_vertices - 1}",
                section.where(record),
            )
    return corners, lengths


def _as_indices(items: NDArray[Any]) -> Ints:
    """Whole numbers as int32 (c,); values that do not fit become indices that no mesh has."""
    kind, size = items.dtype.kind, items.dtype.itemsize
    if kind == "f":
        items = np.clip(items.astype(np.float64), -2.0, 2.0**31 - 1.0)
    elif size == 8 and items.size:
        items = items.astype(items.dtype.newbyteorder("="), copy=False)
        low, high = (0 if kind == "u" else -2), MAX_VERTICES
        if items.min() < low or items.max() > high:
            items = np.clip(items, low, high)
    is_plain = size == 4 and kind in "iu" and items.dtype.isnative and items.size > 0
    if is_plain and items.ndim == 2 and items.strides[1] == size:
        # Faster by records than by numbers.  An index beyond int32 becomes negative.
        items = np.ascontiguousarray(items.view(f"V{items.shape[1] * size}")).view(np.int32)
    return np.ascontiguousarray(items.astype(np.int32, copy=False)).reshape(-1)


def wanted_names(element: ply_header.Element) -> Sequence[str]:
    """Properties whose places are needed: positions, normals, corners."""
    if element.name == "vertex":
        return ply_header.POSITION + ply_header.NORMAL
    return CORNERS if element.name in ("face", "tristrips", GRID) else ()


def has_normals(element: ply_header.Element) -> bool:
    """Whether the element has nx, ny and nz as floating-point scalars."""
    found = [element.find(name) for name in ply_header.NORMAL]
    return all(prop is not None and not prop.is_list and prop.code[0] == "f" for prop in found)


def vertex_element(header: ply_header.Header) -> ply_header.Element:
    """The element ``vertex``; FormatError if it is missing, or lacks the scalars x, y and z."""
    vertex = header.find("vertex")
    if vertex is None:
        raise FormatError(
            "the header declares no element 'vertex'",
            where="header",
            hint="this PLY file does not hold a mesh",
        )
    for name in ply_header.POSITION:
        prop = vertex.find(name)
        if prop is None or prop.is_list:
            problem = "is a list" if prop is not None else "is missing"
            raise FormatError(
                f"the coordinate '{name}' of element 'vertex' {problem}", where="header"
            )
    if (name := corner_list(vertex)) and header.find("face") is None:
        raise FormatError(
            f"the list '{name}' is declared for element 'vertex', and there is no element 'face'",
            where="header",
            hint="put a line 'element face' with the number of faces in front of the list",
        )
    return vertex


def properties_of(header: ply_header.Header, grid: Ints | None = None) -> tuple[str, ...]:
    """What the file contains besides positions and corners, in file order; ``grid`` (rows, columns)
    are the samples of a range grid whose surface is used."""
    carried: list[str] = []
    for element in header.elements:
        if element.name == GRID and grid is not None:
            carried.append(f"range grid of {grid.shape[0]} rows and {grid.shape[1]} columns")
            continue
        if element.name not in ("vertex", "face", "tristrips"):
            carried.append(f"element {element.name} ({element.count})")
            continue
        known = ply_header.POSITION if element.name == "vertex" else (corner_list(element),)
        carried += [
            f"{element.name}.{prop}" for prop in element.properties if prop.name not in known
        ]
    return (*carried, *header.notes)


@dataclass(eq=False, kw_only=True)
class PlyLayout(mesh_file.Layout):
    header: ply_header.Header
    # the elements by name; ``end`` is the byte after the last one
    sections: Mapping[str, Section] = field(repr=False)
    end: int
    surface: Surface


def parse(data: Buffer) -> PlyLayout:
    """Find the positions, normals and faces of a PLY file; raises as ``PlyFile`` does."""
    content = as_bytes(memoryview(data).cast("B"))
    header = ply_header.parse_header(memoryview(data).cast("B"))
    vertex = vertex_element(header)
    sections, end = find_sections(content, header, wanted_names)
    positions = sections["vertex"].slots(ply_header.POSITION)
    vertices = positions.values
    # Read now, so that an invalid number is reported before any work is done.
    normals = (sections["vertex"].slots(ply_header.NORMAL),) if has_normals(vertex) else ()
    surface = find_surface(sections, header, vertices)
    corners = surface.triangles if surface.grid is None else surface.grid
    unplaced = mesh_file.find_unplaced(vertices, corners, sections["vertex"].where)
    rest = content[end:]
    n_trailing = len(rest.tobytes().strip()) if header.encoding == "ascii" else len(rest)
    warnings = []
    codes = {prop.name: prop.code for prop in vertex.find_all(ply_header.POSITION)}
    if whole := [name for name, code in codes.items() if code[0] != "f"]:
        warnings.append(
            f"coordinates {', '.join(whole)} are whole numbers: new ones are rounded to the "
            "nearest, halves to the even one"
        )
    named = [prop.name for prop in vertex.properties if prop.name in ply_header.NORMAL]
    if named and not normals:
        warnings.append(
            f"the {', '.join(named)} of element 'vertex' are not three floating-point numbers: "
            "they are kept, not recomputed"
        )
    faces = header.find("face")
    if faces is not None and any(faces.find(name) for name in ply_header.NORMAL):
        warnings.append("normals of faces are kept as they are")
    warnings += surface.warnings
    if n_trailing:
        warnings.append(f"{format_count(n_trailing, 'byte')} behind the last element, kept")
    types = {"f4": "float32", "f8": "float64"}
    coarsest = next((name for code, name in types.items() if code in codes.values()), "integer")
    return PlyLayout(
        encoding=header.encoding,
        precision="text" if header.encoding == "ascii" else coarsest,
        positions=(positions,),
        normals=normals,
        vertices=vertices,
        unplaced=unplaced,
        faces=surface.triangles,
        corners=surface.corners,
        sizes=surface.sizes,
        properties=properties_of(header, surface.grid),
        references=tuple(header.textures),
        warnings=tuple(warnings),
        header=header,
        sections=sections,
        end=end,
        surface=surface,
    )


class PlyFile(mesh_file.MeshFile):
    """An opened PLY file; see ``codecs.mesh_file.MeshFile`` for its attributes.

    ``precision`` is the type of the coordinates: ``float32`` (also if some are double: the coarsest
    type counts), ``float64``, ``text`` in ascii, or ``integer``.  Whole-number coordinates are
    rounded to the nearest whole number, halves to the even one.

    Raises FormatError (not PLY, or an invalid line, type or value), TruncatedError (fewer bytes or
    lines than the header counts), ContentError (``E_NONFINITE``, ``E_INDEX``, ``E_NO_FACES``),
    UnsupportedError and TooLargeError, each with the place.
    """

    _layout: PlyLayout

    def __init__(self, data: Buffer) -> None:
        super().__init__(data, "ply", parse(data))
        surface = self._layout.surface
        self.n_polygons, self.grid = surface.n_polygons, surface.grid

    def vertex_scalars(self) -> dict[str, str]:
        """The scalar properties of the vertices, with the numpy codes of their types."""
        properties = self._layout.sections["vertex"].element.properties
        return {prop.name: prop.code for prop in properties if not prop.is_list}

    def read_scalars(self, names: tuple[str, ...]) -> Floats:
        """These scalar properties of the vertices (n, len(names))."""
        sections, _ = find_sections(
            as_bytes(self._data),
            self._layout.header,
            lambda element: names if element.name == "vertex" else (),
            last="vertex",
        )
        return sections["vertex"].slots(names).values

    def vertex_property(self, name: str) -> Floats:
        scalars = self.vertex_scalars()
        if name not in scalars:
            is_list = self._layout.sections["vertex"].element.find(name) is not None
            raise InputError(
                f"the vertices have no property {name!r}{' that is a number' * is_list}",
                code="E_PROPERTY",
                hint=f"they have: {', '.join(scalars)}",
            )
        return np.ascontiguousarray(self.read_scalars((name,))[:, 0])

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with new positions (n, 3) in another encoding or with other number types.

        ``encoding`` is ``same``, ``ascii`` or ``binary`` (little endian); ``precision`` is
        ``same``, ``float32`` or ``float64``, for positions and normals.  All elements, properties
        and comments are kept, in order; bytes after the last element are kept if the encoding
        stays.  Raises ContentError (``E_RANGE``) if a value does not fit its type, FormatError if
        an ascii value is not of its declared type.
        """
        layout = self._layout
        data, old = as_bytes(self._data), layout.header
        names = ply_header.POSITION + (ply_header.NORMAL if layout.normals else ())
        old_text = data[: old.size].tobytes()
        numbers = vertex_element(old).find_all(names)
        text = ply_header.retype_header(old, old_text, encoding, precision, numbers)
        if text == old_text:
            return self.replaced(vertices)
        mesh_file.require_shape(vertices, self.vertices)
        header = ply_header.parse_header(memoryview(text))
        codes = tuple(prop.code for prop in vertex_element(header).find_all(ply_header.POSITION))
        require_range(vertices, np.ones(vertices.shape, dtype=bool), codes)
        if header.encoding == old.encoding == "ascii":
            # Format new numbers for the new types; nothing else of the lines changes.
            positions = copy.copy(layout.positions[0])
            positions.codes = codes
            retyped = copy.copy(self)
            retyped._layout = replace(layout, positions=(positions,))
            changes = retyped._changes(vertices)
            patches = plan_patches(changes, have_own=False)
            lines = replace_statements(data, patches) if changes else data.data
            return text + lines[old.size :]
        normals = (change.values for change in self._changed_normals(vertices))
        new = [self.with_unplaced(vertices), *normals]
        values = dict(zip(names, np.concatenate(new, axis=1).T, strict=True))
        from msal_cli.codecs.ply_write import recode

        return recode(data, old, header, text, values, layout.end)


read = PlyFile
