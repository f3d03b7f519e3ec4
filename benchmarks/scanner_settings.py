"""Settings of other tools that the benchmark of scanner noise compares with, and how they run.

Each tool runs in a process of its own under the Python that has it, and does all settings of many
meshes there; nothing of these tools is imported here.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]

SCRIPT = Path(__file__).resolve().parent / "peers" / "many_settings.py"


@dataclass(frozen=True)
class PeerSetting:
    """A filter of another tool with its parameters.

    Attributes
    ----------
    label : name in tables, and key in the cache.
    package : distribution that has the tool, also its name in ``peers/many_settings.py``.
    filter : name of the filter in the tool.
    parameters : those that differ from the tool's defaults.
    times : how often the filter runs.
    """

    label: str
    package: str
    filter: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    times: int = 1

    @property
    def words(self) -> str:
        """The call, for the list of settings."""
        given = ", ".join(f"{word} {value}" for word, value in self.parameters.items())
        often = f"{self.times} times" if self.times > 1 else ""
        return f"`{self.filter}`" + "".join(f", {part}" for part in (given, often) if part)


def _pymeshlab(label: str, name: str, times: int = 1, **parameters: Any) -> PeerSetting:
    return PeerSetting(label, "pymeshlab", f"apply_coord_{name}_smoothing", parameters, times)


def _meshlib(label: str, name: str, **parameters: Any) -> PeerSetting:
    return PeerSetting(label, "meshlib", name, parameters)


def _windowed_sinc(iterations: int, pass_band: float) -> PeerSetting:
    return PeerSetting(
        f"windowed sinc {iterations} at {pass_band:g}",
        "vtk",
        "vtkWindowedSincPolyDataFilter",
        {"NumberOfIterations": iterations, "PassBand": pass_band},
    )


TAUBIN = _pymeshlab("Taubin 10", "taubin", stepsmoothnum=10)

PEER_SETTINGS = (
    TAUBIN,
    _pymeshlab("Taubin 20", "taubin", stepsmoothnum=20),
    _pymeshlab("Taubin 50", "taubin", stepsmoothnum=50),
    _pymeshlab("HC 1", "hc_laplacian"),
    _pymeshlab("HC 3", "hc_laplacian", times=3),
    _pymeshlab("HC 8", "hc_laplacian", times=8),
    _pymeshlab("two-step", "two_steps"),
    _pymeshlab("two-step 1, 5", "two_steps", stepsmoothnum=1, stepnormalnum=5),
    _pymeshlab(
        "two-step 1, 10, 10 at 40°",
        "two_steps",
        stepsmoothnum=1,
        stepnormalnum=10,
        stepfitnum=10,
        normalthr=40.0,
    ),
    _pymeshlab("Laplacian 3", "laplacian", stepsmoothnum=3, cotangentweight=False),
    _meshlib("MeshLib denoising", "meshDenoiseViaNormals"),
    _meshlib("MeshLib denoising, γ 20", "meshDenoiseViaNormals", gamma=20.0),
    _meshlib("MeshLib denoising, γ 20, β 0.1", "meshDenoiseViaNormals", gamma=20.0, beta=0.1),
    _meshlib("MeshLib relaxation 8", "relaxKeepVolume", iterations=8),
    _windowed_sinc(20, 0.1),
    _windowed_sinc(30, 0.05),
    _windowed_sinc(50, 0.01),
)
"""Seventeen settings: the tools' own defaults, and what users take for weaker or stronger noise."""


def run_peers(
    python: str, meshes: Mapping[str, Mesh], wanted: Mapping[str, Sequence[PeerSetting]]
) -> dict[str, dict[str, Floats]]:
    """Positions (n, 3) by mesh and label, of the wanted settings of each mesh.

    Parameters
    ----------
    python : path of a Python that has the tools.
    meshes : by names that are good for files.
    wanted : settings by mesh.

    Raises
    ------
    RuntimeError
        where a tool fails, with the end of what it wrote.
    """
    positions: dict[str, dict[str, Floats]] = {name: {} for name in meshes}
    packages = dict.fromkeys(one.package for some in wanted.values() for one in some)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "source"
        source.mkdir()
        for name, mesh in meshes.items():
            np.savez(source / f"{name}.npz", vertices=mesh.vertices, faces=mesh.faces)
        for package in packages:
            jobs = {
                name: [
                    [one.label, one.filter, dict(one.parameters), one.times]
                    for one in some
                    if one.package == package
                ]
                for name, some in wanted.items()
            }
            target = Path(folder) / package
            target.mkdir()
            job_file = target / "jobs.json"
            job_file.write_text(json.dumps(jobs), encoding="utf-8")
            words = [python, str(SCRIPT), package, str(job_file), str(source), str(target)]
            ran = subprocess.run(words, capture_output=True, text=True, check=False)
            if ran.returncode:
                raise RuntimeError(f"{package}: {ran.stderr.strip()[-400:]}")
            for name in jobs:
                with np.load(target / f"{name}.npz") as arrays:
                    positions[name].update({label: arrays[label] for label in arrays.files})
    return positions
