"""Kernels for other systems are linked and checked."""

import struct

import pytest

from kernel_build import binaries, build, linking, objects, release
from kernel_build.targets import TARGETS, native_target
from msal_cli.kernels import library

pytestmark = pytest.mark.ci


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_the_wheel_of_every_system(name, tmp_path):
    pytest.importorskip("ziglang")
    pytest.importorskip("hatchling")
    wheel = release.build_wheel(name, tmp_path)
    assert not release.check_wheel(wheel, name)
    others = [target for target in TARGETS if target != name]
    assert all(release.check_wheel(wheel, target) for target in others)


@pytest.mark.slow
def test_two_builds_are_identical(tmp_path, monkeypatch):
    name, products = native_target(), []
    for at in ("first", "second"):
        for module in (build, objects):
            monkeypatch.setattr(module, "CACHE", tmp_path / at)
        products.append(build.build(name))
    first, second = products
    assert first.library != second.library
    assert first.library.read_bytes() == second.library.read_bytes()
    assert first.table.read_bytes() == second.table.read_bytes()


def test_the_library_of_this_machine_is_for_it():
    data = library.LIBRARY.read_bytes()
    wrong = binaries.faults(data, native_target())
    # A system's compiler may ask for the system's own libc.
    assert not [fault for fault in wrong if "GLIBC" not in fault]
    for name in TARGETS:
        if name.partition("-")[2] != native_target().partition("-")[2]:
            assert binaries.faults(data, name)


def elf(machine, strings):
    return b"\x7fELF\x02" + bytes(13) + struct.pack("<H", machine) + bytes(44) + strings


def mach(cpu, version):
    header = b"\xcf\xfa\xed\xfe" + struct.pack("<IIIIII", cpu, 0, 6, 1, 24, 0) + bytes(4)
    return header + struct.pack("<IIIIII", 0x32, 24, 1, version << 16, 0, 0)


def pe(machine, names):
    return (
        b"MZ" + bytes(58) + struct.pack("<I", 64) + b"PE\0\0" + struct.pack("<H", machine) + names
    )


@pytest.mark.parametrize(
    "name, data, expected",
    [
        ("linux-x86_64", elf(62, b"\0libm.so.6\0GLIBC_2.2.5\0GLIBC_2.17\0"), []),
        ("linux-x86_64", elf(62, b"\0GLIBC_2.2.5\0GLIBC_2.29\0"), ["it needs GLIBC_2.29"]),
        ("linux-x86_64", elf(183, b""), ["it is no ELF library for x86_64"]),
        ("linux-x86_64", elf(62, b"\0libgomp.so.1\0"), ["it needs libgomp.so.1"]),
        ("musl-aarch64", elf(183, b"\0libc.so\0"), []),
        (
            "musl-aarch64",
            elf(183, b"\0GLIBC_2.17\0"),
            ["it needs glibc, but musl is its C library"],
        ),
        ("macos-arm64", mach(0x0100000C, 11), []),
        ("macos-arm64", mach(0x0100000C, 14), ["it needs macOS 14.0"]),
        ("macos-x86_64", mach(0x0100000C, 11), ["it is no Mach-O library for x86_64"]),
        ("windows-x86_64", pe(0x8664, b"\0KERNEL32.dll\0api-ms-win-crt-math-l1-1-0.dll\0"), []),
        (
            "windows-x86_64",
            pe(0x8664, b"\0libwinpthread-1.dll\0"),
            ["it needs libwinpthread-1.dll"],
        ),
        ("windows-x86_64", pe(0xAA64, b""), ["it is not for x86_64"]),
        ("windows-x86_64", elf(62, b""), ["it is no library of Windows"]),
    ],
)
def test_faults_of_a_library(name, data, expected):
    assert binaries.faults(data, name) == expected


def test_the_words_of_a_compiler_that_fails_are_shown(tmp_path):
    target = TARGETS[native_target()]
    with pytest.raises(SystemExit, match="no-such"):
        linking.link([tmp_path / "no-such.o"], target, linking.system_compiler(), tmp_path / "l.so")
