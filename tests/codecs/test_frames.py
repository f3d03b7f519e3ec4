"""The place of a scene's only mesh, which a conversion to a format without scenes loses."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.codecs import convert, gltf, threemf
from msal_cli.codecs.mesh_file import PLACEMENT
from tests.codecs import test_glb
from tests.codecs.plain_3mf import model, package, shape
from tests.codecs.test_threemf import CUBE
from tests.shapes import cube


@pytest.mark.parametrize(
    ("more", "is_placed"),
    [
        ({}, False),
        ({"scale": [1, 1, 1], "translation": [0, 0, 0]}, False),
        ({"scale": [0.01, 0.01, 0.01]}, True),
        ({"translation": [1, 2, 3]}, True),
        ({"scale": [1, 1, 0]}, True),
        ({"scale": ["no number"]}, False),
    ],
)
def test_gltf_losses(more, is_placed):
    scene = test_glb.simple()
    scene.content["nodes"][0] |= more
    file = gltf.read_glb(scene.data(), "")
    assert np.array_equal(file.vertices, cube()[0])
    _, losses = convert(file, file.vertices, "ply", "same", "same")
    assert (PLACEMENT in losses) is is_placed
    _, losses = convert(file, file.vertices, "gltf", "same", "same")
    assert not losses


@pytest.mark.parametrize(
    ("transform", "is_placed"),
    [("1 0 0 0 1 0 0 0 1 0 0 0", False), ("1 0 0 0 1 0 0 0 1 125 105 10", True)],
)
def test_3mf_losses(transform, is_placed):
    build = f'<item objectid="1" transform="{transform}"/>'
    file = threemf.read(package(model(shape(1, CUBE), build)), "")
    assert np.array_equal(file.vertices, cube()[0])
    _, losses = convert(file, file.vertices, "ply", "same", "same")
    assert (PLACEMENT in losses) is is_placed
