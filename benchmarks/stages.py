"""Where the time of a file goes, by the report's own account, and whether that account is whole.

    python -m benchmarks.stages [--around 1414] [--repeats 3] [--folder FOLDER] [--forms ...]
        [--auto]

A noisy torus of AROUND * AROUND / 2 vertices as binary and ascii PLY, STL and OBJ, each denoised
on one core.  Printed are milliseconds by stage of the fastest run, their sum over the total that
the report tells, and what of the whole process the report does not know: the start of Python and of
the command, and its end.  With ``--auto`` the files are denoised so, and choosing is a stage.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from benchmarks import machine, measured, scans

_AUTO_STAGES = ("read", "connectivity", "choose", "normals", "sweeps", "measure", "write")
_STAGES = ("read", "connectivity", "normals", "sweeps", "measure", "write")


def accounted(source: Path, target: Path, *options: str) -> tuple[dict[str, float], float]:
    """The report's seconds by stage of one run, and the seconds of the whole process."""
    report = target.with_suffix(".jsonl")
    words = ["denoise", str(source), "-o", str(target), "--report", str(report), *options]
    source.read_bytes()
    ran = measured.run([sys.executable, "-m", "msal_cli", *words], is_pinned=True)
    if ran.fault:
        sys.exit(f"msal: {ran.fault}")
    seconds = json.loads(report.read_text(encoding="utf-8"))["seconds"]
    return {name: value or 0.0 for name, value in seconds.items()}, ran.seconds


def row(title: str, stages: tuple[str, ...], seconds: dict[str, float], whole: float) -> str:
    """One line of the table."""
    cells = [f"{1000 * seconds[name]:.0f}" for name in stages]
    share = sum(seconds[name] for name in stages) / seconds["total"]
    rest = whole - seconds["total"]
    cells += [f"{1000 * seconds['total']:.0f}", f"{100 * share:.1f} %", f"{1000 * rest:.0f}"]
    return f"| {title} | {' | '.join(cells)} |"


def main(words: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--around", type=int, default=1414)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--forms", nargs="*", choices=list(scans.FORMS), default=list(scans.FORMS))
    parser.add_argument("--folder", type=Path, help="where meshes are kept for the next run")
    parser.add_argument("--auto", action="store_true", help="denoise with --auto")
    arguments = parser.parse_args(words)
    stages: tuple[str, ...] = _STAGES
    options: tuple[str, ...] = ("--method", "msal")
    if arguments.auto:
        stages, options = _AUTO_STAGES, ("--auto",)
    scan = scans.large_torus(arguments.around)
    print(f"{machine.line()}\n{len(scan.vertices):,} vertices, one core, milliseconds.\n")
    print(f"| file | {' | '.join(stages)} | total | stages / total | outside |")
    print("|---|" + "--:|" * (len(stages) + 3), flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or Path(scratch)
        for form in arguments.forms:
            source = scans.file_of(folder, f"torus-{len(scan.vertices)}", form, lambda: scan)
            target = Path(scratch) / f"out{source.suffix}"
            runs = [accounted(source, target, *options) for _ in range(arguments.repeats + 1)][1:]
            best = min(runs, key=lambda run: run[1])
            print(row(scans.FORMS[form].title, stages, *best), flush=True)


if __name__ == "__main__":
    main()
