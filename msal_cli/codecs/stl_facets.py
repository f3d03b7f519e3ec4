"""What binary and ascii STL share: triangle soup with one stored normal per facet."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ContentError, TooLargeError
from msal_cli.storage.buffers import Buffer

HEADER_BYTES = 80
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")])
"""One facet, 50 bytes without padding."""

MOST_FACETS = (2**31 - 1) // 3
"""Facets whose corners can be numbered with 32 bits."""


def check_countable(n_facets: int) -> None:
    """Raise TooLargeError if the corners cannot be numbered."""
    if n_facets > MOST_FACETS:
        raise TooLargeError(
            f"{n_facets} facets are more than the {MOST_FACETS} whose corners can be numbered",
            hint="cut the mesh into parts",
        )


def check_not_empty(n_facets: int, trailing: int = 0) -> None:
    """Raise ContentError ``E_NO_FACES`` if there is no facet; ``trailing`` in bytes."""
    if n_facets:
        return
    more = f"; {trailing} bytes follow that it does not count" if trailing else ""
    raise ContentError(
        f"the file has no facets{more}",
        code="E_NO_FACES",
        hint="export the mesh again" if more else "msal denoises surfaces; this file has none",
    )


def not_finite(facet: int, corner: int, line: int | None = None) -> ContentError:
    """The error for a position that is NaN or infinite; all counts from zero but the line's."""
    return ContentError(
        "a position is not finite",
        code="E_NONFINITE",
        where=f"facet {facet}, corner {corner}" + (f", line {line}" if line else ""),
        hint="remove the facet, or export the scan again",
    )


class FacetFile:
    """An STL file; see ``codecs.mesh_file.MeshFile``.

    ``vertices`` are the different positions of corners, in order of appearance.
    """

    format = "stl"
    references: tuple[str, ...] = ()

    def __init__(
        self,
        data: Buffer,
        vertices: Floats,
        faces: Ints,
        properties: tuple[str, ...],
        warnings: tuple[str, ...],
    ) -> None:
        self.data = data
        self.vertices, self.faces = vertices, faces
        self.properties, self.warnings = properties, warnings
        self.n_polygons = len(faces)
        self.merged_vertices = faces.size - len(vertices)

    def polygons(self) -> Ints:
        """The facets as an (m, 3) array."""
        return self.faces

    def forget_vertices(self) -> None:
        """Do nothing: to read them again takes long."""
