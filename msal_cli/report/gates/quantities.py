"""What gate expressions can name: the numbers of a record, their units, and short names."""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from msal_cli.job.plain_data import value_at

Kind = Literal["truth", "constant", "number", "quotient", "percent", "relative", "edges", "length"]


@dataclass(frozen=True)
class Unit:
    """What a number is.

    ``constant`` is a number in the expression, ``number`` one that is counted or in a
    unit which the name says (degrees, seconds), ``quotient`` one of two alike.  ``percent`` and
    ``relative`` are in percent, and a bare number means percent beside the first and nothing beside
    the second.  ``edges`` is in mean edge lengths, ``length`` in file units to a ``power``.
    """

    kind: Kind
    power: int = 0


TRUTH, CONSTANT, NUMBER = Unit("truth"), Unit("constant"), Unit("number")
QUOTIENT, PERCENT, RELATIVE = Unit("quotient"), Unit("percent"), Unit("relative")
EDGES, LENGTH = Unit("edges"), Unit("length", 1)

SHORT_NAMES: dict[str, tuple[tuple[str, ...], Unit | None]] = {
    "volume_change": (("volume.change_percent", "volume_change_percent"), RELATIVE),
    "area_change": (("area.change_percent", "area_change_percent"), RELATIVE),
    "mean_displacement": (("displacement.mean",), None),
    "rms_displacement": (("displacement.rms",), None),
    "p95_displacement": (("displacement.p95",), None),
    "max_displacement": (("displacement.max",), None),
    "moved_vertices": (("displacement.moved_vertices",), None),
    "mean_angular_error_deg": (("reference.mean_angular_error_deg",), None),
    "max_angular_error_deg": (("reference.max_angular_error_deg",), None),
    "vertex_error_percent": (("reference.vertex_error_percent",), None),
    "hausdorff": (("reference.hausdorff",), None),
    "self_intersections": (("self_intersections.created",), None),
    "fixed_border_vertices": (("tile_set.fixed_border_vertices",), None),
    "noise": (("noise_estimate.file_units",), None),
    "risk": (("choice.risk_edges",), None),
    "seconds": (("seconds.total",), None),
}
"""The fields behind a short name, of which the first known one counts, and its unit if it differs.

Of these, a kind of record has the ones that it has fields for."""

_LENGTHS = {"hausdorff", "seam_gap", "tile_gap", "largest_weld", "mean_edge_length", "file_units"}
_STATISTICS = {"mean", "rms", "p95", "max"}
_POWERS = {"volume": 3, "area": 2}


@dataclass(frozen=True)
class Quantity:
    """The value of a name: the first of these fields that is known, in its unit."""

    name: str
    fields: tuple[str, ...]
    unit: Unit

    def value_in(self, record: Any) -> float | bool | None:
        """The value in a record; None if it is not known there."""
        for path in self.fields:
            value = value_at(record, path)
            if value is not None and value - value == 0.0:
                number: float | bool = value
                return number
        return None

    @property
    def needs_reference(self) -> bool:
        """Whether it is measured against a reference mesh, and against nothing else."""
        return all(one.startswith("reference.") for one in self.fields)

    def why_unknown(self, record: Any) -> str:
        """Why there is no value in a record, in words."""
        volume = getattr(record, "volume", None)
        if volume is not None and not volume.valid and any("volume" in one for one in self.fields):
            return f"{self.name} is not known: {volume.reason or 'the volume means nothing'}"
        reference = getattr(record, "reference", None)
        if self.needs_reference and reference is None:
            return f"{self.name} is not known: nothing was measured against a reference"
        if self.needs_reference and reference is not None and reference.error is not None:
            return f"{self.name} is not known: {reference.error.message}"
        if any(one.startswith("self_intersections.") for one in self.fields):
            return f"{self.name} is not known: count them with --check self-intersections"
        if self.name == "tile_gap" or self.fields[0].startswith("tile_set."):
            return f"{self.name} is not known: files are denoised as one with --tile-set"
        if self.name == "despiked":
            return "despiked is not known: outliers were not looked for, as --despike does"
        return f"{self.name} is not known for this file"


@functools.cache
def quantities(kind: Hashable) -> Mapping[str, Quantity]:
    """Everything that can be named of a kind of record, short names first."""
    fields = dict(_fields(typing.cast("type[Any]", kind), ""))
    found = {}
    for name, (paths, unit) in SHORT_NAMES.items():
        there = tuple(path for path in paths if path in fields)
        if there and name not in fields:
            found[name] = Quantity(name, there, unit or fields[there[0]])
    return found | {name: Quantity(name, (name,), unit) for name, unit in fields.items()}


def _fields(kind: type[Any], prefix: str) -> Iterator[tuple[str, Unit]]:
    """The numbers and truths of a kind of record, dotted, with their units."""
    hints = typing.get_type_hints(kind)
    for one in dataclasses.fields(kind):
        for hint in _alternatives(hints[one.name]):
            if dataclasses.is_dataclass(hint):
                yield from _fields(typing.cast("type[Any]", hint), f"{prefix}{one.name}.")
            elif hint is bool:
                yield prefix + one.name, TRUTH
            elif hint in (int, float):
                yield prefix + one.name, _unit(prefix + one.name)


def _alternatives(hint: Any) -> tuple[Any, ...]:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return typing.get_args(hint)
    return (hint,)


def _unit(path: str) -> Unit:
    parent, _, name = path.rpartition(".")
    group = parent.rpartition(".")[2]
    if name.endswith("_percent"):
        return PERCENT
    if name.endswith("_edges") and not name.startswith(
        ("boundary", "non_manifold", "inconsistent")
    ):
        return EDGES
    if name in _LENGTHS or (name in _STATISTICS and group):
        return LENGTH
    if group in _POWERS:
        return Unit("length", _POWERS[group])
    return NUMBER
