"""Denoise arrays of numpy, keep a part of the surface, and measure the result.

python docs/examples/numpy_arrays.py
"""

from pathlib import Path

import numpy as np
import trimesh

import msal_cli as msal

SAMPLES = Path(__file__).resolve().parents[2] / "sample_meshes"

# Any library that gives vertices (n, 3) and triangles (m, 3) does; the unit of length is yours.
scan = trimesh.load_mesh(SAMPLES / "bracket_noisy.ply", process=False)
vertices, faces = np.array(scan.vertices), np.array(scan.faces)

noise = msal.estimate_noise(vertices, faces)
print(f"noise: {noise.mean_edges:.2f} mean edge lengths, {noise.file_units:.2f} mm; {noise.words}")

# Without a method the parameters are chosen from the noise, as `msal denoise` does.
result = msal.denoise(vertices, faces)
print(f"chosen: {result.reason}")
print(
    f"moved: {result.displacement.mean:.2f} mm in the mean, {result.displacement.max:.2f} at most"
)

# By hand: the lower third stays where it is, and nothing moves by more than half a mean edge.
is_low = vertices[:, 2] < np.quantile(vertices[:, 2], 1 / 3)
held = msal.denoise(vertices, faces, "msal", K=0.6, lock=is_low, max_move="0.5e")
assert (held.vertices[is_low] == vertices[is_low]).all()

truth = SAMPLES / "bracket_clean.ply"
for name, positions in (("scan", vertices), ("chosen", result.vertices), ("held", held.vertices)):
    figures = msal.compare(truth, (positions, faces))
    print(f"{name}: {figures.mean_angular_error_deg:.1f} degrees from the true normals")
