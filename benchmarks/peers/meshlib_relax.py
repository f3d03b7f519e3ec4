"""MeshLib: ``relax``, an umbrella sweep in single precision; it writes binary PLY only."""

import sys

from meshlib import mrmeshpy

STEPS = 4


def denoise(source, target):
    """From one file to the other."""
    mesh = mrmeshpy.loadMesh(source)
    parameters = mrmeshpy.MeshRelaxParams()
    parameters.iterations = STEPS
    mrmeshpy.relax(mesh, parameters)
    mrmeshpy.saveMesh(mesh, target)


if __name__ == "__main__":
    denoise(*sys.argv[1:])
