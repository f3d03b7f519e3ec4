"""The examples of "Your scanner" in docs/noise.md: what each scanner makes of a sample mesh."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

from make_pictures import opened, sample

from msal_cli.mesh import Mesh, prepared
from msal_cli.noise import AddedNoise, add_noise


@dataclass(frozen=True)
class Example:
    """One row of the table.

    Attributes
    ----------
    name : of the picture's file.
    scanner : what the user has.
    noise : what its noise is like.
    does : what msal does about it.
    kinds : kinds of ``benchmarks.scanners`` that stand for it.
    model : sample mesh in the picture.
    make : gives the noisy mesh for the true one.
    """

    name: str
    scanner: str
    noise: str
    does: str
    kinds: tuple[str, ...]
    model: str
    make: Callable[[Mesh], Mesh]


def true_mesh(name: str) -> Mesh:
    """The clean sample of that name."""
    return prepared(*opened(sample(name, "clean"))).mesh


def _added(*noises: AddedNoise) -> Callable[[Mesh], Mesh]:
    """A mesh with noises added, one after the other."""

    def add(true: Mesh) -> Mesh:
        return functools.reduce(lambda mesh, one: mesh.moved(add_noise(mesh, one)), noises, true)

    return add


EXAMPLES = (
    Example(
        "laser",
        "laser line scanner, CMM with a probe, single points merged to a mesh",
        "each vertex has its own error, along the normal",
        "the case that the filters of the literature are made for",
        ("normals 0.2",),
        "bracket",
        _added(AddedNoise("gaussian-normal", 0.2, seed=1)),
    ),
    Example(
        "structured_light",
        "structured light, scanners that smooth inside",
        "neighbours share their error: bumps as wide as several edges",
        "looks at the noise scale by scale, and filters with a reach of several rings",
        ("shared over 1 ring 0.2", "shared over 2 rings 0.2", "shared over 3 rings 0.2"),
        "vase",
        _added(AddedNoise("correlated", 0.2, seed=2, rings=2)),
    ),
    Example(
        "depth_camera",
        "depth camera: Kinect, RealSense, time of flight",
        "along the view; in steps, and more where the surface is seen at a grazing angle",
        "finds the axis of the noise and its level by region",
        ("one direction 0.2", "quantised depth 0.5", "grazing 0.1", "Kinect"),
        "vase",
        _added(
            AddedNoise("view", 0.15, seed=3, direction=(0.3, -1.0, 0.3)),
            AddedNoise("quantised", 0.0, seed=3, direction=(0.3, -1.0, 0.3), step=0.5),
        ),
    ),
    Example(
        "photogrammetry",
        "photogrammetry, multi-view stereo",
        "in all directions alike, with vertices that are far off",
        "brings single vertices back first, then filters positions as well as normals",
        ("isotropic 0.2", "outliers 5 %", "impulsive 0.4 at 30 %"),
        "rock",
        _added(
            AddedNoise("gaussian", 0.15, seed=4),
            AddedNoise("outliers", 0.0, seed=5, fraction=0.02),
        ),
    ),
    Example(
        "partly",
        "several scans in one mesh, parts far from the scanner",
        "one part is noisy, another is not",
        "estimates the level by region, and filters each by its own",
        ("half 0.25", "ramp 0 to 0.4"),
        "toadstool",
        _added(AddedNoise("half", 0.25, seed=6, direction=(1.0, 0.0, 0.0))),
    ),
)
"""In the order of the table."""
