"""The summary of one file: eight lines, and nothing that calls for attention is left out."""

from __future__ import annotations

import dataclasses

import pytest

from msal_cli.job.records import GateResult, NoiseEstimate
from msal_cli.report import text as as_text
from msal_cli.report.short_summary import MOST_LINES
from tests.report.made import RUN, written

BROKEN = GateResult("flipped_faces > 0", True, True, {}, "flipped_faces is 3")
PASSED = dataclasses.replace(BROKEN, broken=False)


def lines(record, **options):
    return [line.text for line in as_text.summary(RUN, [record], **options)]


def test_a_plain_result():
    assert lines(written(), defaults={"K": 0.5, "iterations": 6}) == [
        "scan.ply -> out/scan.ply in 0.95 s",
        "  mesh          35,947 vertices, 69,451 faces, 1 component",
        "  method        msal (iterations 4)",
        "  moved         mean 0.11, most 0.44 mean edge lengths; volume -0.266 %",
    ]


def test_parameters_are_shown_where_the_defaults_are_not_known():
    assert "  method        msal (iterations 4, K 0.5)" in lines(written())
    assert "  method        msal" in lines(written(), defaults={"K": 0.5, "iterations": 4})


def test_noise_that_is_filtered_is_not_said_to_be_none():
    noise = NoiseEstimate(0.001, 0.0002, negligible=True)
    for verbose in (False, True):
        said = "\n".join(lines(written(noise_estimate=noise), verbose=verbose))
        assert "hardly any, filtered all the same" in said
        left = written(noise_estimate=noise, status="unchanged", left_alone="no noise")
        assert "none to speak of" in "\n".join(lines(left, verbose=verbose))


def test_counts_of_what_was_held_back_are_kept():
    record = written(despiked=3, clamped_vertices=1, locked_vertices=0)
    assert lines(record)[-1].endswith(
        "; 3 outlier vertices brought back; 1 vertex cut to the longest move; 0 vertices locked"
    )


@pytest.mark.parametrize("n_warnings", range(8))
def test_there_are_never_more_than_eight_lines(n_warnings):
    warnings = tuple(f"warning {k}" for k in range(n_warnings))
    record = written(warnings=warnings, gates=(PASSED, BROKEN, PASSED), sidecars=("copied a.mtl",))
    found = lines(record)
    assert len(found) <= MOST_LINES
    assert "  gate          broken: flipped_faces > 0 (flipped_faces is 3)" in found
    shown = sum(one.startswith("  warning") for one in found)
    n_left = (
        n_warnings
        + 2
        - shown
        - ("  gate          2 passed" in found)
        - any(one.startswith("  beside it") for one in found)
    )
    assert n_left == (int(found[-1].split()[2]) if found[-1].startswith("  ...") else 0)
    whole = lines(record, verbose=True)
    assert all(f"  warning       {one}" in whole for one in warnings)


def test_what_is_left_out_is_red_if_it_is_a_warning():
    record = written(warnings=tuple("abcdefgh"))
    assert as_text.summary(RUN, [record])[-1].tone == "bad"
    assert as_text.summary(RUN, [written(sidecars=tuple("abcdefgh"))])[-1].tone == "faint"
