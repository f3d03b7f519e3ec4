"""Reading whole files, hashes, and gzip with a bound."""

import gzip
import hashlib
import os
import random
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.errors import InputError, MsalError, TooLargeError
from msal_cli.storage import gzip_streams as streams


@given(st.lists(st.binary(max_size=5000), min_size=1, max_size=4))
def test_members_are_joined(parts):
    data = b"".join(gzip.compress(part, mtime=0) for part in parts)
    assert streams.expand(data, "a.ply.gz") == b"".join(parts)


@given(st.binary(max_size=100_000))
def test_what_is_compressed_expands_again(data):
    packed = streams.compress(data)
    assert gzip.decompress(packed) == data
    assert streams.expand(packed, "x.stl.GZ") == data
    # It has no time, name or system.
    assert packed[:10] == b"\x1f\x8b\x08\x00\0\0\0\0\x00\xff"
    assert packed == streams.compress(bytearray(data)) == streams.compress(memoryview(data))


def _flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :]


PACKED = gzip.compress(bytes(range(256)) * 40, mtime=0)


# Each goes through the whole way of a file in tests/test_sample_meshes.py.
DAMAGED = {
    "empty": (b"", "E_TRUNCATED"),
    "not compress": (b"ply\nformat ascii 1.0\n", "E_FORMAT"),
    "half a magic number": (b"\x1f", "E_FORMAT"),
    "magic number alone": (b"\x1f\x8b", "E_TRUNCATED"),
    "cut in the second member": (PACKED + PACKED[:20], "E_TRUNCATED"),
    "half a second magic number": (PACKED + b"\x1f", "E_TRUNCATED"),
    "wrong checksum": (_flipped(PACKED, len(PACKED) - 5), "E_FORMAT"),
    "wrong length": (_flipped(PACKED, len(PACKED) - 1), "E_FORMAT"),
    "unknown method": (_flipped(PACKED, 2), "E_FORMAT"),
    "damaged data": (_flipped(PACKED, 30), "E_FORMAT"),
    "garbage behind": (PACKED + b"garbage", "E_FORMAT"),
    "bomb": (streams.compress(bytes(1 << 20)) * 33, "E_TOO_LARGE"),
}


def test_every_prefix_and_flip_of_a_gzip_file_is_data_or_an_error():
    whole = streams.compress(b"v 1 2 3\n" * 50)
    variants = [whole[:k] for k in range(len(whole))]
    variants += [_flipped(whole, k) for k in range(len(whole))]
    for variant in variants:
        try:
            data = streams.expand(variant, "a.obj.gz")
        except MsalError:
            continue
        # Only the header's time, flags and system byte are not protected by the checksum.
        assert data == b"v 1 2 3\n" * 50


def test_a_bomb_is_refused_without_being_expanded(monkeypatch):
    resource = pytest.importorskip("resource")
    bomb = bytes(streams.compress(bytes(4 << 20))) * 100
    limit = 6 << 20
    monkeypatch.setattr(streams, "ALWAYS_EXPANDED", limit)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(TooLargeError):
        streams.expand(bomb, "bomb.stl.gz")
    unit = 1 if sys.platform == "darwin" else 1024
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit
    assert grown < 4 * limit


def test_the_default_limit_is_a_size_that_is_always_allowed_or_a_ratio(monkeypatch):
    assert streams.MAX_RATIO < 1000 < 16 << 20 < streams.ALWAYS_EXPANDED
    monkeypatch.setattr(streams, "ALWAYS_EXPANDED", 100_000)
    assert len(streams.expand(streams.compress(bytes(100_000)), "a.gz")) == 100_000
    with pytest.raises(TooLargeError):
        streams.expand(streams.compress(bytes(100_001)), "a.gz")
    # No better compressed than the ratio: any size.
    noise = random.Random(1).randbytes(300_000)
    assert len(streams.expand(streams.compress(noise), "a.gz")) == 300_000


def test_reading_a_file_and_its_failures(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(b"\x00\xff")
    assert streams.read_whole(path) == b"\x00\xff"
    assert streams.read_whole(str(path)) == b"\x00\xff"
    for size in (0, 1, 5 << 20):
        data = bytes(size)
        path.write_bytes(data)
        read = streams.read_whole(path)
        assert bytes(read) == data
        assert memoryview(read).readonly and isinstance(read, memoryview) == (size > 1)
    for bad in (tmp_path / "missing", tmp_path, "a\0b"):
        with pytest.raises(InputError) as caught:
            streams.read_whole(bad)
        assert caught.value.code == "E_READ"
        assert caught.value.path == str(bad)


@pytest.mark.parametrize("large_bytes", [1, 100])
def test_a_file_that_grows_while_it_is_read_is_read_whole(tmp_path, monkeypatch, large_bytes):
    monkeypatch.setattr("msal_cli.storage.regular.LARGE_BYTES", large_bytes)
    path = tmp_path / "a.ply"
    path.write_bytes(b"x" * 1000)
    real_fstat = os.fstat

    def smaller(handle):
        status = list(real_fstat(handle))
        status[6] = 10
        return os.stat_result(status)

    monkeypatch.setattr(os, "fstat", smaller)
    assert bytes(streams.read_whole(path)) == b"x" * 1000


@pytest.mark.parametrize("size", [0, 1000, streams.THREAD_BYTES, streams.THREAD_BYTES + 1])
@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_they_are_those_of_the_bytes(size, kind):
    data = bytes(k % 251 for k in range(1000)) * (size // 1000 + 1)
    data = data[:size]
    wait = streams.sha256_meanwhile(kind(data))
    assert wait() == wait() == hashlib.sha256(data).hexdigest()
