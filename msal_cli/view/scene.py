"""One or two meshes in a few bytes per face; the viewer's script decodes it (assets/decoding.js).

    base64( deflate( length of header, uint32 little-endian | header, JSON | planes of bytes ) )

Faces are sorted so that neighbours follow one another, and vertices by their first use.  A corner
is coded as its vertex's age: how many vertices ago it was first used (0: it is new).  A position is
the step from the vertex before on a grid of whole numbers.  Numbers are split into bytes, and
stored as a plane of lowest bytes, one of second bytes and so on: deflate compresses that better.
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

MAX_FACES = 200_000  # faces of one mesh on a page; larger meshes are decimated

STEPS_PER_EDGE = 256
"""Grid steps per mean edge length: rounding to the grid turns a normal by about 0.1 degrees."""

_MAX_STEPS = (1 << 22) - 1
"""Grid steps along the longest side: exact in float32, with room for sums."""


@dataclass(frozen=True, eq=False)
class EncodedScene:
    text: str  # base64: characters without a special meaning in HTML or JSON
    counts: tuple[tuple[int, int], ...]  # faces of each mesh in its file, and on the page
    # the largest rounding error of a coordinate on the page, file units
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
    """Encode one scene.

    Parameters
    ----------
    before, after : finite meshes in one coordinate system.  If their faces are the same, they are
        decimated alike, and share their faces on the page.
    deviation : (n,) a number in file units for each vertex of ``after`` (of ``before`` if there is
        only that); NaN where it is unknown.
    ends : of the colour scale, file units; two of opposite sign select the diverging map.  None
        for meshes without a deviation.
    view : (3, 3) rotation from the model to right, up, towards the eye, at the start.
    colours : (n, 3) of the vertices of each mesh; None, or left out, if it has none.
    max_faces : a larger mesh is decimated.
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
        # The age of the vertex of each corner; 0 for a new one.
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
    """The origin and the step of the grid for both meshes; ``ends`` (k, 2, 3) are those of edges
    that are drawn."""
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
    """Map small signed whole numbers to small ones without sign (zigzag coding)."""
    return (numbers << 1) ^ (numbers >> 63)


def _planes(numbers: Longs, count: int) -> list[bytes]:
    """The ``count`` lowest bytes of (n,) or (n, k) numbers, one plane per column and byte."""
    columns = numbers.reshape(len(numbers), -1).T
    return [
        np.ascontiguousarray((column >> (8 * rank)) & 255).astype(np.uint8).tobytes()
        for column in columns
        for rank in range(count)
    ]


def _deviation(
    values: Floats, kept: Ints, ends: tuple[float, float]
) -> tuple[dict[str, object], list[bytes]]:
    """The colour scale, and the deviations of kept vertices in 65,535 steps over their range."""
    is_finite = np.isfinite(values)
    finite = values[is_finite] if is_finite.any() else np.zeros(1)
    least, most = float(finite.min()), float(finite.max())
    span = (most - least) or 1.0
    steps = np.where(is_finite, values, 0.0)[kept]
    steps = np.rint((np.clip(steps, least, most) - least) / span * 65535)
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


# Decimation: a coarser mesh where the whole one would be too large for a page
#
# Short edges are contracted to one of their ends, many at a time, until few enough faces are left.
# Vertices that stay keep their positions: means of positions would reduce noise, and noisy meshes
# would look better than they are.


_MIN_COSINE = 0.25  # least cosine of the angle by which a contraction may turn a face

_CHECKS = 3
"""Times that contractions are checked against one another; those that still fail are undone."""

_STALLED = 0.12
"""Share of the faces that a round must remove.  After a worse one faces may turn over, which occurs
only where the noise is larger than the edges and the surface is folded anyway."""

_ROUNDS = 60

_PASSES = 3  # times per round that vertices without a partner are paired

_TAKEN = -2


def coarsen(vertices: Floats, faces: Ints, max_faces: int) -> tuple[Ints, Ints]:
    """Decimate a mesh: the vertices (k,) that stay, in ascending order, and faces (j, 3) int32 as
    indices into these, at most ``max_faces`` if that can be reached.

    ``vertices`` (n, 3) are finite, ``faces`` (m, 3).  Of faces that contractions make equal the
    first stays.  A mesh with few enough faces keeps all of them.
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
        # Keep one face for each set of corners.
        _, first = np.unique(np.sort(left, axis=1), axis=0, return_index=True)
        left = left[np.sort(first)]
    kept, flat = np.unique(left, return_inverse=True)
    return kept, flat.reshape(-1, 3).astype(np.int32)


def _round(vertices: Floats, faces: Ints, excess: int, *, is_checked: bool) -> Ints:
    """The faces after one round, which removes not many more than ``excess``."""
    stays, goes = _pairs(vertices, faces)
    # An inner edge has two faces, so half as many contractions are enough.
    few = (excess + 1) // 2
    stays, goes = stays[:few], goes[:few]
    # Vertices on a boundary do not move inwards: a scan would shrink at its holes.
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
                # If contracting to one end fails, try the other end.
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
    """The ends of short edges, roughly the shortest first; each vertex is in at most one pair."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    # An edge between two faces occurs in both directions: one is enough.
    low, high = sides[sides[:, 0] < sides[:, 1]].T
    gaps = vertices[low] - vertices[high]
    order = np.argsort((gaps * gaps).sum(axis=1), kind="stable")
    low, high = low[order], high[order]
    stays, goes = [], []
    shortest = np.full(len(vertices), -1)
    for _ in range(_PASSES):
        # Written from the longest to the shortest, so that the shortest edge remains.
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

    In a closed fan, where each neighbour is once the next and once the last corner, the differences
    of their numbers add up to zero; in an open fan to the last number minus the first.
    """
    sums = np.zeros(n_vertices)
    for k in range(3):
        steps = faces[:, (k + 1) % 3] - faces[:, (k + 2) % 3]
        sums += np.bincount(faces[:, k], weights=steps, minlength=n_vertices)
    is_open: NDArray[np.bool_] = sums != 0.0
    return is_open


def _turn(vertices: Floats, faces: Ints, moved: Ints) -> Ints:
    """Corners of faces that would turn too far, or become needles."""
    after = moved[faces]
    is_changed = (after != faces).any(axis=1) & ~repeated_corners(after)
    faces = faces[is_changed]
    cosines = face_normals(vertices, faces) * face_normals(vertices, after[is_changed])
    return np.unique(faces[cosines.sum(axis=1) <= _MIN_COSINE])
