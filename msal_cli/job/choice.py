"""A choice for one file: what is run, and what the record says of why."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from msal_cli.auto import NONE, Wishes, choose
from msal_cli.job.records import ChoiceMade, MethodUsed, RunnerUp

if TYPE_CHECKING:
    from msal_cli.analysis.noise_estimate import NoiseLevel
    from msal_cli.mesh import Mesh
    from msal_cli.methods import Method


@dataclass(frozen=True, eq=False)
class Settled:
    """What is run on a mesh: a method, or None where the mesh stays as it is, with parameters."""

    method: Method | None
    used: MethodUsed
    made: ChoiceMade
    noise: NoiseLevel
    warnings: tuple[str, ...]


def settled(
    mesh: Mesh, wishes: Mapping[str, Any] | None, on_step: Callable[[int, int], None]
) -> Settled:
    """The choice for ``mesh``: among all methods by ``wishes``, the fields of ``Wishes``, or within
    the family of equation (2) where they are None."""
    from msal_cli import methods

    if wishes is None:
        from msal_cli.auto import adaptive

        choice = adaptive.choose_adaptive(mesh, on_step)
    else:
        choice = choose(mesh, Wishes(**wishes), on_step)
    method = None if choice.method == NONE else methods.find(choice.method)
    # Checked as if the user had given them.
    values = {} if method is None else method.validate(choice.parameters)
    made = ChoiceMade(
        reason=choice.reason,
        surface=choice.surface,
        noise_edges=choice.noise.mean_edges,
        risk_edges=choice.risk,
        tried=choice.tried,
        runners_up=tuple(RunnerUp(label, risk) for label, risk in choice.runners_up),
        wishes=dict(wishes or {}),
        repeat=options_of(method, values),
        among=choice.among,
    )
    warnings: tuple[str, ...] = ()
    if mesh.trust is not None and method is not None and not method.has_data_term(values):
        # A choice keeps away from this where it can.
        warnings = (f"--weights has no effect: {method.name} has no pull to the scanned positions",)
    return Settled(method, MethodUsed(choice.method, values), made, choice.noise, warnings)


def with_despiking(made: ChoiceMade) -> ChoiceMade:
    """A choice for a mesh whose outliers were brought back: words and options say so."""
    reason = made.reason.replace("left as it is", "the rest left as it is")
    return replace(made, reason=reason, repeat=(*made.repeat, "--despike"))


def options_of(method: Method | None, values: Mapping[str, Any]) -> tuple[str, ...]:
    """The options of ``msal denoise`` that run a method by hand; None leaves a mesh as it is."""
    if method is None:
        return ("--method", "msal", "--set", "iterations=0")
    words = ["--method", method.name]
    for spec in method.parameters:
        value = values[spec.name]
        if value != spec.default:
            # repr gives the very number back.
            text = repr(value) if isinstance(value, float) else str(value)
            words += ["--set", f"{spec.name}={text}"]
    return tuple(words)
