"""Lengths with a unit, and what keeps vertices near their place: --max-move, --lock and --weights.

A limit and pins hold whatever the method does.  Methods that know of pins treat the pinned vertices
as fixed during their sweeps, and trust goes into the data term of those that have one.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from msal_cli.errors import ContentError, UsageError

if TYPE_CHECKING:
    from msal_cli.arrays import Flags, Floats
    from msal_cli.codecs.mesh_file import Surface
    from msal_cli.mesh import Mesh, PreparedMesh

METRES: dict[str, tuple[int, int]] = {
    "nm": (1, 10**9),
    "um": (1, 10**6),
    "mm": (1, 1000),
    "cm": (1, 100),
    "dm": (1, 10),
    "m": (1, 1),
    "km": (1000, 1),
    "mil": (254, 10**7),
    "in": (254, 10**4),
    "ft": (3048, 10**4),
    "yd": (9144, 10**4),
}
"""Length units in metres, as numerator and denominator; ``mil`` is a thousandth of an inch."""

# Micro sign and Greek letter.
_MICRO = ("\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m")

UNIT_NAMES = (*METRES, *_MICRO)

UNIT_PATTERN = "|".join(sorted(UNIT_NAMES, key=len, reverse=True))
"""A regular expression for the name of a unit."""

COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
"""What a user may write between a quantity and a length or number."""


def in_file_units(number: str, unit: str, file_unit: str | None) -> float:
    """A length in the unit of the file.

    Parameters
    ----------
    number : the length as it was written, so that 0.1 is a tenth and not the double next to it.
    unit : its unit, one of ``UNIT_NAMES``.
    file_unit : the unit of the file's coordinates, one of ``METRES``.

    Raises UsageError if the file's unit is not known, or the length is too long for a double.
    """
    if file_unit is None:
        raise UsageError(
            f"{number}{unit}: mesh files have no unit, so that it is not known how long that is",
            hint="say with --unit what the unit of the files is, such as --unit mm, or write the "
            "length in file units (0.05) or mean edge lengths (0.3e)",
        )
    from fractions import Fraction

    if not float(number):
        # An exponent of a billion would be a fraction of as many digits.
        return 0.0
    own, other = METRES["um" if unit in _MICRO else unit], METRES[file_unit]
    try:
        return float(Fraction(number) * Fraction(*own) / Fraction(*other))
    except OverflowError:
        raise UsageError(f"{number}{unit}: the length is too large") from None


BOUNDARY = "boundary"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LENGTH = re.compile(rf"(?a)\s*({_NUMBER})\s*(e|{UNIT_PATTERN})?\s*")
_LOCK = re.compile(rf"(?a)\s*([^\s<>=!]+)\s*(<=|>=|==|!=|<|>)\s*({_NUMBER})\s*")

# Of a sum of coordinates, and of the distance between two points, relative to the largest of them.
_ROUNDING = 2.0**-50


@dataclass(frozen=True)
class Length:
    """A length above 0 in file units, or ``in_edges``: in mean edge lengths of the input."""

    value: float
    in_edges: bool

    def __str__(self) -> str:
        return f"{self.value!r}{'e' if self.in_edges else ''}"

    def in_units(self, mean_edge_length: float) -> float:
        """The length in file units."""
        return self.value * mean_edge_length if self.in_edges else self.value


@dataclass(frozen=True)
class Lock:
    """A vertex property compared with a value, such as ``confidence < 0.2``."""

    name: str
    comparison: str
    value: float

    def __str__(self) -> str:
        return f"{self.name} {self.comparison} {self.value!r}"

    def select(self, values: Floats) -> Flags:
        """For which of the property's values (n,) it is so.

        A property in single precision is compared in single precision: what was stored as 0.2 is
        0.2, and not a little more.
        """
        import numpy as np

        value: Any = self.value
        with np.errstate(over="ignore", invalid="ignore"):
            single = np.float32(value)
            is_single = bool((values.astype(np.float32) == values).all())
        if np.isfinite(single) and is_single:
            value = float(single)
        result: Flags = COMPARISONS[self.comparison](values, value)
        return result


def parse_length(text: str, option: str = "--max-move", unit: str | None = None) -> Length:
    """``0.3e``, ``0.05``, or ``0.01mm`` where the files' ``unit`` is known; UsageError, which names
    the option, for anything else."""
    match = _LENGTH.fullmatch(text)
    value = float(match[1]) if match else 0.0
    if match is not None and 0.0 < value < math.inf and match[2] not in (None, "e"):
        try:
            value = in_file_units(match[1], match[2], unit)
        except UsageError as error:
            raise UsageError(f"{option} {error.message}", hint=error.hint) from None
    if match is None or not 0.0 < value < math.inf:
        raise UsageError(
            f"{option} {text}: this is no length above 0",
            hint="write 0.3e for mean edge lengths, or 0.05 for file units; with --unit mm, if "
            "that is the unit of the files, also 0.01mm or 0.002in",
        )
    return Length(value, match[2] == "e")


def parse_lock(text: str, option: str = "--lock") -> Lock | None:
    """``confidence < 0.2``; None for the word ``boundary``; UsageError, which names the option, for
    anything else."""
    if text.strip() == BOUNDARY:
        return None
    match = _LOCK.fullmatch(text)
    if match is None or not math.isfinite(float(match[3])):
        raise UsageError(
            f"{option} {text}: this is neither 'boundary' nor a property compared with a number",
            hint=f"as in {option} 'confidence < 0.2'; msal info lists a file's properties",
        )
    return Lock(match[1], match[2], float(match[3]))


@dataclass(frozen=True, eq=False)
class Constraints:
    """The constraints on one mesh.

    Attributes
    ----------
    mesh : to be denoised; it knows of the pins and the trust.
    held : (n,) vertices that are pinned, or None.
    limit : longest way of a vertex in file units, or None.
    """

    mesh: Mesh
    held: Flags | None
    limit: float | None

    def apply(self, vertices: Floats) -> tuple[Floats, int]:
        """A method's result (n, 3) with pinned vertices back in their place and the ways of others
        cut to the limit, and how many were cut."""
        import numpy as np

        before = self.mesh.vertices
        if self.held is not None:
            vertices = np.where(self.held[:, None], before, vertices)
        return (vertices, 0) if self.limit is None else clamp_moves(before, vertices, self.limit)


def build_constraints(
    ready: PreparedMesh,
    mesh_file: Surface,
    max_move: str | None,
    locks: Sequence[str],
    weights: str | None,
    pinned: Flags | None = None,
) -> Constraints:
    """The constraints of a file, from the values of the options.

    ``pinned`` (n_file,) are vertices that stay whatever the options say.

    Raises InputError if the file has no such property (``E_PROPERTY``), or one that means nothing
    as trust.
    """
    import numpy as np

    mesh = ready.mesh
    flags = [] if pinned is None else [pinned]
    held: Flags = np.zeros(len(mesh.vertices), dtype=np.bool_)
    for lock in map(parse_lock, locks):
        if lock is None:
            held |= mesh.topology.boundary
        else:
            flags.append(lock.select(mesh_file.vertex_property(lock.name)))
    for file_pins in flags:
        # With a vertex all that coincide with it.
        held |= _spread_largest(ready, file_pins.astype(np.float64)) > 0.0
    trust = None if weights is None else _build_trust(ready, mesh_file, weights)
    limit = None if max_move is None else parse_length(max_move).in_units(mesh.mean_edge_length)
    pins = held if locks or pinned is not None else None
    return Constraints(mesh.with_constraints(pins, trust), pins, limit)


def clamp_moves(before: Floats, after: Floats, limit: float) -> tuple[Floats, int]:
    """Positions (n, 3) no further than ``limit`` from those ``before``, each in the direction in
    which it went, and how many went further.

    Not even by rounding, so that a gate at the limit holds: they stop a little before it.
    """
    import numpy as np

    from msal_cli.kernels.geometry import distances

    lengths = distances(before, after)
    beyond = np.flatnonzero(lengths > limit)
    if len(beyond):
        after = after.copy()
        start = before[beyond]
        ways = after[beyond] - start
        reached = max(0.0, limit - _ROUNDING * float(np.abs(start).max() + limit))
        after[beyond] = start + ways * (reached / lengths[beyond])[:, None]
    return after, len(beyond)


def _build_trust(ready: PreparedMesh, mesh_file: Surface, name: str) -> Floats:
    """Trust (n,) from 0 to 1: the property over its largest value; below 0 there is none.

    Of vertices that coincide the most trusted counts.
    """
    import numpy as np

    values = mesh_file.vertex_property(name)
    finite = np.isfinite(values)
    if not finite.all():
        raise ContentError(
            f"the property {name!r} is not finite",
            code="E_NONFINITE",
            where=f"vertex {int(np.argmin(finite))}",
            hint="mend it, or denoise without --weights",
        )
    largest = float(values.max(initial=0.0))
    if largest <= 0.0:
        raise ContentError(
            f"the property {name!r} is nowhere above 0, so that no vertex is to be trusted",
            hint="choose another property, or denoise without --weights",
        )
    return _spread_largest(ready, np.clip(values / largest, 0.0, 1.0))


def _spread_largest(ready: PreparedMesh, values: Floats) -> Floats:
    """For values (n_file,) of at least 0 at the file's vertices, the largest at each of the mesh's
    (n,)."""
    import numpy as np

    if ready.vertex_map is None:
        return values
    largest = np.zeros(len(ready.mesh.vertices))
    is_used = ready.vertex_map >= 0
    np.maximum.at(largest, ready.vertex_map[is_used], values[is_used])
    return largest
