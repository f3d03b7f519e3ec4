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
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

from tests.mutation.judged import read_judged
from tests.mutation.mutants import find_mutants
from tests.mutation.runs import Target, run_mutants
from tests.mutation.targets import ROOT, TARGETS

ENOUGH = 0.9


def main() -> int:
    """Run the mutants of the targets named on the command line, or of all."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation")
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=", ".join(TARGETS))
    parser.add_argument("--sample", type=int, help="at most so many mutants of each target")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    options = parser.parse_args()
    killed = counted = 0
    for target in options.targets or TARGETS:
        result = run_target(target, options.sample, options.seed, options.jobs)
        killed, counted = killed + result[0], counted + result[1]
    print(f"{killed} of {counted} killed: {killed / max(counted, 1):.1%}")
    return int(killed < ENOUGH * counted)


def run_target(name: str, sample: int | None, seed: int, jobs: int) -> tuple[int, int]:
    """How many mutants were killed, of how many that a user can notice.  Prints the others."""
    start = time.monotonic()
    judged = read_judged()
    file = ROOT / "msal_cli" / f"{name}.py"
    mutants = find_mutants(file.read_text("utf-8"))
    if sample is not None and sample < len(mutants):
        mutants = random.Random(seed).sample(mutants, sample)
    killed = counted = 0
    for mutant, outcome in run_mutants(Target(ROOT, file, TARGETS[name]), mutants, jobs):
        key = f"{name} {mutant.function}: {mutant.words}"
        if outcome != "killed" and key in judged:
            continue
        counted += 1
        killed += outcome == "killed"
        if outcome != "killed":
            words = f"{mutant.function}: {mutant.words}"
            print(f"{outcome:11} {name}:{mutant.line} {words}", flush=True)
    print(
        f"{name}: {killed} of {counted} killed, {len(mutants) - counted} without effect, "
        f"{time.monotonic() - start:.0f} s",
        flush=True,
    )
    return killed, counted


if __name__ == "__main__":
    sys.exit(main())
