"""The examples of "Your scanner" in docs/noise.md: what each scanner makes of a sample mesh."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

from make_pictures import opened, sample

from benchmarks.scan_simulation import ScannerSettings, simulate_scan
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.mesh import Mesh, prepare_mesh


@dataclass(frozen=True)
class Example:
    """One row of the table.

    Attributes
    ----------
    name : of the picture's file.
    scanner : what the user has.
    noise : what its noise is like.
    does : what msal does about it.
    model : sample mesh in the picture.
    make : gives the noisy mesh for the true one.
    """

    name: str
    scanner: str
    noise: str
    does: str
    model: str
    make: Callable[[Mesh], Mesh]


def true_mesh(name: str) -> Mesh:
    """The clean sample of that name."""
    return prepare_mesh(*opened(sample(name, "clean"))).mesh


def _added(*noises: AddedNoise) -> Callable[[Mesh], Mesh]:
    """A mesh with noises added, one after the other."""

    def add(true: Mesh) -> Mesh:
        return functools.reduce(
            lambda mesh, one: mesh.with_vertices(add_noise(mesh, one)), noises, true
        )

    return add


def _scanned(settings: ScannerSettings) -> Callable[[Mesh], Mesh]:
    """A mesh as a simulated scanner makes it, in the true mesh's frame."""

    def scan(true: Mesh) -> Mesh:
        made = simulate_scan(true, settings)
        ready = prepare_mesh(made.vertices, made.faces)
        return ready.mesh.with_vertices(ready.mesh.vertices + ready.origin)

    return scan


EXAMPLES = (
    Example(
        "laser",
        "laser line scanner, CMM with a probe",
        "each vertex has its own error, along the normal; triangulated scans have some noise that "
        "neighbours share, and open borders",
        "the case that the filters of the literature are made for",
        "bracket",
        _added(AddedNoise("gaussian-normal", 0.2, seed=1)),
    ),
    Example(
        "structured_light",
        "structured light, scanners that smooth inside",
        "neighbours share their error: bumps as wide as several edges",
        "measures the noise scale by scale, and filters with a reach of several rings",
        "vase",
        _added(AddedNoise("correlated", 0.2, seed=2, rings=2)),
    ),
    Example(
        "depth_camera",
        "depth camera: Kinect, RealSense, time of flight",
        "along the view, in steps, more where the surface is seen at a grazing angle; one side "
        "only, with open borders",
        "estimates the direction of the noise and its level by region",
        "bear",
        _scanned(
            ScannerSettings(
                "depth", seed=3, cells=140, direction=(0.3, -1.0, 0.3), level=0.5, step=0.5
            )
        ),
    ),
    Example(
        "photogrammetry",
        "photogrammetry, multi-view stereo",
        "in all directions alike, with vertices that are far off",
        "brings single vertices back first, then filters positions as well as normals",
        "rock",
        _added(
            AddedNoise("gaussian", 0.15, seed=4), AddedNoise("outliers", 0.0, seed=5, fraction=0.02)
        ),
    ),
    Example(
        "fusion",
        "several views fused in a volume: hand-held scanners, KinectFusion",
        "neighbours share their error over the width of a voxel and more; seams between views",
        "measures the noise scale by scale, as for structured light",
        "bear",
        _scanned(ScannerSettings("fusion", seed=4, cells=72)),
    ),
    Example(
        "segmentation",
        "segmented CT or MRI: labels, voxels, slices",
        "no noise but a staircase: terraces as high as a voxel or a slice",
        "finds the terraces by their flat steps, and takes off as much as a step is high",
        "knot",
        _scanned(ScannerSettings("voxels", seed=5, cells=72, direction=(0.3, 0.2, 1.0))),
    ),
    Example(
        "ct",
        "CT by grey values (iso-surface)",
        "smooth within a voxel; noise in the volume makes bumps, in reconstructed CT shared by "
        "neighbours",
        "measures level and scale of the noise, with no staircase to take off",
        "bracket",
        _scanned(ScannerSettings("ct", seed=6, cells=80, direction=(0.3, 0.2, 1.0))),
    ),
    Example(
        "partly",
        "several scans in one mesh, parts far from the scanner",
        "one part is noisy, another is not",
        "estimates the level by region, and filters each by its own",
        "toadstool",
        _added(AddedNoise("half", 0.25, seed=7, direction=(1.0, 0.0, 0.0))),
    ),
)
"""In the order of the table."""
