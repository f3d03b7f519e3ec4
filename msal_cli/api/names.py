"""The words of the Python API as types, for editors and type checkers."""

from __future__ import annotations

from typing import Literal, TypedDict

MethodName = Literal[
    "adaptive",
    "auto",
    "al",
    "anisotropic_diffusion",
    "bilateral",
    "bilateral_non_iterative",
    "bilateral_normal",
    "blend",
    "guided_normal",
    "hc",
    "hybrid",
    "l0",
    "learned",
    "mean_curvature_flow",
    "msal",
    "normal_diffusion",
    "normal_threshold",
    "scale_dependent_umbrella",
    "static_dynamic",
    "taubin",
    "umbrella",
    "wiener",
    "windowed_sinc",
]
"""``adaptive`` and ``auto`` choose; the others are methods (``list_methods``)."""

NoiseKind = Literal[
    "gaussian-normal",
    "gaussian",
    "uniform",
    "mixed",
    "impulsive",
    "correlated",
    "view",
    "quantised",
    "grazing",
    "half",
    "ramp",
    "property",
    "outliers",
]
"""What ``add_noise`` adds."""

Preference = Literal["balanced", "positions", "normals", "volume"]
Keep = Literal["texture", "edges", "shape"]
Assumption = Literal["noise", "texture"]
Encoding = Literal["same", "ascii", "binary"]
Precision = Literal["same", "float32", "float64"]


class MethodParameters(TypedDict, total=False):
    """Parameters of methods by name or symbol; ``list_methods`` says which method has which.

    Those that Python or the functions use themselves, such as ``lambda`` and ``weights``, are not
    here: they go into ``parameters``.
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
    threshold: float
    time_step: float
    tolerance_deg: float
    variant: str
    vertex_iterations: int
    volume: str
