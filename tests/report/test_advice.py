"""What the summary advises: files that may be texture, and where --auto would be better."""

from __future__ import annotations

import dataclasses

from msal_cli.job.records import ChoiceMade, MeshRecord, NoiseEstimate, NoiseReading
from msal_cli.report.phrases import auto_text, unsure_text

CHOICE = ChoiceMade("noise 0.3 e; AL", "machined", 0.3, None, 3, (), {}, (), "family", 2.6)
READINGS = (NoiseReading("texture", 0.0, 0.7), NoiseReading("noise", 0.05, 0.3))


def record(choice=CHOICE, **noise):
    estimate = NoiseEstimate(0.3, 0.1, **noise)
    return MeshRecord("a.ply", "written", noise_estimate=estimate, choice=choice)


def test_one_line_says_where_auto_is_better_and_how_long_it_takes():
    other = record(dataclasses.replace(CHOICE, auto_seconds=None))
    assert auto_text([other]) == auto_text([]) == ""
    assert auto_text([record()]).endswith(
        "(machined parts, strong noise), in about 3 s of one core"
    )
    assert "on 2 of 3 files" in auto_text([record(), other, record()])
    assert auto_text([record()] * 100).endswith("about 4 min of one core")


def test_unsure_files_are_named_with_their_readings_unless_something_is_assumed():
    words = "texture (70 %) or noise of 0.05 e (30 %): filtered mildly"
    assert unsure_text(record(unsure=True, readings=READINGS)).startswith(words)
    assert unsure_text(record(unsure=False, readings=READINGS)) == ""
    assumed = dataclasses.replace(CHOICE, wishes={"assume": "noise"})
    assert unsure_text(record(assumed, unsure=True, readings=READINGS)) == ""
