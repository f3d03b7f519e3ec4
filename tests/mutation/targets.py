"""The modules whose tests are tried with planted faults, and the tests to run for each."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

TARGETS: dict[str, list[str]] = {
    "analysis/volume": ["tests/analysis/test_metrics.py", "tests/job/test_comparison.py"],
    "analysis/displacement": ["tests/analysis/test_metrics.py"],
    "analysis/correspondence": [
        "tests/analysis/test_surface_distance.py",
        "tests/job/test_comparison.py",
    ],
    "analysis/surface_distance": ["tests/analysis/test_surface_distance.py"],
}
