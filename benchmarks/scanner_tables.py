"""The tables of ``benchmarks.scanners``, as Markdown, from outcomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.scanner_cases import CLEAN
from benchmarks.scanner_outcomes import NOISY, Row
from benchmarks.scanner_settings import PEER_SETTINGS, TAUBIN

Floats = NDArray[np.float64]

Rows = Mapping[str, Row]
"""Outcomes of one kind, by model."""

TITLES = {
    NOISY: "noisy",
    "msal": "default MSAL",
    "plain": "plain command",
    "auto": "**`--auto`**",
    "learned": "`learned`",
}

JUDGED = "auto"
"""The contestant that is held against the best setting."""


@dataclass(frozen=True, eq=False)
class Best:
    """The single setting that is best for a kind: the least sum of the logarithms of the mean angle
    and the mean distance over the models."""

    label: str
    errors: Floats


def errors_of(rows: Rows, name: str) -> Floats:
    """Angle and distance (models, 2) of one contestant; nan where it was not run."""
    found = []
    for row in rows.values():
        one = row.get(name)
        found.append(
            (np.nan, np.nan) if one is None else (one.errors.angle_deg, one.errors.distance_percent)
        )
    return np.array(found).reshape(-1, 2)


def best_setting(rows: Rows) -> Best | None:
    """The best of the peers' settings, None where none was run on all models."""
    means = {
        one.label: errors_of(rows, one.label).mean(axis=0)
        for one in PEER_SETTINGS
        if not np.isnan(errors_of(rows, one.label)).any()
    }
    if not means:
        return None
    label = min(means, key=lambda name: float(np.log(np.maximum(means[name], 1e-9)).sum()))
    return Best(label, means[label])


def cell(errors: Floats) -> str:
    """Angle / distance."""
    return "" if np.isnan(errors).any() else f"{errors[0]:.1f} / {errors[1]:.1f}"


def misses(errors: Floats, best: Best) -> NDArray[np.bool_]:
    """In which measure ``errors`` are worse than those of the best setting (2,); a difference that
    the table does not show is none."""
    worse: NDArray[np.bool_] = np.round(errors, 1) > np.round(best.errors, 1)
    return worse


def ratio_cell(errors: Floats, best: Best | None) -> str:
    """Errors over those of the best setting, a miss in bold."""
    if best is None or np.isnan(errors).any():
        return ""
    words = (f"{ratio:.2f}" for ratio in errors / best.errors)
    return " / ".join(
        f"**{word}**" if is_worse else word
        for word, is_worse in zip(words, misses(errors, best), strict=True)
    )


def overview(kinds: Mapping[str, Rows], names: Sequence[str]) -> list[str]:
    """One line for each kind: means over its models, and where ``--auto`` misses the target."""
    titles = [TITLES[name] for name in (NOISY, *names)]
    lines = [
        f"| kind | {' | '.join(titles)} | {TAUBIN.label} | best single setting | "
        "least angle, least distance of any | `--auto` / best single setting |",
        "|---|" + "--:|" * (len(titles) + 4),
    ]
    for kind, rows in kinds.items():
        if kind == CLEAN:
            continue
        best = best_setting(rows)
        cells = [cell(errors_of(rows, name).mean(axis=0)) for name in (NOISY, *names, TAUBIN.label)]
        cells.append("" if best is None else f"{cell(best.errors)} ({best.label})")
        cells.append(cell(_least(rows)))
        cells.append(ratio_cell(errors_of(rows, JUDGED).mean(axis=0), best))
        lines.append(f"| {kind} ({len(rows)}) | " + " | ".join(cells) + " |")
    return lines


def _least(rows: Rows) -> Floats:
    means = np.array([errors_of(rows, one.label).mean(axis=0) for one in PEER_SETTINGS])
    return means.min(axis=0)


def totals(kinds: Mapping[str, Rows]) -> list[str]:
    """In how many kinds, and in how many cases, ``--auto`` is at least as good as others."""
    n_kinds = n_reached = 0
    cases: list[Floats] = []
    for kind, rows in kinds.items():
        auto, best = errors_of(rows, JUDGED), best_setting(rows)
        if kind == CLEAN or best is None or np.isnan(auto).any():
            continue
        n_kinds += 1
        n_reached += not misses(auto.mean(axis=0), best).any()
        angles = (errors_of(rows, name)[:, 0] for name in (JUDGED, TAUBIN.label, NOISY))
        cases.append(np.stack(tuple(angles), axis=1))
    if not cases:
        return []
    angle, taubin, noisy = np.concatenate(cases).T
    return [
        f"`--auto` is at least as good as the best single setting, in both measures, in "
        f"{n_reached} of {n_kinds} kinds.",
        f"Its angle is more than 5 % above that of {TAUBIN.label} in "
        f"{int((angle > 1.05 * taubin).sum())} of {len(angle)} cases, and less than 1 % below that "
        f"of the noisy mesh in {int((angle > 0.99 * noisy).sum())}.",
    ]


def models(kinds: Mapping[str, Rows]) -> list[str]:
    """``--auto`` beside the best single setting of the kind, model by model."""
    names = list(dict.fromkeys(name for rows in kinds.values() for name in rows))
    shared = [name for name in names if sum(name in rows for rows in kinds.values()) > 2]
    lines = [f"| kind | | {' | '.join(shared)} |", "|---|---|" + "--:|" * len(shared)]
    for kind, rows in kinds.items():
        best = best_setting(rows)
        if kind == CLEAN or not set(rows) & set(shared):
            continue
        contestants = [NOISY, JUDGED, *([best.label] if best else [])]
        for name in contestants:
            found = dict(zip(rows, errors_of(rows, name), strict=True))
            cells = [cell(found[model]) if model in found else "" for model in shared]
            title = TITLES.get(name, name)
            lines.append(f"| {kind if name == NOISY else ''} | {title} | {' | '.join(cells)} |")
    return lines


def clean(rows: Rows, names: Sequence[str]) -> list[str]:
    """How far clean meshes are moved: angle / distance between corresponding vertices."""
    lines = [f"| clean | mean | {' | '.join(rows)} |", "|---|--:|" + "--:|" * len(rows)]
    for name in (*names, TAUBIN.label):
        found = []
        for row in rows.values():
            one = row.get(name)
            found.append(
                (np.nan, np.nan)
                if one is None or one.errors.vertex_percent is None
                else (one.errors.angle_deg, one.errors.vertex_percent)
            )
        moved = np.array(found)
        cells = [_moved_cell(one) for one in (moved.mean(axis=0), *moved)]
        lines.append(f"| {TITLES.get(name, name)} | {' | '.join(cells)} |")
    return lines


def _moved_cell(errors: Floats) -> str:
    return "" if np.isnan(errors).any() else f"{errors[0]:.2f} / {errors[1]:.2f}"


def seconds(kinds: Mapping[str, Rows], names: Sequence[str]) -> list[str]:
    """Processor time of the whole command, over all cases."""
    lines = ["| | mean s | greatest s | sum s |", "|---|--:|--:|--:|"]
    for name in names:
        found = [
            row[name].cpu_seconds for rows in kinds.values() for row in rows.values() if name in row
        ]
        if found:
            lines.append(
                f"| {TITLES[name]} | {np.mean(found):.2f} | {max(found):.1f} | {sum(found):.0f} |"
            )
    return lines


def reasons(kinds: Mapping[str, Rows]) -> list[str]:
    """What ``--auto`` said of every case."""
    return ["| kind | model | |", "|---|---|---|"] + [
        f"| {kind} | {model} | {row[JUDGED].reason} |"
        for kind, rows in kinds.items()
        for model, row in rows.items()
        if JUDGED in row
    ]


def settings() -> list[str]:
    """The list of the peers' settings."""
    tools = {"pymeshlab": "PyMeshLab", "meshlib": "MeshLib", "vtk": "VTK"}
    return ["| setting | tool | what runs |", "|---|---|---|"] + [
        f"| {one.label} | {tools[one.package]} | {one.words} |" for one in PEER_SETTINGS
    ]
