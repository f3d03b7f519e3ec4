"""``--auto`` and the wishes that go with it: options, and what they may not be mixed with."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click

from msal_cli.errors import UsageError
from msal_cli.job.settings import ADAPTIVE, AUTO

if TYPE_CHECKING:
    from collections.abc import Callable

    from msal_cli.cli.denoise_arguments import Request

_STRONGEST = 2.0


def _number(
    low: float, high: float, allowed: str
) -> Callable[[click.Context, click.Parameter, str | None], float | None]:
    """A callback for an option whose value is a number from ``low`` to ``high``."""

    def checked(
        context: click.Context, parameter: click.Parameter, value: str | None
    ) -> float | None:
        if value is None:
            return None
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not (low <= number <= high and math.isfinite(number)):
            raise click.BadParameter(f"{value!r} is not {allowed}")
        # -0 and 0 wish for the same.
        return number + 0.0

    return checked


OPTIONS = (
    click.option(
        "--auto",
        is_flag=True,
        help="Choose method and parameters for each mesh, from its noise and its surface; the "
        "report tells what was chosen, and why. The four options that follow imply it.",
    ),
    click.option(
        "--keep",
        type=click.Choice(["texture", "edges", "shape"]),
        help="What must not suffer: fine relief, sharp edges, or the smooth shape beneath the "
        "noise.  [default: as the surface looks]",
    ),
    click.option(
        "--strength",
        metavar="-2..2",
        callback=_number(-_STRONGEST, _STRONGEST, "a number from -2 to 2"),
        help="Around the automatic choice: greater is smoother, less keeps more.  [default: 0]",
    ),
    click.option(
        "--prefer",
        type=click.Choice(["positions", "normals", "volume"]),
        help="What is to come out best: places of vertices, directions of faces, or the enclosed "
        "volume.  [default: a balance]",
    ),
    click.option(
        "--auto-budget",
        metavar="N",
        callback=_number(1.0, math.inf, "a number from 1 up"),
        help="Most time for choosing and denoising together, in runs of the default method over "
        "the same mesh.  [default: 60]",
    ),
)
"""The options, in the order in which help shows them."""


def is_asked(request: Request) -> bool:
    """Whether each mesh is to get the method that suits it."""
    return request.auto or request.method == AUTO or _implying(request) is not None


def _implying(request: Request) -> str | None:
    """The first option given that means nothing without ``--auto``."""
    given = {
        "--keep": request.keep,
        "--strength": request.strength,
        "--prefer": request.prefer,
        "--auto-budget": request.auto_budget,
    }
    return next((word for word, value in given.items() if value is not None), None)


def is_by_hand(request: Request) -> bool:
    """Whether a method or parameters are given by hand."""
    return any(_by_hand(request).values())


def _by_hand(request: Request) -> dict[str, bool]:
    """The options by which a method and its parameters are given, and whether they are."""
    return {
        f"--method {request.method}": request.method not in (None, AUTO, ADAPTIVE),
        "-n": request.iterations is not None,
        "-K": request.factor is not None,
        "--mollify": request.mollify is not None,
        "--schedule": request.schedule is not None,
        "--set": bool(request.assignments),
    }


def refuse_contradictions(request: Request) -> None:
    """Refuse a method or parameters by hand beside ``--auto`` or adaptive; UsageError."""
    implying = _implying(request)
    if request.auto:
        asking, implies = "--auto", ""
    elif implying is not None:
        asking, implies = implying, ", which implies --auto,"
    elif request.method in (AUTO, ADAPTIVE):
        asking, implies = f"--method {request.method}", ""
    else:
        return
    given = [word for word, is_given in _by_hand(request).items() if is_given]
    if request.method == ADAPTIVE and is_asked(request):
        given.insert(0, f"--method {ADAPTIVE}")
    if given:
        raise UsageError(
            f"{asking}{implies} and {given[0]} contradict each other",
            hint="let --auto choose, with --keep, --strength or --prefer as wishes, or give "
            "method and parameters by hand",
        )


def wishes_of(request: Request) -> dict[str, Any]:
    """The fields of ``selection.Wishes``, as plain data."""
    from dataclasses import asdict

    from msal_cli.auto import Wishes

    given = {
        "prefer": request.prefer,
        "keep": request.keep,
        "strength": request.strength,
        "budget": request.auto_budget,
    }
    return asdict(Wishes()) | {name: one for name, one in given.items() if one is not None}
