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
    "batch/resume": ["tests/batch/test_manifest.py", "tests/batch/test_plan.py"],
    "job/output": ["tests/job/test_output.py"],
    "job/pipeline": ["tests/job/test_pipeline.py", "tests/job/test_constraints.py"],
    "job/preparation": ["tests/job/test_pipeline.py", "tests/job/test_constraints.py"],
    "kernels/schedules": ["tests/kernels/test_sweeps.py"],
    "kernels/sweeps": ["tests/kernels/test_sweeps.py", "tests/kernels/test_ring_blocks.py"],
    "report/gates/__init__": ["tests/report/gates"],
    "report/gates/evaluation": ["tests/report/gates"],
    "report/gates/grammar": ["tests/report/gates"],
    "report/gates/quantities": ["tests/report/gates"],
}
