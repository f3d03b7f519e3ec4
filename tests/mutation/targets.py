"""The modules whose tests are tried with planted faults, and the tests to run for each."""

from __future__ import annotations

TARGETS: dict[str, list[str]] = {
    "job/output": ["tests/codecs/test_conversion.py", "tests/job/test_output.py"],
    "analysis/volume": ["tests/analysis/test_metrics.py"],
    "kernels/schedules": ["tests/methods"],
}
