"""Pictures and scenes for the HTML report: the bracket that reads inputs and outputs once more.

Only what the records name is shown: a file that is gone, or that is no longer the one that was
denoised, is left out without a word.  Time, the size of files and the number of faces are bounded,
the worst files come first, and what the bounds cost is said on the page.
"""

import hashlib
import logging
import math
import os
import statistics
import time
from collections.abc import Callable, Sequence

from msal_cli import codecs
from msal_cli.analysis import colour_maps as colours
from msal_cli.codecs import header
from msal_cli.codecs.mesh_file import Surface
from msal_cli.errors import format_count
from msal_cli.job.records import WITH_OUTPUT, MeshRecord
from msal_cli.job.settings import DEFAULT_BACKUP
from msal_cli.mesh import Mesh
from msal_cli.report.data import known_values
from msal_cli.report.facts import worst_first
from msal_cli.report.html import Gallery, Pictures
from msal_cli.storage import gzip_streams
from msal_cli.view import pages, pictures
from msal_cli.view.panels import jpeg_bytes
from msal_cli.view.scene import encode_scene
from msal_cli.view.shading import Image, Style, shade

log = logging.getLogger("msal")

_SIZE = 240, 180
_POSTER = 480, 320
_SHADES = 32
_STANDARD_RANGE = 0.5
# Below this, in mean edge lengths, nothing moved but the last digits.
_ROUNDING_EDGES = 1e-9

MAX_SECONDS, MAX_PICTURE_BYTES = 60.0, 14_000_000
"""What pictures of all files may cost; begun ones are finished."""

MAX_FACES = 1_000_000
"""Faces of one mesh with pictures."""

MAX_SCENES, MAX_SCENE_FACES = 5, 100_000
"""The worst files can be turned, as many, with at most so many faces each."""


def build_gallery(
    records: Sequence[MeshRecord],
    *,
    backup: str = DEFAULT_BACKUP,
    on_file: Callable[[int, int], None] | None = None,
) -> Gallery:
    """Pictures of as many files as the bounds allow, and scenes of the worst.

    Never raises for a file's fault.  ``backup`` is the suffix of the originals of files that were
    denoised in place.  ``on_file`` is called before each file with the number of those done
    and of all.
    """
    numbers = {id(record): at for at, record in enumerate(records)}
    reach = _reach(records)
    end = time.monotonic() + MAX_SECONDS
    images: dict[int, Pictures] = {}
    scenes: dict[int, str] = {}
    n_left = n_bytes = 0
    is_decimated = False
    # Both meshes may be found again on this machine's disks.
    candidates = [
        record
        for record in worst_first(records)
        if record.status in WITH_OUTPUT
        and not any(name == "-" or "://" in name for name in (record.input, record.output or "-"))
    ]
    for done, record in enumerate(candidates):
        if on_file is not None:
            on_file(done, len(candidates))
        is_over = time.monotonic() > end or n_bytes > MAX_PICTURE_BYTES
        if is_over or (record.triangles or record.faces or 0) > MAX_FACES:
            n_left += 1
            continue
        at = numbers[id(record)]
        key = f"scene{at}" if len(scenes) < MAX_SCENES else ""
        try:
            drawn = _draw(record, backup, reach, key)
        except Exception:
            # A picture is an extra: whatever keeps it from being made keeps back no report.
            log.info("%s: no picture", record.input, exc_info=True)
            continue
        if drawn is None:
            continue
        images[at], scene = drawn
        n_bytes += sum(len(part or b"") for part in images[at])
        if scene:
            scenes[at] = scene
            is_decimated |= (record.triangles or 0) > MAX_SCENE_FACES
    remarks = []
    if n_left:
        remarks.append(
            f"{format_count(n_left, 'file')} without pictures, which are made of the worst files, "
            f"of up to {MAX_FACES:,} faces, in {MAX_SECONDS:.0f} seconds and "
            f"{MAX_PICTURE_BYTES / 1e6:.0f} MB; `msal view` makes others."
        )
    if is_decimated:
        remarks.append(
            f"In 3D, meshes of more than {MAX_SCENE_FACES:,} faces are decimated; the figures "
            "are those of the full meshes."
        )
    return Gallery(images, scenes, _draw_legend(reach), tuple(remarks))


def _draw(record: MeshRecord, backup: str, reach: float, key: str) -> tuple[Pictures, str] | None:
    """Three pictures from one place, and a scene if it has a ``key``; None where a file is not
    what the record says.  Colours reach to ``reach`` mean edge lengths."""
    output = str(record.output)
    is_in_place = os.path.realpath(record.input) == os.path.realpath(output)
    source = record.input + backup if is_in_place else record.input
    before = _surface(source, record.input_sha256, record.format)
    after = _surface(output, record.output_sha256, None)
    if before is None or after is None:
        return None
    scene = pictures.scene_of(before, after, (source, output), to_surface=False)
    assert scene.after is not None
    camera = pictures.camera_of(scene, pictures.View())
    style = Style(background=(236, 238, 241))

    def image(mesh: Mesh, painted: Image | None, kind: str, size: tuple[int, int] = _SIZE) -> Image:
        return shade(
            mesh.vertices, mesh.faces, camera, *size, painted, style=style, colours_are=kind
        )

    deviation = None
    if scene.deviation is not None and scene.is_signed:
        moved = scene.deviation / scene.before.mean_edge_length
        painted = colours.map_colours(moved, -reach, reach, "diverging")
        deviation = jpeg_bytes(image(scene.after, painted, "map"))
    shown = Pictures(
        jpeg_bytes(image(scene.before, scene.painted(0), "paint")),
        jpeg_bytes(image(scene.after, scene.painted(1), "paint")),
        deviation,
    )
    if not key:
        return shown, ""
    end = reach * scene.before.mean_edge_length
    data = encode_scene(
        scene.before,
        scene.after,
        scene.deviation,
        ends=(-end, end) if scene.is_signed else None,
        view=camera.axes,
        colours=scene.colours,
        max_faces=MAX_SCENE_FACES,
    )
    poster = jpeg_bytes(image(scene.after, scene.painted(1), "paint", _POSTER))
    name = f"{record.input}, after"
    return shown, pages.embed_scene(key, data, picture=poster, description=name, starts="click")


def _surface(path: str, sha256: str | None, format: str | None) -> Surface | None:
    """What the file at ``path`` holds; None if it is not there, or has another SHA-256."""
    if not os.path.isfile(path):
        return None
    data = header.read_input(path, format)
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
        return None
    plain, _ = gzip_streams.expand(data, path)
    return pictures.coloured_surface_of(codecs.open_mesh(plain, path, format), path)


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


def _draw_legend(reach: float) -> str:
    """The elements that say what the colours of deviations mean."""
    shades = colours.colour_table("diverging")[:: 256 // _SHADES]
    size = 100 / len(shades)
    rects = [
        f'<rect x="{at * size:.3f}" width="{size + 0.2:.3f}" height="10" fill="rgb{tuple(shade)}"/>'
        for at, shade in enumerate(shades.tolist())
    ]
    return (
        '<div class="scale"><span>Deviation, along the normals, the same scale for all files:'
        f"</span><span>\N{MINUS SIGN}{reach:g} (inwards)</span>"
        '<svg viewBox="0 0 100 10" preserveAspectRatio="none" aria-hidden="true">'
        f"{''.join(rects)}</svg><span>+{reach:g} mean edge lengths (outwards)</span></div>"
    )
