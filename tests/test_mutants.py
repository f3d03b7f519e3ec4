"""Damaged files through the whole pipeline: a typed failure or a whole output, and nothing else.

The codecs' own tests look closely at reading; here it is the promise to the user that counts.
`pytest -m slow tests/test_mutants.py` runs 10,000 mutants of every format.
"""

from __future__ import annotations

import random

import numpy as np
import pytest

from msal_cli import codecs
from msal_cli.job import pipeline
from msal_cli.job.settings import Task
from tests.job.test_pipeline import WRITERS, settings
from tests.shapes import noisy, torus

BYTES = [b"\0", b"\xff", b"\n", b" ", b"-", b"nan", b"1e999", b"9" * 30, b"#", b"\\\n", b"\x80\x3f"]


def mutants(seed: bytes, number: int, start: int):
    """``number`` damaged copies: bytes changed, inserted, cut out, doubled, the end cut off."""
    for k in range(start, start + number):
        rng = random.Random(k)
        data = bytearray(seed)
        for _ in range(rng.choice([1, 1, 1, 2, 5])):
            at = rng.randrange(len(data) + 1)
            kind = rng.randrange(6)
            if kind == 0 and at < len(data):
                data[at] = rng.randrange(256)
            elif kind == 1 and at < len(data):
                data[at] ^= 1 << rng.randrange(8)
            elif kind == 2:
                data[at:at] = rng.choice(BYTES)
            elif kind == 3:
                del data[at : at + rng.randrange(1, 40)]
            elif kind == 4:
                data[at:at] = data[at : at + rng.randrange(1, 200)]
            elif rng.random() < 0.2:
                del data[at:]
        yield bytes(data)


def campaign(name: str, folder, number: int, start: int) -> tuple[int, int]:
    """Run mutants of a small scan through ``denoise_file``; (written, refused)."""
    vertices, faces = torus(7, 5)
    seed = WRITERS[name](noisy(vertices, 3, 0.1), faces)
    source, target = folder / name, folder / "out" / name
    target.parent.mkdir()
    written = refused = 0
    chosen = settings(iterations=2)
    for data in mutants(seed, number, start):
        source.write_bytes(data)
        record = pipeline.denoise_file(Task(str(source), str(target), name), chosen)
        if record.error is None:
            written += 1
            before = codecs.open_mesh(data, name)
            after = codecs.open_mesh(target.read_bytes(), name)
            if before.format == "stl":  # rounding may put two corners at one place
                assert after.faces.shape == before.faces.shape
            else:
                assert (after.faces == before.faces).all()
            assert np.isfinite(after.vertices).all()
            target.unlink()
        else:
            refused += 1
            assert record.error.code != "E_INTERNAL", (record.error, data)
            assert record.error.message
        assert not list(target.parent.iterdir()), "something was left behind"
    return written, refused


@pytest.mark.parametrize("name", WRITERS)
def test_mutants(name, tmp_path):
    written, refused = campaign(name, tmp_path, 250, 0)
    assert written > 10
    assert refused > 10


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_many_mutants(name, tmp_path):
    campaign(name, tmp_path, 10_000, 1_000)
