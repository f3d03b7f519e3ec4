"""PyMeshLab: the umbrella Laplacian, without cotangent weights, which cost more."""

import sys

import pymeshlab
from form import is_ascii_ply

STEPS = 4
# Only positions and faces, as they came; MeshLab would write normals and qualities too.
LEAN = {
    ".ply": {
        "save_vertex_quality": False,
        "save_vertex_flag": False,
        "save_vertex_color": False,
        "save_vertex_coord": False,
        "save_vertex_normal": False,
        "save_vertex_radius": False,
        "save_face_quality": False,
        "save_face_flag": False,
        "save_face_color": False,
        "save_wedge_color": False,
        "save_wedge_texcoord": False,
        "save_wedge_normal": False,
    },
    ".obj": {"save_vertex_color": False, "save_vertex_normal": False, "save_wedge_texcoord": False},
    ".stl": {"save_face_color": False},
}


def smooth(meshes):
    """Four passes over the current mesh."""
    meshes.apply_coord_laplacian_smoothing(stepsmoothnum=STEPS, cotangentweight=False)


def denoise(source, target):
    """From one file to the other."""
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.load_new_mesh(source)
    smooth(meshes)
    options = dict(LEAN[source[-4:]])
    if source.endswith(".ply"):
        options["binary"] = not is_ascii_ply(source)
    meshes.save_current_mesh(target, save_textures=False, **options)


if __name__ == "__main__":
    denoise(*sys.argv[1:])
