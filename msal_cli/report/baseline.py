"""Comparisons against those of an earlier run, for ``msal compare --baseline``.

Every figure of which less is better may be larger than it was by a tolerance; what is larger still
is a broken gate, as if one had been given for each file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msal_cli.job.plain_data import value_at
from msal_cli.job.records import GateResult

FIGURES = (
    "mean_angular_error_deg",
    "vertex_error_percent",
    "displacement.rms_edges",
    "displacement.max_edges",
    "hausdorff_edges",
    "volume_change_percent",
    "area_change_percent",
    "flipped_faces",
)
"""What is compared with the baseline, changes by their size."""

SLACK = 1e-6
"""What any figure may grow, in its own unit: rounding differs between machines."""

_SIGNED = ("volume_change_percent", "area_change_percent")


def partner(name: str, earlier: Mapping[str, Any]) -> Any | None:
    """The earlier record of a file, known by its path or by its relative path; None if there is
    none, or more than one that it could be.

    Folders are often other ones than they were, so that the end of a path has to do.
    """
    if name in earlier:
        return earlier[name]
    ends = [one for path, one in earlier.items() if _is_end(name, path)]
    return ends[0] if len(ends) == 1 else None


def _is_end(name: str, path: str) -> bool:
    return path.replace("\\", "/").endswith("/" + name.replace("\\", "/"))


def compare_with_baseline(
    record: Any, before: Any | None, tolerance: float
) -> tuple[GateResult, ...]:
    """What became of each figure of a record that was known ``before``.

    Parameters
    ----------
    record, before : a comparison now and then, or the reference part of a denoising; ``before`` is
        None for a file that is new, which has no gates.
    tolerance : by which share of what it was a figure may be larger.
    """
    figures = ((path, _figure(before, path), _figure(record, path)) for path in FIGURES)
    return tuple(
        _gate(path, then, now, tolerance) for path, then, now in figures if then is not None
    )


def _gate(path: str, then: float, now: float | None, tolerance: float) -> GateResult:
    most = then * (1.0 + tolerance) + SLACK
    name = f"abs({path})" if path in _SIGNED else path
    was = f"{then:.6g} in the baseline, tolerance {100.0 * tolerance:g} %"
    return GateResult(
        expression=f"{name} > {most:.6g}",
        broken=now is None or now > most,
        decided=now is not None,
        values={path: now},
        reason=f"{path} is not known, {was}" if now is None else f"{name} is {now:.6g}, {was}",
    )


def _figure(record: Any, path: str) -> float | None:
    value = value_at(record, path)
    return None if value is None or value - value != 0.0 else abs(value)


def missing(names: Sequence[str], earlier: Mapping[str, Any]) -> list[str]:
    """Paths of the baseline that no file of ``names`` has now."""
    found = {id(partner(name, earlier)) for name in names}
    return [path for path, one in earlier.items() if id(one) not in found]
