"""The state of a tile between two rounds."""

from __future__ import annotations

import os

import numpy as np
import pytest

from msal_cli.tiles import part_files


@pytest.mark.parametrize("can_link", [True, False])
def test_unchanged_arrays_are_not_written_again(monkeypatch, tmp_path, can_link):
    first = {"kept": np.arange(5.0), "changed": np.arange(3), "none": np.empty(0)}
    part_files.save_state(tmp_path, 0, first, {})
    saved = part_files.load_state(tmp_path, 0)
    if not can_link:
        monkeypatch.setattr(os, "link", refuse)
    state = {"new": np.zeros(2), "kept": saved["kept"], "changed": saved["changed"] + 1}
    (tmp_path / "state-1").mkdir()
    (tmp_path / "state-1/1.npy").write_bytes(b"half")
    for _ in range(2):
        part_files.save_state(tmp_path, 1, state, saved)
    before, after = tmp_path / "state-0/0.npy", tmp_path / "state-1/1.npy"
    assert before.samefile(after) == can_link
    assert sorted(one.name for one in after.parent.iterdir()) == [
        "0.npy",
        "1.npy",
        "2.npy",
        "names.json",
    ]
    part_files.remove_state(tmp_path, 0)
    again = part_files.load_state(tmp_path, 1)
    assert list(again) == ["new", "kept", "changed"]
    for name, array in state.items():
        np.testing.assert_array_equal(again[name], array)


def refuse(*_: object) -> None:
    raise OSError("no links here")
