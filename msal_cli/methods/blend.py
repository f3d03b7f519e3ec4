"""Weighted mean of what several methods make of the mesh.

    x_i <- v_i + sum over the members k of w_k (f_k(v)_i - v_i),   w_k >= 0, sum of w_k <= 1

What the weights leave over to 1 belongs to the input.  Filters err in different ways: one keeps
edges and drifts, another keeps places and rounds, and where their errors point in different
directions the mean has less of them than the best of them, in angles and in places at once.  Good
weights depend on the mesh and its noise; ``--auto`` finds them by an estimate of the error.

``members`` is a sum such as

    0.6*guided_normal(similarity=0.45,iterations=5)+0.4*al(iterations=3)

A member is the name of a method with those of its parameters that are not at their defaults;
spaces do not matter.  Every member is run on the same input, so the cost is that of all.

Source: the idea of weighting several denoisers so that an estimate of the error is least is that
of F. Luisier, T. Blu and M. Unser, A new SURE approach to image denoising: interscale orthonormal
wavelet thresholding, IEEE Transactions on Image Processing 16 (2007), 593-606; the members have
their own.
"""

from __future__ import annotations

import re
import time
from typing import Any

import numpy as np

from msal_cli.dataclass import dataclass
from msal_cli.errors import UsageError
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import Method, OnSweep, Result, parameter

BYTES_PER_FACE = 455
"""Memory beyond what every method needs, that of the hungriest usual member; see ``Method``."""

MOST_MEMBERS = 16
"""More are taken for a mistake."""

STEPS = 100
"""Into which the progress of one member is told."""

ROUNDING = 1e-9
"""By which weights may add up to more than 1."""

_MEMBER = re.compile(r"([0-9.eE+-]+)\*([a-z_0-9]+)(?:\(([^()]*)\))?")
_EXAMPLE = "for example 0.6*guided_normal(iterations=5)+0.4*al(iterations=3)"


@dataclass(frozen=True)
class Member:
    """One method of a blend: its weight, and its settled parameters."""

    weight: float
    method: Method
    parameters: dict[str, Any]


def written(members: list[tuple[float, str, dict[str, Any]]]) -> str:
    """The text of ``members`` for weights, names and the parameters that are given."""
    parts = []
    for weight, name, given in members:
        inside = ",".join(f"{word}={value}" for word, value in given.items())
        parts.append(f"{weight:g}*{name}" + (f"({inside})" if inside else ""))
    return "+".join(parts)


def read(text: str) -> tuple[Member, ...]:
    """The members that a text names; UsageError says what is wrong with it."""
    from msal_cli import methods

    found = []
    rest = "".join(text.split())
    while rest:
        match = _MEMBER.match(rest)
        if match is None:
            raise UsageError(f"members are not understood from {rest!r} on", hint=_EXAMPLE)
        weight, name, inside = match.groups()
        rest = rest[match.end() :]
        if rest.startswith("+") and len(rest) > 1:
            rest = rest[1:]
        elif rest:
            raise UsageError(f"members are not understood from {rest!r} on", hint=_EXAMPLE)
        if name == __name__.rpartition(".")[2]:
            raise UsageError("a blend cannot be a member of a blend", hint=_EXAMPLE)
        method = methods.find(name)
        given = dict(part.partition("=")[::2] for part in (inside or "").split(",") if part)
        found.append(Member(_weight(weight), method, method.settled(given)))
    total = sum(member.weight for member in found)
    if not found or total > 1.0 + ROUNDING or len(found) > MOST_MEMBERS:
        what = f"the weights of members add up to {total:g}" if found else "there are no members"
        if len(found) > MOST_MEMBERS:
            what = f"there are more than {MOST_MEMBERS} members"
        raise UsageError(what, hint="give at least one, and weights of 1 at most in all")
    return tuple(found)


def _weight(text: str) -> float:
    try:
        weight = float(text)
    except ValueError:
        weight = -1.0
    if not 0.0 < weight <= 1.0:
        raise UsageError(
            f"{text} is not the weight of a member", hint=f"above 0, up to 1: {_EXAMPLE}"
        )
    return weight


@dataclass(frozen=True)
class Parameters:
    """Parameters of a blend."""

    members: str = parameter(
        "0.5*guided_normal(similarity=0.45,iterations=5)+0.5*al(iterations=2,mollify=2)",
        "weights and methods with their parameters: W*METHOD(NAME=VALUE,...)+...",
        more="the more a member weighs, the more the result is like its own",
    )

    def __post_init__(self) -> None:
        """Refuse members that mean nothing."""
        read(self.members)


def denoised(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep | None = None) -> Result:
    """The blend of what the members make of ``mesh``; see the module's description."""
    started = time.perf_counter()
    members = read(parameters.members)
    move = np.zeros_like(mesh.vertices)
    for k, member in enumerate(members):

        def going_on(done: int, total: int, k: int = k) -> None:
            if on_sweep is not None:
                on_sweep(STEPS * k + STEPS * done // max(total, 1), STEPS * len(members))

        result = member.method.denoised(mesh, member.parameters, going_on)
        step = result.vertices - mesh.vertices
        step *= member.weight
        move += step
        del result, step
    move += mesh.vertices
    return Result(move, seconds={"normals": 0.0, "sweeps": time.perf_counter() - started})
