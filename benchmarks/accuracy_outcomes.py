"""What settings, and ``--auto``, make of the noisy meshes of known truth: run once, then kept.

A cache is a JSON file, written after every mesh.  It holds figures of one version of the filters;
``forget_automatic`` drops those of ``--auto`` alone, whose choice changes more often.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.accuracy_grid import Setting
from benchmarks.ground_truth import Case
from msal_cli import methods
from msal_cli.analysis.measures import area_and_volume, measure_surface_change, vertex_error_percent
from msal_cli.auto import NONE, Wishes
from msal_cli.auto.search import choose_method
from msal_cli.mesh import Mesh

NOISY = "noisy"
"""In place of a setting: the mesh as it comes."""

AUTO = "auto"
"""In place of a setting: ``--auto`` without any wish."""

LARGE = 50_000
"""Vertices from which on a mesh goes without the dear settings."""


@dataclass(frozen=True)
class Outcome:
    """How far a result is from the truth.

    Attributes
    ----------
    angle_deg : mean angle between corresponding face normals, degrees.
    vertex_percent : mean distance between corresponding vertices, % of the true mean edge length.
    volume_percent : change of the enclosed volume from the noisy mesh; means nothing if that is
        open.
    reason : what ``--auto`` says of its choice; empty for others.
    """

    angle_deg: float
    vertex_percent: float
    volume_percent: float
    reason: str = ""


class Outcomes:
    """Outcomes by mesh and setting, from a cache file or run when asked for."""

    def __init__(self, path: Path | None) -> None:
        """Read ``path`` if it is there; None keeps nothing.

        Raises
        ------
        ValueError, KeyError, TypeError
            if it is not a cache.
        """
        self._path = path
        # None where a large mesh goes without a setting.
        self._kept: dict[str, dict[str, Outcome | None]] = {}
        if path is not None and path.exists():
            for mesh, row in json.loads(path.read_text(encoding="utf-8")).items():
                self._kept[mesh] = {
                    text: None if values is None else Outcome(*values)
                    for text, values in row.items()
                }

    def forget_automatic(self) -> None:
        """Drop what ``--auto`` did, with any wishes."""
        for row in self._kept.values():
            for text in [text for text in row if text.split()[0] == AUTO]:
                del row[text]

    def of(
        self, case: Case, settings: Sequence[Setting], wishes: dict[str, Wishes]
    ) -> dict[str, Outcome]:
        """Of the noisy mesh, of every setting and of ``--auto`` with every wish, by their texts.

        Large meshes have nothing of dear settings.
        """
        key = f"{case.of}: {case.name}"
        row = self._kept.setdefault(key, {})
        missing = [setting for setting in settings if setting.text not in row]
        unasked = {text: wish for text, wish in wishes.items() if text not in row}
        if missing or unasked or NOISY not in row:
            noisy, true = case.made()
            is_large = len(noisy.vertices) > LARGE
            for text, wish in unasked.items():
                row[text] = _automatic(noisy, true, wish)
            for setting in missing:
                is_run = not (is_large and setting.is_dear)
                row[setting.text] = (
                    run_setting(noisy, true, setting.method, setting.given) if is_run else None
                )
            row[NOISY] = outcome_of(noisy, true, noisy)
            self._write()
            print(f"{key}: {len(missing) + len(unasked)} run", file=sys.stderr, flush=True)
        texts = [NOISY, *(setting.text for setting in settings), *wishes]
        found = ((text, row[text]) for text in texts)
        return {text: outcome for text, outcome in found if outcome is not None}

    def _write(self) -> None:
        if self._path is None:
            return
        held = {
            mesh: {
                text: one and [one.angle_deg, one.vertex_percent, one.volume_percent, one.reason]
                for text, one in row.items()
            }
            for mesh, row in self._kept.items()
        }
        beside = self._path.with_name(self._path.name + ".new")
        beside.write_text(json.dumps(held, indent=1), encoding="utf-8")
        os.replace(beside, self._path)


def outcome_of(noisy: Mesh, true: Mesh, result: Mesh, reason: str = "") -> Outcome:
    """How far ``result`` is from the truth; the volume's change is that from ``noisy``."""
    before, after = area_and_volume(noisy)[1], area_and_volume(result)[1]
    return Outcome(
        measure_surface_change(true, result).mean_angular_error_deg,
        vertex_error_percent(true, result),
        100.0 * (after / before - 1.0) if before else 0.0,
        reason,
    )


def run_setting(
    noisy: Mesh, true: Mesh, name: str, given: dict[str, Any], reason: str = ""
) -> Outcome:
    """What a method makes of ``noisy``."""
    method = methods.find(name)
    vertices = method.denoise(noisy, method.validate(given)).vertices
    return outcome_of(noisy, true, noisy.with_vertices(vertices), reason)


def _automatic(noisy: Mesh, true: Mesh, wishes: Wishes) -> Outcome:
    choice = choose_method(noisy, wishes)
    if choice.method == NONE:
        return outcome_of(noisy, true, noisy, choice.reason)
    return run_setting(noisy, true, choice.method, choice.parameters, choice.reason)
