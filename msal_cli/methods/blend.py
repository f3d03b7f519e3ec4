"""Weighted mean of what several methods make of the mesh.

    x_i <- v_i + sum over the members k of w_k (f_k(v)_i - v_i),   w_k >= 0, sum of w_k <= 1

The rest to 1 is the weight of the input.  Where the errors of filters have different directions,
their mean has a smaller error than the best of them; ``--auto`` finds good weights.

``members`` is a sum such as

    0.6*guided_normal(similarity=0.45,iterations=5)+0.4*al(iterations=3)

of methods with those of their parameters that are not at their defaults.  All members run on the
same input: times add up, the memory is that of the largest.  One member of weight 1 is that method,
to the last bit.

Where the noise is not the same everywhere, weights may follow it: with ``levels=0.02:0.25`` a
member 0.1:0.6*al weighs 0.1 where the local noise is at most 0.02 mean edge lengths, 0.6 from 0.25
on, linear in between.

``share`` is the part of these displacements that is applied: x_i <- v_i + share (x_i - v_i).
``relax`` passes even out triangles within the tangent planes before the members run.  Isotropic
noise makes them jagged, and two passes remove most of that.  ``line=0:0:1`` moves vertices that
face this direction to the lines along it through their scanned positions, where noise along the
view leaves them.

Source: F. Luisier, T. Blu and M. Unser, A new SURE approach to image denoising: interscale
orthonormal wavelet thresholding, IEEE TIP 16 (2007), 593-606, for denoisers weighted so that an
estimate of the error is least; the members have their own.
"""

import itertools
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from msal_cli.analysis.noise_estimate import local_levels
from msal_cli.arrays import Floats
from msal_cli.errors import UsageError
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import Method, OnSweep, Result, Timer
from msal_cli.methods._sliding import even_out, move_to_lines

BYTES_PER_FACE = 760  # memory with ``learned``, the member that needs most; see ``Method``

KEPT_PER_FACE = 30
"""Memory per triangle beyond that of the largest member: the sum so far, and fragmentation."""

MAX_MEMBERS = 16  # largest number of members
STEPS = 100  # steps of progress that are reported for each member
ROUNDING = 1e-9  # rounding error by which the sum of the weights may exceed 1

_MEMBER = re.compile(
    r"([0-9.]+(?:[eE][+-]?[0-9]+)?(?::[0-9.]+(?:[eE][+-]?[0-9]+)?)*)"
    r"\*([a-z_0-9]+)(?:\(([^()]*)\))?"
)
_EXAMPLE = "for example 0.6*guided_normal(iterations=5)+0.4*al(iterations=3)"


@dataclass(frozen=True)
class Member:
    """One method of a blend: its weights, one for each level, and all of its parameters."""

    weights: tuple[float, ...]
    method: Method
    parameters: dict[str, Any]


def format_members(members: list[tuple[Sequence[float], str, dict[str, Any]]]) -> str:
    """The text of ``members`` for weights, names and given parameters; ``parse_members`` reads
    exactly the same numbers back."""
    parts = []
    for weights, name, given in members:
        inside = ",".join(f"{word}={value}" for word, value in given.items())
        parts.append(f"{_format_numbers(weights)}*{name}" + (f"({inside})" if inside else ""))
    return "+".join(parts)


def _format_numbers(values: Sequence[float]) -> str:
    # repr is the shortest text that is read back as the same number.
    return ":".join(repr(float(value)).removesuffix(".0") for value in values)


def format_levels(levels: Sequence[float]) -> str:
    """The text of ``levels``, mean edge lengths."""
    return _format_numbers(levels)


def parse_levels(text: str) -> tuple[float, ...]:
    """Parse ascending levels; an empty text has none."""
    try:
        levels = tuple(float(word) for word in text.split(":")) if text.strip() else ()
    except ValueError:
        levels = (-1.0,)
    # Comparisons with NaN are false.
    is_rising = all(low < high for low, high in itertools.pairwise(levels))
    if not is_rising or not all(0.0 <= level < math.inf for level in levels):
        raise UsageError(
            f"levels = {text} is not allowed", hint="rising levels of noise, for example 0.02:0.25"
        )
    return levels


def format_line(line: Sequence[float]) -> str:
    return _format_numbers([round(number, 6) for number in line])


def parse_line(text: str) -> Floats | None:
    """Parse a direction as a unit vector (3,); None for an empty text."""
    if not text.strip():
        return None
    try:
        line = np.array([float(word) for word in text.split(":")])
    except ValueError:
        line = np.empty(0)
    length = float(np.sqrt((line * line).sum()))
    if line.shape != (3,) or not 0.0 < length < math.inf:
        raise UsageError(f"line = {text} is not allowed", hint="a direction, for example 0:0:1")
    return line / length


def parse_members(text: str, n_levels: int = 0) -> tuple[Member, ...]:
    """Parse members, with one weight for each of ``n_levels``, or a single one for 0."""
    from msal_cli import methods

    found: list[Member] = []
    rest = "".join(text.split())
    while rest:
        match = _MEMBER.match(rest)
        if match is None:
            raise _syntax_error(rest)
        words, name, inside = match.groups()
        left = rest[match.end() :]
        if left == "+" or left[:1] not in ("", "+"):
            raise _syntax_error(left)
        rest = left[1:]
        if name == __name__.rpartition(".")[2]:
            raise UsageError("a blend cannot be a member of a blend", hint=_EXAMPLE)
        method = methods.find(name)
        weights = _parse_weights(words, max(n_levels, 1))
        found.append(Member(weights, method, _parse_parameters(method, inside or "")))
        if len(found) > MAX_MEMBERS:
            raise UsageError(f"there are more than {MAX_MEMBERS} members", hint=_EXAMPLE)
    if not found:
        raise UsageError("there are no members", hint=_EXAMPLE)
    total = max(sum(column) for column in zip(*(member.weights for member in found), strict=True))
    if total > 1.0 + ROUNDING:
        raise UsageError(
            f"the weights of members add up to {total:g}",
            hint="1 at most; what is left over to 1 belongs to the input",
        )
    return tuple(found)


def _syntax_error(rest: str) -> UsageError:
    return UsageError(f"members are not understood from '{rest}' on", hint=_EXAMPLE)


def _parse_parameters(method: Method, inside: str) -> dict[str, Any]:
    """The parameters of a member, given as ``NAME=VALUE,...``."""
    given: dict[str, str] = {}
    for part in inside.split(",") if inside else ():
        word, _, value = part.partition("=")
        if not word or not value:
            raise UsageError(f"'{part}' of member {method.name} is not NAME=VALUE", hint=_EXAMPLE)
        name = method.spec(word).name
        if given.setdefault(name, value) != value:
            raise UsageError(
                f"member {method.name} has two different values of {name}", hint="give it once"
            )
    return method.validate(given)


def _parse_weights(text: str, count: int) -> tuple[float, ...]:
    words = text.split(":")
    if len(words) != count:
        wanted = "one weight" if count == 1 else f"{count} weights, as there are levels"
        raise UsageError(f"{text} is not {wanted}", hint=_EXAMPLE)
    try:
        weights = tuple(float(word) for word in words)
    except ValueError:
        weights = (-1.0,)
    if not (all(0.0 <= weight <= 1.0 for weight in weights) and any(weights)):
        raise UsageError(
            f"{text} is not the weight of a member", hint=f"above 0, up to 1; {_EXAMPLE}"
        )
    return weights


@dataclass(frozen=True)
class Parameters:
    members: str = fields.parameter(
        "0.5*guided_normal(similarity=0.45,iterations=5)+0.5*al(iterations=2,mollify=2)",
        "weights and methods with their parameters: W*METHOD(NAME=VALUE,...)+...",
        more="the more a member weighs, the more the result is like its own",
    )

    levels: str = fields.parameter(
        "",
        "levels of the local noise, mean edge lengths, for which members have a weight each, as "
        "0.02:0.25; empty for the same weights everywhere",
        more="weights of noisier places are for places of more noise",
    )
    relax: int = fields.passes(
        0,
        "passes that even out the triangles within the surface before the members run, for noise "
        "in all directions",
        "more even triangles, vertices farther from the scan",
        high=100,
    )
    line: str = fields.parameter(
        "", "direction of these lines, as 0:0:1; empty for none", more="nearer to the view"
    )
    share: float = fields.share(
        1.0,
        "how much of the way from the mesh to the result is gone, after everything else",
        "farther from the scan; 0 returns the mesh as it is",
    )

    def __post_init__(self) -> None:
        parse_members(self.members, len(parse_levels(self.levels)))
        parse_line(self.line)

    @property
    def has_data_term(self) -> bool:
        """Whether all members have a data term; see ``Method``."""
        members = parse_members(self.members, len(parse_levels(self.levels)))
        return all(member.method.has_data_term(member.parameters) for member in members)

    @property
    def bytes_per_face(self) -> int:
        """Memory per triangle for these members; see ``Method``."""
        members = parse_members(self.members, len(parse_levels(self.levels)))
        needs = (member.method.bytes_per_face_of(member.parameters) for member in members)
        return KEPT_PER_FACE + max(needs)


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    timer = Timer()
    levels = parse_levels(parameters.levels)
    members = parse_members(parameters.members, len(levels))
    local = local_levels(mesh) if levels else None
    scanned, line = mesh, parse_line(parameters.line)
    mesh = even_out(mesh, parameters.relax)
    is_alone = [member.weights for member in members] == [(1.0,)]
    if is_alone and parameters.share == 1.0 and line is None:
        return members[0].method.denoise(mesh, members[0].parameters, on_sweep)
    move = np.zeros_like(mesh.vertices)
    for k, member in enumerate(members):

        def on_step(done: int, total: int, k: int = k) -> None:
            on_sweep(STEPS * k + STEPS * done // max(total, 1), STEPS * len(members))

        step = member.method.denoise(mesh, member.parameters, on_step).vertices
        step = step - mesh.vertices
        if local is None:
            step *= member.weights[0]
        else:
            step *= np.interp(local, levels, member.weights)[:, None]
        move += step
        del step
        # Normals take as much memory as the vertices, and are fast to compute again.
        mesh.release_normals()
    move += mesh.vertices
    if line is not None:
        move = move_to_lines(scanned, move, line)
    if parameters.share < 1.0:
        move -= scanned.vertices
        move *= parameters.share
        move += scanned.vertices
    return timer.finish(move)
