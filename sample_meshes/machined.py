"""A machined bracket: exact planes and cylinders, from a block-structured hexahedral mesh."""

from __future__ import annotations

import numpy as np
from shapes import Array, welded


def _grid(low: float, high: float, steps: int, growth: float = 1.0) -> Array:
    """``steps`` + 1 values from ``low`` to ``high``; each step is ``growth`` times the last."""
    widths = growth ** np.arange(steps)
    return low + (high - low) * np.concatenate([[0.0], np.cumsum(widths) / widths.sum()])


def _hexes(nodes: Array) -> Array:
    """(i, j, k, 3) block of nodes -> (cells, 8, 3) corners: bottom ring of four, then top ring."""
    a, b = nodes[:-1], nodes[1:]
    quads = [a[:, :-1], b[:, :-1], b[:, 1:], a[:, 1:]]
    corners = [q[:, :, :-1] for q in quads] + [q[:, :, 1:] for q in quads]
    return np.stack(corners, axis=3).reshape(-1, 8, 3)


def _lug(side: Array, bore: list[float], rings: list[int]) -> Array:
    """(layers, around, 2) nodes of a plate end: bored at the origin, round beyond it.

    ``side`` are the values of the second coordinate along the edge that meets the rest of the
    plate, at first coordinate -r, where r is ``side[-1]``; the far end is a half circle of that
    radius.  ``bore`` are the radii of concentric circles inside, each followed by ``rings`` cells.
    """
    radius = side[-1]
    near = np.stack([np.full(len(side) - 1, -radius), side[::-1][:-1]], axis=1)
    flank = np.stack([_grid(-radius, 0.0, 14), np.full(15, -radius)], axis=1)
    turn = _grid(-np.pi / 2, np.pi / 2, 44)[1:-1]
    arc = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    outline = np.concatenate([near, flank, arc, flank[::-1][:-1] * [1, -1]])
    angle = np.arctan2(outline[:, 1], outline[:, 0])
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    curves = [r * unit for r in bore] + [outline]
    layers = [curves[0]]
    for inner, outer, steps in zip(curves[:-1], curves[1:], rings, strict=True):
        layers += [inner + (outer - inner) * (s / steps) for s in range(1, steps + 1)]
    nodes = np.stack(layers)
    return np.concatenate([nodes, nodes[:, :1]], axis=1)


def _extruded(section: Array, levels: Array) -> Array:
    """(i, j, 2) section and (k,) heights -> (i, j, k, 3) nodes."""
    flat = np.broadcast_to(section[:, :, None, :], (*section.shape[:2], len(levels), 2))
    height = np.broadcast_to(levels[:, None], (*flat.shape[:3], 1))
    return np.concatenate([flat, height], axis=3)


def _skin(hexes: Array) -> tuple[Array, Array]:
    """Vertices and triangles of the boundary of a conforming hexahedral mesh (cells, 8, 3)."""
    a, b, d, e = (hexes[:, k] for k in (0, 1, 3, 4))
    left_handed = (np.cross(b - a, d - a) * (e - a)).sum(axis=1) < 0
    hexes = hexes.copy()
    hexes[left_handed] = hexes[left_handed][:, [4, 5, 6, 7, 0, 1, 2, 3]]
    points, number = welded(hexes.reshape(-1, 3))
    cells = number.reshape(-1, 8)
    sides = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    quads = cells[:, sides].reshape(-1, 4)
    _, inverse, count = np.unique(
        np.sort(quads, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    quads = quads[count[inverse.reshape(-1)] == 1]
    corner = points[quads]
    first = ((corner[:, 0] - corner[:, 2]) ** 2).sum(axis=1)
    second = ((corner[:, 1] - corner[:, 3]) ** 2).sum(axis=1)
    # The shorter diagonal; on equal ones alternate, so that flat areas get no preferred direction.
    tie = np.abs(first - second) < 1e-6
    odd = quads.min(axis=1) % 2 == 1
    cut = np.where(tie, odd, first < second)
    fans = np.where(
        cut[:, None], quads[:, [0, 1, 2, 0, 2, 3]], quads[:, [0, 1, 3, 1, 2, 3]]
    ).reshape(-1, 3)
    used, faces = np.unique(fans, return_inverse=True)
    return points[used], faces.reshape(-1, 3)


def bracket() -> tuple[Array, Array]:
    """An angle bracket of 72 x 40 x 72 mm: bored round ends, a boss, a counterbore and a rib."""
    across = np.concatenate(
        [_grid(-20, -4, 10, 0.93), _grid(-4, 4, 7)[1:], _grid(4, 20, 10, 1.07)[1:]]
    )
    plate, reach = _grid(0, 8, 6), 32.0
    along = np.concatenate([plate, _grid(8, reach, 20, 1.03)[1:]])
    x, y, z = np.meshgrid(along, across, along, indexing="ij")
    cells = _hexes(np.stack([x, y, z], axis=3))
    middle = cells.mean(axis=1)
    solid = cells[(middle[:, 0] < 8) | (middle[:, 2] < 8)]

    # The rib's triangular section is one quadrilateral block whose fourth corner lies on the
    # middle of the long side.
    u = ((along[6:] - 8) / (reach - 8))[:, None]
    v = u.T
    bend = 0.5 * u * v
    section = 8 + (reach - 8) * np.stack([u - bend, v - bend], axis=2)
    rib = _extruded(section, _grid(-4, 4, 7))[..., [0, 2, 1]]

    base_end = _lug(across, [9.0, 14.0], [4, 9])
    boss = _extruded(base_end[:5], _grid(8, 13, 4))
    base = _extruded(base_end, plate)
    lift = np.array([reach + 20.0, 0.0, 0.0])
    top_end = _lug(across, [5.0, 10.0], [4, 11])
    # Extruded along z, then turned so that the plate stands: (s, t, depth) -> (depth, t, s).
    bored = _extruded(top_end[4:], plate)[..., [2, 1, 0]]
    seat = _extruded(top_end[:5], plate[:4])[..., [2, 1, 0]]
    raise_ = lift[[2, 1, 0]]
    blocks = [solid, _hexes(rib), _hexes(base + lift), _hexes(boss + lift)]
    blocks += [_hexes(bored + raise_), _hexes(seat + raise_)]
    return _skin(np.concatenate(blocks))
