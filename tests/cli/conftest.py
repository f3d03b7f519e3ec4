"""Scans on disk that tests of several commands share."""

import pytest

from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, open_scan


@pytest.fixture
def scan(tmp_path):
    """The path of one scan, in a folder of its own."""
    return folder_of(tmp_path / "a folder", scan=closed_scan()) / "scan.ply"


@pytest.fixture
def scans(tmp_path):
    """A folder of two scans and a bad one."""
    return folder_of(tmp_path, a=closed_scan(0), b=closed_scan(1), bad=BAD_SCAN)


@pytest.fixture
def mixed(tmp_path):
    """A folder of two good files, one of them below, and a bad one."""
    folder = folder_of(tmp_path / "scans", bad=BAD_SCAN, closed=closed_scan())
    folder_of(folder / "below", open=open_scan())
    return folder
