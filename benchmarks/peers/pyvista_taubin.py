"""PyVista: ``smooth_taubin``, which is VTK's windowed sinc filter."""

import sys

import pyvista
from form import is_ascii_ply

STEPS = 4


def denoise(source, target):
    """From one file to the other."""
    mesh = pyvista.read(source)
    mesh.smooth_taubin(n_iter=STEPS, inplace=True)
    if source.endswith(".obj"):
        mesh.save(target)
    else:
        is_text = source.endswith(".ply") and is_ascii_ply(source)
        mesh.save(target, binary=not is_text, recompute_normals=False)


if __name__ == "__main__":
    denoise(*sys.argv[1:])
