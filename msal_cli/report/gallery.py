"""Pictures and scenes for the HTML report: the bracket that reads inputs and outputs once more.

Only what the records name is shown: a file that is gone, or that is no longer the one that was
denoised, is left out without a word.  Time, the size of files and the number of faces are bounded,
the worst files come first, and what the bounds cost is said on the page.
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from msal_cli import codecs
from msal_cli.analysis import colour_maps as colours
from msal_cli.codecs import header_check
from msal_cli.job.comparison import Surface
from msal_cli.job.records import WITH_OUTPUT, MeshRecord
from msal_cli.job.settings import DEFAULT_BACKUP
from msal_cli.mesh import Mesh
from msal_cli.report.data import known_values
from msal_cli.report.facts import format_count, worst_first
from msal_cli.report.picture_cache import PictureCache, picture_key
from msal_cli.storage import gzip_streams
from msal_cli.view import pictures, viewer
from msal_cli.view.camera import Camera
from msal_cli.view.illustrations import Gallery, Pictures, Scale
from msal_cli.view.image_files import jpeg_bytes, png_bytes
from msal_cli.view.pictures import Scene
from msal_cli.view.scene import encode_scene
from msal_cli.view.shading import Image, Style, shade
from msal_cli.view.surface_colours import coloured_surface_of

log = logging.getLogger("msal")

_SIZE = 240, 180
_POSTER = 480, 320
_SHADES = 24
_STANDARD_RANGE = 0.5
# Below this, in mean edge lengths, nothing moved but the last digits.
_ROUNDING_EDGES = 1e-9


@dataclass(frozen=True)
class Bounds:
    """What pictures may cost.

    ``seconds`` in all, begun pictures are finished; ``file_bytes`` and ``faces`` of one mesh that
    is loaded; ``scenes`` are the worst files that can be turned, with at most ``scene_faces`` each;
    ``picture_bytes`` in all.
    """

    seconds: float = 60.0
    file_bytes: int = 200_000_000
    faces: int = 1_000_000
    scenes: int = 5
    scene_faces: int = 100_000
    picture_bytes: int = 18_000_000


def build_gallery(
    records: Sequence[MeshRecord],
    *,
    backup: str = DEFAULT_BACKUP,
    bounds: Bounds | None = None,
    on_file: Callable[[int, int], None] | None = None,
    cache: PictureCache | None = None,
) -> Gallery:
    """Pictures of as many files as the bounds allow, and scenes of the worst.

    Never raises for a file's fault.  ``backup`` is the suffix of the originals of files that were
    denoised in place.  ``on_file`` is called before each file with the number of those done
    and of all.  What ``cache`` has is not drawn again.
    """
    bounds, cache = bounds or Bounds(), cache or PictureCache()
    numbers = {id(record): at for at, record in enumerate(records)}
    reach = _reach(records)
    end = time.monotonic() + bounds.seconds
    images: dict[int, Pictures] = {}
    scenes: dict[int, str] = {}
    n_late = n_large = n_bytes = n_decimated = 0
    candidates = [record for record in worst_first(records) if _is_shown(record)]
    for done, record in enumerate(candidates):
        if on_file is not None:
            on_file(done, len(candidates))
        at = numbers[id(record)]
        wants_scene = len(scenes) < bounds.scenes
        key = picture_key(record, reach, f"scene{at}" if wants_scene else "")
        if n_bytes <= bounds.picture_bytes and (known := cache.find(key)) is not None:
            images[at], scene_text = known
            if scene_text:
                scenes[at] = scene_text
                n_decimated += (record.triangles or 0) > bounds.scene_faces
            n_bytes += _n_bytes(images[at])
            continue
        if time.monotonic() > end or n_bytes > bounds.picture_bytes:
            n_late += 1
            continue
        if _is_too_large(record, bounds):
            n_large += 1
            continue
        try:
            scene = _scene(record, backup, bounds)
            if scene is None:
                continue
            camera = pictures.camera_of(scene, pictures.View())
            shown = _pictures(scene, camera, reach)
            if wants_scene:
                scenes[at] = _embed(record, scene, camera, reach, bounds.scene_faces, f"scene{at}")
                n_decimated += len(scene.before.faces) > bounds.scene_faces
        except Exception:
            # A picture is an extra: whatever keeps it from being made keeps back no report.
            log.info("%s: no picture", record.input, exc_info=True)
            continue
        images[at] = shown
        cache.add(key, shown, scenes.get(at, ""))
        n_bytes += _n_bytes(shown)
    return Gallery(
        pictures=images,
        scenes=scenes,
        scale=_scale(reach),
        script=viewer.script() if scenes else "",
        style=viewer.style() if scenes else "",
        remarks=tuple(_remarks(len(images), n_late, n_large, n_decimated, bounds)),
    )


def _n_bytes(shown: Pictures) -> int:
    return len(shown.before) + len(shown.after) + len(shown.deviation or b"")


# Which files, and what of them


def _is_shown(record: MeshRecord) -> bool:
    """Whether both meshes may be found again on this machine's disks."""
    names = (record.input, record.output or "-")
    return record.status in WITH_OUTPUT and not any(one == "-" or "://" in one for one in names)


def _is_too_large(record: MeshRecord, bounds: Bounds) -> bool:
    if (record.triangles or record.faces or 0) > bounds.faces:
        return True
    try:
        return os.path.getsize(str(record.output)) > bounds.file_bytes
    except OSError:
        return False


def _paths(record: MeshRecord, backup: str) -> tuple[str, str]:
    """Where the mesh before and the mesh after are."""
    output = str(record.output)
    is_in_place = os.path.realpath(record.input) == os.path.realpath(output)
    return (record.input + backup if is_in_place else record.input), output


def _scene(record: MeshRecord, backup: str, bounds: Bounds) -> Scene | None:
    """Both meshes, if they are still those of the record and can be drawn."""

    source, output = _paths(record, backup)
    before = _surface(source, record.input_sha256, record.format, bounds)
    after = _surface(output, record.output_sha256, None, bounds)
    if before is None or after is None:
        return None
    return pictures.scene_of(before, after, (source, output), to_surface=False)


def _surface(path: str, sha256: str | None, format: str | None, bounds: Bounds) -> Surface | None:
    """What the file at ``path`` holds; None if it is not there, or has another SHA-256."""

    if not os.path.isfile(path) or os.path.getsize(path) > bounds.file_bytes:
        return None
    data = header_check.read_input(path, format)
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
        return None
    plain, _ = gzip_streams.expand(data, path)
    mesh_file = codecs.open_mesh(plain, path, format)
    if len(mesh_file.faces) > bounds.faces:
        return None
    return coloured_surface_of(mesh_file, path)


# Pictures


def _pictures(scene: Scene, camera: Camera, reach: float) -> Pictures:
    """Three pictures from one place; colours reach to ``reach`` mean edge lengths."""
    after = scene.after or scene.before
    deviation = None
    if scene.deviation is not None and scene.is_signed:
        moved = scene.deviation / scene.before.mean_edge_length
        painted = colours.map_colours(moved, -reach, reach, "diverging")
        deviation = jpeg_bytes(_image(after, camera, _SIZE, painted))
    before = jpeg_bytes(_painted(scene, 0, camera, _SIZE))
    return Pictures(before, jpeg_bytes(_painted(scene, 1, camera, _SIZE)), deviation)


def _painted(scene: Scene, at: int, camera: Camera, size: tuple[int, int]) -> Image:
    """The mesh before (0) or after (1) in its file's colours, or of clay."""
    mesh = scene.after if at and scene.after is not None else scene.before
    return _image(mesh, camera, size, scene.painted(at), "paint")


def _image(
    mesh: Mesh,
    camera: Camera,
    size: tuple[int, int],
    painted: Image | None = None,
    colours_are: str = "map",
) -> Image:
    style = Style(background=(236, 238, 241))
    return shade(
        mesh.vertices, mesh.faces, camera, *size, painted, style=style, colours_are=colours_are
    )


def _reach(records: Sequence[MeshRecord]) -> float:
    """Mean edge lengths at the ends of the colours, the same for all files.

    What 95 % of the vertices of a typical file stay below, doubled and rounded up, so that a bad
    file is visible.
    """

    done = [record for record in records if record.status in WITH_OUTPUT]
    moves = known_values(done, "displacement.p95_edges")
    sizes = [size for size in moves if math.isfinite(size) and size > _ROUNDING_EDGES]
    if not sizes:
        return _STANDARD_RANGE
    wanted = 2.0 * statistics.median(sizes)
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= wanted * 0.999)


def _scale(reach: float) -> Scale:

    table = colours.colour_table("diverging")
    rows = [table[round(at * (len(table) - 1) / (_SHADES - 1))] for at in range(_SHADES)]
    return Scale(
        title="Deviation, along the normals, the same scale for all files:",
        low=f"−{reach:g} (inwards)",
        high=f"+{reach:g} mean edge lengths (outwards)",
        colours=tuple("#" + "".join(f"{int(part):02x}" for part in row) for row in rows),
    )


# Scenes


def _embed(
    record: MeshRecord, scene: Scene, camera: Camera, reach: float, most_faces: int, key: str
) -> str:

    end = reach * scene.before.mean_edge_length
    drawn = encode_scene(
        scene.before,
        scene.after,
        scene.deviation,
        ends=(-end, end) if scene.is_signed else None,
        view=camera.axes,
        colours=scene.colours,
        most_faces=most_faces,
    )
    most_colours = None if scene.painted(1) is None else 256
    poster = png_bytes(_painted(scene, 1, camera, _POSTER), most_colours)
    return viewer.embedded_scene(
        key, drawn, picture=poster, description=f"{record.input}, after", starts="click"
    )


def _remarks(
    n_shown: int, n_late: int, n_large: int, n_decimated: int, bounds: Bounds
) -> list[str]:
    remarks = []
    if n_late:
        limits = f"{bounds.seconds:.0f} seconds or {bounds.picture_bytes / 1e6:.0f} MB"
        remarks.append(
            f"Pictures are of the worst {format_count(n_shown, 'file')}: the other {n_late:,} "
            f"would have taken more than {limits}."
        )
    if n_large:
        remarks.append(
            f"{format_count(n_large, 'file')} of more than {bounds.faces:,} faces or "
            f"{bounds.file_bytes / 1e6:.0f} MB without pictures here; `msal view` makes them."
        )
    if n_decimated:
        remarks.append(
            f"In 3D, meshes of more than {bounds.scene_faces:,} faces are decimated, before and "
            "after alike; the figures are those of the full meshes."
        )
    return remarks
