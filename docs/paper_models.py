"""What the remade figures share: models, noise, methods, measures and panels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import ground_truth
from msal_cli import methods
from msal_cli.analysis.measures import measure_surface_change, vertex_error_percent
from msal_cli.job import comparison
from msal_cli.kernels.geometry import face_normals_and_areas, ring_means
from msal_cli.mesh import Mesh, PreparedMesh, prepare_mesh
from msal_cli.view.rendering import CREASE_DEG, Camera, shade

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Image = NDArray[np.uint8]
Panel = tuple[Image, str, Sequence[str]]

SEED = 0
LEVEL = 0.1
"""The paper's "about 10 %": standard deviation in mean edge lengths."""


def opened(folder: Path, name: str) -> PreparedMesh:
    """A model of the data folder, made ready."""
    mesh_file = comparison.open_mesh_file(str(folder / name))
    return prepare_mesh(mesh_file.vertices, mesh_file.faces)


def corrupted(clean: Mesh, kind: str = "mixed", level: float = LEVEL) -> Mesh:
    """The mesh with noise of ``level`` mean edge lengths."""
    return clean.with_vertices(ground_truth.add_plain_noise(clean, kind, level, SEED))


def after(mesh: Mesh, method: str, **given: Any) -> Mesh:
    """The mesh after a method with these parameters."""
    chosen = methods.find(method)
    return mesh.with_vertices(chosen.denoise(mesh, chosen.validate(given)).vertices)


def fidelity(mesh: Mesh) -> Floats:
    """lambda (n,) of eq. (7) in the first sweep of MSAL."""
    chosen = methods.find("msal")
    return chosen.denoise(mesh, chosen.validate({"iterations": 1})).fields["fidelity"]


def volume(mesh: Mesh, origin: Floats) -> float:
    """Signed volume about the file's own origin, which matters where the mesh is open."""
    placed = mesh.with_vertices(mesh.vertices + origin)
    return measure_surface_change(placed, placed).volume_before


def angle(clean: Mesh, mesh: Mesh) -> float:
    """Mean angle between face normals in degrees."""
    return measure_surface_change(clean, mesh).mean_angular_error_deg


def face_angles(clean: Mesh, mesh: Mesh) -> Floats:
    """Angles (m,) between face normals in degrees; not a number where a face has none."""
    both = [face_normals_and_areas(one.vertices, one.faces)[0] for one in (clean, mesh)]
    cosine = np.clip((both[0] * both[1]).sum(axis=1), -1.0, 1.0)
    known = both[0].any(axis=1) & both[1].any(axis=1)
    return np.where(known, np.degrees(np.arccos(cosine)), np.nan)


def roughness(mesh: Mesh) -> Floats:
    """How rough the surface is around each face (m,): lambda, averaged over the one-rings."""
    links = mesh.topology
    around = ring_means(fidelity(mesh), links.ring_start, links.ring)
    return around[mesh.faces].mean(axis=1)


def offset(clean: Mesh, mesh: Mesh) -> float:
    """Mean distance between corresponding vertices in % of the mean edge length."""
    return vertex_error_percent(clean, mesh)


def errors(clean: Mesh, mesh: Mesh) -> str:
    """Both errors, as the other pages give them."""
    return f"{angle(clean, mesh):.2f}° / {offset(clean, mesh):.1f} %"


def closer(camera: Camera, right: float, up: float, share: float) -> Camera:
    """The camera closer by: moved by shares of the half sizes, with less of them around it."""
    aside = right * camera.half_width * camera.axes[0] + up * camera.half_height * camera.axes[1]
    return Camera(
        camera.axes, camera.centre + aside, share * camera.half_width, share * camera.half_height
    )


def drawn(
    mesh: Mesh,
    camera: Camera,
    size: tuple[int, int],
    colours: Image | None = None,
    crease_deg: float = CREASE_DEG,
) -> Image:
    """One mesh as an image, cut out of a larger one: what surrounds it throws its shadow too."""
    margin = round(0.1 * max(size))
    width, height = size[0] + 2 * margin, size[1] + 2 * margin
    share = camera.pixels_per_unit(*size) / camera.pixels_per_unit(width, height)
    wide = closer(camera, 0.0, 0.0, 1.0 / share)
    image = shade(mesh.vertices, mesh.faces, wide, width, height, colours, crease_deg=crease_deg)
    return image[margin:-margin, margin:-margin]


def panels(
    shown: Sequence[tuple[str, Mesh]],
    camera: Camera,
    size: tuple[int, int],
    clean: Mesh | None = None,
    crease_deg: float = CREASE_DEG,
) -> list[Panel]:
    """Titled panels of meshes seen by one camera, with their errors where ``clean`` is known."""
    made: list[Panel] = []
    for title, mesh in shown:
        image = drawn(mesh, camera, size, crease_deg=crease_deg)
        lines = [] if clean is None or mesh is clean else [errors(clean, mesh)]
        made.append((image, title, lines))
    return made


def bends(mesh: Mesh) -> tuple[Ints, Floats]:
    """Pairs of neighbouring faces (k, 2), and the angle between their normals (k,) in degrees."""
    import trimesh

    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return plain.face_adjacency, np.degrees(plain.face_adjacency_angles)


def uneven_head(solid: Mesh) -> Mesh:
    """A closed head of some 2,500 vertices, fine at the face and coarse at the back, whose volume
    is the 215.0 of the paper's Head.

    A sphere of triangles, refined three times towards the front and not at all behind, is drawn
    out to the surface of ``solid``, the Igea, as it is seen from outside.
    """
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2)
    directions, faces = np.array(ball.vertices), np.array(ball.faces)
    for least in (-0.1, 0.15, 0.62):
        front = directions[faces].mean(axis=1)[:, 2] > least
        directions, faces = _refined(directions, faces, front)
    seen = solid.vertices - 0.5 * (solid.vertices.min(axis=0) + solid.vertices.max(axis=0))
    radii = np.linalg.norm(seen, axis=1)
    seen = seen / radii[:, None]
    outer = np.empty(len(directions))
    for start in range(0, len(directions), 128):
        rows = slice(start, start + 128)
        near = directions[rows] @ seen.T > np.cos(np.radians(1.0))
        outer[rows] = np.where(near, radii, 0.0).max(axis=1)
    mesh = prepare_mesh(outer[:, None] * directions, faces.astype(np.int32)).mesh
    scale = (215.0 / measure_surface_change(mesh, mesh).volume_before) ** (1.0 / 3.0)
    return mesh.with_vertices(scale * mesh.vertices)


def _refined(points: Floats, faces: Any, chosen: NDArray[np.bool_]) -> tuple[Floats, Any]:
    """Chosen triangles of a sphere in four, and their neighbours so that nothing gapes."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, which = np.unique(edges, axis=0, return_inverse=True)
    which = which.reshape(-1, 3)
    halved = np.zeros(len(unique), dtype=bool)
    halved[which[chosen]] = True
    place = np.cumsum(halved) - 1 + len(points)
    middles = points[unique[halved]].mean(axis=1)
    middles /= np.linalg.norm(middles, axis=1)[:, None]
    made = []
    for corners, sides in zip(faces.tolist(), which.tolist(), strict=True):
        cut = [bool(halved[side]) for side in sides]
        # Turned so that one cut side comes first, or of two cut sides the one after the whole one.
        first = 0
        if sum(cut) == 1:
            first = cut.index(True)
        elif sum(cut) == 2:
            first = (cut.index(False) + 1) % 3
        a, b, c = corners[first:] + corners[:first]
        ab, bc, ca = (int(place[side]) for side in sides[first:] + sides[:first])
        if not any(cut):
            made.append((a, b, c))
        elif all(cut):
            made += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        elif sum(cut) == 1:
            made += [(a, ab, c), (ab, b, c)]
        else:
            made += [(ab, b, bc), (a, ab, bc), (a, bc, c)]
    return np.concatenate([points, middles]), np.array(made)
