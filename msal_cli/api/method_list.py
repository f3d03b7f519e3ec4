"""``list_methods``, and the names of methods and parameters as types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypedDict, cast

MethodName = Literal[
    "adaptive", "auto", "al", "anisotropic_diffusion", "bilateral", "bilateral_non_iterative",
    "bilateral_normal", "blend", "guided_normal", "hc", "hybrid", "l0", "learned",
    "mean_curvature_flow", "msal", "normal_diffusion", "normal_threshold",
    "scale_dependent_umbrella", "static_dynamic", "taubin", "umbrella", "wiener", "windowed_sinc",
]  # fmt: skip
"""``adaptive`` and ``auto`` stand for a choice; the others are methods (``list_methods``)."""


class MethodParameters(TypedDict, total=False):
    """Parameters of methods by name or symbol; ``list_methods`` says which method has which.

    Names that Python or the functions use themselves, such as ``lambda`` and ``weights``, are
    missing: give them in ``parameters``.
    """

    alpha: float
    areas: str
    beta: float
    boundary: str
    c: float
    caution: float
    closeness: float
    clusters: int
    crease_angle_deg: float
    deviation: str
    eta: float
    falloff: float
    fidelity: float
    guidance: float
    inflate: float
    iterations: int
    K: float
    k_PB: float
    levels: str
    line: str
    members: str
    mollify: int
    mu: float
    n: int
    neighbours: str
    noise: float
    normal_iterations: int
    normals: str
    nu: float
    pass_band: float
    presmooth: int
    q: float
    quantile: float
    r: float
    radius: float
    regularity: float
    regularize: float
    relax: int
    rho: float
    scaled_step: float
    scaling: str
    scan_share: float
    schedule: str
    shape: str
    share: float
    shrink: float
    sigma_c: float
    sigma_f: float
    sigma_g: float
    sigma_r: float
    sigma_s: float
    similarity: float
    sliding: str
    sparsity: float
    T: float
    tau: float
    texture: str
    threshold: float
    time_step: float
    tolerance_deg: float
    variant: str
    vertex_iterations: int
    volume: str


@dataclass(frozen=True)
class MethodInfo:
    """A method for ``denoise``.

    Attributes
    ----------
    name : the name for ``method=``.
    summary : what it does, in one line.
    parameters : for each parameter by name its meaning, range and default, and the effect of more.
    """

    name: MethodName
    summary: str
    parameters: Mapping[str, str]


def list_methods() -> tuple[MethodInfo, ...]:
    """All methods with their parameters, as ``msal methods`` shows them.

    Returns
    -------
    A MethodInfo for each, in alphabetical order, without the choices ``"adaptive"`` and ``"auto"``.
    """
    from msal_cli import methods

    found = []
    for name in methods.names():
        method = methods.find(name)
        parameters = {
            spec.name: f"{spec.help} {spec.range_text}; default {spec.default}"
            + (f"; more is {spec.more}" if spec.more else "")
            for spec in method.parameters
        }
        found.append(MethodInfo(cast(MethodName, name), method.summary, parameters))
    return tuple(found)
