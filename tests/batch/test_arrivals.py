"""Which files are complete, and in what order they came; the clock is a number."""

import os

import pytest

from msal_cli.batch.arrivals import Arrivals, is_renamed_from, is_unfinished_name
from msal_cli.batch.inputs import DiscoveredInput


@pytest.fixture
def put(tmp_path):
    """Write a file, with a time of change in seconds; it is given as an input."""

    def write(name, text, time_s=None):
        path = tmp_path / name
        path.write_text(text)
        if time_s is not None:
            os.utime(path, (time_s, time_s))
        return DiscoveredInput(str(path), name, str(tmp_path))

    return write


def names(files):
    return [one.relative for one in files]


def test_a_file_is_taken_once_it_has_stood_still_and_then_never_again(put):
    arrivals = Arrivals(2.0)
    one = put("a.ply", "x")
    arrivals.note(one, 10.0)
    assert arrivals.pop_complete(11.9) == []
    assert arrivals.pop_complete(12.0) == [one]
    arrivals.note(one, 13.0)
    assert arrivals.pop_complete(100.0) == []
    assert len(arrivals) == 0


def test_a_file_written_in_pieces_waits_for_the_last_one_with_or_without_an_event(put):
    arrivals = Arrivals(2.0)
    arrivals.note(put("a.ply", "x"), 0.0)
    arrivals.note(put("a.ply", "xy"), 1.5)
    assert arrivals.pop_complete(2.0) == []
    put("a.ply", "xyz")
    assert arrivals.pop_complete(3.5) == []
    assert arrivals.pop_complete(5.4) == []
    assert names(arrivals.pop_complete(5.5)) == ["a.ply"]


def test_of_several_files_the_first_to_arrive_comes_first(put):
    arrivals = Arrivals(1.0)
    for at, name in enumerate(["c.ply", "a.ply", "b.ply"]):
        arrivals.note(put(name, name), 0.1 * at)
    # It changes, but keeps its place.
    arrivals.note(put("c.ply", "longer"), 0.3)
    assert names(arrivals.pop_complete(1.31)) == ["c.ply", "a.ply", "b.ply"]


def test_what_is_there_at_the_start_comes_by_its_times(put):
    arrivals = Arrivals(1.0)
    files = [put("a.ply", "1", 300), put("b.ply", "1", 100), put("c.ply", "1", 200)]
    arrivals.note_all(files, 0.0)
    assert names(arrivals.pop_complete(1.0)) == ["b.ply", "c.ply", "a.ply"]


def test_a_renamed_file_need_not_settle(put):
    arrivals = Arrivals(5.0)
    arrivals.note(put("a.ply", "x"), 7.0, is_complete=True)
    assert names(arrivals.pop_complete(7.0)) == ["a.ply"]


def test_a_file_that_is_overwritten_arrives_again(put):
    arrivals = Arrivals(1.0)
    arrivals.note(put("a.ply", "x", 100), 0.0)
    assert len(arrivals.pop_complete(1.0)) == 1
    arrivals.note(put("a.ply", "x", 200), 2.0)
    assert names(arrivals.pop_complete(3.0)) == ["a.ply"]


@pytest.mark.parametrize("by_listing", [True, False])
def test_a_file_that_goes_away_while_it_settles_is_forgotten(put, by_listing):
    arrivals = Arrivals(1.0)
    one = put("a.ply", "x")
    arrivals.note(one, 0.0)
    os.unlink(one.path)
    if by_listing:
        arrivals.note_all([], 0.5)
    assert arrivals.pop_complete(1.0) == []
    assert len(arrivals) == 0
    # One of the same size and time is another file.
    arrivals.note(put("a.ply", "x"), 2.0)
    assert names(arrivals.pop_complete(3.0)) == ["a.ply"]


@pytest.mark.parametrize(
    "name", [".a.ply", "~a.ply", "a.ply~", "a.ply.part", "a.ply.CRDOWNLOAD", "a.ply.tmp"]
)
def test_names_of_unfinished_files(name):
    assert is_unfinished_name(name)
    assert is_renamed_from(name, "a.ply")
    assert not is_renamed_from(name, "b.ply")


def test_a_finished_file_is_no_earlier_name_of_another():
    assert not is_unfinished_name("a.ply")
    assert not is_renamed_from("aa.ply", "a.ply")
