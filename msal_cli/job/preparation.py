"""What is run on one mesh: whether it is left alone, its outliers brought back, and the method.

All of it counts as the stage ``choose`` of a record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from msal_cli.auto.wishes import NONE
from msal_cli.job.records import ChoiceMade, MethodUsed
from msal_cli.job.settings import AUTO, CHOOSING, Settings

if TYPE_CHECKING:
    from msal_cli.analysis.harm import Harm
    from msal_cli.analysis.noise_estimate import NoiseLevel
    from msal_cli.mesh import Mesh
    from msal_cli.methods import Method


@dataclass(frozen=True, eq=False)
class Preparation:
    """What is to be run on a mesh, and how that came about.

    Attributes
    ----------
    mesh : the mesh to denoise, without its outliers if they were brought back.
    method : None where the mesh stays as it is.
    parameters : of the method, every one of them.
    noise : what was estimated of ``mesh`` on the way; None if nothing was.
    known : fields of the record.
    warnings : for the record.
    """

    mesh: Mesh
    method: Method | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    noise: NoiseLevel | None = None
    known: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def looks_at_mesh(settings: Settings) -> bool:
    """Whether ``prepare`` looks at a mesh, which takes time, or does the same with every mesh."""
    is_named = settings.method not in CHOOSING
    return not is_named or settings.looks_for_outliers or settings.min_noise is not None


def prepare(
    given: Mesh,
    settings: Settings,
    on_choice: Callable[[int, int], None] = lambda done, total: None,
) -> Preparation:
    """What ``settings`` mean for one mesh; ``on_choice(done, total)`` says how far choosing is."""
    result = Preparation(given)
    if settings.min_noise is not None:
        result = _judge_noise(result, settings.min_noise)
        if result.known:
            return result
    if settings.looks_for_outliers:
        result = _repair_outliers(result, settings)
    return _choose_method(result, settings, on_choice)


def _judge_noise(so_far: Preparation, min_noise: str) -> Preparation:
    """With the noise; and with fields of the record, if the mesh is left alone for it."""
    from msal_cli.analysis.noise_estimate import estimate_noise
    from msal_cli.job.min_noise import too_little

    noise = estimate_noise(so_far.mesh)
    why = too_little(noise, so_far.mesh, min_noise)
    known = {"left_alone": why, "method": MethodUsed(NONE, {})} if why else {}
    return replace(so_far, noise=noise, known=known)


def _repair_outliers(so_far: Preparation, settings: Settings) -> Preparation:
    """With the outlier vertices brought back, where they are clear or this was asked for; the noise
    is then that without them."""
    from msal_cli.analysis import outliers

    found = outliers.find_outliers(so_far.mesh)
    is_asked = bool(settings.despike)
    warnings: tuple[str, ...] = ()
    if is_asked and found.are_too_many:
        warnings = (
            f"{100.0 * found.share:.0f} % of the vertices stand out, too many to be "
            "outliers: none was brought back",
        )
    if not found.count or not (is_asked or found.are_clear):
        return replace(so_far, known={"despiked": 0}, warnings=warnings)
    mesh, noise = so_far.mesh.with_vertices(found.vertices), so_far.noise
    if settings.method not in CHOOSING:
        from msal_cli.analysis.noise_estimate import estimate_noise

        noise = estimate_noise(mesh)
    known = {"despiked": found.count}
    return replace(so_far, mesh=mesh, noise=noise, known=known, warnings=warnings)


def _choose_method(
    so_far: Preparation, settings: Settings, on_choice: Callable[[int, int], None]
) -> Preparation:
    """With the method that is named, or that suits the mesh, and its parameters."""
    if settings.method not in CHOOSING:
        from msal_cli import methods

        method, parameters = methods.find(settings.method), settings.parameters
        return replace(so_far, method=method, parameters=parameters)
    from msal_cli.job import choice as automatic

    wishes = settings.parameters if settings.method == AUTO else None
    found = automatic.settled(so_far.mesh, wishes, on_choice)
    made = automatic.with_despiking(found.made) if so_far.known.get("despiked") else found.made
    return replace(
        so_far,
        method=found.method,
        parameters=found.used.parameters,
        noise=found.noise,
        known={**so_far.known, "method": found.used, "choice": made},
        warnings=so_far.warnings + found.warnings,
    )


def reject_choice(choice: ChoiceMade, despiked: int | None, harm: Harm) -> dict[str, Any]:
    """Fields of the record where a mesh stays as it is, since what was chosen would damage it."""
    from msal_cli.job import choice as automatic

    return {
        "method": MethodUsed(NONE, {}),
        "despiked": None if despiked is None else 0,
        "choice": replace(
            choice,
            reason=f"{choice.reason}; rejected, for {harm.reason}; left as it is",
            risk_edges=None,
            repeat=automatic.options_of(None, {}),
        ),
    }
