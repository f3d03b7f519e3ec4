"""What this package and other tools make of scans of known truth: run once, then kept.

A cache is a JSON file, written after every kind of noise.  Each row has a digest of its noisy mesh:
where a kind comes out otherwise than before, its row is dropped and run anew.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.scanner_cases import Case, Pair
from benchmarks.scanner_settings import PeerSetting, run_peers
from msal_cli import codecs, methods
from msal_cli.analysis.measures import (
    measure_surface_change,
    nearest_on_surface,
    used_vertices,
    vertex_error_percent,
)
from msal_cli.auto import Wishes
from msal_cli.job.pipeline import FileRun
from msal_cli.job.settings import ADAPTIVE, AUTO, Settings
from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]

NOISY = "noisy"
"""In place of a contestant: the mesh as it comes."""

OURS = ("msal", "plain", "auto", "learned")
"""Default MSAL, the command without a method, ``--auto``, and the learned filter at its default."""


@dataclass(frozen=True)
class Errors:
    """How far a mesh is from the truth.

    Attributes
    ----------
    angle_deg : mean angle between face normals and those of the truth: of the same face or, where
        the faces differ, of the true surface nearest to the centre; degrees.
    distance_percent : mean distance of vertices to the true surface, % of the mean edge length:
        of the truth's or, where the faces differ, of the noisy mesh's.
    vertex_percent : mean distance between corresponding vertices, % of the same length; None where
        the faces differ.
    """

    angle_deg: float
    distance_percent: float
    vertex_percent: float | None = None


@dataclass(frozen=True)
class Outcome:
    """``errors`` of a result, the processor time of the whole command, and what it said of its
    choice; time and words are only of this package."""

    errors: Errors
    cpu_seconds: float = 0.0
    reason: str = ""


Row = Mapping[str, Outcome]
"""Outcomes of one case by contestant: ``NOISY``, those of ``OURS``, labels of peers' settings."""


def ours() -> tuple[str, ...]:
    """Those of ``OURS`` that this version has."""
    return tuple(name for name in OURS if name != "learned" or name in methods.names())


def measure_errors(pair: Pair, result: Mesh) -> Errors:
    """The errors of ``result``, which has the faces of the noisy mesh."""
    true = pair.true
    if pair.has_same_faces:
        edge = true.mean_edge_length
        angle = measure_surface_change(true, result).mean_angular_error_deg
        vertex = vertex_error_percent(true, result)
    else:
        edge = pair.noisy.mean_edge_length
        angle = float(np.degrees(pair.true_surface.angles_of(result)).mean())
        vertex = None
    distance = nearest_on_surface(used_vertices(result), true)[1].mean()
    return Errors(angle, 100.0 * float(distance) / edge, vertex)


class Outcomes:
    """Outcomes by case, from a cache file or run when they are needed.

    Parameters
    ----------
    path : the cache; None keeps nothing.
    python : Python that has the peers; None leaves them to the cache.
    run : gives the outcome of a contestant by name; None for ``run_command``.

    Raises
    ------
    ValueError, KeyError, TypeError, AttributeError
        if ``path`` is not a cache.
    """

    def __init__(
        self,
        path: Path | None,
        python: str | None,
        run: Callable[[Pair, str], Outcome] | None = None,
    ) -> None:
        self._path, self._run_one = path, run or run_command
        self._python = python
        self._rows: dict[str, dict[str, Outcome]] = {}
        self._digests: dict[str, str] = {}
        if path is not None and path.exists():
            for key, row in json.loads(path.read_text(encoding="utf-8")).items():
                self._digests[key] = row["digest"]
                self._rows[key] = {
                    name: Outcome(Errors(*one["errors"]), one["cpu_seconds"], one["reason"])
                    for name, one in row["outcomes"].items()
                }

    def forget(self, names: Iterable[str], keys: Iterable[str]) -> None:
        """Drop what these contestants made of the cases with these keys."""
        for key in keys:
            for name in names:
                self._rows.get(key, {}).pop(name, None)

    def known(self, cases: Sequence[Case]) -> dict[str, Row]:
        """The rows of the cases by model, as far as they are in the cache."""
        return {one.model: self._rows[one.key] for one in cases if one.key in self._rows}

    def run(
        self, cases: Sequence[Case], names: Sequence[str], settings: Sequence[PeerSetting]
    ) -> dict[str, Row]:
        """The rows of the cases by model; what is not known yet is run and kept.

        ``names`` are some of ``OURS``; they run one after the other in this process.
        """
        others = settings if self._python is not None else ()
        wanted = [NOISY, *names, *(one.label for one in others)]
        open_cases = [one for one in cases if set(wanted) - set(self._rows.get(one.key, {}))]
        pairs = {one.key: one.make() for one in open_cases}
        for key, pair in pairs.items():
            digest = _digest(pair)
            if self._digests.get(key) != digest:
                self._rows[key] = {}
                self._digests[key] = digest
            self._run_ours(key, pair, names)
        self._run_peers(pairs, others)
        if open_cases:
            self._write()
        return self.known(cases)

    def _run_ours(self, key: str, pair: Pair, names: Sequence[str]) -> None:
        row = self._rows[key]
        if NOISY not in row:
            row[NOISY] = Outcome(measure_errors(pair, pair.noisy))
        for name in names:
            if name not in row:
                row[name] = self._run_one(pair, name)
                errors = row[name].errors
                print(
                    f"{key}, {name}: {errors.angle_deg:.2f} / {errors.distance_percent:.1f}, "
                    f"{row[name].cpu_seconds:.1f} s; {row[name].reason}",
                    file=sys.stderr,
                    flush=True,
                )

    def _run_peers(self, pairs: Mapping[str, Pair], settings: Sequence[PeerSetting]) -> None:
        wanted: dict[str, list[PeerSetting]] = {}
        for key in pairs:
            missing = [one for one in settings if one.label not in self._rows[key]]
            if missing:
                wanted[key] = missing
        if not wanted or self._python is None:
            return
        # Keys are no file names.
        numbers = {key: f"{number}" for number, key in enumerate(wanted)}
        positions = run_peers(
            self._python,
            {number: pairs[key].noisy for key, number in numbers.items()},
            {number: wanted[key] for key, number in numbers.items()},
        )
        for key, number in numbers.items():
            for label, vertices in positions[number].items():
                result = pairs[key].noisy.with_vertices(np.ascontiguousarray(vertices))
                self._rows[key][label] = Outcome(measure_errors(pairs[key], result))

    def _write(self) -> None:
        if self._path is None:
            return
        kept = {
            key: {
                "digest": self._digests[key],
                "outcomes": {
                    name: {
                        "errors": list(asdict(one.errors).values()),
                        "cpu_seconds": one.cpu_seconds,
                        "reason": one.reason,
                    }
                    for name, one in row.items()
                },
            }
            for key, row in self._rows.items()
        }
        beside = self._path.with_name(self._path.name + ".new")
        beside.write_text(json.dumps(kept, indent=1), encoding="utf-8")
        os.replace(beside, self._path)


def run_command(pair: Pair, name: str) -> Outcome:
    """What the whole command, from the bytes of a file to those of another, makes of a scan."""
    started = time.process_time()
    vertices, reason = denoise(pair.noisy, name)
    seconds = round(time.process_time() - started, 3)
    return Outcome(measure_errors(pair, pair.noisy.with_vertices(vertices)), seconds, reason)


def denoise(mesh: Mesh, name: str) -> tuple[Floats, str]:
    """Positions (n, 3) after one of ``OURS``, or after a method with its parameters as the members
    of a blend are written, and the reason of its choice if it made one.

    Raises
    ------
    MsalError
        where the command fails.
    """
    run = FileRun("scan.ply", _settings(name))
    data = run.denoise(to_ply(mesh), None).data
    reason = run.record.choice.reason if run.record.choice is not None else ""
    return codecs.open_mesh(data, "scan.ply").vertices, reason


def _settings(name: str) -> Settings:
    if name == "auto":
        return Settings(AUTO, asdict(Wishes()))
    if name == "plain":
        return Settings(ADAPTIVE)
    return Settings("blend", methods.find("blend").validate({"members": f"1*{name}"}))


def to_ply(mesh: Mesh) -> bytes:
    """A binary PLY with positions in double precision."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(mesh.faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(mesh.faces), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, mesh.faces
    return header.encode() + mesh.vertices.astype("<f8").tobytes() + rows.tobytes()


def _digest(pair: Pair) -> str:
    digest = hashlib.sha256()
    for mesh in (pair.noisy, pair.true):
        digest.update(np.ascontiguousarray(mesh.vertices))
        digest.update(np.ascontiguousarray(mesh.faces))
    return digest.hexdigest()[:16]
