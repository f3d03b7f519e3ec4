"""New STL files, binary and ascii."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.codecs.slots import as_float32
from msal_cli.codecs.stl_facets import FACET, HEADER_BYTES
from msal_cli.errors import UnsupportedError
from msal_cli.storage.buffers import Buffer


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
    from msal_cli.kernels.text import fill_rows, printed_shortest

    numbers = np.concatenate([np.where(np.isfinite(normals), normals, 0.0), corners], axis=1)
    numbers[:, :3] = numbers[:, :3].astype(np.float32)
    digits, stops = printed_shortest(numbers.reshape(-1), single)
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
