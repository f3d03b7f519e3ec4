"""The joint bilateral mean by hand."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.normal_averages import joint_bilateral

X, Y, NONE = [1.0, 0, 0], [0, 1.0, 0], [0.0, 0, 0]
EACH_OTHER = np.array([0, 1, 2]), np.array([1, 0], dtype=np.int32)


def filtered(normals, guides, areas=(1.0, 3.0), sigma_s=2.0, sigma_r=0.5, near=EACH_OTHER):
    centroids = np.array([[0.0, 0, 0], [0, 0, 3.0]])
    return joint_bilateral(
        np.array(normals), np.array(guides), centroids, np.array(areas), *near, sigma_s, sigma_r
    )


def test_two_faces():
    # Guides differ by 0.6, centroids by 3: e^(-9 / 8) e^(-0.36 / 0.5), times the other's area.
    out = filtered([X, Y], [[0.0, 0, 1], [0.6, 0, 1]])
    weight = np.exp(-9 / 8 - 0.36 / 0.5)
    expected = np.array([[1, 3 * weight, 0], [weight, 3, 0]])
    assert out == pytest.approx(expected / np.linalg.norm(expected, axis=1)[:, None], abs=1e-15)


def test_a_face_without_a_normal_takes_that_of_its_neighbours():
    assert (filtered([NONE, Y], [Y, Y], areas=(0.0, 3.0)) == [Y, Y]).all()


def test_where_the_sum_vanishes_the_normal_is_kept():
    out = filtered([X, [-1.0, 0, 0]], [Y, Y], areas=(1.0, 1.0), sigma_s=1e9)
    assert (out == [X, [-1, 0, 0]]).all()
    assert (filtered([NONE, NONE], [NONE, NONE]) == 0).all()


def test_guides_far_apart_do_not_mix():
    # Exponents end at -700.
    assert np.abs(filtered([X, Y], [X, Y], sigma_r=0.01) - [X, Y]).max() < 1e-300


def test_without_neighbours_nothing_changes():
    alone = np.array([0, 0, 0]), np.empty(0, dtype=np.int32)
    assert (filtered([X, Y], [Y, Y], near=alone) == [X, Y]).all()
