"""Two meshes as a few bytes per face: what the viewer's script unpacks (assets/decoding.js).

    base64( deflate( length of the header, 4 bytes, low first | header, JSON | planes of bytes ) )

Faces are put in an order in which neighbours follow one another, and vertices in that of their
first use.  So a corner is coded as how long ago its vertex was new (0: now), and a position as the
step from a known corner of the same face, in whole steps of a grid.  Each number is cut into bytes,
and all lowest bytes come first, then all second ones: deflate finds more in them that way.
"""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.colour_maps import colour_table
from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.mesh import Mesh
from msal_cli.view.decimation import Coarse, coarsen

MOST_FACES = 200_000
"""Faces of one mesh that a page holds; more are decimated."""

STEPS_PER_EDGE = 256
"""Steps of the grid in a mean edge length, so that rounding turns a normal by some 0.1 degrees."""

_FINEST = (1 << 22) - 1
"""Steps along the longest side: what float32 holds exactly, with room for sums."""

_CLIPPED = 0.002
"""Share of the deviations that lie beyond the colour scale, so that one stray vertex does not
make all others look alike."""

_DEVIATION_STEPS = 65535


@dataclass(frozen=True, eq=False)
class EncodedScene:
    """What is drawn, as text.

    Attributes
    ----------
    text : base64, letters that mean nothing in HTML or JSON.
    faces, drawn_faces : of the mesh before (or the only one), in the file and on the page.
    after_faces, drawn_after_faces : likewise, None without a mesh after.
    rounding : the largest distance by which the page shows a coordinate off its place, file units.
    """

    text: str
    faces: int
    drawn_faces: int
    after_faces: int | None
    drawn_after_faces: int | None
    rounding: float

    @property
    def is_decimated(self) -> bool:
        """Whether the page holds fewer faces than the files."""
        return (self.faces, self.after_faces) != (self.drawn_faces, self.drawn_after_faces)


def encode_scene(
    before: Mesh,
    after: Mesh | None = None,
    deviation: Floats | None = None,
    *,
    ends: tuple[float, float] | None = None,
    view: Floats | None = None,
    colours: Sequence[NDArray[np.uint8] | None] = (),
    most_faces: int = MOST_FACES,
) -> EncodedScene:
    """One scene.

    Parameters
    ----------
    before, after : finite meshes in one coordinate system.  Where their faces are the same, they
        are coarsened as one, and share their faces on the page.
    deviation : (n,) one number in file units for each vertex of ``after`` (of ``before`` if that is
        all there is); not-a-number where there is none.
    ends : of the colour scale; two of opposite sign get the diverging map.  None asks
        the numbers.
    view : (3, 3) rotation from the model to right, up, towards the eye, at the start.
    colours : (n, 3) of the vertices of each mesh, None or left out where it has none.
    most_faces : beyond this a mesh is coarsened.
    """
    shares = after is not None and _same_faces(before, after)
    first = coarsen(before.vertices, before.faces, most_faces)
    low, step = _grid(before, after, Mesh(before.vertices[first.kept], first.faces))
    kept, faces, ticks, planes = _mesh_planes(before, first, low, step)
    meshes: list[dict[str, int | bool]] = [{"vertices": len(kept), "faces": len(faces)}]
    painted = [_kept_colours(colours, 0, kept)]
    drawn_after = None
    if after is not None and shares:
        moved = _ticks(after.vertices[kept], low, step)
        planes += _planes(_zigzag(moved - ticks), 3)
        meshes.append({**meshes[0], "moved": True})
        painted.append(_kept_colours(colours, 1, kept))
        drawn_after = len(faces)
    elif after is not None:
        second = coarsen(after.vertices, after.faces, most_faces)
        kept, faces_after, _, planes_after = _mesh_planes(after, second, low, step)
        planes += planes_after
        drawn_after = len(faces_after)
        meshes.append({"vertices": len(kept), "faces": drawn_after})
        painted.append(_kept_colours(colours, 1, kept))
    header: dict[str, object] = {"meshes": meshes, "step": step}
    if view is not None:
        header["view"] = [round(float(one), 6) for one in np.asarray(view).reshape(-1)]
    if deviation is not None:
        scale, plane = _deviation(deviation, kept, ends)
        header["deviation"] = scale
        planes += plane
    for mesh, own in zip(meshes, painted, strict=True):
        if own is not None:
            mesh["painted"] = True
            planes += _planes(own.astype(np.int64), 1)
    head = json.dumps(header, separators=(",", ":")).encode()
    packed = zlib.compress(struct.pack("<I", len(head)) + head + b"".join(planes), 9)
    return EncodedScene(
        text=base64.b64encode(packed).decode("ascii"),
        faces=len(before.faces),
        drawn_faces=len(faces),
        after_faces=None if after is None else len(after.faces),
        drawn_after_faces=drawn_after,
        rounding=step / 2,
    )


def _kept_colours(
    colours: Sequence[NDArray[np.uint8] | None], at: int, kept: Longs
) -> NDArray[np.uint8] | None:
    """The colours (k, 3) of the vertices of mesh ``at`` that are drawn."""
    own = colours[at] if at < len(colours) else None
    return None if own is None else own[kept]


def _mesh_planes(
    mesh: Mesh, coarse: Coarse, low: Floats, step: float
) -> tuple[Longs, Ints, Longs, list[bytes]]:
    """The vertices that are drawn, in their order, the faces between them (m, 3), the vertices'
    steps on the grid (n, 3), and the bytes of all."""
    order, faces = _order(mesh.vertices[coarse.kept], coarse.faces)
    kept = coarse.kept[order]
    ticks = _ticks(mesh.vertices[kept], low, step)
    planes = _index_planes(faces) + _planes(_zigzag(_residuals(ticks, faces)), 3)
    return kept, faces, ticks, planes


def _same_faces(before: Mesh, after: Mesh) -> bool:
    return len(before.vertices) == len(after.vertices) and (
        before.faces is after.faces or np.array_equal(before.faces, after.faces)
    )


def _grid(before: Mesh, after: Mesh | None, drawn: Mesh) -> tuple[Floats, float]:
    """The corner and the step of a grid that both meshes are rounded to."""
    corners = [one.vertices[one.faces.reshape(-1)] for one in (before, after) if one is not None]
    low = np.min([one.min(axis=0) for one in corners], axis=0)
    high = np.max([one.max(axis=0) for one in corners], axis=0)
    extent = float((high - low).max())
    if extent == 0.0:
        return low, 1.0
    edges = drawn.vertices[drawn.faces[:, 1]] - drawn.vertices[drawn.faces[:, 0]]
    edge = float(np.sqrt((edges * edges).sum(axis=1)).mean()) if len(edges) else 0.0
    return low, max(edge / STEPS_PER_EDGE, extent / _FINEST)


def _ticks(vertices: Floats, low: Floats, step: float) -> Longs:
    return np.rint((vertices - low) / step).astype(np.int64)


def _order(vertices: Floats, faces: Ints) -> tuple[Longs, Ints]:
    """An order of the vertices, and the faces with the vertices' new numbers.

    Faces follow a Z-shaped curve through space (Morton 1966), and vertices their first use.
    """
    centres = vertices[faces].sum(axis=1)
    low = centres.min(axis=0)
    extent = float((centres.max(axis=0) - low).max()) or 1.0
    cells = np.minimum((centres - low) / extent * 1024, 1023).astype(np.int64)
    keys = _spread(cells[:, 0]) | _spread(cells[:, 1]) << 1 | _spread(cells[:, 2]) << 2
    flat = faces[np.argsort(keys, kind="stable")].reshape(-1)
    used, first, inverse = np.unique(flat, return_index=True, return_inverse=True)
    order = np.argsort(first)
    number = np.empty(len(used), dtype=np.int32)
    number[order] = np.arange(len(used))
    return used[order].astype(np.int64), number[inverse].reshape(-1, 3)


def _spread(numbers: Longs) -> Longs:
    """Numbers of ten bits with two zeros put after each bit."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        numbers = (numbers | numbers << shift) & mask
    return numbers


def _index_planes(faces: Ints) -> list[bytes]:
    """How long ago the vertex of each corner was new: 0 for a new one."""
    flat = faces.reshape(-1).astype(np.int64)
    newest = np.maximum.accumulate(flat)
    seen = np.concatenate([[0], newest[:-1] + 1])
    return _planes(seen - flat, 3)


def _residuals(ticks: Longs, faces: Ints) -> Longs:
    """Steps (n, 3) from the corner that the script knows already when it meets a vertex."""
    flat = faces.reshape(-1).astype(np.int64)
    _, first = np.unique(flat, return_index=True)
    numbers = np.arange(len(first))
    place = first % 3
    begin = first - place
    second, third = flat[begin + 1], flat[begin + 2]
    known = np.where(second < numbers, second, np.where(third < numbers, third, numbers - 1))
    known = np.where(place > 0, flat[np.maximum(first - 1, 0)], known)
    parents = np.concatenate([np.zeros((1, 3), dtype=np.int64), ticks])[known + 1]
    residuals: Longs = ticks - parents
    return residuals


def _zigzag(numbers: Longs) -> Longs:
    """Small whole numbers of either sign as small ones without."""
    return (numbers << 1) ^ (numbers >> 63)


def _planes(numbers: Longs, count: int) -> list[bytes]:
    """The ``count`` lowest bytes of (n,) or (n, k) numbers, all of one rank and column together."""
    columns = numbers.reshape(len(numbers), -1).T
    return [
        np.ascontiguousarray((column >> (8 * rank)) & 255).astype(np.uint8).tobytes()
        for column in columns
        for rank in range(count)
    ]


def _deviation(
    deviation: Floats, kept: Longs, ends: tuple[float, float] | None
) -> tuple[dict[str, object], list[bytes]]:
    """The colour scale of the deviations, and the kept ones in 65,535 steps over their range."""
    values = np.asarray(deviation, dtype=np.float64)
    known = values[np.isfinite(values)]
    if not len(known):
        known = np.zeros(1)
    least, most = float(known.min()), float(known.max())
    if ends is None:
        far = float(np.quantile(np.abs(known), 1.0 - _CLIPPED)) or max(abs(least), abs(most)) or 1.0
        ends = (-far if least < 0 else 0.0, far)
    low, high = ends
    name = "diverging" if low < 0 else "sequential"
    span = (most - least) or 1.0
    steps = np.where(np.isfinite(values), values, 0.0)[kept]
    steps = np.rint((np.clip(steps, least, most) - least) / span * _DEVIATION_STEPS)
    scale: dict[str, object] = {
        "least": least,
        "most": most,
        "span": span,
        "low": low,
        "high": high if high > low else low + 1.0,
        "colours": base64.b64encode(colour_table(name).tobytes()).decode("ascii"),
    }
    return scale, _planes(steps.astype(np.int64), 2)
