"""Solids by boolean operations, as machined and printed parts are: exact sharp edges, fine curves.

Each function draws its own measures from the generator; a part is about 2 to 4 units large.
"""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, set_circular_segments

from training.connectivity import Floats
from training.surface import LabelledMesh, label_patches

Generator = np.random.Generator

SEGMENTS = 192
"""Facets around a circle of radius 1, whose chords leave it by 1.4e-4, some 0.003 mean edges."""

set_circular_segments(SEGMENTS)


def to_labelled_mesh(solid: Manifold) -> LabelledMesh:
    """The surface of a solid; faces of one smooth part of one primitive share a label."""
    # Offset outlines have facets as narrow as their rounding.
    mesh = solid.simplify(1e-6).to_mesh64()
    vertices = np.array(mesh.vert_properties)[:, :3].copy()
    faces = np.array(mesh.tri_verts).astype(np.int64)
    runs = np.array(mesh.run_index) // 3
    groups = np.repeat(np.array(mesh.run_original_id).astype(np.int64), np.diff(runs))
    return LabelledMesh(vertices, faces, label_patches(vertices, faces, groups))


def _box(*size: float) -> Manifold:
    return Manifold.cube(size, True)


def _segments(radius: float) -> int:
    """Facets around a circle, whose chords leave it as far as those of any other."""
    return 4 * int(np.ceil(SEGMENTS * np.sqrt(radius) / 4.0))


def _rod(radius: float, height: float, top: float = -1.0) -> Manifold:
    return Manifold.cylinder(height, radius, top, _segments(max(radius, top)), True)


def _ball(radius: float) -> Manifold:
    return Manifold.sphere(radius, _segments(radius))


def _section(points: Floats | list[tuple[float, float]]) -> CrossSection:
    return CrossSection([np.asarray(points, dtype=np.float64)])


def _polar(radius: Floats, angle: Floats) -> Floats:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _around(solid: Manifold, count: int, radius: float) -> Manifold:
    """Copies of a solid, ``count`` of them, on a circle about z."""
    shifted = solid.translate((radius, 0.0, 0.0))
    return Manifold.compose([shifted.rotate((0, 0, 360.0 * k / count)) for k in range(count)])


def make_drilled_plate(g: Generator) -> Manifold:
    """A plate with round corners, counterbored holes and a slot."""
    height = g.uniform(0.25, 0.5)
    outline = CrossSection.square((2.6, 1.6), True).offset(0.3, JoinType.Round)
    plate = outline.extrude(height).translate((0, 0, -height / 2))
    for x in (-1.2, 1.2):
        for y in (-0.7, 0.7):
            hole = _rod(g.uniform(0.12, 0.18), 2.0)
            plate -= (hole + _rod(0.26, 0.2).translate((0, 0, height / 2))).translate((x, y, 0))
    slot = CrossSection.square((g.uniform(0.5, 1.0), 0.02), True).offset(0.22, JoinType.Round)
    return plate - slot.extrude(2.0).translate((0, 0, -1.0)).rotate((0, 0, g.uniform(-30, 30)))


def make_bracket(g: Generator) -> Manifold:
    """An angle with a fillet inside, gussets and holes in both legs."""
    wall, leg, width, fillet = g.uniform(0.2, 0.35), 2.0, g.uniform(1.2, 2.0), g.uniform(0.2, 0.4)
    turn = np.linspace(np.pi, 1.5 * np.pi, 33)
    arc = _polar(np.full(33, fillet), turn) + (wall + fillet)
    outline = [(0, 0), (leg, 0), (leg, wall), *arc[::-1].tolist(), (wall, leg), (0, leg)]
    part = _section(outline).extrude(width).translate((0, 0, -width / 2))
    gusset = _section([(0.1, 0.1), (1.3, 0.1), (0.1, 1.3)]).extrude(0.16)
    part += gusset.translate((0, 0, -0.08))
    for z in (-0.32 * width, 0.32 * width):
        part -= _rod(0.17, 1.0).rotate((90, 0, 0)).translate((1.5, 0.0, z))
        part -= _rod(0.14, 1.0, 0.24).rotate((0, 90, 0)).translate((0.0, 1.5, z))
    return part


def _gear_outline(teeth: int, root: float, tip: float) -> Floats:
    """Flanks of four points, so nearly involute, and flat tips."""
    pitch = 2.0 * np.pi / teeth
    share = np.array([-0.36, -0.30, -0.22, -0.13, 0.13, 0.22, 0.30, 0.36])
    rise = np.array([0.0, 0.2, 0.6, 1.0, 1.0, 0.6, 0.2, 0.0])
    angle = (np.arange(teeth)[:, None] + share).reshape(-1) * pitch
    return _polar(np.tile(root + rise * (tip - root), teeth), angle)


def make_gear(g: Generator) -> Manifold:
    """A spur or helical gear with hub, bore, keyway and lightening holes."""
    teeth, height = int(g.integers(12, 22)), g.uniform(0.5, 0.8)
    twist = float(g.choice([0.0, 12.0]))
    section = _section(_gear_outline(teeth, 1.25, 1.55))
    gear = section.extrude(height, 1 if twist == 0.0 else 24, twist).translate((0, 0, -height / 2))
    gear -= _around(_rod(0.2, 2.0), int(g.integers(4, 7)), 0.85)
    gear += _rod(0.5, height + 0.5)
    return gear - _rod(0.28, 3.0) - _box(0.16, 0.16, 3.0).translate((0.3, 0, 0))


def make_stepped_shaft(g: Generator) -> Manifold:
    """A turned shaft: shoulders, chamfers, a groove, a fillet and a keyway."""
    radii = g.uniform(0.35, 0.8, 4)
    outline, z, chamfer = [(0.0, 0.0)], 0.0, 0.07
    for radius in radii:
        length = g.uniform(0.5, 1.0)
        outline += [(radius - chamfer, z), (radius, z + chamfer), (radius, z + length)]
        z += length
    outline += [(radii[-1] - chamfer, z + chamfer), (0.0, z + chamfer)]
    shaft = CrossSection([np.array(outline)]).revolve().translate((0, 0, -z / 2))
    ring = _rod(1.0, 0.12) - _rod(float(radii[1]) - 0.1, 0.2)
    shaft -= ring.translate((0, 0, g.uniform(-0.7, -0.4)))
    shaft -= _box(0.2, 0.3, 0.7).translate((0, float(radii[-1]), z / 2 - 0.3))
    return shaft - _rod(0.14, 2.0).rotate((90, 0, 0)).translate((0, 0, -z / 2 + 0.4))


def make_cut_sphere(g: Generator) -> Manifold:
    """A ball cut by planes and drilled: sharp curved edges."""
    ball = _ball(1.0)
    for _ in range(int(g.integers(4, 9))):
        normal = g.normal(size=3)
        ball = ball.trim_by_plane(tuple(normal / np.linalg.norm(normal)), -g.uniform(0.55, 0.85))
    drill = _rod(g.uniform(0.2, 0.35), 3.0).rotate(tuple(g.uniform(0, 180, 3)))
    return ball - drill


def make_lens(g: Generator) -> Manifold:
    """What balls have in common: one sharp curve, then three meeting in corners."""
    gap = g.uniform(0.45, 0.7)
    part = _ball(1.0).translate((gap, 0, 0)) ^ _ball(1.0).translate((-gap, 0, 0))
    return part ^ _ball(1.1).translate((0, g.uniform(0.4, 0.7), 0.3))


def make_flange(g: Generator) -> Manifold:
    """A pipe with a bolted flange and a branch that meets it at an angle."""
    pipe, bore = _rod(0.6, 2.4), _rod(0.45, 4.0)
    flange = _rod(1.15, 0.28).translate((0, 0, -1.1))
    flange -= _around(_rod(0.11, 3.0), int(g.integers(5, 9)), 0.88)
    tilt = g.uniform(50, 90)
    branch = _rod(0.38, 1.5).translate((0, 0, 0.75)).rotate((tilt, 0, 0))
    hollow = _rod(0.27, 2.0).translate((0, 0, 1.0)).rotate((tilt, 0, 0))
    return (pipe + flange + branch) - bore - hollow


def make_ribbed_cover(g: Generator) -> Manifold:
    """A shallow open box with ribs crossing inside and round bosses with holes."""
    wall = g.uniform(0.1, 0.16)
    outer = CrossSection.square((2.0, 1.4), True).offset(0.25, JoinType.Round)
    cover = outer.extrude(0.8) - outer.offset(-wall, JoinType.Round).extrude(1.0).translate(
        (0, 0, wall)
    )
    inside = outer.offset(-wall / 2, JoinType.Round).extrude(0.5).translate((0, 0, wall / 2))
    ribs = Manifold()
    for x in np.linspace(-0.8, 0.8, int(g.integers(3, 6))):
        ribs += _box(0.1, 3.0, 2.0).translate((x, 0, 0))
    cover += (ribs + _box(4.0, 0.1, 2.0)) ^ inside
    for x in (-0.75, 0.75):
        post = _rod(0.2, 0.75).translate((x, 0.35, 0.4))
        cover = cover + post - _rod(0.09, 0.8).translate((x, 0.35, 0.7))
    return cover


def make_heat_sink(g: Generator) -> Manifold:
    """A block with thin fins, straight or as pins."""
    part = _box(2.4, 1.8, 0.3)
    if g.integers(2):
        for x in np.linspace(-1.05, 1.05, int(g.integers(6, 9))):
            part += _box(0.14, 1.8, 0.9).translate((x, 0, 0.5))
        return part - _rod(0.2, 2.0).rotate((0, 90, 0)).scale((4, 1, 1)).translate((0, 0, 0.7))
    for x in np.linspace(-0.95, 0.95, 5):
        for y in np.linspace(-0.65, 0.65, 4):
            part += _rod(0.16, 1.0, 0.11).translate((x, y, 0.55))
    return part


def make_hex_bolt(g: Generator) -> Manifold:
    """A hexagon head with the conical chamfer that leaves curved edges, and a collar and shank."""
    angle = np.radians(60.0) * np.arange(6)
    head = _section(_polar(np.ones(6), angle)).extrude(0.65)
    head ^= _rod(1.25, 1.3, 0.6).translate((0, 0, 0.45))
    shank = _rod(0.5, g.uniform(1.2, 1.8))
    return (
        head
        + _rod(0.75, 0.12)
        + shank.translate((0, 0, -0.6))
        - _rod(0.3, 1.0, 0.36).translate((0, 0, 0.6))
    )


def make_rounded_block(g: Generator) -> Manifold:
    """A block with all edges rounded, a chamfered pocket and a step with a fillet."""
    radius = g.uniform(0.12, 0.25)
    size = g.uniform(0.6, 1.0, 3)
    corners = [_ball(radius).translate(tuple(size * s)) for s in _signs()]
    block = Manifold.batch_hull(corners)
    pocket = CrossSection.square((0.5, 0.3), True).extrude(0.6, scale_top=(2.0, 2.6))
    block -= pocket.translate((0, 0, float(size[2]) + radius - 0.5))
    notch = _rod(0.3, 4.0).rotate((90, 0, 0))
    return block - notch.translate((float(size[0]) + radius, 0, 0.1))


def _signs() -> Floats:
    return np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def make_egg_crate(g: Generator) -> Manifold:
    """Thin crossing sheets: two sides everywhere near each other."""
    sheets, thick = Manifold(), g.uniform(0.06, 0.1)
    for x in np.linspace(-0.8, 0.8, 3):
        sheets += _box(thick, 2.2, 1.0).translate((x, 0, 0))
        sheets += _box(2.2, thick, 0.8).translate((0, x, 0))
    return sheets - _rod(0.3, 4.0).rotate((90, 0, 0)) - _rod(0.25, 4.0).rotate((0, 90, 0))


def make_rod_lattice(g: Generator) -> Manifold:
    """Thin round rods that cross, with balls where they do."""
    part, radius = Manifold(), g.uniform(0.14, 0.18)
    for a in (-0.6, 0.6):
        for b in (-0.6, 0.6):
            rod = _rod(radius, 1.8).translate((a, b, 0))
            part += rod + rod.rotate((90, 0, 0)) + rod.rotate((0, 90, 0))
    for corner in _signs():
        part += _ball(1.7 * radius).translate(tuple(0.6 * corner))
    return part


def make_impeller(g: Generator) -> Manifold:
    """A hub and a disc with twisted blades."""
    # Points along the blade keep the twisted facets nearly flat.
    x = np.linspace(0.2, 1.25, 33)
    lower = np.stack([x, np.full(33, -0.045)], axis=1)
    blade = _section(np.concatenate([lower, lower[::-1] * [1.0, -1.0]]))
    twisted = blade.extrude(0.8, 24, g.uniform(25, 45))
    count = int(g.integers(5, 8))
    blades = Manifold()
    for k in range(count):
        blades += twisted.rotate((0, 0, 360.0 * k / count))
    part = blades + _rod(0.45, 1.0, 0.3).translate((0, 0, 0.45)) + _rod(1.3, 0.14)
    return part - _rod(0.16, 4.0)


def make_pulley(g: Generator) -> Manifold:
    """A wheel with grooves, a web with spokes' windows, and a bore: all turned."""
    depth = g.uniform(0.12, 0.25)
    rim = [(1.0, 0.0), (1.4, 0.0)]
    for k in range(3):
        z = 0.12 + 0.24 * k
        rim += [(1.4, z), (1.4 - depth, z + 0.08), (1.4 - depth, z + 0.12), (1.4, z + 0.2)]
    rim += [(1.4, 0.84), (1.0, 0.84)]
    wheel = CrossSection([np.array(rim)]).revolve().translate((0, 0, -0.42))
    web = _rod(1.1, 0.2) - _around(_rod(0.24, 1.0), int(g.integers(4, 7)), 0.72)
    return wheel + web + _rod(0.4, 1.0) - _rod(0.2, 2.0)


def make_polyhedron(g: Generator) -> Manifold:
    """The hull of random points, with a cone and a notch: flat faces, edges of all angles."""
    points = g.normal(size=(int(g.integers(12, 22)), 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    hull = Manifold.hull_points([tuple(p) for p in points * g.uniform(0.9, 1.1, (len(points), 1))])
    return hull - _box(0.4, 0.5, 4.0).rotate((30, 20, 10)).translate((0.7, 0, 0))


def make_random_csg(g: Generator) -> Manifold:
    """Three to five primitives anywhere, joined, cut and intersected."""
    part = _random_primitive(g)
    for _ in range(int(g.integers(2, 5))):
        other = _random_primitive(g)
        kind = int(g.integers(3))
        joined = part + other if kind == 0 else part - other if kind == 1 else part ^ other
        # What a cut leaves must still be a part, in one piece.
        if joined.volume() < 0.3 * part.volume() or len(joined.decompose()) != 1:
            joined = part + other
        part = joined
    pieces = part.decompose()
    return max(pieces, key=lambda piece: piece.volume())


def _random_primitive(g: Generator) -> Manifold:
    kind = int(g.integers(5))
    if kind == 0:
        solid = _box(*g.uniform(0.5, 1.3, 3))
    elif kind == 1:
        solid = _ball(g.uniform(0.4, 0.65))
    elif kind == 2:
        solid = _rod(g.uniform(0.2, 0.5), g.uniform(0.8, 1.6))
    elif kind == 3:
        solid = _rod(g.uniform(0.4, 0.7), g.uniform(0.7, 1.2), g.uniform(0.05, 0.3))
    else:
        circle = CrossSection.circle(g.uniform(0.12, 0.22), 88).translate((g.uniform(0.4, 0.6), 0))
        solid = circle.revolve()
    if g.integers(2):
        solid = solid.rotate(tuple(g.uniform(0, 360, 3)))
    else:
        solid = solid.rotate(tuple(90.0 * g.integers(4, size=3)))
    return solid.translate(tuple(g.uniform(-0.3, 0.3, 3)))
