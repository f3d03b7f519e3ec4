"""Open3D: ``filter_smooth_simple``, the mean of the neighbours."""

import sys

import open3d
from form import is_ascii_ply

STEPS = 4


def denoise(source, target):
    """From one file to the other."""
    mesh = open3d.io.read_triangle_mesh(source)
    is_soup = source.endswith(".stl")
    if is_soup:
        # Without it no triangle has a neighbour, and the filter would only shrink each.
        mesh.remove_duplicated_vertices()
    mesh = mesh.filter_smooth_simple(number_of_iterations=STEPS)
    if is_soup:
        mesh.compute_triangle_normals()  # its writer of STL asks for them
    ascii_too = source.endswith(".ply") and is_ascii_ply(source)
    written = open3d.io.write_triangle_mesh(
        target,
        mesh,
        write_ascii=ascii_too,
        write_vertex_normals=False,
        write_vertex_colors=False,
        write_triangle_uvs=False,
    )
    if not written:
        raise OSError(f"Open3D did not write {target}")


if __name__ == "__main__":
    denoise(*sys.argv[1:])
