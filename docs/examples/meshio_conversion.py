"""Denoise a meshio.Mesh of quads and triangles, and write it as VTU with what was done as data.

    python docs/examples/meshio_conversion.py

ParaView and PyVista show the field: `pyvista.read("toadstool.vtu").plot(scalars="moved")`.
"""

from pathlib import Path

import meshio
import numpy as np

import msal_cli as msal

SAMPLES = Path(__file__).resolve().parents[2] / "sample_meshes"

scan = meshio.read(SAMPLES / "toadstool_noisy.ply")
print("cells:", ", ".join(f"{len(cells)} {kind}" for kind, cells in scan.cells_dict.items()))

smooth = msal.denoise(scan, method="msal", K=0.5, iterations=4)

# Quads are cut into triangles for the computation only.
assert [block.type for block in smooth.cells] == [block.type for block in scan.cells]
smooth.point_data["moved"] = np.linalg.norm(smooth.points - scan.points, axis=1)
smooth.write("toadstool.vtu")

truth = meshio.read(SAMPLES / "toadstool_clean.ply")
before, after = (msal.compare(truth, one).vertex_error_percent for one in (scan, smooth))
print(f"vertex error: {before:.1f} % of the mean edge length before, {after:.1f} % after")
