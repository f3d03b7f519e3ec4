"""The tables of benchmarks/results/accuracy.txt, as text, from outcomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.accuracy_grid import Setting
from benchmarks.accuracy_outcomes import AUTO, NOISY, Outcome

Floats = NDArray[np.float64]

Rows = Mapping[str, Mapping[str, Outcome]]
"""Outcomes by model, and by the text of the setting."""

BY = ("angle", "vertex error", "both")
"""What settings are chosen by; both: the least sum of the logarithms."""

GOALS = {
    "machined": (5.5, 12.5),
    "organic": (5.4, 7.8),
    "texture 0.1": (4.4, 4.6),
    "texture 0.2": (5.6, 6.9),
}
"""Mean angle and vertex error that ``--auto`` is to reach, set for classes with other members."""

CLEAN_GOAL = 1.5
"""Mean move, % of the mean edge length, that clean meshes are to stay within."""


def errors(rows: Rows, texts: Sequence[str]) -> Floats:
    """Angle and vertex error (models, settings, 2); nan where a setting was not run."""
    return np.array([[_both(row.get(text)) for text in texts] for row in rows.values()])


def _both(one: Outcome | None) -> tuple[float, float]:
    return (np.nan, np.nan) if one is None else (one.angle_deg, one.vertex_percent)


def best_of(found: Floats, by: str) -> int:
    """Which of the settings (settings, 2) that were run is best by one word of ``BY``."""
    if by == "both":
        return int(np.nanargmin(np.log(found).sum(axis=1)))
    return int(np.nanargmin(found[:, BY.index(by)]))


def tuned(found: Floats, by: str) -> Floats:
    """Errors (models, 2) where every model has the setting that is best for it."""
    return np.array([one[best_of(one, by)] for one in found])


def summary(of: str, rows: Rows, settings: Sequence[Setting], with_goal: bool = True) -> list[str]:
    """Class means: best single settings, tuning for every model, and ``--auto``."""
    lines = [f"| {of}: {len(rows)} models | angle | vertex error | setting |", "|---|--:|--:|---|"]

    def line(label: str, found: Floats, setting: str = "") -> None:
        lines.append(f"| {label} | {found[0]:.2f} | {found[1]:.2f} | {setting} |")

    auto = errors(rows, [AUTO])[:, 0].mean(axis=0)
    line("noisy", errors(rows, [NOISY])[:, 0].mean(axis=0))
    published = [setting for setting in settings if setting.is_published]
    least: list[tuple[str, Floats]] = []
    for label, among in (
        ("best published setting", published),
        ("best setting of this package", list(settings)),
    ):
        means = errors(rows, [setting.text for setting in among]).mean(axis=0)
        for by in BY:
            at = best_of(means, by)
            line(f"{label}, by {by}", means[at], among[at].label)
        least.append((label, np.nanmin(means, axis=0)))
    found = errors(rows, [setting.text for setting in settings])
    each = {by: tuned(found, by).mean(axis=0) for by in BY}
    for by in BY:
        line(f"tuned for each model, by {by}", each[by])
    line("**`--auto`**", auto)
    if with_goal and of in GOALS:
        line("goal", np.array(GOALS[of]))
    least.append(("tuning for each measure by itself", np.array([each[BY[0]][0], each[BY[1]][1]])))
    least.append(("tuning for both at once", each["both"]))
    for label, against in least:
        line(f"`--auto` / {label}", auto / against)
    return lines


def overview(classes: Mapping[str, Rows], settings: Sequence[Setting]) -> list[str]:
    """One line for every class: the least that any published setting reaches in each measure,
    ``--auto``, and tuning."""
    lines = [
        "| class | noisy | least angle of any published setting | least vertex error of any | "
        "**`--auto`** | tuned for each model, by both | goal |",
        "|---|" + "--:|" * 6,
    ]
    published = [setting.text for setting in settings if setting.is_published]
    everything = [setting.text for setting in settings]
    for of, rows in classes.items():
        means = errors(rows, published).mean(axis=0)
        found = [
            errors(rows, [NOISY])[:, 0].mean(axis=0),
            means[best_of(means, BY[0])],
            means[best_of(means, BY[1])],
            errors(rows, [AUTO])[:, 0].mean(axis=0),
            tuned(errors(rows, everything), BY[2]).mean(axis=0),
        ]
        cells = [cell(one) for one in found]
        goal = cell(np.array(GOALS[of])) if of in GOALS else ""
        lines.append(f"| {of} ({len(rows)}) | " + " | ".join([*cells, goal]) + " |")
    return lines


def models(rows: Rows, settings: Sequence[Setting], is_tuned: bool = True) -> list[str]:
    """Every method at its default, ``--auto`` and the tuned best, model by model."""
    lines = ["| | mean | " + " | ".join(rows) + " |", "|---|--:|" + "--:|" * len(rows)]

    def line(label: str, found: Floats) -> None:
        cells = [cell(one) for one in (found.mean(axis=0), *found)]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")

    line("noisy", errors(rows, [NOISY])[:, 0])
    for setting in settings:
        if setting.is_default:
            line(setting.label, errors(rows, [setting.text])[:, 0])
    line("**`--auto`**", errors(rows, [AUTO])[:, 0])
    if is_tuned:
        found = errors(rows, [setting.text for setting in settings])
        for by in BY:
            line(f"tuned, by {by}", tuned(found, by))
    return lines


def wishes(rows: Rows, texts: Sequence[str]) -> list[str]:
    """What each wish does: angle / vertex error / change of the volume."""
    lines = ["| | " + " | ".join(rows) + " |", "|---|" + "--:|" * len(rows)]
    for text in (NOISY, *texts):
        cells = [
            f"{one.angle_deg:.2f} / {one.vertex_percent:.1f} / {one.volume_percent:+.2f}"
            for one in (row[text] for row in rows.values())
        ]
        label = f"`{text.removeprefix(AUTO).strip() or '--auto'}`" if text != NOISY else text
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return lines


def robustness(rows: Rows, settings: Sequence[Setting]) -> list[str]:
    """``--auto`` beside the best settings for each model, and those for all."""
    texts = [setting.text for setting in settings]
    found = errors(rows, texts)
    means = found.mean(axis=0)
    singles = [best_of(means, by) for by in BY]
    lines = [
        "| | noisy | **`--auto`** | tuned, by angle | tuned, by vertex error | tuned, by both | "
        + "by which setting | "
        + " | ".join(settings[at].label for at in dict.fromkeys(singles))
        + " |",
        "|---|" + "--:|" * 5 + "---|" + "--:|" * len(set(singles)),
    ]

    def line(label: str, found: Sequence[Floats], setting: str, own: Floats) -> None:
        cells = [cell(one) for one in found]
        cells += [setting, *(cell(own[at]) for at in dict.fromkeys(singles))]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")

    firsts = [errors(rows, [NOISY])[:, 0], errors(rows, [AUTO])[:, 0]]
    firsts += [tuned(found, by) for by in BY]
    for k, name in enumerate(rows):
        line(
            name, [first[k] for first in firsts], settings[best_of(found[k], BY[2])].label, found[k]
        )
    line("mean", [first.mean(axis=0) for first in firsts], "", means)
    return lines


def reasons(rows: Rows) -> list[str]:
    """What ``--auto`` said of every model."""
    return [f"| {name} | {row[AUTO].reason} |" for name, row in rows.items()]


def cell(found: Floats) -> str:
    """Angle / vertex error."""
    if np.isnan(found).any():
        return "-"
    return f"{found[0]:.2f} / {found[1]:.1f}"
