"""trimesh: ``filter_laplacian`` with equal weights, without its volume constraint."""

import sys

import trimesh
from form import is_ascii_ply
from trimesh.smoothing import filter_laplacian

STEPS = 4


def denoise(source, target):
    """From one file to the other."""
    # An STL is welded by ``process``; of the others it would only cost time.
    mesh = trimesh.load_mesh(source, process=source.endswith(".stl"))
    filter_laplacian(mesh, iterations=STEPS, volume_constraint=False)
    options = {}
    if source.endswith(".ply"):
        options["encoding"] = "ascii" if is_ascii_ply(source) else "binary"
        options["vertex_normal"] = False
    elif source.endswith(".obj"):
        options["include_normals"] = False
    mesh.export(target, **options)


if __name__ == "__main__":
    denoise(*sys.argv[1:])
