"""What a shared library needs of the system that it is for, read from its bytes."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

GLIBC = (2, 17)
"""The newest version that manylinux2014 allows."""

MACOS = (11, 0)

_ELF_MACHINES = {"x86_64": 62, "aarch64": 183}
_MACH_CPUS = {"x86_64": 0x01000007, "arm64": 0x0100000C}
_PE_X86_64 = 0x8664
_BUILD_VERSION, _VERSION_MIN = 0x32, 0x24
_WINDOWS_LIBRARIES = rb"(?i)kernel32|msvcrt|ucrtbase|api-ms-win-[\w-]+"


def faults(data: bytes, name: str) -> list[str]:
    """Why the library with these bytes cannot be that of a target; nothing if it can.

    Parameters
    ----------
    data : the file.
    name : of the target, such as ``"linux-x86_64"``.
    """
    system, _, machine = name.partition("-")
    if system == "windows":
        return list(_pe_faults(data))
    if system == "macos":
        return list(_mach_faults(data, machine))
    return list(_elf_faults(data, machine, is_musl=system == "musl"))


def _elf_faults(data: bytes, machine: str, *, is_musl: bool) -> Iterator[str]:
    (its_machine,) = struct.unpack_from("<H", data, 18)
    if data[:5] != b"\x7fELF\x02" or its_machine != _ELF_MACHINES[machine]:
        yield f"it is no ELF library for {machine}"
        return
    versions = {tuple(map(int, one)) for one in re.findall(rb"GLIBC_(\d+)\.(\d+)", data)}
    if is_musl and versions:
        yield "it needs glibc, but musl is its C library"
    elif versions and max(versions) > GLIBC:
        yield f"it needs GLIBC_{max(versions)[0]}.{max(versions)[1]}"
    allowed = rb"lib[cm]\.so|libc\.musl" if is_musl else rb"lib[cm]\.so\.6|ld-linux[\w-]*\.so\.\d"
    needed = set(re.findall(rb"\x00((?:lib|ld-)[\w.+-]*\.so[\w.]*)(?=\x00)", data))
    yield from (f"it needs {one.decode()}" for one in sorted(needed) if not re.match(allowed, one))


def _mach_faults(data: bytes, machine: str) -> Iterator[str]:
    (its_cpu,) = struct.unpack_from("<I", data, 4)
    if data[:4] != b"\xcf\xfa\xed\xfe" or its_cpu != _MACH_CPUS[machine]:
        yield f"it is no Mach-O library for {machine}"
        return
    (count,) = struct.unpack_from("<I", data, 16)
    at, oldest = 32, None
    for _ in range(count):
        command, size = struct.unpack_from("<II", data, at)
        if command in (_BUILD_VERSION, _VERSION_MIN):
            version_at = at + (12 if command == _BUILD_VERSION else 8)
            (packed,) = struct.unpack_from("<I", data, version_at)
            oldest = (packed >> 16, packed >> 8 & 255)
        at += size
    if oldest is None or oldest > MACOS:
        yield f"it needs macOS {oldest and '.'.join(map(str, oldest))}"


def _pe_faults(data: bytes) -> Iterator[str]:
    start = struct.unpack_from("<I", data, 60)[0] if data[:2] == b"MZ" else 0
    if not start or data[start : start + 4] != b"PE\0\0":
        yield "it is no library of Windows"
        return
    if struct.unpack_from("<H", data, start + 4)[0] != _PE_X86_64:
        yield "it is not for x86_64"
    needed = set(re.findall(rb"([\w-]+)\.dll\x00", data))
    for one in sorted(needed):
        if not re.fullmatch(_WINDOWS_LIBRARIES, one) and not one.startswith(b"_kernels"):
            yield f"it needs {one.decode()}.dll"
