"""denoise on arrays: the bits of the command, what stays, and what is refused."""

import json
import logging

import numpy as np
import pytest

import msal_cli as msal
from msal_cli.api.mesh_objects import from_arrays
from tests.cli.scans import msal as run_command
from tests.ply_files import positions_of, to_ply
from tests.shapes import noisy, torus


def scan(around=40, across=20, level=0.15):
    vertices, faces = torus(around, across)
    return noisy(vertices, 3, level), faces


VERTICES, FACES = scan()
TRUST = np.linspace(0.0, 3.0, len(VERTICES))

CASES = {
    "adaptive": ({}, []),
    "msal": ({"K": 0.35, "iterations": 3}, ["-K", "0.35", "-n", "3"]),
    "symbol": (
        {"method": "taubin", "parameters": {"lambda": 0.3}},
        ["--method", "taubin", "--set", "lambda=0.3"],
    ),
    "max_move": ({"max_move": "0.1e"}, ["--max-move", "0.1e"]),
    "units": ({"max_move": np.float64(0.02)}, ["--max-move", "0.02"]),
    "lock": ({"lock": TRUST < 0.5}, ["--lock", "trust < 0.5"]),
    "boundary": ({"lock": "boundary"}, ["--lock", "boundary"]),
    "weights": ({"method": "msal", "weights": TRUST}, ["--method", "msal", "--weights", "trust"]),
    "despike": ({"method": "umbrella", "despike": True}, ["--method", "umbrella", "--despike"]),
    "no despike": ({"despike": False}, ["--no-despike"]),
    "min_noise": ({"min_noise": "5e"}, ["--min-noise", "5e"]),
}


@pytest.mark.parametrize("method", [None, "learned", "auto"])
def test_the_winding_of_a_closed_surface_does_not_matter(method):
    expected = msal.denoise(VERTICES, FACES, method).vertices
    assert np.array_equal(msal.denoise(VERTICES, FACES[:, ::-1], method).vertices, expected)


@pytest.mark.parametrize(
    ("name", "dtype"),
    [*((name, np.float32) for name in CASES), ("adaptive", np.float64), ("msal", np.float64)],
)
def test_the_bits_are_those_of_the_command(tmp_path, name, dtype):
    arguments, options = CASES[name]
    check_against_command(tmp_path, VERTICES.astype(dtype), FACES, arguments, options)


def test_the_bits_of_the_automatic_choice_are_those_of_the_command(tmp_path):
    vertices, faces = scan(24, 12)
    arguments = {"keep": "edges", "strength": 1}
    options = ["--keep", "edges", "--strength", "1"]
    check_against_command(tmp_path, vertices, faces, arguments, options)


def check_against_command(tmp_path, given, faces, arguments, options):
    """Denoise in both ways; positions and records have to agree."""
    before = given.copy()
    result = msal.denoise(given, faces, **arguments)
    trust = TRUST[: len(given)]
    (tmp_path / "in.ply").write_bytes(to_ply(given, faces, trust=trust))
    done = run_command(
        "denoise", tmp_path / "in.ply", "-o", tmp_path / "out.ply", "--json", *options
    )
    assert done.exit_code == 0, done.stderr
    expected = positions_of((tmp_path / "out.ply").read_bytes(), given, 1)
    assert result.vertices.dtype == given.dtype
    assert result.vertices.tobytes() == expected.tobytes()
    assert given.tobytes() == before.tobytes()
    record = json.loads(done.stdout)["records"][0]
    assert result.method == record["method"]["name"]
    assert result.parameters == record["method"]["parameters"]
    assert result.record.locked_vertices == record["locked_vertices"]
    assert result.record.despiked == record["despiked"]
    assert result.record.clamped_vertices == record["clamped_vertices"]
    assert list(result.record.warnings) == record["warnings"]
    assert "--" not in f"{result.warnings} {result.reason}"
    assert result.noise.mean_edges == record["noise_estimate"]["mean_edges"]
    assert result.record.left_alone == record["left_alone"]


@pytest.mark.parametrize(
    "given",
    [
        VERTICES.tolist(),
        np.asfortranarray(VERTICES),
        VERTICES.astype(">f8"),
        np.concatenate([VERTICES, VERTICES])[: len(VERTICES)],
        VERTICES.astype(np.longdouble),
    ],
    ids=["lists", "fortran", "big endian", "a view", "long double"],
)
def test_any_array_of_real_numbers_does(given):
    expected = msal.denoise(VERTICES, FACES, "al").vertices
    for faces in (FACES.tolist(), FACES.astype(np.uint8 if len(FACES) < 256 else np.uint64)):
        result = msal.denoise(given, faces, "al")
        assert np.array_equal(result.vertices, expected)
        assert result.vertices.dtype == np.asarray(given).dtype


def test_indices_lock_as_a_mask_does():
    places = [5, 2, 2, 99]
    mask = np.zeros(len(VERTICES), dtype=bool)
    mask[places] = True
    results = [msal.denoise(VERTICES, FACES, "msal", lock=lock) for lock in (places, mask)]
    assert results[0].vertices.tobytes() == results[1].vertices.tobytes()
    assert np.array_equal(results[0].vertices[mask], VERTICES[mask])
    assert results[0].record.locked_vertices == 3
    none = msal.denoise(VERTICES, FACES, "msal", lock=[])
    assert none.vertices.tobytes() == msal.denoise(VERTICES, FACES, "msal").vertices.tobytes()


def changed(array, value):
    copy = array.copy()
    copy[7, 1] = value
    return copy


def masked_at(values, *rows):
    mask = np.zeros(np.shape(values), dtype=bool)
    mask[list(rows)] = True
    return np.ma.MaskedArray(values, mask)


MESH = (VERTICES, FACES)
CONTENT, USAGE = (msal.ContentError, "E_CONTENT"), (msal.UsageError, "E_USAGE")

REFUSED = {
    "nan": ((changed(VERTICES, np.nan), FACES), {}, msal.ContentError, "E_NONFINITE"),
    "infinite": ((changed(VERTICES, np.inf), FACES), {}, msal.ContentError, "E_NONFINITE"),
    "too large": ((1e70 * VERTICES, FACES), {}, msal.ContentError, "E_RANGE"),
    "a negative index": ((VERTICES, changed(FACES, -1)), {}, msal.ContentError, "E_INDEX"),
    "2D": ((VERTICES[:, :2], FACES), {}, *CONTENT),
    "flat": ((VERTICES.reshape(-1), FACES), {}, *CONTENT),
    "no faces": ((VERTICES, []), {}, msal.ContentError, "E_NO_FACES"),
    "real faces": ((VERTICES, FACES + 0.5), {}, msal.ContentError, "E_INDEX"),
    "complex": ((VERTICES + 1j, FACES), {}, *CONTENT),
    "texts": ((VERTICES.astype(str), FACES), {}, *CONTENT),
    "ragged": (([[0, 0, 0], [1, 0]], FACES), {}, *CONTENT),
    "no mesh": ((VERTICES,), {}, *USAGE),
    "a path": (("scan.ply",), {}, *USAGE),
    "method first": ((VERTICES, "msal"), {}, *USAGE),
    "twice": (MESH, {"K": 1, "parameters": {"K": 1}}, *USAGE),
    "max_move": (MESH, {"max_move": "1mm"}, *USAGE, 'as unit="mm"'),
    "unit": (MESH, {"unit": "parsec", "max_move": "1mm"}, *USAGE, "mil"),
    "parameters": (MESH, {"parameters": [1]}, *USAGE, '"K"'),
    "method": ((*MESH, 5), {}, *USAGE),
    "whole mask": (MESH, {"lock": [0] * len(VERTICES)}, *USAGE, "astype(bool)"),
    "mixed lock": (MESH, {"lock": ["boundary", [1]]}, *USAGE),
    "real indices": (MESH, {"lock": [1.5]}, *USAGE),
    "lock beyond": (MESH, {"lock": [800]}, *USAGE),
    "lock name": (MESH, {"lock": "trust > 1"}, msal.InputError, "E_PROPERTY"),
    "weights short": (MESH, {"weights": [1.0]}, *USAGE),
    "weights nan": (MESH, {"weights": TRUST + np.nan}, msal.ContentError, "E_NONFINITE"),
    "weights 0": (MESH, {"weights": 0 * TRUST}, *CONTENT),
    "weights al": ((*MESH, "al"), {"weights": TRUST}, *USAGE),
    "weights name": (MESH, {"weights": "trust"}, msal.InputError, "E_PROPERTY"),
    "masked": ((masked_at(VERTICES, 3), FACES), {}, *CONTENT, "masked"),
    "masked row": ((list(masked_at(VERTICES, 3)), FACES), {}, *CONTENT, "masked"),
    "masked faces": ((VERTICES, masked_at(FACES, 0)), {}, *CONTENT, "masked"),
    "masked weights": ((*MESH, "msal"), {"weights": masked_at(TRUST, 5)}, *USAGE, "masked"),
    "masked lock": (MESH, {"lock": masked_at(TRUST < 0.5, 5)}, *USAGE, "masked"),
    "counted from 1": ((VERTICES, FACES + 1), {}, msal.ContentError, "E_INDEX", "give faces - 1"),
    "vertices in columns": ((VERTICES.T, FACES), {}, *CONTENT, "give vertices.T"),
    "faces in columns": ((VERTICES, FACES.T), {}, *CONTENT, "give faces.T"),
    "faces in a row": ((VERTICES, FACES.reshape(-1)), {}, *CONTENT, "give faces.reshape(-1, 3)"),
    "quads": ((VERTICES, FACES[:, [0, 1, 2, 2]]), {}, *CONTENT, "faces[:, [0, 2, 3]]"),
    "counted rows": ((VERTICES, np.insert(FACES, 0, 3, axis=1)), {}, *CONTENT, "give faces[:, 1:]"),
    "other vertices": ((VERTICES[:9], FACES), {}, msal.ContentError, "E_INDEX", "0 to 8"),
    "max_mov": (MESH, {"max_mov": 1}, *USAGE, "did you mean max_move?"),
    "k": (MESH, {"k": 0.5}, *USAGE, "did you mean K?"),
    "auto": (MESH, {"auto": True}, *USAGE, 'did you mean method="auto"?'),
    "iteration": ((*MESH, "al"), {"iteration": 2}, *USAGE, "did you mean iterations?"),
    "msla": ((*MESH, "msla"), {}, *USAGE, "did you mean msal"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name):
    positional, keywords, error_class, code, *words = REFUSED[name]
    with pytest.raises(msal.MsalError) as caught:
        msal.denoise(*positional, **keywords)
    assert type(caught.value) is error_class
    assert caught.value.code == code
    places = {"nan": "vertex 7", "infinite": "vertex 7", "a negative index": "face 7"}
    assert caught.value.where.startswith(places.get(name, ""))
    # A traceback shows the notes, and the hint with them.
    notes = " ".join(caught.value.__notes__)
    assert code in notes and (caught.value.hint in notes)
    text = f"{caught.value} {caught.value.hint}"
    assert "--" not in text and "damaged" not in text and all(word in text for word in words)


def test_nothing_is_printed_and_no_warning_reaches_standard_error(capfd):
    msal.denoise(VERTICES, FACES, "umbrella", iterations=30)
    logging.getLogger("msal.test").warning("nobody listens")
    assert capfd.readouterr() == ("", "")


def test_a_position_that_the_type_cannot_hold():
    mesh = from_arrays(VERTICES.astype(np.float16), FACES)
    with pytest.raises(msal.ContentError) as caught:
        mesh.to_given_type(1e5 * VERTICES)
    assert caught.value.code == "E_RANGE"
