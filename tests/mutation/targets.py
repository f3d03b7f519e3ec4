"""The modules whose tests are tried with planted faults, and the tests to run for each, as pytest
takes them."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# A reader of a library is ended by an exception from another thread, which CPython 3.11 may turn
# into an endless loop while it is traced; and real scans take long.
PIPELINE = [
    "tests/job/test_pipeline.py",
    "--deselect=tests/job/test_pipeline.py::test_conversion_by_option_and_by_name",
    "--deselect=tests/job/test_pipeline.py::test_real_files",
]

TEXTS = [
    f"tests/codecs/test_{name}.py"
    for name in ("off", "vtk", "vtk_xml", "medit", "gmsh", "avs_and_netgen", "ply_unusual")
] + ["tests/codecs/test_decimal_comma.py"]

TARGETS: dict[str, list[str]] = {
    "analysis/measures": [
        "tests/analysis/test_metrics.py",
        "tests/analysis/test_curvature.py",
        "tests/job/test_comparison.py",
    ],
    "analysis/correspondence": [
        "tests/analysis/test_surface_distance.py",
        "tests/job/test_comparison.py",
    ],
    "analysis/surface_distance": ["tests/analysis/test_surface_distance.py"],
    "batch/resume": ["tests/batch/test_resume.py", "tests/batch/test_manifest.py"],
    "codecs/slot_file": [*TEXTS, "tests/codecs/test_frames.py", "tests/codecs/test_ply_ascii.py"],
    "codecs/slots": ["tests/codecs/test_slots.py", *TEXTS],
    "job/choice": [
        "tests/job/test_choice.py",
        "tests/cli/test_despike.py",
        "tests/cli/test_min_noise.py",
    ],
    "job/output": ["tests/job/test_output.py"],
    "job/pipeline": [
        *PIPELINE,
        "tests/job/test_method_warnings.py",
        "tests/cli/test_constraints.py",
        "tests/cli/test_despike.py",
        "tests/cli/test_fields.py",
    ],
    "kernels/schedules": ["tests/kernels/test_sweeps.py"],
    "kernels/sweeps": ["tests/kernels/test_sweeps.py", "tests/kernels/test_ring_blocks.py"],
    "report/gates/__init__": ["tests/report/gates"],
    "report/gates/evaluation": ["tests/report/gates"],
    "report/gates/grammar": ["tests/report/gates"],
    "report/gates/quantities": ["tests/report/gates"],
}
