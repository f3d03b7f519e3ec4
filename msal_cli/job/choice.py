"""Decide what runs on one mesh: whether it stays as it is, whether outliers are brought back first,
and which method.  The time counts as the stage ``choose`` of a record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from msal_cli.auto import NONE, Wishes
from msal_cli.job.records import ChoiceMade, MethodUsed, RunnerUp
from msal_cli.job.settings import AUTO, CHOOSING, NEGLIGIBLE, Settings, parse_length
from msal_cli.light_dataclass import dataclass, field

if TYPE_CHECKING:
    from msal_cli.analysis.measures import Harm
    from msal_cli.mesh import Mesh
    from msal_cli.methods import Method


@dataclass(frozen=True, eq=False)
class Preparation:
    """What is to be run on a mesh, and why."""

    mesh: Mesh  # the mesh to denoise, without its outliers if they were brought back
    method: Method | None = None  # None where the mesh stays as it is
    parameters: Mapping[str, Any] = field(default_factory=dict)  # all parameters of the method
    known: dict[str, Any] = field(default_factory=dict)  # fields of the record
    warnings: tuple[str, ...] = ()  # for the record
    share: float = 1.0  # part of the full displacement that the wishes allow, above 0 to 1


def looks_at_mesh(settings: Settings) -> bool:
    """Whether ``prepare`` examines a mesh, which takes time; else it treats all meshes alike."""
    is_named = settings.method not in CHOOSING
    return not is_named or settings.looks_for_outliers or settings.min_noise is not None


def prepare(mesh: Mesh, settings: Settings, on_step: Callable[[int, int], None]) -> Preparation:
    """Apply ``settings`` to one mesh; ``on_step(done, total)`` is called while choosing."""
    from msal_cli import methods

    if settings.min_noise is not None:
        from msal_cli.analysis.noise_estimate import estimate_noise

        edge = mesh.mean_edge_length
        noise = estimate_noise(mesh).assume(settings.assume, edge)
        if settings.min_noise == NEGLIGIBLE:
            is_quiet, why = noise.is_negligible, ": none to speak of"
        else:
            bound = parse_length(settings.min_noise, "--min-noise").in_units(edge) / edge
            is_quiet, why = noise.is_below(bound), f", below --min-noise {settings.min_noise}"
        if is_quiet:
            why = f"noise {noise.mean_edges:.2g} e{why}"
            known = {"left_alone": why, "method": MethodUsed(NONE, {})}
            return Preparation(mesh, known=known)
    despiked = None
    warnings: tuple[str, ...] = ()
    is_named = settings.method not in CHOOSING
    if settings.looks_for_outliers:
        from msal_cli.analysis.outliers import find_outliers

        outliers = find_outliers(mesh)
        despiked = 0
        if settings.despike and outliers.are_too_many:
            warnings = (
                f"{100.0 * outliers.share:.0f} % of the vertices stand out, too many to be "
                "outliers: none was brought back",
            )
        if outliers.count and (settings.despike or outliers.are_clear):
            despiked = outliers.count
            mesh = mesh.with_vertices(outliers.vertices)
    known = {} if despiked is None else {"despiked": despiked}
    if is_named:
        method = methods.find(settings.method)
        return Preparation(mesh, method, settings.parameters, known, warnings)
    made = choose(mesh, settings.method, settings.parameters, on_step)
    if despiked:
        first = made.known["choice"]
        reason = first.reason.replace("left as it is", "the rest left as it is")
        repeat = (*first.repeat, "--despike")
        made.known["choice"] = replace(first, reason=reason, repeat=repeat)
    return replace(made, known=known | made.known, warnings=warnings + made.warnings)


def choose(
    mesh: Mesh, among: str, given: Mapping[str, Any], on_step: Callable[[int, int], None]
) -> Preparation:
    """Choose for ``mesh`` by the wishes ``given``, fields of ``Wishes``: ``among`` all methods
    (``AUTO``), or within the family of equation (2) (``ADAPTIVE``)."""
    from msal_cli import methods
    from msal_cli.analysis.noise_estimate import estimate_noise

    auto_seconds, wishes = None, Wishes(**given)
    if among == AUTO:
        from msal_cli.auto import search

        choice = search.choose_method(mesh, wishes, on_step)
    else:
        from msal_cli.auto import adaptive

        choice = adaptive.choose_adaptive(mesh, wishes)
        on_step(1, 1)
        if not estimate_noise(mesh).is_unsure:
            auto_seconds = adaptive.seconds_of_better(choice, len(mesh.vertices))
    method = None if choice.method == NONE else methods.find(choice.method)
    # Checked as if the user had given them.
    parameters = {} if method is None else method.validate(choice.parameters)
    made = ChoiceMade(
        reason=choice.reason,
        surface=choice.surface,
        noise_edges=choice.noise.mean_edges,
        risk_edges=choice.risk,
        tried=choice.tried,
        runners_up=tuple(RunnerUp(label, risk) for label, risk in choice.runners_up),
        wishes=dict(given),
        repeat=options_of(method, parameters),
        among="all" if among == AUTO else "family",
        auto_seconds=auto_seconds,
    )
    warnings: tuple[str, ...] = ()
    if mesh.trust is not None and method is not None and not method.has_data_term(parameters):
        # A choice avoids such methods where it can.
        warnings = (f"--weights has no effect: {method.name} has no pull to the scanned positions",)
    known = {"method": MethodUsed(choice.method, parameters), "choice": made}
    return Preparation(mesh, method, parameters, known, warnings, wishes.share)


def choose_weaker(
    mesh: Mesh, settings: Settings, choice: ChoiceMade, harm: Harm
) -> tuple[Settings, Preparation] | None:
    """Choose by the next weaker wishes, for a mesh that the ``choice`` would damage by ``harm``;
    returns the settings with these wishes, too, or None if there are no weaker ones.

    This way a greater strength never moves vertices less.
    """
    wishes = Wishes(**settings.parameters)
    if wishes.weaker is None:
        return None
    weaker, first = wishes.weaker, Wishes(**choice.wishes)
    is_shape = wishes.keep == "shape"
    was = "--keep shape" if is_shape else f"--strength {first.strength:g}"
    is_left_out = is_shape or weaker.strength <= 0.0
    instead = "left out" if is_left_out else f"{weaker.strength:g} instead"
    settings = replace(settings, parameters=asdict(weaker))
    chosen = prepare(mesh, settings, lambda done, total: None)
    made = replace(chosen.known["choice"], wishes=choice.wishes)
    why = f"{was} would damage the mesh ({harm.reason}): {instead}"
    return settings, replace(
        chosen, known=chosen.known | {"choice": made}, warnings=(*chosen.warnings, why)
    )


MILDER = (0.5, 0.25, 0.0)
"""Fractions of the noise for which smoothing is tried in turn if the chosen method would damage the
mesh; 0 leaves it unchanged."""


def soften_choice(
    given: Mesh, chosen: Preparation, choice: ChoiceMade, harm: Harm, share: float
) -> Preparation:
    """A milder preparation for a mesh that ``chosen`` would damage: AL with the Wiener schedule for
    this ``share`` of its noise; for 0 the mesh as it was ``given``.

    ``choice`` is the first choice, before any was softened.
    """
    import numpy as np

    from msal_cli import methods
    from msal_cli.analysis.noise_estimate import estimate_noise
    from msal_cli.auto.blends import build_recipe
    from msal_cli.auto.candidates import wiener_al

    despiked = chosen.known.get("despiked")
    parameters: dict[str, Any] = {}
    if share == 0.0:
        despiked = None if despiked is None else 0
        name, label, chosen = NONE, "", replace(chosen, mesh=given, share=1.0)
        which, what = "every choice", "left as it is"
    else:
        level = round(share * estimate_noise(chosen.mesh).mean_edges, 4)
        name, parameters, label = build_recipe(
            [wiener_al(level)], np.ones(1), level, share=chosen.share
        )
        which, what = "the first choice", f"smoothed for noise of {level:.2g} e only"
    method = None if name == NONE else methods.find(name)
    repeat = options_of(method, parameters)
    made = replace(
        choice,
        reason="; ".join(
            filter(None, (choice.reason, f"rejected, for {harm.reason}", what, label))
        ),
        risk_edges=None,
        repeat=(*repeat, "--despike") if despiked else repeat,
        auto_seconds=None if method is None else choice.auto_seconds,
    )
    fields = {"method": MethodUsed(name, parameters), "choice": made, "despiked": despiked}
    why = f"{which} would damage the mesh ({harm.reason}): {what}"
    known = chosen.known | fields
    return replace(chosen, method=method, parameters=parameters, known=known, warnings=(why,))


def options_of(method: Method | None, values: Mapping[str, Any]) -> tuple[str, ...]:
    """The options of ``msal denoise`` that run a method; None leaves a mesh as it is."""
    if method is None:
        return ("--method", "msal", "--set", "iterations=0")
    options = ["--method", method.name]
    for spec in method.parameters:
        value = values[spec.name]
        if value != spec.default:
            # repr is exact: it is parsed as the same number.
            text = repr(value) if isinstance(value, float) else str(value)
            options += ["--set", f"{spec.name}={text}"]
    return tuple(options)
