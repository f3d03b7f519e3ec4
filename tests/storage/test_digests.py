"""Hashes that are worked out while something else is done."""

from __future__ import annotations

import hashlib

import pytest

from msal_cli.storage.gzip_streams import THREAD_BYTES, sha256_meanwhile


@pytest.mark.parametrize("size", [0, 1000, THREAD_BYTES, THREAD_BYTES + 1])
@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_they_are_those_of_the_bytes(size, kind):
    data = bytes(k % 251 for k in range(1000)) * (size // 1000 + 1)
    data = data[:size]
    wait = sha256_meanwhile(kind(data))
    assert wait() == wait() == hashlib.sha256(data).hexdigest()
