"""How near ``--auto`` and every method come to the truth, class by class.

    MSAL_DATA=FOLDER python -m benchmarks.accuracy --cache FILE.json [--quick] [--again]

Prints benchmarks/results/accuracy.txt over the noisy meshes of ``benchmarks.ground_truth``: mean
angle between corresponding face normals in degrees / mean distance between corresponding vertices
in % of the true mean edge length.  The settings are those of ``benchmarks.accuracy_grid``.  Without
MSAL_DATA the sample meshes and the shapes that are made here remain.

An interrupted run goes on from its cache.  After filters have changed take another one; after the
choice has changed ``--again`` repeats what ``--auto`` does, and nothing else.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks import accuracy_tables, accuracy_trials, ground_truth
from benchmarks.accuracy_grid import Setting, defaults, grid
from benchmarks.accuracy_outcomes import AUTO, NOISY, Outcome, Outcomes
from benchmarks.plain_accuracy import plain
from msal_cli.auto import Wishes

COMMON = {
    "machined": ("Fandisk0.3", "SharpSphere0.3"),
    "organic": ("Bunny0.2", "Julius0.2"),
    "texture 0.1": ("bunny 0.1", "igea 0.1", "dragon 0.1"),
    "texture 0.2": ("bunny 0.2", "igea 0.2", "dragon 0.2"),
}
"""Members that the classes share with those that the goals were set for."""

PARTS = ("classes", "wishes", "robustness", "reasons")
"""What is printed by default."""

CHOICES = "choices"
"""A part that takes minutes: what the command chooses, beside the learned filter by name."""

Rows = dict[str, dict[str, Outcome]]


def class_rows(held: Outcomes, quick: bool) -> dict[str, Rows]:
    """The outcomes of every class, by model: small meshes are run before the large ones."""
    settings = {of: defaults() if of == "clean" else grid() for of in ground_truth.CLASSES}
    wish = {AUTO: Wishes()}
    if not quick:
        for case in ground_truth.cases(quick=True):
            held.of(case, settings[case.of], wish)
    found: dict[str, Rows] = {of: {} for of in ground_truth.CLASSES}
    for case in ground_truth.cases(quick):
        found[case.of][case.name] = held.of(case, settings[case.of], wish)
    return {of: rows for of, rows in found.items() if rows}


def print_classes(found: dict[str, Rows]) -> None:
    """The tables of every class."""
    print("\n### Overview\n")
    filtered = {of: rows for of, rows in found.items() if of != "clean"}
    print("\n".join(accuracy_tables.overview(filtered, grid())))
    for of, rows in found.items():
        print(f"\n### {of.capitalize()}\n")
        if of == "clean":
            moved = accuracy_tables.errors(rows, [AUTO])[:, 0, 1]
            goal = accuracy_tables.CLEAN_GOAL
            print(
                f"`--auto` moves vertices by {moved.mean():.2f} % of the mean edge; goal: {goal}.\n"
            )
            print("\n".join(accuracy_tables.models(rows, defaults(), is_tuned=False)))
            continue
        print("\n".join(accuracy_tables.summary(of, rows, grid())))
        shared = {name: rows[name] for name in COMMON[of] if name in rows}
        if len(shared) == len(COMMON[of]):
            print("\nThose of them that the goals were set for, too:\n")
            print("\n".join(accuracy_tables.summary(of, shared, grid())))
        print("\nModel by model:\n")
        print("\n".join(accuracy_tables.models(rows, grid())), flush=True)


def print_choices(held: Outcomes, quick: bool) -> None:
    """The means of every class and each case, as the command makes them without a parameter."""
    learned = Setting("learned", {})
    rows: dict[str, list[str]] = {}
    means: dict[str, list[list[tuple[float, float]]]] = {}
    for case in ground_truth.cases(quick):
        found = held.of(case, [learned], {AUTO: Wishes()})
        made = [found[NOISY], plain(*case.made()), found[learned.text], found[AUTO]]
        pairs = [(outcome.angle_deg, outcome.vertex_percent) for outcome in made]
        means.setdefault(case.of, []).append(pairs)
        cells = " | ".join(f"{angle:.2f} / {error:.1f}" for angle, error in pairs)
        rows.setdefault(case.of, []).append(f"| {case.name} | {cells} | {made[-1].reason} |")
    print("| class | noisy | plain command | `learned` | **`--auto`** |\n|---|--:|--:|--:|--:|")
    for of, pairs_of_cases in means.items():
        mean = np.mean(pairs_of_cases, axis=0)
        cells = " | ".join(f"{angle:.2f} / {error:.1f}" for angle, error in mean)
        print(f"| {of} ({len(pairs_of_cases)}) | {cells} |")
    print("\n| mesh | noisy | plain command | `learned` | **`--auto`** | chosen |")
    print("|---|--:|--:|--:|--:|---|")
    print("\n".join(line for lines in rows.values() for line in lines))


def print_wishes(held: Outcomes, quick: bool) -> None:
    """The table of wishes."""
    rows = {
        case.name: held.of(case, [], accuracy_trials.WISHES)
        for case in ground_truth.cases(quick)
        if case.name in accuracy_trials.WISHED
    }
    print(
        "\n### Wishes\n\n" + "\n".join(accuracy_tables.wishes(rows, list(accuracy_trials.WISHES)))
    )


def print_robustness(held: Outcomes) -> None:
    """The table of other models and other noise."""
    settings = grid(coarse=True)
    rows = {
        case.name: held.of(case, settings, {AUTO: Wishes()})
        for case in accuracy_trials.other_cases()
    }
    print("\n### Robustness\n\n" + "\n".join(accuracy_tables.robustness(rows, settings)))


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cache", type=Path, help="JSON file that keeps what was run")
    parser.add_argument("--quick", action="store_true", help="leave igea and the dragon out")
    parser.add_argument("--again", action="store_true", help="run --auto anew")
    parser.add_argument("--parts", nargs="+", choices=(*PARTS, CHOICES), default=PARTS)
    arguments = parser.parse_args(words)
    try:
        held = Outcomes(arguments.cache)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        parser.error(f"{arguments.cache} is not a cache of this benchmark: {error}")
    if arguments.again:
        held.forget_automatic()
    if {"classes", "reasons"} & set(arguments.parts):
        found = class_rows(held, arguments.quick)
        if "classes" in arguments.parts:
            print_classes(found)
    if CHOICES in arguments.parts:
        print_choices(held, arguments.quick)
    if "wishes" in arguments.parts:
        print_wishes(held, arguments.quick)
    if "robustness" in arguments.parts:
        print_robustness(held)
    if "reasons" in arguments.parts:
        print("\n### What `--auto` said\n\n| | |\n|---|---|")
        for rows in found.values():
            print("\n".join(accuracy_tables.reasons(rows)))


if __name__ == "__main__":
    main()
