"""Two meshes as a few bytes per face: what the viewer's script unpacks (assets/decoding.js).

    base64( deflate( length of the header, 4 bytes, low first | header, JSON | planes of bytes ) )

Faces are put in an order in which neighbours follow one another, and vertices in that of their
first use.  So a corner is coded as how long ago its vertex was new (0: now), and a position as the
way from the vertex before, in whole steps of a grid.  Each number is cut into bytes, and all lowest
bytes come first, then all second ones: deflate finds more in them that way.
"""

import base64
import json
import struct
import zlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import used_vertices
from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.codecs.colours import colour_table
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.spatial_order import order_in_space
from msal_cli.kernels.welding import repeated_corners
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

MAX_FACES = 200_000
"""Faces of one mesh that a page holds; more are decimated."""

STEPS_PER_EDGE = 256
"""Steps of the grid in a mean edge length, so that rounding turns a normal by some 0.1 degrees."""

_MAX_STEPS = (1 << 22) - 1
"""Steps along the longest side: what float32 holds exactly, with room for sums."""

_DEVIATION_STEPS = 65535


@dataclass(frozen=True, eq=False)
class EncodedScene:
    """What is drawn, as text."""

    text: str  # base64, letters that mean nothing in HTML or JSON
    counts: tuple[tuple[int, int], ...]  # faces of each mesh in its file, and on the page
    # the largest distance by which the page shows a coordinate off its place, file units
    rounding: float


def encode_scene(
    before: Mesh,
    after: Mesh | None = None,
    deviation: Floats | None = None,
    *,
    ends: tuple[float, float] | None = None,
    view: Floats | None = None,
    colours: Sequence[NDArray[np.uint8] | None] = (),
    max_faces: int = MAX_FACES,
) -> EncodedScene:
    """One scene.

    Parameters
    ----------
    before, after : finite meshes in one coordinate system.  Where their faces are the same, they
        are coarsened as one, and share their faces on the page.
    deviation : (n,) one number in file units for each vertex of ``after`` (of ``before`` if that is
        all there is); not-a-number where there is none.
    ends : of the colour scale, file units; two of opposite sign get the diverging map. None is
        for meshes without a deviation.
    view : (3, 3) rotation from the model to right, up, towards the eye, at the start.
    colours : (n, 3) of the vertices of each mesh, None or left out where it has none.
    max_faces : beyond this a mesh is coarsened.
    """
    shares = (
        after is not None
        and len(before.vertices) == len(after.vertices)
        and np.array_equal(before.faces, after.faces)
    )
    meshes = [before] if after is None or shares else [before, after]
    drawn = [coarsen(mesh.vertices, mesh.faces, max_faces) for mesh in meshes]
    stays, coarse = drawn[0]
    low, step = _grid(before, after, before.vertices[stays][coarse[:, :2]])
    entries: list[dict[str, int | bool]] = []
    planes: list[bytes] = []
    selections = []
    for mesh, (stays, coarse) in zip(meshes, drawn, strict=True):
        order, faces = _order(mesh.vertices[stays], coarse)
        kept = stays[order]
        ticks = _ticks(mesh.vertices[kept], low, step)
        steps = np.diff(ticks, axis=0, prepend=0)
        # How long ago the vertex of each corner was new: 0 for a new one.
        flat = faces.reshape(-1).astype(np.int64)
        newest = np.maximum.accumulate(flat)
        ages = np.concatenate([[0], newest[:-1] + 1]) - flat
        planes += _planes(ages, 3) + _planes(_zigzag(steps), 3)
        entries.append({"vertices": len(kept), "faces": len(faces)})
        selections.append(kept)
    if after is not None and shares:
        moved = _ticks(after.vertices[kept], low, step)
        planes += _planes(_zigzag(moved - ticks), 3)
        entries.append({**entries[0], "moved": True})
        selections.append(kept)
    header: dict[str, object] = {"meshes": entries, "step": step}
    if view is not None:
        header["view"] = [round(float(x), 6) for x in np.asarray(view).reshape(-1)]
    if deviation is not None:
        header["deviation"], plane = _deviation(deviation, kept, ends or (-1.0, 1.0))
        planes += plane
    for entry, own, kept in zip(entries, colours, selections, strict=False):
        if own is not None:
            entry["painted"] = True
            planes += _planes(own[kept].astype(np.int64), 1)
    head = json.dumps(header, separators=(",", ":")).encode()
    packed = zlib.compress(struct.pack("<I", len(head)) + head + b"".join(planes), 9)
    return EncodedScene(
        text=base64.b64encode(packed).decode("ascii"),
        counts=tuple(
            (len(mesh.faces), int(entry["faces"]))
            for mesh, entry in zip((before, after), entries, strict=False)
            if mesh is not None
        ),
        rounding=step / 2,
    )


def _grid(before: Mesh, after: Mesh | None, ends: Floats) -> tuple[Floats, float]:
    """The corner and the step of a grid that both meshes are rounded to; ``ends`` (k, 2, 3) are
    those of edges that are drawn."""
    points = np.concatenate([used_vertices(mesh) for mesh in (before, after) if mesh is not None])
    low, extent = points.min(axis=0), float(np.ptp(points, axis=0).max())
    if extent == 0.0:
        return low, 1.0
    edges = ends[:, 1] - ends[:, 0]
    edge = float(np.sqrt((edges * edges).sum(axis=1)).mean()) if len(edges) else 0.0
    return low, max(edge / STEPS_PER_EDGE, extent / _MAX_STEPS)


def _ticks(vertices: Floats, low: Floats, step: float) -> Longs:
    return np.rint((vertices - low) / step).astype(np.int64)


def _order(vertices: Floats, faces: Ints) -> tuple[Longs, Ints]:
    """An order of the vertices, and the faces with the vertices' new numbers.

    Faces follow a curve through space, and vertices their first use.
    """
    flat = faces[order_in_space(vertices[faces].sum(axis=1))].reshape(-1)
    used, first, inverse = np.unique(flat, return_index=True, return_inverse=True)
    order = np.argsort(first)
    number = np.empty(len(used), dtype=np.int32)
    number[order] = np.arange(len(used))
    return used[order].astype(np.int64), number[inverse].reshape(-1, 3)


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
    values: Floats, kept: Ints, ends: tuple[float, float]
) -> tuple[dict[str, object], list[bytes]]:
    """The colour scale of the deviations, and the kept ones in 65,535 steps over their range."""
    is_finite = np.isfinite(values)
    finite = values[is_finite] if is_finite.any() else np.zeros(1)
    least, most = float(finite.min()), float(finite.max())
    span = (most - least) or 1.0
    steps = np.where(is_finite, values, 0.0)[kept]
    steps = np.rint((np.clip(steps, least, most) - least) / span * _DEVIATION_STEPS)
    low, high = ends
    colours = colour_table("diverging" if low < 0 else "sequential")
    scale: dict[str, object] = {
        "least": least,
        "most": most,
        "span": span,
        "low": low,
        "high": high if high > low else low + 1.0,
        "colours": base64.b64encode(colours.tobytes()).decode("ascii"),
    }
    return scale, _planes(steps.astype(np.int64), 2)


# Decimation: a coarser mesh to look at, where the whole one would be too much for a page
#
# Short edges are contracted to one of their ends, many at a time, until few enough faces are left.
# A vertex that stays keeps its place: a mean of places would take away noise, and the picture of a
# noisy mesh would flatter it.


_MIN_COSINE = 0.25
"""Of the angle by which a face may turn when an edge beside it is contracted."""

_CHECKS = 3
"""Times that contractions are checked against one another; what still fails then is left."""

_STALLED = 0.12
"""Share of the faces that a round must take away; after a poorer one faces may turn over, which
happens only where the noise is larger than the edges and the surface is folded anyhow."""

_ROUNDS = 60

_PASSES = 3
"""Times that the vertices which are in no pair yet are paired in one round."""

_TAKEN = -2


def coarsen(vertices: Floats, faces: Ints, max_faces: int) -> tuple[Ints, Ints]:
    """The vertices (k,) that stay, in rising order, and faces (j, 3) int32 of places among them:
    as many faces as there may be, at most ``max_faces`` where that can be reached.

    ``vertices`` (n, 3) finite, ``faces`` (m, 3).  Faces that contractions put on one another are
    left out but for the first.  What has few enough faces keeps all of them.
    """
    left = faces
    if len(left) > max_faces:
        left = left[~repeated_corners(left)]
    is_checked = True
    for _ in range(_ROUNDS):
        excess = len(left) - max_faces
        if excess <= 0:
            break
        fewer = _round(vertices, left, excess, is_checked=is_checked)
        is_checked = is_checked and len(left) - len(fewer) >= min(excess, _STALLED * len(left))
        left = fewer
    if len(left) < len(faces):
        # Each set of corners but once.
        _, first = np.unique(np.sort(left, axis=1), axis=0, return_index=True)
        left = left[np.sort(first)]
    kept, flat = np.unique(left, return_inverse=True)
    return kept, flat.reshape(-1, 3).astype(np.int32)


def _round(vertices: Floats, faces: Ints, excess: int, *, is_checked: bool) -> Ints:
    """The faces after one round, which takes away not many more than ``excess``."""
    stays, goes = _pairs(vertices, faces)
    # Two faces to an edge inside; the last round stops where it should.
    few = (excess + 1) // 2
    stays, goes = stays[:few], goes[:few]
    # What is on a boundary does not move inwards: a scan would shrink at its holes.
    is_rim = _on_boundary(len(vertices), faces)
    outward = is_rim[goes] & ~is_rim[stays]
    stays[outward], goes[outward] = goes[outward], stays[outward].copy()
    moved = np.arange(len(vertices), dtype=np.int32)
    moved[goes] = stays
    if is_checked:
        pair = np.full(len(vertices), -1)
        pair[goes] = np.arange(len(goes))
        for check in range(_CHECKS):
            failed = np.unique(pair[_turn(vertices, faces, moved)])
            failed = failed[failed >= 0]
            if not len(failed):
                break
            moved[goes[failed]] = goes[failed]
            pair[goes[failed]] = -1
            if check == 0:
                # What one end cannot do, the other may.
                failed = failed[is_rim[goes[failed]] == is_rim[stays[failed]]]
                goes[failed], stays[failed] = stays[failed], goes[failed].copy()
                moved[goes[failed]] = stays[failed]
                pair[goes[failed]] = failed
        else:
            bad = _turn(vertices, faces, moved)
            moved[bad] = bad
    after = moved[faces]
    return after[~repeated_corners(after)]


def _pairs(vertices: Floats, faces: Ints) -> tuple[Ints, Ints]:
    """Ends of short edges, each vertex in one pair at most; the shortest first, by and large."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    # An edge between two faces is met in both directions: once is enough.
    low, high = sides[sides[:, 0] < sides[:, 1]].T
    gaps = vertices[low] - vertices[high]
    order = np.argsort((gaps * gaps).sum(axis=1), kind="stable")
    low, high = low[order], high[order]
    stays, goes = [], []
    shortest = np.full(len(vertices), -1)
    for _ in range(_PASSES):
        # Written from the longest to the shortest, so that the shortest remains.
        ranks = np.arange(len(low))
        both = np.stack([low, high], axis=1)[::-1].reshape(-1)
        shortest[both] = np.repeat(ranks[::-1], 2)
        is_pair = (shortest[low] == ranks) & (shortest[high] == ranks)
        stays.append(low[is_pair])
        goes.append(high[is_pair])
        shortest[stays[-1]] = shortest[goes[-1]] = _TAKEN
        is_free = (shortest[low] != _TAKEN) & (shortest[high] != _TAKEN)
        low, high = low[is_free], high[is_free]
    return np.concatenate(stays), np.concatenate(goes)


def _on_boundary(n_vertices: int, faces: Ints) -> NDArray[np.bool_]:
    """Whether the faces around each vertex leave a gap.

    Numbers of the neighbours add up to nothing around a closed fan, where each is once the next
    and once the last corner, and to the last less the first one of an open fan.
    """
    sums = np.zeros(n_vertices)
    for k in range(3):
        steps = faces[:, (k + 1) % 3] - faces[:, (k + 2) % 3]
        sums += np.bincount(faces[:, k], weights=steps, minlength=n_vertices)
    is_open: NDArray[np.bool_] = sums != 0.0
    return is_open


def _turn(vertices: Floats, faces: Ints, moved: Ints) -> Ints:
    """Corners of the faces that would turn too far, or become needles."""
    after = moved[faces]
    is_changed = (after != faces).any(axis=1) & ~repeated_corners(after)
    faces = faces[is_changed]
    cosines = face_normals(vertices, faces) * face_normals(vertices, after[is_changed])
    return np.unique(faces[cosines.sum(axis=1) <= _MIN_COSINE])
