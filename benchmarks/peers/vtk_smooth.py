"""VTK: the Laplacian filter."""

import sys

from vtk_files import smoothed_file
from vtkmodules.vtkFiltersCore import vtkSmoothPolyDataFilter

STEPS = 4


def denoise(source, target):
    """From one file to the other."""
    smoother = vtkSmoothPolyDataFilter()
    smoother.SetNumberOfIterations(STEPS)
    smoother.SetRelaxationFactor(0.5)
    smoothed_file(source, target, smoother)


if __name__ == "__main__":
    denoise(*sys.argv[1:])
