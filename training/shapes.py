"""Clean training meshes, made by script: ``build_shapes`` and ``python -m training.shapes``.

Every mesh is a recipe: a solid or a smooth field, a triangulation, and perhaps relief and an open
border.  All are noise-free samples of a known surface, so their own normals are the truth.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from training import organic, relief, solids, triangulations
from training.connectivity import Floats, mean_edge_length
from training.openings import cut_open
from training.organic import FieldSurface, polygonise
from training.range_grid import make_range_grid
from training.remesh import Remesher
from training.surface import LabelledMesh, PolyhedralSurface, Surface

COARSE = 32
"""Cells of the grid that tells how fine a field must be sampled."""

HALF_SIZE = 1.6
"""Half of the cube in which fields are polygonised."""


@dataclass(frozen=True)
class Recipe:
    """How one mesh is made.

    Attributes
    ----------
    source : a ``make_`` function of ``training.solids`` or ``training.organic``, by its name.
    triangulation : one of ``training.triangulations``, ``range_grid`` or ``marching_cubes``.
    relief : a ``make_`` function of ``training.relief``; "" for none.
    wavelength, amplitude : of the relief, in mean edge lengths.
    border : "closed", or "cut" for an open border.
    """

    source: str
    triangulation: str = "isotropic"
    relief: str = ""
    wavelength: float = 0.0
    amplitude: float = 0.0
    border: str = "closed"

    @property
    def is_solid(self) -> bool:
        """Whether it has exact sharp edges."""
        return hasattr(solids, f"make_{self.source}")

    @property
    def is_closed(self) -> bool:
        """Whether the mesh has no boundary."""
        return self.border == "closed" and self.triangulation != "range_grid"

    @property
    def name(self) -> str:
        """Such as ``gear-isotropic-hair-6``."""
        parts = [self.source, self.triangulation]
        if self.relief:
            parts += [self.relief, f"{self.wavelength:g}"]
        return "-".join(parts + ([self.border] if self.border != "closed" else []))


RECIPES = (
    Recipe("drilled_plate"),
    Recipe("figure"),
    Recipe("cut_sphere", "adaptive"),
    Recipe("metaballs", "marching_cubes"),
    Recipe("head", "isotropic", "hair", 6.0, 0.7),
    Recipe("bracket", "isotropic", "letters", 18.0, 0.9),
    Recipe("bumpy_ball", "range_grid"),
    Recipe("random_csg", "jagged"),
    Recipe("torus", "decimated", "orange_peel", 8.0, 0.5),
    Recipe("stepped_shaft", "isotropic", border="cut"),
    Recipe("egg_crate", "scattered"),
    Recipe("random_csg", "range_grid"),
    # The first twelve are the quick set.
    Recipe("drilled_plate", "subdivided"),
    Recipe("drilled_plate", "jagged", "orange_peel", 5.0, 0.25),
    Recipe("bracket", "scattered"),
    Recipe("bracket", "adaptive"),
    Recipe("gear"),
    Recipe("gear", "graded"),
    Recipe("gear", "subdivided"),
    Recipe("stepped_shaft"),
    Recipe("stepped_shaft", "jagged"),
    Recipe("stepped_shaft", "range_grid"),
    Recipe("cut_sphere"),
    Recipe("cut_sphere", "jagged"),
    Recipe("cut_sphere", "isotropic", "dents", 9.0, 0.6),
    Recipe("lens", "scattered"),
    Recipe("lens", "graded"),
    Recipe("flange"),
    Recipe("flange", "jagged"),
    Recipe("flange", "adaptive", border="cut"),
    Recipe("ribbed_cover"),
    Recipe("ribbed_cover", "range_grid"),
    Recipe("heat_sink"),
    Recipe("heat_sink", "scattered"),
    Recipe("hex_bolt", "graded"),
    Recipe("hex_bolt", "isotropic", "letters", 16.0, 0.8),
    Recipe("rounded_block"),
    Recipe("rounded_block", "isotropic", "letters", 20.0, 1.2),
    Recipe("egg_crate"),
    Recipe("rod_lattice"),
    Recipe("rod_lattice", "scattered"),
    Recipe("impeller"),
    Recipe("impeller", "adaptive"),
    Recipe("pulley", "scattered"),
    Recipe("pulley", "isotropic", "weave", 4.0, 0.4),
    Recipe("polyhedron"),
    Recipe("polyhedron", "jagged"),
    Recipe("polyhedron", "isotropic", "rough", 4.0, 0.5),
    Recipe("random_csg"),
    Recipe("random_csg", "adaptive"),
    Recipe("random_csg", "scattered"),
    Recipe("random_csg", "isotropic", "orange_peel", 12.0, 0.6),
    Recipe("random_csg", "graded", border="cut"),
    Recipe("metaballs", "isotropic", "cobbles", 8.0, 0.6),
    Recipe("metaballs", "decimated"),
    Recipe("bumpy_ball"),
    Recipe("bumpy_ball", "marching_cubes", "rough", 3.0, 0.5),
    Recipe("bumpy_ball", "isotropic", "scales", 12.0, 1.0),
    Recipe("knot", "isotropic", "scales", 8.0, 0.7),
    Recipe("knot", "scattered"),
    Recipe("torus"),
    Recipe("torus", "isotropic", "dents", 14.0, 1.2),
    Recipe("torus", "range_grid", "weave", 6.0, 0.5),
    Recipe("figure", "isotropic", "rough", 3.0, 0.6),
    Recipe("figure", "marching_cubes", "hair", 4.0, 0.45),
    Recipe("figure", "range_grid"),
    Recipe("figure", "decimated", "cobbles", 6.0, 0.5),
    Recipe("branches", "isotropic", "rough", 5.0, 0.6),
    Recipe("branches", "marching_cubes"),
    Recipe("head", "marching_cubes", border="cut"),
    Recipe("head", "range_grid"),
    Recipe("head", "isotropic", "rough", 4.0, 0.7),
    Recipe("head", "graded", "pits", 10.0, 1.0),
    Recipe("gyroid"),
    Recipe("gyroid", "marching_cubes"),
    Recipe("shell"),
    Recipe("shell", "scattered", "hair", 10.0, 1.2),
    Recipe("bumpy_ball", "isotropic", "letters", 20.0, 1.4),
    Recipe("metaballs", "isotropic", "hair", 3.0, 0.35),
    Recipe("head", "isotropic", "orange_peel", 30.0, 2.0, "cut"),
    Recipe("torus", "isotropic", "letters", 15.0, 0.6, "cut"),
    Recipe("polyhedron", "subdivided"),
    Recipe("random_csg", "subdivided"),
    Recipe("bracket", "subdivided"),
    Recipe("cut_sphere", "subdivided"),
    Recipe("lens", "subdivided"),
    Recipe("random_csg", "jagged", "rough", 4.0, 0.3),
)
QUICK = 12


def build_shapes(seed: int, quick: bool = False) -> Iterator[tuple[str, Floats, NDArray[np.int32]]]:
    """Clean meshes: name, vertices (n, 3) with edges of mean length 1, faces (m, 3).

    The same seed gives the same meshes.  ``quick`` gives the first twelve, a quarter as fine.
    """
    for index, recipe in enumerate(RECIPES[:QUICK] if quick else RECIPES):
        mesh = build_shape(recipe, np.random.default_rng([seed, index]), 0.25 if quick else 1.0)
        yield f"{index:02d}-{recipe.name}", mesh.vertices, mesh.faces.astype(np.int32)


def build_shape(recipe: Recipe, g: np.random.Generator, fineness: float = 1.0) -> LabelledMesh:
    """The mesh of a recipe, of 4,000 to 15,000 vertices times ``fineness``, mean edge 1."""
    count = int(fineness * np.exp(g.uniform(np.log(3600), np.log(9000))))
    mesh = scale_to_unit_edges(_triangulate(recipe, count, g))
    if recipe.relief:
        maker = getattr(relief, f"make_{recipe.relief}")
        mesh = relief.apply_relief(mesh, maker, recipe.wavelength, recipe.amplitude, g)
    if recipe.border == "cut":
        mesh = cut_open(mesh, g)
    return scale_to_unit_edges(mesh)


def _triangulate(recipe: Recipe, count: int, g: np.random.Generator) -> LabelledMesh:
    surface: Surface
    if recipe.is_solid:
        start = solids.to_labelled_mesh(getattr(solids, f"make_{recipe.source}")(g))
        surface = PolyhedralSurface(start)
    else:
        field = getattr(organic, f"make_{recipe.source}")(g)
        coarse = polygonise(field, HALF_SIZE, COARSE)
        share = count / len(coarse.vertices)
        surface = FieldSurface(field, 0.5 * HALF_SIZE / COARSE)
        start = polygonise(field, HALF_SIZE, int(COARSE * np.sqrt(1.1 * share)))
        if recipe.triangulation == "marching_cubes":
            edge = triangulations.ideal_edge(start, count)
            sizing = triangulations.constant_sizing(edge)
            state = Remesher(start, surface, sizing, int(g.integers(2**31)))
            state.remove_slivers(0.3)
            return state.mesh()
    if recipe.triangulation == "range_grid":
        return make_range_grid(start, surface, count, g)
    make = getattr(triangulations, f"make_{recipe.triangulation}")
    mesh: LabelledMesh = make(start, surface, count, g)
    return mesh


def scale_to_unit_edges(mesh: LabelledMesh) -> LabelledMesh:
    """The mesh about its centre, with edges of mean length 1."""
    centred = mesh.vertices - 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    scale = mean_edge_length(centred, mesh.faces)
    return LabelledMesh(centred / scale, mesh.faces, mesh.labels)


def main(arguments: list[str] | None = None) -> int:
    """Write the shapes of a seed as PLY files to a folder."""
    parser = argparse.ArgumentParser(prog="python -m training.shapes", description=main.__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="twelve small shapes")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    for name, vertices, faces in build_shapes(options.seed, options.quick):
        write_ply(options.output / f"{name}.ply", vertices, faces)
        print(f"{name}: {len(vertices)} vertices, {len(faces)} faces")
    return 0


def write_ply(path: Path, vertices: Floats, faces: NDArray[np.int32]) -> None:
    """Write a binary PLY file beside its name, then move it there."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(header.encode() + vertices.astype("<f8").tobytes() + rows.tobytes())
    part.replace(path)


if __name__ == "__main__":
    sys.exit(main())
