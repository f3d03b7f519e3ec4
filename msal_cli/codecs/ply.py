"""PLY files: positions and normals replaced inside the original bytes.

Read are ascii and both binary encodings, any elements and properties in any order, polygons
(``vertex_indices`` or ``vertex_index`` of ``face``), triangle strips (``tristrips``) and range
grids (``range_grid``).  Written is a copy of the file in which only ``x y z`` of moved vertices,
and the normals ``nx ny nz`` of vertices and faces around them, differ.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats
from msal_cli.codecs.layout import Layout, require_finite
from msal_cli.codecs.ply_ascii import Lines
from msal_cli.codecs.ply_description import (
    check_strays,
    has_normals,
    precision_of,
    properties_of,
    scalar_property,
    vertex_element,
    wanted_names,
    warn_of_rest,
    warnings_of,
)
from msal_cli.codecs.ply_faces import Surface, find_surface
from msal_cli.codecs.ply_header import NORMAL, POSITION, Header, parsed
from msal_cli.codecs.ply_sections import Section, located
from msal_cli.codecs.slot_file import SlotFile, require_shape
from msal_cli.codecs.slots import Slots, require_range
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.regular import Buffer

_STREAM_WARNING = (
    "the records do not stand one to a line: they are read as a stream of words, and the lines kept"
)


def read(data: Buffer) -> PlyFile:
    """Open the PLY file ``data`` (its bytes).

    Raises FormatError (not PLY, or a line, type or value that breaks the format),
    TruncatedError (fewer bytes or lines than the counts promise), ContentError (``E_NONFINITE``,
    ``E_INDEX``, ``E_NO_FACES``), UnsupportedError and TooLargeError, each with the place.
    """
    return PlyFile(data)


@dataclass(eq=False, kw_only=True)
class PlyLayout(Layout):
    """What the parser makes of a PLY file.

    Attributes
    ----------
    sections : the elements by name; ``end`` is the byte behind the last one.
    normal_elements : those that the arrays of normals belong to.
    is_stream : ascii records are not one to a line.
    """

    header: Header
    sections: Mapping[str, Section] = field(repr=False)
    end: int
    surface: Surface
    normal_elements: tuple[str, ...]
    is_stream: bool


def parse(data: Buffer) -> PlyLayout:
    """Find the positions, normals and faces of a PLY file; errors as in ``read``."""
    content = as_bytes(memoryview(data).cast("B"))
    header = parsed(memoryview(data).cast("B"))
    vertex = vertex_element(header)
    sections, end = located(content, header, wanted_names)
    positions = sections["vertex"].slots(POSITION)
    vertices = positions.values
    require_finite(vertices, sections["vertex"].where)
    # Found here, so that a word that is no number is reported before any work is done.
    elements = [
        name
        for name, section in sections.items()
        if name in ("vertex", "face") and has_normals(section.element)
    ]
    normals = {name: sections[name].slots(NORMAL) for name in elements}
    found = find_surface(sections, header, vertices)
    if not found.n_faces:
        normals.pop("face", None)
    rest = content[end:]
    n_behind = len(rest.tobytes().strip()) if header.encoding == "ascii" else len(rest)
    check_strays(header, n_behind)
    first = sections["vertex"]
    is_stream = isinstance(first, Lines) and first.is_stream
    return PlyLayout(
        encoding=header.encoding,
        precision=precision_of(header, vertex),
        positions=(positions,),
        normals=tuple(normals.values()),
        renew_normals=functools.partial(_renew_normals, found, normals),
        vertices=vertices,
        faces=found.triangles,
        properties=properties_of(header, found.grid),
        references=header.textures,
        warnings=(
            *warnings_of(header, vertex),
            *found.warnings,
            *((_STREAM_WARNING,) if is_stream else ()),
            *((warn_of_rest(n_behind),) * bool(n_behind)),
        ),
        header=header,
        sections=sections,
        end=end,
        surface=found,
        normal_elements=tuple(normals),
        is_stream=is_stream,
    )


def _renew_normals(
    surface: Surface, normals: Mapping[str, Slots], old: Floats, new: Floats
) -> list[tuple[Floats, Flags]]:
    """The normals of each element for new vertices, and which rows changed."""
    from msal_cli.kernels.geometry import regroup_normals

    result = []
    for element, slots in normals.items():
        if element == "face":
            moved = np.asarray((old != new).any(axis=1))
            result.append(surface.face_normals(old, new, moved, slots.values))
        else:
            faces = surface.triangles
            result.append(regroup_normals(old, new, faces, faces, slots.values))
    return result


class PlyFile(SlotFile):
    """An opened PLY file; see ``codecs.mesh_file.MeshFile`` for what its attributes mean.

    ``precision`` is the type of the coordinates: ``float32`` (also when mixed with double, since
    the coarsest one limits), ``float64``, ``text`` in ascii, or ``integer``.  Whole-number
    coordinates are rounded to the nearest whole number, halves to the even one.
    """

    _layout: PlyLayout

    def __init__(self, data: Buffer) -> None:
        super().__init__(data, "ply", parse)
        self.n_polygons = self._layout.surface.n_polygons
        self.grid = self._layout.surface.grid

    def vertex_property(self, name: str) -> Floats:
        """The scalar property ``name`` of the vertices, (n,); InputError (``E_PROPERTY``) if there
        is none."""
        element = self._layout.sections["vertex"].element
        scalar_property(element, name)
        if name in POSITION + NORMAL:
            return self._layout.sections["vertex"].slots((name,)).values[:, 0]
        found, _ = located(
            as_bytes(self._data),
            self._layout.header,
            lambda element: (name,) if element.name == "vertex" else (),
            last="vertex",
        )
        values: Floats = np.ascontiguousarray(found["vertex"].slots((name,)).values[:, 0])
        return values

    def polygons(self) -> list[Any] | NDArray[np.int32]:
        """The faces as the file has them: (m, k) int32 where all have k corners, or a list.

        Faces of fewer than three corners are left out; strips give their triangles.
        """
        return self._layout.surface.polygons()

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with new positions (n, 3) in another encoding or with other number types.

        ``encoding`` is ``same``, ``ascii`` or ``binary`` (little endian); ``precision`` is
        ``same``, ``float32`` or ``float64`` and concerns positions and normals.  Every element,
        property, comment and their order are kept; bytes behind the last element are kept where
        the encoding stays.  Raises ContentError (``E_RANGE``) where a value does not fit its
        type, FormatError where an ascii value is not of its declared type.
        """
        from msal_cli.codecs.ply_recode import Recoding

        layout = self._layout
        retypable: dict[str, tuple[str, ...]] = dict.fromkeys(layout.normal_elements, NORMAL)
        retypable["vertex"] = POSITION + retypable.get("vertex", ())
        data = as_bytes(self._data)
        is_stream = layout.is_stream
        recoding = Recoding(data, layout.header, encoding, precision, retypable, is_stream)
        if recoding.is_same:
            return self.replaced(vertices)
        require_shape(vertices, self.vertices)
        element = layout.sections["vertex"].element
        codes = tuple(recoding.code(one) for one in element.find_all(POSITION))
        require_range(vertices, np.ones(vertices.shape, dtype=bool), codes)
        if recoding.keeps_encoding and self.encoding == "ascii":
            # New numbers as the new types need them; nothing else of the lines changes.
            positions = copy.copy(layout.positions[0])
            positions.codes = codes
            retyped = copy.copy(self)
            retyped._layout = copy.copy(layout)
            retyped._layout.positions = (positions,)
            changes = retyped._changes(vertices)
            text = retyped._spliced(changes, vertices) if changes else data.data
            return recoding.header() + text[layout.header.size :]
        values = {("vertex", name): vertices[:, k] for k, name in enumerate(POSITION)}
        for element_name, (_, normals, _) in zip(
            layout.normal_elements, self._changed_normals(vertices), strict=True
        ):
            values |= {(element_name, name): normals[:, k] for k, name in enumerate(NORMAL)}
        return recoding.encoded(values, layout.end)
