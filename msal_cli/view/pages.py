"""One mesh, or two and what is between them, as a page: ``msal view -o page.html``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli.view import pictures

if TYPE_CHECKING:
    from msal_cli.job.comparison_record import ComparisonRecord
    from msal_cli.job.records import Displacement, SurfaceDistance
    from msal_cli.mesh import Mesh
    from msal_cli.view.pictures import Scene, View

Rows = list[tuple[str, ...]]

_MINUS = "\N{MINUS SIGN}"
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SIDES = "blue inwards, orange outwards"


STILL_SIZE = 560
"""Pixels in the width of each panel of the picture in a page, at most."""


def page_of(scene: Scene, view: View, command: str) -> bytes:
    """The page of a scene, seen at the start as in ``view``.

    ``command`` is what made the page, for its readers.  A picture of the scene is in the page too,
    for where there is no WebGL and for print, so always on white.
    """
    from msal_cli.view import viewer
    from msal_cli.view.image_files import png_bytes

    scale = pictures.scale_of_scene(scene)
    still = replace(view, size=min(view.size, STILL_SIZE), style="light")

    titles = pictures.titles_of(scene.names)
    return viewer.page_bytes(
        " \N{RIGHTWARDS ARROW} ".join(titles),
        scene.before,
        scene.after,
        scene.deviation,
        numbers=figures_of(scene),
        notes=[*_state(scene), *_warnings(scene), f"Made by: {command}"],
        picture=png_bytes(pictures.drawn(scene, still), 256),
        description=_description(titles, scene),
        deviation_name=pictures.deviation_name(scene),
        deviation_note=_SIDES if scene.is_signed else "",
        ends=None if scale is None else (scale.low, scale.high),
        view=pictures.camera_of(scene, view).axes,
        is_flat=view.shading == "flat",
        theme="dark" if view.style == "dark" else "",
    )


def _state(scene: Scene) -> list[str]:
    is_still = scene.after is not None and not pictures.has_moved(scene)
    return [pictures.NOTHING_MOVED] if is_still else []


def figures_of(scene: Scene) -> list[tuple[str, Rows]]:
    """Tables of numbers to stand beside a scene: a heading, and rows of a name and a value."""
    record = scene.record
    if record is None:
        return [("Mesh", _mesh(scene.before))]
    tables = []
    if record.displacement is not None:
        tables.append(("Displacement", _lengths(record.displacement)))
    if record.distance_to_before is not None and record.displacement is None:
        tables.append(("Distance, after to before", _lengths(record.distance_to_before)))
    if record.distance_to_after is not None and record.displacement is None:
        tables.append(("Distance, before to after", _lengths(record.distance_to_after)))
    tables.append(("Change", _changes(record)))
    tables.append(("Meshes", _sizes(record)))
    return tables


def _mesh(mesh: Mesh) -> Rows:
    return [
        ("Vertices", f"{pictures.count_of_vertices(mesh):,}"),
        ("Triangles", f"{len(mesh.faces):,}"),
        ("Mean edge length", _number(mesh.mean_edge_length)),
    ]


def _lengths(one: Displacement | SurfaceDistance) -> Rows:
    """Each in file units, and in mean edge lengths (e)."""
    heads: Rows = [("", "file units", "e")]
    return heads + [
        (name, _number(length), _number(edges))
        for name, length, edges in (
            ("Mean", one.mean, one.mean_edges),
            ("RMS", one.rms, one.rms_edges),
            ("95 %", one.p95, one.p95_edges),
            ("Maximum", one.max, one.max_edges),
        )
    ]


def _changes(record: ComparisonRecord) -> Rows:
    rows: Rows = []
    if record.volume_change_percent is not None:
        rows.append(("Volume", _percent(record.volume_change_percent)))
    elif record.volume is not None:
        rows.append(("Volume", "unknown"))
    if record.area_change_percent is not None:
        rows.append(("Area", _percent(record.area_change_percent)))
    if record.mean_angular_error_deg is not None:
        rows.append(("Mean normal angle", f"{record.mean_angular_error_deg:.3g}°"))
    if record.max_angular_error_deg is not None:
        rows.append(("Largest normal angle", f"{record.max_angular_error_deg:.3g}°"))
    if record.flipped_faces is not None:
        rows.append(("Flipped faces", f"{record.flipped_faces:,}"))
    if record.vertex_error_percent is not None:
        rows.append(("Vertex error", f"{record.vertex_error_percent:.3g} % of e"))
    if record.hausdorff is not None:
        rows.append(("Hausdorff distance", _number(record.hausdorff)))
    return rows


def _sizes(record: ComparisonRecord) -> Rows:
    rows: Rows = []
    for name, before, after in (
        ("Vertices", record.vertices_before, record.vertices_after),
        ("Triangles", record.faces_before, record.faces_after),
    ):
        if before is not None and after is not None:
            same = f"{before:,}"
            rows.append(
                (name, same if before == after else f"{same} \N{RIGHTWARDS ARROW} {after:,}")
            )
    if record.mean_edge_length is not None:
        rows.append(("Mean edge length, e", _number(record.mean_edge_length)))
    return rows


def _warnings(scene: Scene) -> Sequence[str]:
    if scene.record is None:
        return ()
    said = list(scene.record.warnings)
    if scene.deviation is None:
        said.append("Other faces: no deviation without the package fcpw.")
    if scene.record.volume is not None and scene.record.volume.reason:
        said.append(f"No volume: {scene.record.volume.reason}.")
    return said


def _description(titles: Sequence[str], scene: Scene) -> str:
    if scene.after is None:
        return titles[0]
    words = f"{titles[0]} and {titles[1]}"
    if scene.deviation is None:
        return words
    return f"{words}, and the {pictures.deviation_name(scene).lower()}"


def _number(value: float) -> str:
    text = f"{value:.3g}"
    if "e" in text:
        digits, exponent = text.split("e")
        text = f"{digits}·10{str(int(exponent)).translate(_RAISED)}"
    return text.replace("-", _MINUS)


def _percent(value: float) -> str:
    return f"{value:+.3g} %".replace("-", _MINUS)
