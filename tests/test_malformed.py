"""Malformed files through the whole way of a file: each its code, its reason and what to do."""

from __future__ import annotations

import pytest

from msal_cli.job import pipeline
from tests.job.test_pipeline import settings
from tests.malformed import counts, malformed

MALFORMED = malformed()

OF_THE_INPUT = {
    "E_READ",
    "E_FORMAT",
    "E_TRUNCATED",
    "E_NONFINITE",
    "E_INDEX",
    "E_NO_FACES",
    "E_RANGE",
    "E_UNSUPPORTED",
    "E_TOO_LARGE",
}
"""Codes that the content of a file can end in; E_READ where it names another that is not there.
E_CONTENT stands for arrays of a wrong shape, which no reader gives."""


@pytest.mark.parametrize("name", MALFORMED)
def test_the_record_has_the_code_and_the_reason(name):
    data, code, place = MALFORMED[name]
    output, record = pipeline.denoise_bytes(data, name, settings(iterations=0))
    assert output is None
    assert record.status == "failed"
    error = record.error
    assert error is not None
    assert (error.code, place in error.where) == (code, True), error
    assert error.message and len(error.message) < 300
    assert "Traceback" not in error.message and "\n" not in error.message


def test_there_are_enough_of_every_format_and_code():
    found = counts()
    assert sum(codes.total() for codes in found.values()) >= 300
    for format in ("ply", "obj", "stl", "glb", "gltf", "3mf", "gz"):
        assert found[format].total() >= 15
    assert set().union(*found.values()) == OF_THE_INPUT
