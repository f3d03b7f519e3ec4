"""Facets of binary STL files, new STL files, and what is wrong with either."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.codecs.slots import as_float32
from msal_cli.errors import ContentError, TooLargeError, UnsupportedError
from msal_cli.storage.regular import Buffer

HEADER_BYTES = 80
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")])
"""One facet, 50 bytes without padding."""

MAX_FACETS = (2**31 - 1) // 3
"""Facets whose corners can be numbered with 32 bits."""


def check_countable(n_facets: int) -> None:
    """Raise TooLargeError if the corners cannot be numbered."""
    if n_facets > MAX_FACETS:
        raise TooLargeError(
            f"{n_facets} facets are more than the {MAX_FACETS} whose corners can be numbered",
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


def binary_stl(corners: Floats, normals: Floats, name: str) -> bytes:
    """A binary STL file of corners (m, 9) and normals (m, 3)."""
    facets = np.zeros(len(corners), dtype=FACET)
    facets["corners"] = as_float32(corners)
    with np.errstate(over="ignore", invalid="ignore"):
        single = normals.astype(np.float32)
    facets["normal"] = np.where(np.isfinite(single), single, np.float32(0.0))
    # A header that begins with "solid" would make readers take the file for text.
    header = b"binary STL " + name.encode("ascii", "replace")
    count = len(corners).to_bytes(4, "little")
    return header[:HEADER_BYTES].ljust(HEADER_BYTES) + count + facets.tobytes()


def ascii_stl(corners: Floats, normals: Floats, name: str, *, single: bool) -> Buffer:
    """An ascii STL file of corners (m, 9) and normals (m, 3), in the shortest exact digits.

    ``single`` writes what float32 holds.
    """
    from msal_cli.kernels.text import fill_rows, print_shortest

    numbers = np.concatenate([np.where(np.isfinite(normals), normals, 0.0), corners], axis=1)
    numbers[:, :3] = numbers[:, :3].astype(np.float32)
    digits, stops = print_shortest(numbers.reshape(-1), single)
    corner = (b"\n      vertex ", b" ", b" ")
    pieces: tuple[bytes, ...] = (
        b"  facet normal ",
        b" ",
        b" ",
        b"\n    outer loop" + corner[0],
        b" ",
        b" ",
    )
    pieces = (*pieces, *corner, *corner, b"\n    endloop\n  endfacet\n")
    line = " ".join(name.split())
    head, tail = (f"{word} {line}".rstrip().encode() + b"\n" for word in ("solid", "endsolid"))
    return b"".join([head, *fill_rows(pieces, digits, stops), tail])


def refuse_float64(precision: str) -> None:
    """Raise UnsupportedError if binary STL is asked for float64."""
    if precision == "float64":
        raise UnsupportedError(
            "binary STL has no float64",
            hint="use --encoding ascii, or --to ply",
        )
