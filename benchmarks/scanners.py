"""Noise as scanners make it: this package beside 17 settings of other tools, kind by kind.

    MSAL_DATA=FOLDER python -m benchmarks.scanners --cache FILE.json --peers-python PYTHON [--quick]

Prints the section "Noise as scanners make it" of docs/accuracy.md: mean angle between face normals
in degrees / mean distance of the vertices to the true surface in % of the mean edge length, over
the models of ``benchmarks.scanner_cases``.  PYTHON has PyMeshLab, MeshLib and VTK; nothing here
imports them, and without it only what the cache has of them is in the tables.

An interrupted run goes on from its cache; ``--again`` repeats what this package does, all or those
that are named, and nothing else.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks import scanner_cases, scanner_outcomes, scanner_tables
from benchmarks.scanner_outcomes import OURS, Outcomes
from benchmarks.scanner_settings import PEER_SETTINGS

DETAILS = ("models", "seconds", "reasons")


def section(found: Mapping[str, scanner_tables.Rows], details: Sequence[str]) -> list[str]:
    """The tables, as lines; ``details`` are some of ``DETAILS``."""
    names = scanner_outcomes.ours()
    lines = [*scanner_tables.overview(found, names), "", *scanner_tables.totals(found)]
    if scanner_cases.CLEAN in found:
        lines += ["", "Clean meshes, angle / distance between corresponding vertices:", ""]
        lines += scanner_tables.clean(found[scanner_cases.CLEAN], names)
    if "models" in details:
        lines += ["", "Model by model, with the best single setting of the kind:", ""]
        lines += scanner_tables.models(found)
        lines += ["", "The settings of other tools; the rest is at the tool's default:", ""]
        lines += scanner_tables.settings()
    if "seconds" in details:
        lines += ["", "Processor time of the whole command:", ""]
        lines += scanner_tables.seconds(found, names)
    if "reasons" in details:
        lines += ["", "What `--auto` said:", "", *scanner_tables.reasons(found)]
    return lines


def main(words: list[str] | None = None) -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cache", type=Path, help="JSON file that keeps what was run")
    parser.add_argument(
        "--peers-python",
        default=os.environ.get("MSAL_PEERS_PYTHON"),
        help="Python that has the other tools [default: MSAL_PEERS_PYTHON, or none]",
    )
    parser.add_argument(
        "--again",
        nargs="*",
        choices=OURS,
        help="run this package's commands anew, all or those that are named",
    )
    parser.add_argument("--only", nargs="+", choices=OURS, help="run only these of this package")
    parser.add_argument("--kinds", nargs="+", help="only kinds with one of these words")
    parser.add_argument("--models", nargs="+", help="only models with one of these words")
    parser.add_argument("--quick", action="store_true", help="only a few models")
    parser.add_argument("--details", nargs="*", choices=DETAILS, default=["models", "seconds"])
    given = parser.parse_args(words)
    try:
        outcomes = Outcomes(given.cache, given.peers_python)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        parser.error(f"{given.cache} is not a cache of this benchmark: {error}")
    names = tuple(one for one in scanner_outcomes.ours() if not given.only or one in given.only)
    cases = scanner_cases.cases(given.quick, given.kinds, given.models)
    if given.again is not None:
        keys = [case.key for some in cases.values() for case in some]
        outcomes.forget(given.again or names, keys)
    found = {kind: outcomes.run(some, names, PEER_SETTINGS) for kind, some in cases.items()}
    print("## Noise as scanners make it\n")
    print("\n".join(section(found, given.details)))


if __name__ == "__main__":
    main()
