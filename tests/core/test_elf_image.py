"""Object files in memory: they run as LLVM would run them, and odd ones are refused."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from msal_cli.core import elf_image, machine_code
from msal_cli.core.compiled import Kernel, compiled, kind
from msal_cli.core.elf_image import Image, UnknownObjectError

pytestmark = pytest.mark.skipif(not elf_image.is_usable(), reason="object files of other systems")

TABLE = np.array([3.0, 5.0, 7.0])


@compiled
def much(values, count):
    """Constants, a table, memory of its own, a function of the library, two results."""
    room = np.zeros(count)
    for i in range(count):
        room[i] = np.arctan2(values[i], TABLE[i % 3]) + np.log10(1.0 + TABLE[0])
    total = 0.0
    for i in range(count):
        total += room[i]
    return total, count > 2


def code_of(kernel, *arguments):
    return Kernel(kernel.function)._compiled(tuple(kind(one) for one in arguments))


@pytest.fixture(scope="module")
def code():
    return code_of(much, np.ones(4), 4)


def by(way, code, monkeypatch):
    monkeypatch.setattr(elf_image, "is_usable", lambda: way == "image")
    return machine_code.loaded(code, (kind(np.ones(1)), "int64"))


@pytest.mark.parametrize("way", ["image", "llvm"])
def test_both_ways_give_what_the_function_gives(code, way, monkeypatch):
    values = np.linspace(0.0, 9.0, 5)
    total, is_many = by(way, code, monkeypatch)(values, 5)
    expected, _ = much.function(values, 5)
    assert total == pytest.approx(expected, rel=1e-15) and is_many is True
    # The image really was used: it does not go to LLVM in silence.
    owner, _ = machine_code._in_memory(code)
    assert isinstance(owner, Image) == (way == "image")


def test_memory_that_runs_is_not_memory_that_is_written(code):
    image = Image(code.code, machine_code._address_of)
    with open("/proc/self/maps") as file:
        ranges = [line.split()[:2] for line in file]
    address = image.address(code.symbol)
    (rights,) = [
        rights
        for where, rights in ranges
        if int(where.split("-")[0], 16) <= address < int(where.split("-")[1], 16)
    ]
    assert rights.startswith("r-x")


def test_a_function_that_is_not_there_is_refused(code):
    def nothing(name):
        raise KeyError(name)

    with pytest.raises(UnknownObjectError, match="there is no"):
        Image(code.code, nothing)
    with pytest.raises(KeyError):
        machine_code._address_of("no_such_function_at_all")


def test_other_files_are_refused(code):
    for data in (b"", b"\x7fELF", b"x" * 200, b"\x7fELF\x01\x01" + code.code[6:]):
        with pytest.raises(UnknownObjectError):
            Image(data, machine_code._address_of)
    other_machine = bytearray(code.code)
    struct.pack_into("<H", other_machine, 18, 183)
    with pytest.raises(UnknownObjectError, match="of this machine"):
        Image(bytes(other_machine), machine_code._address_of)


def test_a_place_of_another_kind_is_refused_and_goes_to_llvm(code, monkeypatch):
    data = bytearray(code.code)
    for section in elf_image._sections(code.code):
        if section.kind == 4 and section.name.endswith("text"):
            info = struct.unpack_from("<Q", data, section.offset + 8)[0]
            struct.pack_into("<Q", data, section.offset + 8, (info >> 32 << 32) | 2)
    with pytest.raises(UnknownObjectError, match="type 2"):
        Image(bytes(data), machine_code._address_of)
    monkeypatch.setattr(
        elf_image, "Image", lambda *_: (_ for _ in ()).throw(UnknownObjectError("odd"))
    )
    call = machine_code.loaded(code, (kind(np.ones(1)), "int64"))
    assert call(np.ones(4), 4)[1] is True


def test_llvm_is_not_needed(monkeypatch):
    import subprocess
    import sys

    program = (
        "import numpy as np, sys\n"
        "from msal_cli.core.geometry import normals_and_flat_faces\n"
        "faces = np.zeros((1, 3), dtype=np.int32)\n"
        "_, flat = normals_and_flat_faces(np.zeros((1, 3)), faces, 'uniform')\n"
        "print(flat, 'llvmlite' in sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
    again = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert again.stdout == "1 False\n"
