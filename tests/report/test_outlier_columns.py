"""Outliers that were brought back stand in the tables of a run."""

from __future__ import annotations

from msal_cli.job.records import MeshRecord
from msal_cli.report import csv_report, rows


def test_the_page_has_a_column():
    record = MeshRecord(input="a.ply", status="written", version="1", despiked=12)
    titles = [column["title"] for column in rows.columns([record])]
    assert titles[-3:] == ["Flipped", "Outliers", "Time"]


def test_csv_has_a_column():
    assert "despiked" in csv_report._columns([{"despiked": 12}])
