"""The choice by the level of the noise alone: a ladder from gentle to strong."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msal_cli.selection import NONE, Choice, Wishes

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh
    from msal_cli.selection import OnStep

# From gentle to strong, each from a noise level (mean edge lengths) up.
_LADDER: tuple[tuple[float, str, dict[str, Any], str], ...] = (
    (0.0, "msal", {"K": 0.35, "iterations": 4}, "MSAL, K = 0.35, 4 sweeps"),
    (0.05, "msal", {"K": 0.5, "iterations": 4}, "MSAL, K = 0.5, 4 sweeps"),
    (0.08, "msal", {"K": 0.7, "iterations": 3}, "MSAL, K = 0.7, 3 sweeps"),
    (0.15, "al", {"iterations": 3}, "AL, 3 sweeps"),
    (0.35, "al", {"iterations": 5}, "AL, 5 sweeps"),
)
# In place of what has no data term for trust to scale.
_WITH_DATA_TERM = ("msal", {"K": 1.0, "iterations": 4}, "MSAL, K = 1, 4 sweeps")
# In place of what rounds edges.
_EDGES = (
    "bilateral_normal",
    {"similarity": 0.35},
    "bilateral filter of the normals, sigma_s = 0.35",
)

_STEPS = {"texture": -1, "shape": 1, "positions": -1, "volume": -1, "normals": 1}
_SURFACES = {"texture": "textured", "edges": "machined"}


def chosen(mesh: Mesh, wishes: Wishes, on_step: OnStep | None = None) -> Choice:
    """See ``selection.chosen``."""
    from msal_cli import methods
    from msal_cli.noise_estimate import estimated

    noise = estimated(mesh)
    level = noise.mean_edges
    if on_step is not None:
        on_step(1, 1)
    if noise.is_negligible:
        reason = f"noise {level:.2g} e; clean; left as it is"
        return Choice(NONE, {}, reason, "clean", noise)
    step = sum(level >= least for least, *_ in _LADDER) - 1
    step += round(wishes.strength) + _STEPS.get(wishes.prefer, 0)
    step += _STEPS.get(wishes.keep or "", 0)
    _, name, given, label = _LADDER[min(max(step, 0), len(_LADDER) - 1)]
    if mesh.trust is not None and name != "msal":
        name, given, label = _WITH_DATA_TERM
    elif mesh.trust is None and wishes.keep == "edges" and step >= 2:
        name, given, label = _EDGES
    surface = _SURFACES.get(wishes.keep or "", "organic")
    return Choice(
        name,
        methods.find(name).settled(given),
        f"noise {level:.2g} e; {surface}; {label}",
        surface,
        noise,
    )
