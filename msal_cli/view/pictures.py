"""The picture of ``msal view``: one mesh, or two of one object, with numbers."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import at_other_positions, measure_enclosure, nearest_on_surface
from msal_cli.arrays import Floats
from msal_cli.codecs.colours import colour_table, map_colours, vertex_colours
from msal_cli.codecs.mesh_file import MeshFile, Surface, SurfaceColours
from msal_cli.errors import format_count
from msal_cli.job import comparison
from msal_cli.job.display_names import figure
from msal_cli.job.records import ComparisonRecord
from msal_cli.job.room import prepare_mesh
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh, PreparedMesh
from msal_cli.view.panels import Legend, Panel, draw_panels
from msal_cli.view.rendering import CREASE_DEG, Camera, Image, choose_camera, shade

_log = logging.getLogger("msal")

SIGNED = "Displacement along the normal"
DISTANCE = "Distance to the surface before"

NOTHING_MOVED = "Nothing moved"

SHARE_WITHIN = 0.99
"""Share of the numbers within the ends of a scale, so that one outlier does not make all pale."""

_MIN_END = 1e-290
"""Least end of a scale, file units: parts of a smaller one would be denormal numbers."""

_MIN_BRIGHTNESS = 16
"""If all colours of a file are darker, they would hide the shape; programs write such colours where
none are meant."""

_MIN_TALLNESS, _MAX_TALLNESS = 0.6, 1.4  # range of the ratio of height to width of a panel

# Rounding error of a position after a few operations, relative to the largest coordinate.
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class Scene:
    """One mesh, or two in one coordinate system, ready to draw."""

    names: tuple[str, ...]  # of the files, one for each mesh
    # before, after: welded, with consistent winding; ``after`` is None if there is one mesh
    before: Mesh
    after: Mesh | None = None
    # (n,) a number in file units for each vertex of ``after``; None if unknown
    deviation: Floats | None = None
    # whether that is the displacement along the normals of ``before``, positive outwards, even if
    # the normals point inwards because the surface is inside out; else it is the distance to the
    # surface of ``before``
    is_signed: bool = True
    record: ComparisonRecord | None = None  # the numbers; None for one mesh
    # one for each mesh, (n, 3) of its vertices or None; empty if none were read
    colours: tuple[Image | None, ...] = ()
    notes: tuple[str, ...] = ()  # what of the files could not be shown, with their names

    def painted(self, at: int) -> Image | None:
        """The file's colours of mesh ``at``; None if it has none."""
        return self.colours[at] if at < len(self.colours) else None


@dataclass(frozen=True)
class View:
    """The viewpoint and the size of a picture; see ``view.rendering.choose_camera``.

    ``size`` is the width of each panel in pixels.  ``colours`` is ``auto`` for those of the
    files and the deviation, ``file`` or ``deviation`` for one of the two, or ``none``.
    """

    view: str = "auto"
    turn_deg: float | None = None
    tilt_deg: float | None = None
    up: str = "auto"
    size: int = 640
    shading: str = "smooth"
    colours: str = "auto"

    @property
    def shows_file_colours(self) -> bool:
        return self.colours in ("auto", "file")

    @property
    def shows_deviation(self) -> bool:
        return self.colours in ("auto", "deviation")


def scene_of(
    before: Surface, after: Surface | None, names: tuple[str, ...], *, to_surface: bool = True
) -> Scene:
    """Prepare one or two surfaces for drawing, and compare two.

    Where the faces are not the same, the distance to the surface is measured if ``to_surface``.
    Raises ContentError, which names the file, if it has no surface to draw.
    """
    first = prepare_mesh(before, names[0])
    if after is None:
        return _with_colours(Scene(names, first.mesh), (before,), (first,))
    is_signed = before.has_same_faces(after)
    is_measured = to_surface and not is_signed
    record = comparison.compare_meshes(before, after, *names, to_surface=is_measured)
    second, deviation = first, None
    if is_signed:
        moved = at_other_positions(first, after.vertices)
        steps = moved.vertices - first.mesh.vertices
        deviation = (steps * first.mesh.vertex_normals()).sum(axis=1)
        deviation *= measure_enclosure(first).outward_signs(first.mesh)
    else:
        second = prepare_mesh(after, names[1])
        moved = second.mesh.with_vertices(second.mesh.vertices + (second.origin - first.origin))
        if is_measured:
            _, deviation = nearest_on_surface(moved.vertices, first.mesh)
    scene = Scene(names, first.mesh, moved, deviation, is_signed, record)
    return _with_colours(scene, (before, after), (first, second))


def _with_colours(
    scene: Scene, surfaces: tuple[Surface, ...], prepared: tuple[PreparedMesh, ...]
) -> Scene:
    """The scene with vertex colours of the surfaces; welded vertices get the mean colour."""
    painted, notes = [], []
    titles = titles_of(scene.names)
    for title, surface, ready in zip(titles, surfaces, prepared, strict=True):
        own = surface.colours
        colours = None if own is None else own.vertices
        if colours is not None and ready.vertex_map is not None:
            is_used, n = ready.vertex_map >= 0, len(ready.mesh.vertices)
            places, rows = ready.vertex_map[is_used], colours[is_used]
            count = np.maximum(np.bincount(places, minlength=n), 1)
            sums = [np.bincount(places, weights=column, minlength=n) for column in rows.T]
            colours = np.rint(np.stack(sums, axis=1) / count[:, None]).astype(np.uint8)
        painted.append(colours)
        notes += [f"{title}: {note}" for note in (own.notes if own is not None else ())]
    return replace(scene, colours=tuple(painted), notes=tuple(notes))


def camera_of(scene: Scene, view: View) -> Camera:
    """The camera for all meshes of a scene."""
    # Noise must not tilt the view, so the orientation is guessed from the mesh after.
    chosen = scene.after or scene.before
    return choose_camera(
        chosen.vertices,
        chosen.faces,
        view.view,
        turn_deg=view.turn_deg,
        tilt_deg=view.tilt_deg,
        up=view.up,
        also=None if scene.after is None else scene.before.vertices[scene.before.topology.has_ring],
    )


def draw_picture(scene: Scene, view: View) -> Image:
    """(H, W, 3) uint8: the meshes side by side, their deviation, and the numbers."""
    camera = camera_of(scene, view)

    def image(mesh: Mesh, at: int) -> Image:
        painted = scene.painted(at) if view.shows_file_colours else None
        return panel(mesh, camera, view, painted, colours_are="paint")

    titles = titles_of(scene.names)
    record = scene.record
    panels: list[Panel] = [(image(scene.before, 0), titles[0], [counts_text(scene, 0)])]
    if scene.after is None or record is None:
        return draw_panels(panels)
    lines = [counts_text(scene, 1), *_changes(record)]
    panels.append((image(scene.after, 1), titles[1], lines))
    scale = scale_of_scene(scene) if view.shows_deviation else None
    if scene.deviation is None or scale is None:
        return draw_panels(panels)
    edge = scene.before.mean_edge_length
    beyond = float((abs(scene.deviation) > scale.high).mean())
    ends = f"Its ends: 99th percentile, rounded up ({100.0 * beyond:.2g} % lie beyond)"
    if not has_moved(scene):
        ends = f"{NOTHING_MOVED}: its ends are the mean edge length"
    lines_of_scale = ("Above the scale: file units; below: mean edge lengths (e)", ends)
    legend = scale.legend(lines_of_scale, edge)
    picture = panel(scene.after, camera, view, scale.paint(scene.deviation))
    lines = [_move(scene, scene.deviation, edge)]
    lines += ["Blue: inwards, orange: outwards"] if scene.is_signed else []
    panels.append((picture, deviation_name(scene), lines))
    return draw_panels(panels, legend)


def scale_of_scene(scene: Scene) -> Scale | None:
    """The colour scale of a deviation; None without one.

    If nothing moved, the scale ends at one mean edge length: all colours are from its middle.
    """
    if scene.deviation is None:
        return None
    return scale_of(
        scene.deviation,
        is_signed=scene.is_signed,
        rounding=_rounding(scene),
        if_none=scene.before.mean_edge_length,
    )


def has_moved(scene: Scene) -> bool:
    """Whether any vertex deviates by more than rounding, along the normals or across them."""
    record = scene.record
    sizes = [] if scene.deviation is None else [float(abs(scene.deviation).max(initial=0.0))]
    if record is not None and record.displacement is not None:
        sizes.append(record.displacement.max)
    return not sizes or max(sizes) > _rounding(scene)


def _rounding(scene: Scene) -> float:
    return _ROUNDING * float(abs(scene.before.vertices).max())


def deviation_name(scene: Scene) -> str:
    return SIGNED if scene.is_signed else DISTANCE


def panel(
    mesh: Mesh,
    camera: Camera,
    view: View,
    colours: Image | None = None,
    *,
    colours_are: str = "map",
) -> Image:
    """(h, w, 3) uint8: one mesh with ``colours`` (n, 3) uint8 of its vertices, or of clay; see
    ``rendering.shade``."""
    tallness = min(max(camera.half_height / camera.half_width, _MIN_TALLNESS), _MAX_TALLNESS)
    return shade(
        mesh.vertices,
        mesh.faces,
        camera,
        view.size,
        round(view.size * tallness),
        colours,
        crease_deg=0.0 if view.shading == "flat" else CREASE_DEG,
        colours_are=colours_are,
    )


def titles_of(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names of the files without folders, if they differ."""
    bare = tuple(os.path.basename(name) or name for name in names)
    return names if len(set(bare)) < len(bare) else bare


def counts_text(scene: Scene, at: int) -> str:
    """The size of a mesh, the one before or after: faces, and the vertices that they use."""
    mesh = scene.after if at and scene.after is not None else scene.before
    n_vertices = int(mesh.topology.has_ring.sum())
    return f"{format_count(len(mesh.faces), 'triangle')}, {format_count(n_vertices, 'vertex')}"


def _changes(record: ComparisonRecord) -> list[str]:
    change = figure(record.volume_change_percent, "+.3g", " %")
    reason = record.volume.reason if record.volume is not None else ""
    before, after = record.inside_out_before, record.inside_out_after
    inside_out = "" if before and after else f" {'before' if before else 'after'} only"
    turned = figure(record.mean_angular_error_deg, ".3g", "\N{DEGREE SIGN} (mean)")
    lines = (
        f"Volume {change}" if change else f"No volume: {reason}" if reason else "",
        f"Inside out{inside_out}" if before or after else "",
        f"Normals turned by {turned}" if turned else "",
    )
    return list(filter(None, lines))


def _move(scene: Scene, deviation: Floats, edge: float) -> str:
    moved = scene.record.displacement if scene.record is not None else None
    if not has_moved(scene):
        return NOTHING_MOVED
    if moved is not None:
        return f"Moved by {moved.mean_edges:.3g} e (mean), {moved.max_edges:.3g} e (max)"
    sizes = abs(deviation) / edge
    return f"{sizes.mean():.3g} e (mean), {sizes.max():.3g} e (max)"


# Colour scales of deviations


@dataclass(frozen=True)
class Scale:
    """The colour scale of a deviation.

    ``low`` and ``high`` are in file units; numbers beyond them get the colours of the ends.  If
    ``is_signed``, ``low`` is ``-high`` and the colour map has a pale middle.
    """

    low: float
    high: float
    is_signed: bool

    @property
    def map_name(self) -> str:
        """The name of the colour map in ``codecs.colours``."""
        return "diverging" if self.is_signed else "sequential"

    def paint(self, values: Floats) -> NDArray[np.uint8]:
        """The colours (n, 3) of ``values`` (n,)."""
        return map_colours(values, self.low, self.high, self.map_name)

    def legend(self, lines: tuple[str, ...], edge: float) -> Legend:
        """The legend: five ticks in file units above, and in units of ``edge`` below."""
        ticks = []
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            value = self.low + share * (self.high - self.low)
            ticks.append((share, _number_text(value), _number_text(value / edge)))
        return Legend(lines, colour_table(self.map_name), tuple(ticks))


def scale_of(
    values: Floats, *, is_signed: bool, rounding: float = 0.0, if_none: float = 1.0
) -> Scale:
    """The scale for ``values`` (n,) in file units: up to the 99th percentile of their absolute
    values, rounded up to two digits.

    If none of these is above ``rounding``, it ends at ``if_none``.
    """
    sizes = np.abs(values[np.isfinite(values)])
    largest = float(sizes.max(initial=0.0))
    end = if_none
    if largest > rounding:
        common = float(np.quantile(sizes, SHARE_WITHIN))
        end = common if common > rounding else largest
    end = max(end, _MIN_END)
    exponent = math.floor(math.log10(end)) - 1
    digits = math.ceil(end / 10.0**exponent - 1e-9)
    end = float(f"{digits}e{exponent}")
    return Scale(-end if is_signed else 0.0, end, is_signed)


def _number_text(value: float) -> str:
    return f"{value:.3g}" if value else "0"


# Colours of the files.  What cannot be read of them is a note, never an error: a picture without
# colours is better than none.


def open_coloured_surface(path: str, format: str | None = None) -> Surface:
    return coloured_surface_of(comparison.open_mesh_file(path, format), path)


def coloured_surface_of(mesh_file: MeshFile, path: str) -> Surface:
    """The surface in an open file, with its colours; ``path`` is that of the file."""
    return replace(comparison.surface_of(mesh_file), colours=_read_colours(mesh_file, path))


def _read_colours(mesh_file: MeshFile, path: str) -> SurfaceColours:
    try:
        colours = vertex_colours(mesh_file)
    except Exception as failure:  # colours are an extra, and files may come from anywhere
        _log.info("%s: no colours", path, exc_info=True)
        return SurfaceColours(None, (f"its colours cannot be read: {str(failure)[:200]}",))
    if colours is None:
        return SurfaceColours()
    colours = colours[:, :3]
    if len(colours) != len(mesh_file.vertices):
        return SurfaceColours(None, ("its colours do not fit its vertices",))
    if int(colours.max(initial=0)) < _MIN_BRIGHTNESS:
        return SurfaceColours(None, ("all of its colours are black, and are not shown",))
    return SurfaceColours(colours)
