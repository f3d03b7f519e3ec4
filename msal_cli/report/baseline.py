"""Comparisons held against those of an earlier run, for ``msal compare --baseline``.

Every figure of which less is better may be larger than it was by a tolerance; what is larger still
is a broken gate, as if somebody had written one for each file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

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
"""What is held against the baseline, changes by their size."""

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


def judged(record: Any, before: Any | None, tolerance: float) -> tuple[GateResult, ...]:
    """What became of each figure of a record that was known ``before``.

    Parameters
    ----------
    record, before : a comparison now and then, or the reference part of a denoising; ``before`` is
        None for a file that is new, against which nothing is held.
    tolerance : by which share of what it was a figure may be larger.
    """
    return () if before is None else tuple(_judged(record, before, tolerance))


def _judged(record: Any, before: Any, tolerance: float) -> Iterator[GateResult]:
    for path in FIGURES:
        then, now = _figure(before, path), _figure(record, path)
        if then is None:
            continue
        most = then * (1.0 + tolerance) + SLACK
        name = f"abs({path})" if path in _SIGNED else path
        was = f"{then:.6g} in the baseline, tolerance {100.0 * tolerance:g} %"
        yield GateResult(
            expression=f"{name} > {most:.6g}",
            broken=now is None or now > most,
            decided=now is not None,
            values={path: now},
            reason=f"{path} is not known, {was}" if now is None else f"{name} is {now:.6g}, {was}",
        )


def _figure(record: Any, path: str) -> float | None:
    value = record
    for name in path.split("."):
        value = None if value is None else getattr(value, name)
    return None if value is None or value - value != 0.0 else abs(value)


def missing(names: Sequence[str], earlier: Mapping[str, Any]) -> list[str]:
    """Paths of the baseline that no file of ``names`` has now."""
    found = {id(partner(name, earlier)) for name in names}
    return [path for path, one in earlier.items() if id(one) not in found]
