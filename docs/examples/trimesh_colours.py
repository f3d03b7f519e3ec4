"""Denoise a coloured trimesh.Trimesh: the result is one, too, with its colours.

python docs/examples/trimesh_colours.py
"""

from pathlib import Path

import trimesh

import msal_cli as msal

SAMPLES = Path(__file__).resolve().parents[2] / "sample_meshes"

# With process=False trimesh merges no vertices; msal itself needs neither.
scan = trimesh.load_mesh(SAMPLES / "toadstool_noisy.ply", process=False)

smooth = msal.denoise(scan)

assert isinstance(smooth, trimesh.Trimesh)
assert (smooth.visual.vertex_colors == scan.visual.vertex_colors).all()
print(f"volume: {scan.volume:.0f} before, {smooth.volume:.0f} after")
print(f"noise: {msal.estimate_noise(scan).mean_edges:.2f} mean edge lengths before")

smooth.export("toadstool.glb")
print("written: toadstool.glb, in colour")
