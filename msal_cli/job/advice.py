"""Where a method that was asked for by name harms a mesh: one line each, with the option to try."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from msal_cli.job.records import Displacement, NoiseEstimate
    from msal_cli.methods import Method

LEAST_MOVE_EDGES = 0.005
"""Mean displacement in mean edge lengths below which nothing worth a warning has happened."""

RULED = 0.2
"""The 99th percentile of lambda below which one spike rules it.  Without spikes it is 0.28 and more
on scans and on models with any noise; one spike of ten mean edge lengths makes it 0.11 to 0.15."""

MOST_SAMPLED = 16_384
"""Vertices whose lambda is looked at."""


def build_advice(
    method: Method,
    parameters: Mapping[str, Any],
    noise: NoiseEstimate,
    displacement: Displacement,
    is_ruled: bool,
) -> tuple[str, ...]:
    """Warnings about a run of ``method``; ``is_ruled`` is what ``is_ruled_by_spike`` gave."""
    from msal_cli.analysis.noise_estimate import SURE

    if displacement.mean_edges is None or displacement.mean_edges < LEAST_MOVE_EDGES:
        return ()
    if noise.negligible and (noise.high_edges is None or noise.high_edges < SURE):
        return (
            f"no noise to speak of, and {method.name} moved vertices by "
            f"{displacement.mean_edges:.2g} e: give no --method, or --min-noise auto, to leave "
            "such meshes as they are",
        )
    warnings = []
    most = method.most_noise_edges(parameters)
    if noise.mean_edges > most:
        warnings.append(
            f"noise {noise.mean_edges:.2g} e is more than {method.name} is made for with these "
            f"parameters (about {most:g} e): give no --method, or try --auto"
        )
    if is_ruled and method.uses_largest_sigma(parameters):
        warnings.append(
            "one spike rules lambda, which is next to nothing elsewhere: try --schedule robust"
        )
    return tuple(warnings)


def is_ruled_by_spike(fidelity: NDArray[np.float64] | None) -> bool:
    """Whether lambda (n,) of the first sweep is small nearly everywhere beside its maximum, 1."""
    import numpy as np

    if fidelity is None:
        return False
    sample = fidelity[:: max(len(fidelity) // MOST_SAMPLED, 1)]
    sample = sample[sample > 0.0]
    return len(sample) > 0 and float(np.quantile(sample, 0.99)) < RULED
