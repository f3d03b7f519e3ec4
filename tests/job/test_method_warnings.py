"""Warnings about methods that harm a mesh."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.added_noise import add_plain_noise
from msal_cli.job.changes import is_ruled_by_spike, method_warnings
from msal_cli.job.records import Displacement, NoiseEstimate
from msal_cli.mesh import prepare_mesh
from tests.cli.scans import msal, ply_text, record_of
from tests.shapes import torus


def scan_with(path, level, spike=0.0):
    """A torus with noise, and one vertex further out, both in mean edge lengths."""
    vertices, faces = torus(60, 30)
    mesh = prepare_mesh(vertices, faces).mesh
    made = add_plain_noise(mesh, "gaussian-normal", level, 1)
    made[100] += spike * mesh.mean_edge_length * mesh.vertex_normals("uniform")[100]
    path.write_bytes(ply_text(made, faces))
    return path


def warnings_of(scan, *words):
    output = scan.with_name("out.ply")
    return record_of(msal("denoise", scan, "-o", output, "--force", "--json", *words))["warnings"]


def test_no_noise_to_speak_of(tmp_path):
    scan = scan_with(tmp_path / "a.ply", 0.0)
    (warning,) = warnings_of(scan, "--method", "taubin")
    assert warning.startswith("no noise to speak of, and taubin moved vertices by 0.")
    assert "--min-noise auto leaves such meshes as they are" in warning
    assert warnings_of(scan, "--method", "msal", "-n", "0") == []
    assert warnings_of(scan) == []


@pytest.mark.parametrize(
    ("words", "is_too_much"),
    [
        (("-n", "4"), True),
        (("--method", "al", "--schedule", "multiscale"), True),
        (("--schedule", "robust"), True),
        (("--schedule", "wiener"), False),
        (("--method", "al"), False),
        (("--auto",), False),
        ((), False),
    ],
)
def test_noise_beyond_what_the_method_is_made_for(tmp_path, words, is_too_much):
    scan = scan_with(tmp_path / "a.ply", 0.3)
    warnings = warnings_of(scan, *words)
    assert any("is more than" in warning and "--auto" in warning for warning in warnings) == (
        is_too_much
    )


@pytest.mark.parametrize(("unsure", "count"), [(False, 1), (True, 0)])
def test_no_advice_where_noise_may_be_texture(unsure, count):
    found = methods.find("msal")
    noise = NoiseEstimate(0.3, 0.1, 0.0, 0.4, negligible=False, unsure=unsure)
    moved = Displacement(*[0.1] * 8, moved_vertices=100)
    assert len(method_warnings(found, found.validate({}), noise, moved, False)) == count


def test_a_spike_that_rules_lambda(tmp_path):
    spiked = scan_with(tmp_path / "a.ply", 0.1, spike=10.0)
    (warning,) = warnings_of(spiked, "--method", "msal")
    assert "--schedule robust" in warning
    assert warnings_of(spiked, "--method", "msal", "--schedule", "robust") == []
    plain = scan_with(tmp_path / "b.ply", 0.1)
    assert warnings_of(plain, "--method", "msal") == []


def test_a_spike_is_seen_in_the_sample():
    fidelity = np.full(100_000, 0.05)
    fidelity[77_777] = 1.0
    assert is_ruled_by_spike(fidelity)
    assert not is_ruled_by_spike(np.linspace(0.0, 1.0, 100_000))
    assert not is_ruled_by_spike(np.zeros(10))
    assert not is_ruled_by_spike(None)


def test_most_noise_is_asked_of_the_method():
    msal_method, taubin = methods.find("msal"), methods.find("taubin")
    assert msal_method.most_noise_edges(msal_method.validate({})) == 0.15
    assert taubin.most_noise_edges(taubin.validate({})) == float("inf")
