"""The figures of a moved surface against plain sums, by hand, and for any number of threads."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels import geometry as core
from msal_cli.kernels.geometry import area_and_volume
from tests.shapes import noisy, torus


def normal_angles(before, after, faces):
    """By the arccosine, which has its digits where angles are not tiny."""
    units = []
    for vertices in (before, after):
        a, b, c = vertices[faces.T]
        normals = np.cross(b - a, c - a)
        units.append(normals / np.linalg.norm(normals, axis=1)[:, None])
    return np.arccos((units[0] * units[1]).sum(axis=1))


def test_they_are_those_of_one_face_after_another():
    before, faces = torus(60, 30)
    after = noisy(before, 3)
    figures = core.surface_figures(before, after, faces)
    angles = normal_angles(before, after, faces)
    area, volume = area_and_volume(after, faces)
    assert figures[core.DOUBLED_AREA_AFTER] / 2 == pytest.approx(area, rel=1e-13)
    assert figures[core.SIXFOLD_VOLUME_AFTER] / 6 == pytest.approx(volume, rel=1e-12)
    assert figures[core.ANGLES] == pytest.approx(angles.sum(), rel=1e-9)
    assert figures[core.LARGEST_ANGLE] == pytest.approx(angles.max(), rel=1e-9)
    assert figures[core.FLIPPED] == (angles > np.pi / 2).sum()
    assert figures[core.COMPARED] == len(faces)


def test_threads_do_not_change_a_bit(monkeypatch):
    before, faces = torus(400, 200)
    after = noisy(before, 1)
    found = []
    for threads in ("1", "3"):
        monkeypatch.setenv("MSAL_THREADS", threads)
        found.append(core.surface_figures(before, after, faces))
    assert found[0].tobytes() == found[1].tobytes()
