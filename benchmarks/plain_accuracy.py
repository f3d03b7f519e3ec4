"""How near the plain command comes to the truth, beside fixed settings of AL and MSAL.

    MSAL_DATA=FOLDER python -m benchmarks.plain_accuracy [--quick]

Prints what benchmarks/results/plain_accuracy.txt holds: for every class of
``benchmarks.ground_truth`` the mean angle between corresponding face normals in degrees / the mean
distance between corresponding vertices in % of the true mean edge length, of what the plain
command chooses and of the best fixed settings; then what was chosen for each mesh.
"""

from __future__ import annotations

import argparse
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import ground_truth
from benchmarks.accuracy_grid import Setting
from benchmarks.accuracy_outcomes import Outcome, outcome_of, run_setting
from msal_cli.auto import NONE, adaptive
from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]

_FAMILY: tuple[tuple[str, dict[str, tuple[Any, ...]]], ...] = (
    ("al", {"iterations": (1, 2, 3, 4, 5, 6, 8), "mollify": (0, 1, 2, 3)}),
    (
        "msal",
        {
            "K": (0.2, 0.25, 0.35, 0.5, 0.7, 0.85, 1.0),
            "iterations": (2, 3, 4, 6),
            "mollify": (0, 1, 2),
        },
    ),
)
_SCHEDULES: tuple[tuple[str, dict[str, tuple[Any, ...]]], ...] = (
    (
        "al",
        {
            "schedule": ("wiener",),
            "iterations": (3, 6, 10),
            "mollify": (1, 2),
            "caution": (0.75, 1.0, 1.5),
        },
    ),
    ("msal", {"schedule": ("robust",), "K": (0.35, 0.5, 0.7), "iterations": (2, 4)}),
)


def settings_of(products: tuple[tuple[str, dict[str, tuple[Any, ...]]], ...]) -> list[Setting]:
    """All settings of the products."""
    return [
        Setting(method, dict(zip(spread, values, strict=True)))
        for method, spread in products
        for values in itertools.product(*spread.values())
    ]


def plain(noisy: Mesh, true: Mesh) -> Outcome:
    """What the plain command makes of a mesh."""
    choice = adaptive.choose_adaptive(noisy)
    if choice.method == NONE:
        return outcome_of(noisy, true, noisy, choice.reason)
    return run_setting(noisy, true, choice.method, choice.parameters, choice.reason)


def figures(one: Outcome) -> tuple[float, float]:
    """Angle and vertex error."""
    return one.angle_deg, one.vertex_percent


def cell(pair: Floats) -> str:
    """Both figures in a table."""
    return f"{pair[0]:.2f} / {pair[1]:.1f}"


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="leave igea and the dragon out")
    arguments = parser.parse_args(words)
    paper, schedules = settings_of(_FAMILY), settings_of(_SCHEDULES)
    everything = [*paper, *schedules]
    rows: dict[str, list[tuple[str, Floats, Outcome, Floats]]] = {}
    for case in ground_truth.cases(arguments.quick):
        noisy, true = case.made()
        fixed = [run_setting(noisy, true, one.method, one.given) for one in everything]
        before = np.array(figures(outcome_of(noisy, true, noisy)))
        made = (case.name, before, plain(noisy, true), np.array([figures(one) for one in fixed]))
        rows.setdefault(case.of, []).append(made)
    heads = ["class", "noisy", "**plain command**", "default MSAL"]
    heads += ["least angle of any AL or MSAL", "least vertex error of any"]
    heads += ["the same with their Wiener and robust schedules", "least vertex error"]
    print(f"| {' | '.join(heads)} |\n|---|" + "--:|" * (len(heads) - 1))
    default = next(
        at for at, one in enumerate(paper) if one.given == {"K": 0.5, "iterations": 4, "mollify": 1}
    )
    for of, found in rows.items():
        means = np.mean([one[3] for one in found], axis=0)
        cells = [np.mean([one[1] for one in found], axis=0)]
        cells += [np.mean([figures(one[2]) for one in found], axis=0), means[default]]
        for among in (means[: len(paper)], means):
            cells += [among[among[:, k].argmin()] for k in (0, 1)]
        print(f"| {of} ({len(found)}) | {' | '.join(cell(one) for one in cells)} |")
    print("\n| mesh | noisy | plain command | chosen |\n|---|--:|--:|---|")
    for found in rows.values():
        for name, before, one, _ in found:
            print(f"| {name} | {cell(before)} | {cell(np.array(figures(one)))} | {one.reason} |")


if __name__ == "__main__":
    main()
