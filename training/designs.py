"""Clean meshes of every make for training the noise estimate: parts, designs, sculptures.

Beside the recipes of ``training.shapes``, which are sampled as scans are, these have triangles as
designers, CAD exports and decimation leave them: needles, few vertices, exact repetition, detail
as fine as the mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import fast_simplification
import numpy as np
from manifold3d import CrossSection, Manifold
from trimesh.remesh import subdivide_loop, subdivide_to_size

from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.mesh import prepare_mesh
from training import organic, relief, solids
from training.connectivity import Floats, Ints, build_edges, drop_unused
from training.organic import polygonise
from training.shapes import HALF_SIZE, RECIPES, build_shape, scale_to_unit_edges
from training.surface import LabelledMesh

Generator = np.random.Generator
Triangles = tuple[Floats, Ints]

SOLIDS = tuple(sorted(name for name in vars(solids) if name.startswith("make_")))
FIELDS = tuple(sorted(name for name in vars(organic) if name.startswith("make_")))
RELIEFS = tuple(sorted(name for name in vars(relief) if name.startswith("make_")))

MAX_CAGE_FACES = 60_000
"""Faces of a subdivided cage at most."""

LARGEST_SCULPTURE = 25_000
"""Vertices of a sculpture at most: decimation is what makes it a sculpture, not its size."""


def count_designs(others: int) -> int:
    """How many designs there are: the shapes of ``training.shapes``, ``others``, and a tenth as
    many with steep relief."""
    return len(RECIPES) + others + others // 10


def build_design(seed: int, index: int, others: int) -> tuple[str, Floats, Ints]:
    """One of ``count_designs(others)`` clean meshes: maker, vertices (n, 3) with sides of mean
    length 1, faces (m, 3).

    The shapes of ``training.shapes`` come first.  The same seed gives the same meshes.
    """
    if index < len(RECIPES):
        mesh = build_shape(RECIPES[index], np.random.default_rng([seed, index]))
        return "sampled", mesh.vertices, mesh.faces.astype(np.int32)
    generator = np.random.default_rng([seed, 7, index])
    shares = np.array(list(MAKERS.values()))
    maker = list(MAKERS)[int(generator.choice(len(MAKERS), p=shares / shares.sum()))]
    if index >= len(RECIPES) + others:
        maker = make_medal
    points, faces = maker(generator)
    corners = points[faces]
    sides = corners - np.roll(corners, 1, axis=1)
    scale = float(np.sqrt((sides * sides).sum(axis=2)).mean()) if len(faces) else 1.0
    return maker.__name__[5:], points / scale, faces.astype(np.int32)


def make_exported_part(g: Generator) -> Triangles:
    """A part with the triangles of its boolean operations: needles and fans."""
    solid = getattr(solids, str(g.choice(SOLIDS)))(g)
    solid = solid.simplify(float(10.0 ** g.uniform(-5.0, -1.5)))
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties)[:, :3].copy(), np.array(mesh.tri_verts).astype(np.int64)


def make_coarse_field(g: Generator) -> Triangles:
    """An organic shape by marching cubes of few cells."""
    mesh = polygonise(_draw_field(g), HALF_SIZE, int(g.integers(10, 28)))
    return mesh.vertices, mesh.faces


def make_low_polygon(g: Generator) -> Triangles:
    """An organic shape of a few hundred to a few thousand vertices, with features of few triangles
    and finer at one end, as characters of games are."""
    mesh = scale_to_unit_edges(polygonise(_draw_field(g), HALF_SIZE, int(g.integers(44, 76))))
    mesh = _add_reliefs(mesh, int(g.integers(0, 3)), (4.0, 40.0), (0.02, 0.3), g)
    count = int(np.exp(g.uniform(np.log(150), np.log(9000))))
    return _decimate_graded(mesh.vertices, mesh.faces, count, g)


def _add_reliefs(
    mesh: LabelledMesh,
    count: int,
    wavelengths: tuple[float, float],
    slopes: tuple[float, float],
    g: Generator,
) -> LabelledMesh:
    """So many reliefs, of a wavelength in edges and a slope, amplitude over wavelength, drawn."""
    for _ in range(count):
        maker = getattr(relief, str(g.choice(RELIEFS)))
        wavelength = float(np.exp(g.uniform(*np.log(wavelengths))))
        amplitude = wavelength * float(np.exp(g.uniform(*np.log(slopes))))
        rough = relief.apply_relief(mesh, maker, wavelength, amplitude, g)
        share = np.ones((len(mesh.vertices), 1))
        if g.random() < PARTLY:
            extent = float(np.ptp(mesh.vertices, axis=0).max())
            waves = organic.draw_waves(g, extent * float(g.uniform(0.15, 0.6)))(mesh.vertices)
            share = np.clip(0.5 + 2.0 * waves[:, None], 0.0, 1.0)
        points = mesh.vertices + share * (rough.vertices - mesh.vertices)
        mesh = LabelledMesh(points, mesh.faces, mesh.labels)
    return mesh


PARTLY = 0.4
"""Share of the reliefs that are on a part of the surface only."""


def _decimate_graded(points: Floats, faces: Ints, target: int, g: Generator) -> Triangles:
    """Quadric decimation, with triangles up to eight times as large at one end."""
    turned = points @ np.linalg.qr(g.normal(size=(3, 3)))[0]
    turned -= turned.mean(axis=0)
    rate = float(g.choice([0.0, g.uniform(0.0, 2.0)])) / np.abs(turned[:, 0]).max()
    growth = np.exp(rate * turned[:, :1])
    along = turned[:, :1] if rate == 0.0 else (growth - 1.0) / rate
    fewer, kept = _decimate(np.hstack([along, turned[:, 1:] * growth]), faces, target)
    if rate == 0.0:
        return fewer, kept
    growth = np.maximum(1.0 + rate * fewer[:, :1], 1e-3)
    return np.hstack([np.log(growth) / rate, fewer[:, 1:] / growth]), kept


def make_decimated_part(g: Generator) -> Triangles:
    """A part out of few triangles, decimated from an even mesh or from its export."""
    points, faces = make_exported_part(g)
    target = int(len(faces) * g.uniform(0.15, 0.7))
    return _decimate(points, faces, max(target, 60))


def make_sculpture(g: Generator) -> Triangles:
    """An organic shape with relief of one to three wavelengths, decimated until its detail is as
    fine as the mesh."""
    mesh = scale_to_unit_edges(polygonise(_draw_field(g), HALF_SIZE, int(g.integers(64, 112))))
    coarser = float(np.exp(g.uniform(np.log(1.2), np.log(4.5))))
    # Detail finer than the result's edges leaves errors of single vertices.
    wavelengths = (max(2.5, 0.8 * coarser), 16.0 * coarser)
    mesh = _add_reliefs(mesh, int(g.integers(1, 4)), wavelengths, (0.003, 0.15), g)
    target = min(int(len(mesh.faces) / coarser**2), 2 * LARGEST_SCULPTURE)
    return _decimate(mesh.vertices, mesh.faces, max(target, 600))


def make_reconstruction(g: Generator) -> Triangles:
    """A surface fused of many good scans, as published models are: a trace of error that many
    neighbours share, often decimated, and no noise to speak of."""
    mesh = scale_to_unit_edges(polygonise(_draw_field(g), HALF_SIZE, int(g.integers(64, 112))))
    coarser = float(g.choice([1.0, np.exp(g.uniform(np.log(1.2), np.log(4.0)))]))
    wavelengths = (max(2.5, 0.8 * coarser), 16.0 * coarser)
    mesh = _add_reliefs(mesh, int(g.integers(1, 4)), wavelengths, (0.002, 0.06), g)
    ready = prepare_mesh(mesh.vertices, mesh.faces.astype(np.int32)).mesh
    level = coarser * float(np.exp(g.uniform(np.log(0.003), np.log(0.03))))
    trace = AddedNoise("correlated", level, int(g.integers(2**31)), rings=int(g.integers(2, 7)))
    points = add_noise(ready, trace)
    return _decimate(points, ready.faces.astype(np.int64), int(len(ready.faces) / coarser**2))


def make_textured(g: Generator) -> Triangles:
    """Relief on even triangles, as they come from marching cubes: not decimated."""
    mesh = scale_to_unit_edges(polygonise(_draw_field(g), HALF_SIZE, int(g.integers(40, 80))))
    mesh = _add_reliefs(mesh, int(g.integers(1, 3)), (3.0, 16.0), (0.003, 0.12), g)
    return mesh.vertices, mesh.faces


def make_medal(g: Generator) -> Triangles:
    """Steep relief of several wavelengths on even triangles: on a sheet, as medals and range scans
    have, or on an organic shape."""
    if g.random() < 0.5:
        rows, columns = int(g.integers(50, 150)), int(g.integers(50, 150))
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float64)
        points[:, 2] = float(g.uniform(0.0, 0.2)) * organic.draw_waves(g, 0.4 * columns)(points)
        faces = _grid_faces(rows, columns, False)
        mesh = LabelledMesh(points, faces, np.zeros(len(faces), dtype=np.int64))
    else:
        mesh = scale_to_unit_edges(polygonise(_draw_field(g), HALF_SIZE, int(g.integers(40, 80))))
    mesh = _add_reliefs(mesh, int(g.integers(1, 4)), (3.0, 24.0), (0.02, 0.3), g)
    return mesh.vertices, mesh.faces


def make_subdivided_cage(g: Generator) -> Triangles:
    """A coarse cage, often mirrored, subdivided by Loop's rule up to three times."""
    points, faces = make_low_polygon(g) if g.random() < 0.6 else make_decimated_part(g)
    points, faces = _decimate(points, faces, int(np.exp(g.uniform(np.log(80), np.log(500)))))
    if g.random() < 0.5:
        points, faces = _mirror(points, faces)
    times = int(g.integers(0, 4))
    while times and len(faces) * 4**times > MAX_CAGE_FACES:
        times -= 1
    if times and is_manifold(faces, len(points)):
        # Any hides that it has no types.
        subdivide: Any = subdivide_loop
        points, faces = subdivide(points, faces, iterations=times)
    return np.asarray(points, dtype=np.float64), np.asarray(faces, dtype=np.int64)


def make_turned(g: Generator) -> Triangles:
    """A profile swept around an axis: vases, tubes, wheels, with the poles open."""
    rows, around = int(g.integers(6, 160)), int(g.integers(8, 240))
    height = np.linspace(0.0, float(g.uniform(0.5, 4.0)), rows)
    if g.random() < 0.4:
        radius = np.repeat(g.uniform(0.3, 1.5, rows // 4 + 1), 4)[:rows]
    else:
        waves = g.normal(size=(4, 2)) / np.arange(1, 5)[:, None]
        turns = np.arange(1, 5)[:, None] * height
        radius = 1.2 + 0.3 * (waves[:, :1] * np.sin(turns) + waves[:, 1:] * np.cos(turns)).sum(0)
        radius = np.maximum(radius, 0.1)
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    lobes = 1.0 + float(g.choice([0.0, 0.1, 0.3])) * np.cos(int(g.integers(2, 12)) * angle)
    reach = radius[:, None] * lobes[None, :]
    points = np.stack(
        [
            reach * np.cos(angle),
            reach * np.sin(angle),
            np.broadcast_to(height[:, None], reach.shape),
        ],
        axis=-1,
    )
    return points.reshape(-1, 3), _grid_faces(rows, around, True)


def make_terrain(g: Generator) -> Triangles:
    """A height field on a grid, smooth or in terraces."""
    rows, columns = int(g.integers(20, 160)), int(g.integers(20, 160))
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    places = np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64)
    heights = np.zeros(len(places))
    longest = float(g.uniform(12.0, 80.0))
    for octave in range(int(g.integers(1, 4))):
        ways = g.normal(size=(12, 2)) * 2.0 * np.pi / longest * 2.0**octave
        phases = g.uniform(0.0, 2.0 * np.pi, 12)
        share = 2.0 ** (-octave * float(g.uniform(1.5, 2.5)))
        heights += share * np.sin(places @ ways.T + phases).sum(axis=1)
    heights *= float(g.uniform(0.02, 0.12)) * longest / 3.0
    if g.random() < 0.2:
        heights = np.round(heights / 2.0) * 2.0
    return np.column_stack([places, heights]), _grid_faces(rows, columns, False)


def make_blocks(g: Generator) -> Triangles:
    """A design out of cubes, two triangles to a side: blocky figures and pixel art."""
    size = int(g.integers(5, 14))
    filled = np.zeros((size + 2,) * 3, dtype=bool)
    for _ in range(int(g.integers(3, 12))):
        low = g.integers(1, size, 3)
        high = np.minimum(low + g.integers(1, max(size // 2, 2), 3), size + 1)
        filled[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
    quads = []
    for axis in range(3):
        across = [(axis + 1) % 3, (axis + 2) % 3]
        for way in (-1, 1):
            for cell in np.argwhere(filled & ~np.roll(filled, -way, axis=axis)):
                corner = cell.copy()
                corner[axis] += way > 0
                steps = np.zeros((4, 3), dtype=np.int64)
                steps[1:3, across[0]] = 1
                steps[2:4, across[1]] = 1
                quads.append((corner + steps)[:: 1 if way > 0 else -1])
    corners, where = np.unique(np.array(quads).reshape(-1, 3), axis=0, return_inverse=True)
    numbers = where.reshape(-1, 4)
    faces = np.concatenate([numbers[:, [0, 1, 2]], numbers[:, [0, 2, 3]]])
    return corners.astype(np.float64) * g.uniform(0.5, 2.0, 3), faces


def make_drawing(g: Generator) -> Triangles:
    """Outlines with whole coordinates, extruded by whole heights: lettering and plates."""
    solid = Manifold()
    for _ in range(int(g.integers(2, 25))):
        size = g.integers(1, 20, 2)
        place = g.integers(0, 60, 2)
        if g.random() < 0.6:
            outline = CrossSection.square((float(size[0]), float(size[1])))
        else:
            corners = g.integers(0, 20, (int(g.integers(3, 9)), 2)).astype(np.float64)
            outline = CrossSection.hull_points(corners)
            if g.random() < 0.5:
                outline -= outline.translate((1.0, 1.0))
        layer = outline.extrude(float(g.integers(1, 6))).translate((0, 0, float(g.integers(0, 3))))
        solid += layer.translate((float(place[0]), float(place[1]), 0.0))
    mesh = solid.to_mesh64()
    points = np.array(mesh.vert_properties)[:, :3].copy()
    faces = np.array(mesh.tri_verts).astype(np.int64)
    if len(faces) and g.random() < 0.5:
        points, faces = _split_long(points, faces, float(g.uniform(1.0, 6.0)))
    return points * np.exp(0.3 * g.normal(size=3)), faces


def _split_long(points: Floats, faces: Ints, length: float) -> Triangles:
    """Edges halved until none is longer than ``length``."""
    # Any hides that it has no types.
    subdivide: Any = subdivide_to_size
    split, kept = subdivide(points, faces, length, max_iter=12)
    corners, where = np.unique(np.round(split, 6), axis=0, return_inverse=True)
    return corners, where.reshape(-1)[kept]


def make_assembly(g: Generator) -> Triangles:
    """Two to six designs side by side, of different sizes and finenesses, some of them twice."""
    makers = [maker for maker in MAKERS if maker is not make_assembly]
    points, faces = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    for _ in range(int(g.integers(2, 5))):
        some, theirs = makers[int(g.integers(len(makers)))](g)
        if not 0 < len(theirs) <= 30_000:
            continue
        some = some / max(float(np.ptp(some, axis=0).max()), 1e-9) * float(g.uniform(0.2, 1.0))
        for _ in range(int(g.integers(1, 3))):
            turned = some @ np.linalg.qr(g.normal(size=(3, 3)))[0] + 3.0 * g.normal(size=3)
            faces = np.concatenate([faces, theirs + len(points)])
            points = np.concatenate([points, turned])
    return points, faces


MAKERS: dict[Callable[[Generator], Triangles], float] = {
    make_exported_part: 4.0,
    make_decimated_part: 3.0,
    make_coarse_field: 2.0,
    make_low_polygon: 8.0,
    make_sculpture: 10.0,
    make_reconstruction: 6.0,
    make_textured: 4.0,
    make_subdivided_cage: 5.0,
    make_turned: 3.0,
    make_terrain: 2.0,
    make_blocks: 3.0,
    make_drawing: 3.0,
    make_assembly: 5.0,
}
"""Makers and how often each is drawn, relative to the others."""


def _draw_field(g: Generator) -> organic.Field:
    field: organic.Field = getattr(organic, str(g.choice(FIELDS)))(g)
    return field


def is_manifold(faces: Ints, n_vertices: int) -> bool:
    """Whether no edge has more than two faces; decimation may join what was apart."""
    try:
        build_edges(faces, n_vertices)
    except ValueError:
        return False
    return True


def _decimate(points: Floats, faces: Ints, target: int) -> Triangles:
    """About ``target`` faces by quadric decimation; as they are where there are fewer."""
    if len(faces) <= target:
        return points, faces
    fewer, theirs = fast_simplification.simplify(
        points.astype(np.float32), faces.astype(np.int32), target_count=target
    )
    vertices, kept, _ = drop_unused(fewer.astype(np.float64), theirs.astype(np.int64))
    return vertices, kept


def _mirror(points: Floats, faces: Ints) -> Triangles:
    """The mesh and its mirror image beside it."""
    mirrored = points * [-1.0, 1.0, 1.0]
    mirrored[:, 0] += 2.0 * points[:, 0].max()
    both = np.concatenate([points, mirrored])
    return both, np.concatenate([faces, faces[:, ::-1] + len(points)])


def _grid_faces(rows: int, columns: int, is_round: bool) -> Ints:
    """Two triangles to each cell of a grid, whose last column joins the first if ``is_round``."""
    last = columns if is_round else columns - 1
    row, column = np.divmod(np.arange((rows - 1) * last), last)
    first = row * columns + column
    right = row * columns + (column + 1) % columns
    above, diagonal = first + columns, right + columns
    return np.concatenate(
        [np.stack([first, right, diagonal], 1), np.stack([first, diagonal, above], 1)]
    )
