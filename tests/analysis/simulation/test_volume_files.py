"""Meshes out of volume files."""

from __future__ import annotations

import io

import numpy as np
import pytest

from msal_cli.analysis.simulation.volume_files import VolumeSettings, mesh_volume, read_npy
from msal_cli.errors import (
    ContentError,
    FormatError,
    InputError,
    TooLargeError,
    TruncatedError,
    UsageError,
)
from msal_cli.kernels.geometry import area_and_volume

pytest.importorskip("skimage")


def box_volume(dtype=np.uint8):
    """Values (nz, ny, nx) of 200 in a box of 4 x 3 x 2 voxels about (4, 3, 2.5), 0 elsewhere."""
    volume = np.zeros((6, 7, 9), dtype=dtype)
    volume[2:4, 2:5, 3:7] = 100 if dtype == np.int8 else 200
    return volume


def npy(array, **options):
    stream = io.BytesIO()
    np.save(stream, array, **options)
    return stream.getvalue()


def test_the_axes_are_z_y_x_and_the_surface_looks_outwards():
    vertices, faces, iso = mesh_volume(npy(box_volume()), VolumeSettings())
    assert iso == 100.0
    assert vertices.min(axis=0) == pytest.approx([2.5, 1.5, 1.5])
    assert vertices.max(axis=0) == pytest.approx([6.5, 4.5, 3.5])
    assert 0.7 * 24.0 < area_and_volume(vertices, faces)[1] < 24.0


def test_spacing_stretches_and_iso_shifts_the_surface():
    settings = VolumeSettings(iso=50.0, spacing=(1.0, 0.5, 3.0))
    vertices, _, iso = mesh_volume(npy(box_volume()), settings)
    assert iso == 50.0
    assert vertices.min(axis=0) == pytest.approx([2.25, 0.625, 3.75])


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">i2", "<i4", "<f4", ">f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_every_type_and_order_gives_the_same_mesh(dtype, order):
    expected = mesh_volume(npy(box_volume()), VolumeSettings())
    array = np.asarray(box_volume().astype(dtype), order=order)
    made = mesh_volume(npy(array), VolumeSettings())
    assert np.array_equal(made[0], expected[0])
    assert np.array_equal(made[1], expected[1])


def test_flags_are_a_volume_too():
    made = mesh_volume(npy(box_volume() > 0), VolumeSettings())
    assert np.array_equal(made[0], mesh_volume(npy(box_volume()), VolumeSettings())[0])


@pytest.mark.parametrize(("name", "dtype"), [("uint8", "u1"), ("int16", "<i2"), ("float32", "<f4")])
def test_raw_numbers_run_along_x_first(name, dtype):
    settings = VolumeSettings(counts=(9, 7, 6), number_type=name)
    made = mesh_volume(box_volume().astype(dtype).tobytes(), settings)
    expected = mesh_volume(npy(box_volume()), VolumeSettings())
    assert np.array_equal(made[0], expected[0])


def test_every_prefix_of_a_file_is_refused():
    data = npy(box_volume())
    for length in (*range(130), *range(130, len(data), 37)):
        with pytest.raises(InputError):
            mesh_volume(data[:length], VolumeSettings())


def test_counts_are_checked_before_anything_is_read():
    data = npy(box_volume()).replace(b"(6, 7, 9)", b"(6000, 7000, 9000)")
    with pytest.raises(TooLargeError):
        read_npy(data)
    with pytest.raises(TruncatedError):
        read_npy(npy(box_volume()).replace(b"(6, 7, 9)", b"(6, 7, 99)"))


@pytest.mark.parametrize(
    ("array", "named"),
    [
        (np.zeros((4, 4)), "2 axes"),
        (np.zeros((2, 2, 2, 2)), "4 axes"),
        (np.zeros((4, 4, 4), dtype=complex), "type complex128"),
        (np.array([[["a"]]]), "type <U1"),
        (np.zeros((3, 3, 3), dtype=[("a", "f4")]), "of type"),
        (np.zeros((0, 5, 6)), "6 x 5 x 0 voxels"),
        (np.eye(4)[None], "4 x 4 x 1 voxels"),
    ],
)
def test_arrays_that_are_no_volume_of_numbers(array, named):
    with pytest.raises(ContentError, match=named):
        mesh_volume(npy(array), VolumeSettings())


def test_objects_are_not_unpickled():
    data = npy(np.array([[[{}]]], dtype=object), allow_pickle=True)
    with pytest.raises(ContentError, match="type object"):
        mesh_volume(data, VolumeSettings())


def test_values_that_are_not_finite():
    volume = box_volume().astype(float)
    volume[0, 0, 0] = np.nan
    with pytest.raises(ContentError, match="not finite"):
        mesh_volume(npy(volume), VolumeSettings())
    volume[0, 0, 0] = 1e300
    with pytest.raises(ContentError, match="not finite"):
        mesh_volume(npy(volume), VolumeSettings())


def test_a_value_that_no_voxel_reaches():
    for iso in (-1.0, 200.0, 1e9):
        with pytest.raises(ContentError, match=r"no surface at .*values from 0 to 200"):
            mesh_volume(npy(box_volume()), VolumeSettings(iso=iso))
    with pytest.raises(ContentError, match="every voxel has the value 7"):
        mesh_volume(npy(np.full((3, 3, 3), 7)), VolumeSettings())


def test_the_counts_of_a_npy_file_are_its_own():
    with pytest.raises(FormatError) as caught:
        mesh_volume(npy(box_volume()), VolumeSettings(counts=(9, 7, 6)))
    assert "leave out --dims" in caught.value.hint


def test_a_header_that_is_cut_off_is_truncated_and_not_of_another_format():
    with pytest.raises(TruncatedError, match="within the header"):
        read_npy(npy(box_volume())[:60])


def test_a_spacing_beyond_the_limits_is_named_with_them():
    with pytest.raises(UsageError, match=r"1e\+200,1,1; .* from 1e-30 to 1e\+30"):
        VolumeSettings(spacing=(1e200, 1.0, 1.0))


def test_raw_files_of_another_size():
    settings = VolumeSettings(counts=(9, 7, 6))
    with pytest.raises(TruncatedError, match="378 bytes"):
        mesh_volume(b"\0" * 377, settings)
    with pytest.raises(FormatError, match="378 bytes"):
        mesh_volume(b"\0" * 379, settings)


@pytest.mark.parametrize(
    "settings",
    [
        {"spacing": (0.0, 1.0, 1.0)},
        {"spacing": (float("nan"), 1.0, 1.0)},
        {"counts": (0, 1, 1)},
        {"number_type": "float16"},
        {"iso": float("inf")},
    ],
)
def test_settings_that_mean_nothing_are_refused(settings):
    with pytest.raises(UsageError):
        VolumeSettings(**settings)
