"""A small part of what the codecs, the commands and the reports made when the sums were frozen.

All of it: ``python -m tests.frozen.corpus_sums`` and ``python -m tests.frozen.record_sums``.
"""

from __future__ import annotations

import json

import pytest

from tests.frozen import corpus_inputs, corpus_sums, record_sums

CORPUS = json.loads(corpus_sums.KEPT.read_text())
RECORDS = json.loads(record_sums.KEPT.read_text())


@pytest.fixture(autouse=True)
def same_environment():
    if corpus_sums.here() != CORPUS["environment"]:
        pytest.skip("the sums were made elsewhere")


@pytest.mark.parametrize("format", corpus_inputs.FUZZED)
def test_mutants(format):
    # If a change is meant: python -m tests.frozen.corpus_sums --write
    task, sums, _ = corpus_sums.sums_of((format, "mutants", 0))
    assert corpus_sums.different(task, sums, CORPUS["formats"]) == {}


@pytest.mark.parametrize("format", ["off", "vtk", "none"])
def test_ordinary_files(format):
    task, sums, _ = corpus_sums.sums_of((format, "files", 1))
    assert corpus_sums.different(task, sums, CORPUS["formats"]) == {}


def test_records():
    # If a change is meant: python -m tests.frozen.record_sums --write
    for name, *parts in record_sums.outcomes(["stored", "bad"]):
        assert [corpus_sums.digest(one)[:12] for one in parts] == RECORDS["sums"][name], name
