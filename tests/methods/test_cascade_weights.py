"""The learned filter's weights: files that do not fit are refused before a kernel reads them."""

from __future__ import annotations

import hashlib
import json

import pytest

from msal_cli.errors import InternalError
from msal_cli.methods._cascade import WEIGHTS, read_networks


def copy_weights(folder, change):
    """The weights of the package in ``folder``, after ``change(header, data) -> data``."""
    header = json.loads((WEIGHTS / "learned.json").read_text(encoding="utf-8"))
    data = change(header, (WEIGHTS / "learned.f32").read_bytes())
    (folder / "learned.f32").write_bytes(data)
    path = folder / "learned.json"
    path.write_text(json.dumps(header), encoding="utf-8")
    return path


def test_a_copy_is_read(tmp_path):
    networks = read_networks(copy_weights(tmp_path, lambda header, data: data))
    assert len(networks) == 3


def test_other_bytes_are_refused(tmp_path):
    path = copy_weights(tmp_path, lambda header, data: data[:-4] + b"\1\2\3\4")
    with pytest.raises(InternalError, match="damaged"):
        read_networks(path)


@pytest.mark.parametrize("layer", range(4))
def test_layers_of_other_sizes_are_refused(tmp_path, layer):
    def change(header, data):
        header["stages"][1][layer] += 1
        return data

    with pytest.raises(InternalError, match="in stage 2"):
        read_networks(copy_weights(tmp_path, change))


def test_too_few_numbers_are_refused(tmp_path):
    def change(header, data):
        header["sha256"] = hashlib.sha256(data[:-4]).hexdigest()
        return data[:-4]

    with pytest.raises(InternalError, match=r"are [\d,]+ numbers instead of"):
        read_networks(copy_weights(tmp_path, change))
