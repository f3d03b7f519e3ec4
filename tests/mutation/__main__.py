"""Show that the tests can fail: plant small faults, and count those that no test notices.

    python -m tests.mutation [TARGET...] [--sample N] [--seed S] [--jobs 2]

Targets are the modules of ``TARGETS``, by their path in the package.  Prints the survivors and the
share that was killed.  ``survivors.md`` lists survivors that cannot change what a user sees, each
with the reason; they do not count.  Exit status 1 if fewer than 90 % of the others were killed.
"""

from __future__ import annotations

import argparse
import os
import random
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")

from tests.mutation.judged import read_judged
from tests.mutation.mutants import find_mutants
from tests.mutation.runs import ROOT, measure_coverage, run_mutants
from tests.mutation.targets import TARGETS

ENOUGH = 0.9


def main() -> int:
    """Run the mutants of the targets named on the command line, or of all."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation")
    parser.add_argument("targets", nargs="*", help=", ".join(TARGETS))
    parser.add_argument("--sample", type=int, help="of each target so many mutants only")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    judged = read_judged()
    n_killed = n_counted = 0
    for target in options.targets or TARGETS:
        file = ROOT / "msal_cli" / f"{target}.py"
        mutants = find_mutants(file.read_text("utf-8"))
        if options.sample and options.sample < len(mutants):
            mutants = random.Random(options.seed).sample(mutants, options.sample)
        coverage = measure_coverage(file, TARGETS[target])
        killed = counted = 0
        for mutant, outcome in run_mutants(file, mutants, coverage, options.jobs):
            key = f"{target} {mutant.function}: {mutant.words}"
            if outcome == "killed":
                killed += 1
            elif key in judged:
                continue
            else:
                print(
                    f"{outcome:11} {target}:{mutant.line} {mutant.function}: {mutant.words}",
                    flush=True,
                )
            counted += 1
        print(f"{target}: {killed} of {counted} killed, {len(mutants) - counted} without effect")
        n_killed, n_counted = n_killed + killed, n_counted + counted
    print(f"{n_killed} of {n_counted} killed: {n_killed / max(n_counted, 1):.1%}")
    return int(n_killed < ENOUGH * n_counted)


if __name__ == "__main__":
    sys.exit(main())
