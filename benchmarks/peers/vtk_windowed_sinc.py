"""VTK: the windowed sinc filter, four terms."""

import sys

from vtk_files import smoothed_file
from vtkmodules.vtkFiltersCore import vtkWindowedSincPolyDataFilter

STEPS = 4


def denoise(source, target):
    """From one file to the other."""
    smoother = vtkWindowedSincPolyDataFilter()
    smoother.SetNumberOfIterations(STEPS)
    smoothed_file(source, target, smoother)


if __name__ == "__main__":
    denoise(*sys.argv[1:])
