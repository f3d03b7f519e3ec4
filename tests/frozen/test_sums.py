"""Every method, and a part of the codecs, commands and reports, give what they gave when the sums
were frozen.

All of it: ``python -m tests.frozen.sums``, ``corpus_sums`` and ``record_sums``; where a change is
meant, with ``--write``.
"""

import json

import pytest

from tests.frozen import corpus_sums, kept, record_sums, sums

KEPT, CORPUS, RECORDS = (
    json.loads(module.KEPT.read_text()) for module in (sums, corpus_sums, record_sums)
)


def require_same_environment(sums, *ignored):
    here, there = kept.environment("meshio", "trimesh"), sums["environment"]
    names = [name for name in there if name not in ignored]
    different = [f"{name} {here[name]}" for name in names if here[name] != there[name]]
    if different:
        pytest.skip(f"the sums were made elsewhere: here is {', '.join(different)}")


@pytest.fixture
def compare(tmp_path):
    # Processors with AVX-512 and without it gave the same bytes.
    require_same_environment(KEPT, "simd")

    def compare(case):
        path = sums.locate(case[0])
        if path is None:
            pytest.skip("MSAL_DATA is not set: no real scans at hand")
        assert sums.output_sum(path, case[1], tmp_path) == KEPT["sums"][sums.key(case)]

    return compare


@pytest.mark.parametrize("case", list(sums.fast_cases()), ids=sums.key)
def test_the_bytes_are_the_frozen_ones(case, compare):
    compare(case)


@pytest.mark.slow
@pytest.mark.parametrize("case", list(sums.all_cases()), ids=sums.key)
def test_all_bytes_are_the_frozen_ones(case, compare):
    compare(case)


def test_every_case_has_a_sum():
    assert set(KEPT["sums"]) == {sums.key(case) for case in sums.all_cases()}


@pytest.mark.parametrize(
    "task",
    [(format, "mutants", 0) for format in corpus_sums.FUZZED]
    + [(format, "files", 1) for format in ("off", "vtk", "none")],
    ids=lambda task: " ".join(task[:2]),
)
def test_codecs(task):
    require_same_environment(CORPUS)
    found = corpus_sums.sums_of(task)
    assert found == {name: CORPUS["sums"].get(name) for name in found}


@pytest.mark.parametrize("chosen", ["bad", pytest.param("stored", marks=pytest.mark.ci)])
def test_records(chosen):
    require_same_environment(RECORDS)
    found = dict(record_sums.sums([chosen], None))
    assert found == {name: RECORDS["sums"].get(name) for name in found}
