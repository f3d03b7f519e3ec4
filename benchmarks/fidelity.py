"""How close each way of pulling back to the data comes to the truth, class by class.

    MSAL_DATA=FOLDER python -m benchmarks.fidelity [--all] [--models]

Prints the tables of benchmarks/results/fidelity.txt: over the noisy meshes of
``benchmarks.ground_truth`` (those of 50,000 vertices at most, or ``--all``), the mean over each
class of the mean angle between corresponding face normals in degrees / of the mean distance between
corresponding vertices in % of the true mesh's mean edge length.  For filters with settings to
choose the best single one of the class is shown, by either measure, and which it is.  ``--models``
adds every model.  At last it prints what one spike does to lambda, and lambda on a scan with ragged
triangles.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import ground_truth, machine
from msal_cli import methods
from msal_cli.analysis.measures import measure_surface_change, vertex_error_percent
from msal_cli.mesh import Mesh

CLASSES = ("texture 0.1", "texture 0.2", "organic")

Floats = NDArray[np.float64]

Setting = tuple[str, dict[str, Any]]

_SWEEPS = (2, 3, 4, 6)

ROWS: dict[str, list[Setting]] = {
    "`msal`, the paper's λ": [
        ("msal", {"K": K, "iterations": n, "mollify": mollify})
        for K in (0.25, 0.35, 0.5, 0.7, 0.85, 1)
        for n in _SWEEPS
        for mollify in (0, 1, 2)
    ],
    **{
        f"`robust`, q = {q:g}": [
            ("msal", {"schedule": "robust", "quantile": q, "K": K, "iterations": n})
            for K in (0.25, 0.35, 0.5, 0.7, 0.85, 1)
            for n in _SWEEPS
        ]
        for q in (0.999, 0.99, 0.95, 0.9)
    },
    "`bilateral_normal`": [
        ("bilateral_normal", {"iterations": n, "similarity": similarity})
        for n in (2, 3, 4, 5)
        for similarity in (0.35, 0.4, 0.45, 0.5)
    ],
    "`msal`, default": [("msal", {})],
    "`robust`, default": [("msal", {"schedule": "robust"})],
    "`wiener` schedule, default": [("msal", {"schedule": "wiener"})],
    "`wiener` schedule, noise given": [("msal", {"schedule": "wiener", "noise": None})],
    "`wiener` method, default": [("wiener", {})],
    "`wiener` method, noise given": [("wiener", {"noise": None})],
}
"""Settings by row; a noise of None is the true one."""


def errors(true: Mesh, mesh: Mesh) -> Floats:
    """Mean angle in degrees, and vertex error in %."""
    angle = measure_surface_change(true, mesh).mean_angular_error_deg
    return np.array([angle, vertex_error_percent(true, mesh)])


def outcome(setting: Setting, noisy: Mesh, true: Mesh) -> Floats:
    """The errors that a setting leaves."""
    name, given = setting
    if "noise" in given:
        heights = ((noisy.vertices - true.vertices) * true.vertex_normals()).sum(axis=1)
        given = {**given, "noise": float(heights.std()) / noisy.mean_edge_length}
    method = methods.find(name)
    return errors(true, noisy.with_vertices(method.denoise(noisy, method.validate(given)).vertices))


def describe_setting(setting: Setting) -> str:
    """What was chosen of a row."""
    return ", ".join(f"{word} {value:g}" for word, value in setting[1].items() if value != "robust")


def pair(both: Floats) -> str:
    """Both errors for a table."""
    return f"{both[0]:.2f} / {both[1]:.2f}"


def class_table(of: str, everything: bool, models: bool) -> None:
    """One class: the rows, the best setting by angle and by vertex error where there are many."""
    cases = [case for case in ground_truth.cases(quick=not everything) if case.of == of]
    meshes = [case.made() for case in cases]
    names = " | ".join(case.name for case in cases) if models else ""
    print(f"\n{of} ({len(cases)} models)\n\n| | setting | mean |{names}")
    print("|---|---|--:|" + "--:|" * (len(cases) if models else 0))

    def row(label: str, setting: str, found: Floats) -> None:
        own = " | ".join(pair(one) for one in found) if models else ""
        print(f"| {label} | {setting} | {pair(found.mean(axis=0))} |{own}", flush=True)

    row("noisy", "", np.array([errors(true, noisy) for noisy, true in meshes]))
    for label, settings in ROWS.items():
        found = [np.array([outcome(one, *both) for both in meshes]) for one in settings]
        means = np.array([one.mean(axis=0) for one in found])
        for best in dict.fromkeys(int(at) for at in means.argmin(axis=0)):
            row(label, describe_setting(settings[best]) if len(settings) > 1 else "", found[best])


def medians_of_lambda(noisy: Mesh) -> str:
    """The median lambda of the first sweep under both schedules."""
    method = methods.find("msal")
    found = [
        np.median(method.denoise(noisy, method.validate(given)).fields["fidelity"])
        for given in ({}, {"schedule": "robust"})
    ]
    return " | ".join(f"{one:.3f}" for one in found)


def spike_table() -> None:
    """What a spike, and ragged triangles, do to lambda."""
    print("\n| median λ of the first sweep | max σ | 0.99-quantile |\n|---|--:|--:|")
    for case in ground_truth.cases(quick=True):
        if case.name in ("dragon_egg 0.1", "coin 0.1"):
            noisy, _ = case.made()
            print(f"| {case.name} | {medians_of_lambda(noisy)} |")
            vertices = noisy.vertices.copy()
            at = len(vertices) // 2
            vertices[at] += 50.0 * noisy.mean_edge_length * noisy.vertex_normals()[at]
            print(
                f"| the same with one spike | {medians_of_lambda(noisy.with_vertices(vertices))} |"
            )
    folder = ground_truth.data_folder()
    scan = folder / "scans" / "face000.ply" if folder else None
    if scan is not None and scan.exists():
        print(f"| a scanned face with holes | {medians_of_lambda(ground_truth.opened(scan))} |")


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--all", action="store_true", help="large models, too")
    parser.add_argument("--models", action="store_true", help="every model beside the means")
    chosen = parser.parse_args(words)
    print(machine.line())
    for of in CLASSES:
        class_table(of, chosen.all, chosen.models)
    spike_table()


if __name__ == "__main__":
    main()
