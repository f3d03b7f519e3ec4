"""The filters at the settings of public implementations, beside what those reached.

    MSAL_DATA=FOLDER python -m benchmarks.published_settings

FOLDER holds pairs/NAME/{Noisy,Original}.obj; the number in a name is the noise in mean edge
lengths.  Prints benchmarks/results/published_settings.txt: mean angle between face normals in
degrees / mean distance between corresponding vertices in % of the original's mean edge length.
"""

from __future__ import annotations

import argparse
from typing import Any

from benchmarks import ground_truth
from msal_cli import methods
from msal_cli.analysis.measures import measure_surface_change, vertex_error_percent
from msal_cli.mesh import Mesh

PUBLISHED = (
    (
        "AL, 3 sweeps, no mollification",
        "al",
        {"iterations": 3, "mollify": 0},
        ("10.41 / 14.4", "12.38 / 16.2", "6.31 / 10.8", "6.99 / 8.2"),
    ),
    (
        "AL, 3 sweeps, 1 mollification",
        "al",
        {"iterations": 3},
        ("9.77 / 13.8", "11.31 / 16.2", "5.91 / 10.3", "6.04 / 7.3"),
    ),
    (
        "MSAL, 3 sweeps, K = 1/2, no mollification",
        "msal",
        {"iterations": 3, "mollify": 0},
        ("15.09 / 14.3", "14.63 / 13.7", "7.75 / 8.7", "9.38 / 8.1"),
    ),
    (
        "implicit fairing",
        "mean_curvature_flow",
        {"time_step": 1, "iterations": 1, "boundary": "free"},
        ("11.71", "11.82", "6.89", "7.94"),
    ),
    ("Taubin", "taubin", {}, ("9.94 / 16.1", "11.18 / 15.2", "6.25 / 12.7", "6.92 / 17.5")),
    (
        "Fleishman 2003, 5 sweeps",
        "bilateral",
        {"variant": "fleishman", "iterations": 5},
        ("11.11 / 14.1", "16.74 / 16.3", "8.51 / 9.6", "10.29 / 9.0"),
    ),
    (
        "Jones 2003",
        "bilateral_non_iterative",
        {},
        ("10.99 / 14.8", "15.03 / 15.7", "6.50 / 8.4", "7.86 / 8.9"),
    ),
    (
        "Sun 2007, T 0.5, 20 + 50",
        "normal_threshold",
        {},
        ("4.27 / 10.7", "11.82 / 21.2", "9.51 / 21.9", "8.68 / 16.7"),
    ),
    (
        "Zheng 2011 local, 20 + 10",
        "bilateral_normal",
        {},
        ("3.49 / 7.2", "8.29 / 10.3", "6.64 / 10.6", "6.81 / 8.3"),
    ),
    (
        "Zheng 2011 global",
        "bilateral_normal",
        {"variant": "global"},
        ("11.19 / 12.6", "16.55 / 14.1", "6.50 / 7.7", "8.32 / 7.2"),
    ),
    ("L0 2013", "l0", {}, ("2.20 / 8.1", "10.60 / 17.4", "", "8.67 / 13.5")),
    (
        "Guided 2015, 20 + 10",
        "guided_normal",
        {},
        ("2.93 / 8.7", "8.17 / 13.3", "6.66 / 11.1", "7.97 / 10.8"),
    ),
)
"""Settings of public implementations, and what these reached on ``ground_truth.PAIRS``."""


def errors(true: Mesh, mesh: Mesh) -> str:
    """Mean angle in degrees / mean vertex error in % of the mean edge length."""
    angle = measure_surface_change(true, mesh).mean_angular_error_deg
    percent = vertex_error_percent(true, mesh)
    return f"{angle:.2f} / {percent:.1f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.parse_args()
    folder = ground_truth.data_folder()
    if folder is None:
        parser.error("set MSAL_DATA to the folder that holds pairs/")
    pairs = [ground_truth.pair(folder / "pairs" / name) for name in ground_truth.PAIRS]

    def row(label: str, name: str, given: dict[str, Any], beside: tuple[str, ...]) -> str:
        method = methods.find(name)
        cells = []
        for (noisy, true), other in zip(pairs, beside, strict=True):
            vertices = method.denoise(noisy, method.validate(given)).vertices
            cell = errors(true, noisy.with_vertices(vertices))
            cells.append(f"{cell} ({other})" if other else cell)
        return f"| {label} | " + " | ".join(cells) + " |"

    print("| setting | " + " | ".join(ground_truth.PAIRS) + " |")
    print("|---" * (1 + len(pairs)) + "|")
    print("| noisy | " + " | ".join(errors(true, noisy) for noisy, true in pairs) + " |")
    for setting in PUBLISHED:
        print(row(*setting), flush=True)


if __name__ == "__main__":
    main()
