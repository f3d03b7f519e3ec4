"""The one place where a file's arrays are checked and prepared for the methods.

``prepare_mesh`` checks shape, type, index range and finiteness once, and makes from the file's
vertices and triangles a mesh that every method can use: coincident vertices are welded, degenerate
and duplicate faces are left out, the winding is consistent, and the origin is local.
``PreparedMesh.to_file_vertices`` maps the result back to the file's vertices.
"""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ContentError, TooLargeError, format_count, not_finite
from msal_cli.kernels import array_files, geometry, spatial_order
from msal_cli.kernels.connectivity import (
    Connectivity,
    connectivity,
    count_components,
    faces_to_flip,
)
from msal_cli.kernels.parallel import at_once, is_worth_it
from msal_cli.kernels.welding import (
    duplicate_faces,
    first_alike,
    repeated_corners,
    scatter,
    used_vertices,
    widest_gap,
)
from msal_cli.light_dataclass import dataclass

MAX_FACES = (2**31 - 1) // 6
"""The most triangles whose one-ring offsets always fit 32 bits: 357,913,941."""

LARGE_VERTICES = 500_000
"""From so many vertices on a mesh exceeds the processor's caches, and its order matters."""

LARGEST_EXTENT = 1e60
"""File units.  Fourth powers of lengths much beyond it overflow, below its reciprocal underflow."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh that every method and measure can use."""

    vertices: Floats  # (n, 3) float64, finite, about a local origin, file units
    # (m, 3) int32, three different vertices each, m >= 1, counter-clockwise from outside
    faces: Ints
    # (n,) vertices that must stay where they are; None if all may move
    fixed_vertices: NDArray[np.bool_] | None = None
    # (n,) from 0 to 1, a factor of the fidelity (the pull to the data) of each vertex; None for 1
    trust: Floats | None = None

    @functools.cached_property
    def topology(self) -> Connectivity:
        """The one-rings, and counts of boundary, non-manifold and inconsistent edges."""
        return connectivity(len(self.vertices), self.faces)

    @functools.cached_property
    def mean_edge_length(self) -> float:
        """Mean length of the unique edges, file units."""
        return geometry.mean_edge_length(self.vertices, *self.topology.one_ring)

    def vertex_normals(self, weighting: str = "uniform", mollify: int = 0) -> Floats:
        """Unit vertex normals (n, 3), averaged ``mollify`` times; zeros for no normal.

        ``weighting`` is ``"uniform"`` or ``"area"``; see ``kernels.geometry.vertex_normals``.  The
        array is computed once and shared: do not write to it.
        """
        known = self._cached_normals
        if (weighting, mollify) not in known:
            done = [passes for kind, passes in known if kind == weighting and passes < mollify]
            if done:
                normals = known[weighting, max(done)]
            elif weighting == "uniform" and "_left_normals" in self.__dict__:
                # Left by ``flat_faces``.  They are moved, not shared, because a second reference
                # would keep as much memory as the vertices take.
                normals = self.__dict__.pop("_left_normals")
            else:
                normals = geometry.vertex_normals(self.vertices, self.faces, weighting)
            passes = mollify - max(done, default=0)
            known[weighting, mollify] = geometry.mollify(normals, *self.topology.one_ring, passes)
        return known[weighting, mollify]

    @functools.cached_property
    def _cached_normals(self) -> dict[tuple[str, int], Floats]:
        return {}

    def release_normals(self) -> None:
        """Free the memory of all normals; they are computed anew when needed."""
        self._cached_normals.clear()
        self.__dict__.pop("_left_normals", None)

    @functools.cached_property
    def flat_faces(self) -> int:
        """The number of faces without a normal."""
        # The same pass computes vertex normals, which nearly every method and measure needs next.
        self.__dict__["_left_normals"], flat = geometry.normals_and_flat_faces(
            self.vertices, self.faces, "uniform"
        )
        return flat

    def with_constraints(
        self, fixed_vertices: NDArray[np.bool_] | None, trust: Floats | None
    ) -> Mesh:
        """The same mesh with these constraints; its cached properties are shared."""
        other = Mesh(self.vertices, self.faces, fixed_vertices, trust)
        own = {name: value for name, value in self.__dict__.items() if name not in other.__dict__}
        other.__dict__.update(own)
        return other

    def with_vertices(self, vertices: Floats) -> Mesh:
        """The same mesh with its vertices at other positions (n, 3); connectivity is shared."""
        other = Mesh(vertices, self.faces, self.fixed_vertices, self.trust)
        if "topology" in self.__dict__:
            other.__dict__["topology"] = self.topology
        return other


Given = ParamSpec("Given")
Value = TypeVar("Value")


def cached_by_mesh(
    compute: Callable[Concatenate[Mesh, Given], Value],
) -> Callable[Concatenate[Mesh, Given], Value]:
    """Decorator: cache the values of ``compute`` by mesh and other arguments, as long as the mesh
    exists.  A value must not refer to the mesh, which would then never be freed."""
    cache: weakref.WeakKeyDictionary[Mesh, dict[object, Value]] = weakref.WeakKeyDictionary()

    @functools.wraps(compute)
    def cached(mesh: Mesh, /, *given: Given.args, **named: Given.kwargs) -> Value:
        known, key = cache.setdefault(mesh, {}), (given, tuple(sorted(named.items())))
        if key not in known:
            known[key] = compute(mesh, *given, **named)
        return known[key]

    return cached


@dataclass(frozen=True)
class Defects:
    """Counts of the defects that ``prepare_mesh`` found and worked around."""

    # vertices that coincide with an earlier one and are merged with it
    welded_vertices: int
    unreferenced_vertices: int  # vertices that no usable face has; they stay where they are
    degenerate_faces: int  # faces with a repeated vertex (left out) or without area (no normal)
    duplicate_faces: int  # faces whose three vertices an earlier face has; left out
    is_two_sided: bool  # whether each face has a duplicate that is wound the other way
    boundary_edges: int  # edges with one face
    non_manifold_edges: int  # edges with more than two faces
    inconsistent_edges: int  # edges whose two faces have opposite winding in the file
    turned_faces: int  # faces flipped in memory to make the winding consistent
    unorientable_parts: int  # components without a consistent winding; left as they are
    components: int  # connected components

    @property
    def volume_objection(self) -> str:
        """Why the enclosed volume is not well defined; empty if it is."""
        if self.boundary_edges:
            return f"open ({format_count(self.boundary_edges, 'boundary edge')})"
        if self.non_manifold_edges:
            return f"non-manifold ({format_count(self.non_manifold_edges, 'edge')})"
        if self.unorientable_parts:
            return "not orientable"
        return ""


@dataclass(frozen=True, eq=False)
class PreparedMesh:
    """A mesh to compute with, and the map back to the file's vertices."""

    mesh: Mesh  # welded, cleaned, consistently wound, relative to ``origin``
    origin: Floats  # (3,), subtracted from the file's positions
    # (n_file,) int32, the mesh vertex of each file vertex, -1 for none; None for the identity.
    # A mesh that the file stores in random order is sorted in space, so its vertices and faces have
    # other indices than in the file
    vertex_map: Ints | None
    defects: Defects

    def outward(self, mesh: Mesh | None = None) -> Mesh:
        """``mesh``, by default ``self.mesh``, turned round if it is closed and inside out.

        Methods run on it: the learned filter knows convex from concave.
        """
        mesh = self.mesh if mesh is None else mesh
        if (
            self.defects.volume_objection
            or geometry.area_and_volume(mesh.vertices, mesh.faces)[1] >= 0.0
        ):
            return mesh
        faces = np.ascontiguousarray(mesh.faces[:, ::-1])
        return Mesh(mesh.vertices, faces, mesh.fixed_vertices, mesh.trust)

    def to_file_vertices(self, vertices: Floats, original: Floats) -> Floats:
        """File positions (n_file, 3) for mesh positions (n, 3).

        A file vertex without a mesh vertex, or whose mesh vertex did not move, keeps exactly its
        value in ``original`` (n_file, 3).
        """
        mesh = self.mesh
        return scatter(
            mesh.vertices, vertices, mesh.topology.has_ring, self.vertex_map, self.origin, original
        )

    def seam_gap(self, vertices: Floats) -> float:
        """Largest distance, file units, between file vertices that coincided in the input and are
        now at ``vertices`` (n_file, 3)."""
        if self.vertex_map is None or not self.defects.welded_vertices:
            return 0.0
        return widest_gap(vertices, self.vertex_map, len(self.mesh.vertices))


def prepare_mesh(vertices: Floats, faces: Ints, *, are_distinct: bool = False) -> PreparedMesh:
    """Check a file's arrays and prepare them as a mesh to compute with.

    Parameters
    ----------
    vertices : (n, 3) real numbers, file units.
    faces : (m, 3) integers, zero-based.
    are_distinct : no two vertices coincide, so the search for them is skipped.

    Raises ContentError with code ``E_NO_FACES``, ``E_INDEX``, ``E_NONFINITE`` or ``E_RANGE``;
    TooLargeError for more than ``MAX_FACES`` triangles.
    """
    vertices, faces, (low, high) = validate_arrays(vertices, faces)
    n_file = len(vertices)
    ranks = None
    if n_file >= LARGE_VERTICES and spatial_order.is_random(faces):
        _require_extent(low, high)
        vertices, faces, ranks = spatial_order.sort_in_space(vertices, faces)
    used = used_vertices(n_file, faces)
    first, n_welded = np.empty(0, dtype=np.int32), 0
    links = None
    repeated = repeated_corners(faces)
    if not are_distinct:
        tasks: list[Callable[[], Any]] = [lambda: first_alike(vertices, used)]
        if is_worth_it(n_file) and not repeated.any() and not array_files.are_used():
            # Usually there is nothing to weld, and this connectivity is already right.  Not where
            # arrays are kept in files: the two tasks would evict each other's pages from memory.
            tasks.append(lambda: connectivity(n_file, faces))
        (first, n_welded), *linked = at_once(n_file, *tasks)
        links = linked[0] if linked and not n_welded else None
        del linked
    if n_welded:
        faces = first[faces]
        repeated = repeated_corners(faces)
    n_repeated = int(np.count_nonzero(repeated))
    if n_repeated:
        faces = faces[~repeated]
    del repeated
    if not len(faces):
        raise ContentError(
            "every face is degenerate: its corners are not three different points",
            code="E_NO_FACES",
            hint="check the file in a viewer; there is no surface to denoise",
        )
    vertex_map = None
    if n_welded or n_repeated:
        used = used_vertices(n_file, faces)
    n_unreferenced = n_file - n_welded - int(np.count_nonzero(used))
    if n_welded:
        number = np.cumsum(used, dtype=np.int32) - np.int32(1)
        vertex_map = np.where(used[first], number[first], np.int32(-1)).astype(np.int32)
        faces = number[faces]
        vertices = vertices[used]
        used = np.ones(len(vertices), dtype=bool)
        del number
    del first
    faces = np.ascontiguousarray(faces)

    if links is None:
        links = connectivity(len(vertices), faces)
    n_duplicate, is_two_sided = 0, False
    if links.non_manifold_edges or links.inconsistent_edges:
        # Duplicate faces always make an edge non-manifold or inconsistently wound.
        duplicate, is_two_sided = duplicate_faces(faces)
        n_duplicate = int(duplicate.sum())
        if n_duplicate:
            faces = np.ascontiguousarray(faces[~duplicate])
            links = connectivity(len(vertices), faces)
    n_inconsistent = links.inconsistent_edges
    n_turned = unorientable = 0
    if n_inconsistent:
        flip, unorientable = faces_to_flip(faces, links)
        n_turned = int(flip.sum())
        faces = np.where(flip[:, None], faces[:, ::-1], faces)

    if n_unreferenced:
        low, high = spatial_order.bounds(vertices if n_welded else vertices[used])
    _require_extent(low, high)
    origin = (low + high) / 2.0
    is_own = n_welded > 0 or ranks is not None
    mesh = Mesh(np.subtract(vertices, origin, out=vertices if is_own else None), faces)
    mesh.__dict__["topology"] = links
    components, _, _ = at_once(
        len(vertices),
        lambda: count_components(len(vertices), faces, used),
        lambda: mesh.flat_faces,
        lambda: mesh.mean_edge_length,
    )
    defects = Defects(
        welded_vertices=n_welded,
        unreferenced_vertices=n_unreferenced,
        degenerate_faces=n_repeated + mesh.flat_faces,
        duplicate_faces=n_duplicate,
        is_two_sided=is_two_sided,
        boundary_edges=links.boundary_edges,
        non_manifold_edges=links.non_manifold_edges,
        inconsistent_edges=n_inconsistent,
        turned_faces=n_turned,
        unorientable_parts=unorientable,
        components=components,
    )
    if ranks is not None:
        vertex_map = ranks if vertex_map is None else vertex_map[ranks]
    return PreparedMesh(mesh, origin, vertex_map, defects)


def _require_extent(low: Floats, high: Floats) -> None:
    """Raise ContentError for a bounding box with which computations would over- or underflow."""
    with np.errstate(over="ignore"):
        extent = float((high - low).max())
    if not 1.0 / LARGEST_EXTENT < extent < LARGEST_EXTENT:
        raise ContentError(
            f"the mesh extends over {extent:g} units, too far or too little to compute with",
            code="E_RANGE",
            hint="scale the mesh, or look for a stray vertex",
        )


def validate_arrays(vertices: Floats, faces: Ints) -> tuple[Floats, Ints, tuple[Floats, Floats]]:
    """Check the arrays: vertices as float64, faces as int32, and the bounds of the vertices.

    Raises the errors of ``prepare_mesh``.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.asarray(faces)
    if not faces.size:
        raise ContentError(
            "there are no faces",
            code="E_NO_FACES",
            hint="msal denoises surfaces; make a mesh of the point cloud first",
        )
    for array, what, shape in ((vertices, "vertices", "(n, 3)"), (faces, "faces", "(m, 3)")):
        if array.ndim != 2 or array.shape[1] != 3:
            raise ContentError(
                f"{what} have shape {array.shape}, not {shape}", hint=_reshape_hint(array, what)
            )
    n = len(vertices)
    if len(faces) > MAX_FACES:
        raise TooLargeError(
            f"the mesh has {len(faces):,} triangles, more than the {MAX_FACES:,} that fit",
            hint="cut it into parts",
        )
    if faces.dtype.kind not in "iu":
        raise ContentError(
            f"face indices are {faces.dtype}, not integers",
            code="E_INDEX",
            hint="give faces.astype(int) if they are whole numbers",
        )
    # Viewed as unsigned integers, negative indices are very large, so one comparison is enough.
    is_within = (
        int(faces.view(np.uint32).max()) < n
        if faces.dtype == np.int32
        else int(faces.min()) >= 0 and int(faces.max()) < n
    )
    if not is_within:
        at, corner = np.argwhere((faces < 0) | (faces >= n))[0].tolist()
        counts_from_1 = faces.min() == 1 and faces.max() == n
        raise ContentError(
            f"a face names vertex {int(faces[at, corner])} of {n:,}",
            code="E_INDEX",
            where=f"face {at}",
            hint="the faces count from 1: give faces - 1"
            if counts_from_1
            else f"indices go from 0 to {n - 1}: give the vertices that these faces belong to",
        )
    faces, ends = np.ascontiguousarray(faces, dtype=np.int32), spatial_order.bounds(vertices)
    if not np.isfinite(ends).all():
        is_finite = np.asarray(np.isfinite(vertices).all(axis=1))
        if (is_bad := used_vertices(n, faces) & ~is_finite).any():
            raise not_finite("a position is not finite", f"vertex {int(np.argmax(is_bad))}")
        # Samples that an organized point cloud lacks, at a place on the mesh.
        vertices = np.where(is_finite[:, None], vertices, vertices[faces[0, 0]])
        ends = spatial_order.bounds(vertices)
    return vertices, faces, ends


def _reshape_hint(array: NDArray[Any], name: str) -> str:
    """The hint for an array of the wrong shape."""
    if array.ndim == 2 and array.shape[0] == 3:
        return f"each row must be one of them: give {name}.T"
    if array.ndim == 1 and array.size % 3 == 0:
        return f"give {name}.reshape(-1, 3)"
    if name == "faces" and array.ndim == 2 and array.shape[1] == 4:
        if (array[:, 0] == 3).all():
            return "each row begins with the number of its corners: give faces[:, 1:]"
        return (
            "cut each quad into two triangles: "
            "numpy.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])"
        )
    return f"give a row of three numbers for each of the {name}"
