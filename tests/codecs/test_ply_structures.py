"""PLY files of random structure against a plain writer and reader of the tests' own."""

import itertools
import re
import struct
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.codecs import ply, ply_body
from msal_cli.errors import InputError, MsalError
from msal_cli.kernels import parallel
from tests.codecs import plain_ply
from tests.codecs.patching import any_float, any_integer, rewritten
from tests.codecs.plain_ply import FLOATS, PACK, Element, Ply, single
from tests.ply_files import XYZ, to_ascii_ply

INTEGERS = [name for name in PACK if name not in FLOATS]
SMALL = [name for name in INTEGERS if not name.endswith("64")]


def scalar(random: Random, kind: str) -> float:
    if kind in FLOATS:
        return single(any_float(random, 1e6)) + 0.0
    # What is beyond 2^53 does not become binary.
    bits = min(8 * struct.calcsize("<" + PACK[kind]), 53)
    low = 0 if PACK[kind].isupper() else -(1 << (bits - 1))
    return any_integer(random, low, low + (1 << bits) - 1)


def extras(random: Random, prefix: str, most: int = 3):
    """Some properties (name, type, count type)."""
    return [
        (f"{prefix}{k}", random.choice([*PACK]), random.choice(["", random.choice(SMALL)]))
        for k in range(random.randint(0, most))
    ]


def rows_of(random: Random, properties, count):
    def value(kind, count_kind):
        if not count_kind:
            return scalar(random, kind)
        return [scalar(random, kind) for _ in range(random.randint(0, 3))]

    return [[value(*types) for _, *types in properties] for _ in range(count)]


def structure(random: Random, encodings) -> Ply:
    def shuffled(values):
        return random.sample(values, len(values))

    def floats(*names):
        return [(name, random.choice(FLOATS), "") for name in names]

    def normals():
        return floats("nx", "ny", "nz") if random.random() < 0.5 else []

    n = random.randint(4, 8)
    properties = shuffled(floats(*"xyz") + normals() + extras(random, "v"))
    vertex = Element("vertex", properties, rows_of(random, properties, n))

    corner = (random.choice(["vertex_indices", "vertex_index"]),)
    corner += (random.choice(INTEGERS), random.choice(SMALL))
    properties = shuffled([corner, *normals(), *extras(random, "f", 2)])
    rows = rows_of(random, properties, random.randint(1, 6))
    least, most = random.choice([(3, 3), (4, 4), (3, 5), (0, 5)])
    at = properties.index(corner)
    for row in rows:
        row[at] = random.choices(range(n), k=random.randint(least, most))
    rows[0][at] = list(range(max(3, least)))
    elements = [vertex, Element("face", properties, rows)]
    if random.random() < 0.5:
        kind = random.choice(["int", "int32", "short", "char", "int64"])
        strips = [
            [random.choices(range(-1, n), k=random.randint(0, 9))]
            for _ in range(random.randint(0, 3))
        ]
        elements.append(Element("tristrips", [("vertex_indices", kind, "int")], strips))
    for k in range(random.randint(0, 2)):
        properties = extras(random, "u", 4)
        rows = rows_of(random, properties, random.randint(0, 3))
        elements.append(Element(f"user{k}", properties, rows))
    encoding = random.choice(encodings)
    comments = ["comment hello", "obj_info 3", "comment end_header "]
    return Ply(
        encoding,
        shuffled(elements),
        random.choices(comments, k=random.randint(0, 3)),
        random.choice(["\n", "\r\n", "\r"]) if encoding == "ascii" else "\n",
        b"" if encoding == "ascii" else random.choice([b"", b"\x00tail"]),
    )


def structures(*encodings):
    return st.builds(
        structure, st.randoms(use_true_random=True), st.just(encodings or plain_ply.ENCODINGS)
    )


def positions(file: Ply) -> np.ndarray:
    vertex = file.element("vertex")
    return np.array([[float(row[vertex.column(axis)]) for axis in "xyz"] for row in vertex.rows])


def text_rounding(vertices: np.ndarray) -> float:
    """The rounding that ascii output may bring: 1e-7 of the extent."""
    return 0.5e-7 * float(np.linalg.norm(np.ptp(vertices, axis=0))) * (1 + 1e-9) + 1e-9


def rounded(values, kind: str):
    """Values, or lists of them, as the number type holds them: text tells more than a float."""
    if PACK[kind] != "f":
        return values
    return [rounded(v, kind) if isinstance(v, list) else single(v) for v in values]


def moved(vertices: np.ndarray) -> np.ndarray:
    """Some vertices moved along some axes, others not."""
    result = vertices.copy()
    result[::2, 0] += 0.37
    result[1::3] *= 1.25
    return result


def normal_names(file: Ply) -> list[tuple[str, str]]:
    names = [name for name, _, _ in file.element("vertex").properties]
    return [("vertex", name) for name in names if name in ("nx", "ny", "nz")]


@given(structures())
def test_what_is_read_is_what_was_written(file):
    data = plain_ply.written(file)
    mesh = ply.read(data)
    assert np.array_equal(mesh.vertices, positions(file))
    assert mesh.faces.tolist() == plain_ply.triangles(file)
    assert mesh.faces.dtype == np.int32
    strips = len(mesh.faces) - sum(
        max(len(row[k]) - 2, 0)
        for row in file.element("face").rows
        for k, p in enumerate(file.element("face").properties)
        if p[0].startswith("vertex_ind")
    )
    assert mesh.n_polygons == len(file.element("face").rows) + strips
    assert mesh.encoding == file.encoding
    assert bytes(mesh.replaced(mesh.vertices.copy())) == data


@given(structures("ascii"))
def test_ascii_differs_in_moved_tokens_only(file):
    data = plain_ply.written(file)
    mesh = ply.read(data)
    vertices = moved(mesh.vertices)
    output = rewritten(mesh, vertices)
    result = plain_ply.read(output)
    assert np.abs(positions(result) - vertices).max() <= text_rounding(mesh.vertices)
    # Token for token and blank for blank: only coordinates that differ, and normals, may.
    pieces = [re.split(rb"(\s+)", text) for text in (data, output)]
    assert len(pieces[0]) == len(pieces[1])
    n_moved = int((vertices != mesh.vertices).sum())
    differing = sum(a != b for a, b in zip(*pieces, strict=True))
    n_normals = sum(3 * len(file.element(e).rows) for e, name in normal_names(file) if name == "nx")
    assert differing <= n_moved + n_normals


@given(structures())
def test_encoded_keeps_all_but_encoding_and_types(file):
    mesh = ply.read(plain_ply.written(file))
    vertices = moved(mesh.vertices)
    assert rewritten(mesh, vertices) == bytes(mesh.encoded(vertices, "same", "same"))
    ways = itertools.product(("same", "ascii", "binary"), ("same", "float32", "float64"))
    for encoding, precision in ways:
        require_encoded(file, mesh, vertices, encoding, precision)


def require_encoded(file, mesh, vertices, encoding, precision):
    output = bytes(mesh.encoded(vertices, encoding, precision))
    result = plain_ply.read(output)
    assert (
        result.encoding
        == {"same": file.encoding, "ascii": "ascii", "binary": "binary_little_endian"}[encoding]
    )
    assert result.comments == list(file.comments)
    assert result.newline == file.newline
    if result.encoding == file.encoding:
        assert result.trailing == file.trailing
    normals = normal_names(file)
    for before, after in zip(file.elements, result.elements, strict=True):
        assert before.name == after.name
        for k, (old, new) in enumerate(zip(before.properties, after.properties, strict=True)):
            axis = "xyz".find(old[0]) if before.name == "vertex" else -1
            is_free = axis >= 0 or (before.name, old[0]) in normals
            if is_free and precision != "same":
                wide = {"float32": "f", "float64": "d"}[precision]
                assert new[0] == old[0] and PACK[new[1]] == wide and not new[2]
                assert new[1][-1].isdigit() == old[1][-1].isdigit()
            else:
                assert new == old
            got = [row[k] for row in after.rows]
            if (before.name, old[0]) in normals:
                continue
            if axis < 0:
                assert rounded(got, old[1]) == [row[k] for row in before.rows]
                continue
            wanted = vertices[:, axis].tolist()
            got, wanted = rounded(got, new[1]), rounded(wanted, new[1])
            if file.encoding == result.encoding == "ascii":
                slack = text_rounding(mesh.vertices)
                assert np.allclose(got, wanted, rtol=2e-7, atol=slack)
            else:
                assert got == wanted
    again = ply.read(output)
    assert np.array_equal(again.faces, mesh.faces)


# Ascii: one walk, and the walk that keeps the place of every word

ODD_SPELLINGS = {
    b" ": [b" ", b"  ", b"\t"],
    b"\n": [b"\n", b" \n", b"\n\n"],
    b"1.0": [b"1.0", b"+1", b"1.", b"1e0", b"100.0E-2", b"1.0000000000000"],
}


def outcome(data: bytes, seed: int) -> list[Any]:
    """What is read and written of a file, or the error."""
    try:
        file = ply.read(data)
    except InputError as error:
        return [str(error), error.where]
    vertices = file.vertices.copy()
    vertices += np.random.default_rng(seed).normal(size=vertices.shape) * [[1e-2, 1e-9, 0.0]]
    output = rewritten(file, vertices)
    arrays = (file.vertices, file.faces)
    return [*(one.tobytes() for one in arrays), file.n_polygons, file.warnings, output]


@given(structures("ascii"), st.randoms(use_true_random=True), st.binary(max_size=2))
def test_both_walks_read_and_write_the_same(file, random, noise):
    head, end, body = plain_ply.written(file).partition(b"end_header" + file.newline.encode())
    body = re.sub(rb" |\n|\b1\.0\b", lambda found: random.choice(ODD_SPELLINGS[found[0]]), body)
    at = random.randrange(len(body))
    data, seed = head + end + body[:at] + noise + body[at + len(noise) :], len(body)
    plain = outcome(data, seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MSAL_THREADS", "3")
        patch.setattr(parallel, "MIN_COUNT", 1)
        assert plain == outcome(data, seed)
        patch.setattr(ply_body, "_plain_lines", lambda *_: None)
        assert plain == outcome(data, seed)


def test_a_normal_that_stays_keeps_its_spelling(monkeypatch):
    names = ("double x", "double y", "double z", "double nx", "double ny", "double nz")
    rows = [f"{place} 0 -0.0 1.00" for place in ("0 0 0", "1 0 0", "0 1 0")]
    for is_slow in (False, True):
        if is_slow:
            monkeypatch.setattr(ply_body, "_plain_lines", lambda *_: None)
        file = ply.read(to_ascii_ply(names, rows))
        lines = bytes(file.replaced(file.vertices * [[2.0, 1.0, 1.0]])).splitlines()
        vertices = lines[lines.index(b"end_header") + 1 :][:3]
        assert [line.split(b" ", 3)[3] for line in vertices] == [b"0 -0.0 1.00"] * 3
        assert vertices[1].startswith(b"2")


@pytest.mark.parametrize("line", ["# one", "comment one", "0 0 0.25 comment"])
def test_other_words_among_records_are_refused(line):
    with pytest.raises(MsalError):
        ply.read(to_ascii_ply(XYZ, ["0 0 0", f"{line}\n1 0 0", "0 1 0"]))
