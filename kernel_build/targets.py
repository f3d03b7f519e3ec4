"""The systems that wheels are made for."""

from __future__ import annotations

import platform
import sys
from dataclasses import dataclass

X86_LEVELS = ("v2", "v3")
"""Levels of x86-64 that the library of a wheel has code for."""


@dataclass(frozen=True)
class Target:
    """A system with a processor.

    Attributes
    ----------
    triple : its name for LLVM.
    zig : its name for zig, with the oldest version of the system.
    processors : what LLVM optimizes for, by the end of the symbols.
    wheel_tag : the platform's tag where zig has linked the library.
    suffix : of the library's name.
    """

    triple: str
    zig: str
    processors: dict[str, str]
    wheel_tag: str
    suffix: str = ".so"


_X86 = {f"_{level}": f"x86-64-{level}" for level in X86_LEVELS}
_ANY = {"": "generic"}

TARGETS = {
    "linux-x86_64": Target(
        "x86_64-unknown-linux-gnu", "x86_64-linux-gnu.2.17", _X86, "manylinux_2_17_x86_64"
    ),
    "linux-aarch64": Target(
        "aarch64-unknown-linux-gnu", "aarch64-linux-gnu.2.17", _ANY, "manylinux_2_17_aarch64"
    ),
    "musl-x86_64": Target(
        "x86_64-unknown-linux-musl", "x86_64-linux-musl", _X86, "musllinux_1_2_x86_64"
    ),
    "musl-aarch64": Target(
        "aarch64-unknown-linux-musl", "aarch64-linux-musl", _ANY, "musllinux_1_2_aarch64"
    ),
    "macos-x86_64": Target(
        "x86_64-apple-macosx11.0.0", "x86_64-macos.11.0", _X86, "macosx_11_0_x86_64", ".dylib"
    ),
    "macos-arm64": Target(
        "arm64-apple-macosx11.0.0",
        "aarch64-macos.11.0",
        {"": "apple-m1"},
        "macosx_11_0_arm64",
        ".dylib",
    ),
    "windows-x86_64": Target(
        "x86_64-pc-windows-gnu", "x86_64-windows-gnu", _X86, "win_amd64", ".dll"
    ),
}


def native_target() -> str:
    """The name of the target that this Python runs on.

    Raises
    ------
    SystemExit
        where none of them is.
    """
    system = {"linux": "linux", "darwin": "macos", "win32": "windows"}.get(sys.platform, "")
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    if system == "macos" and machine == "aarch64":
        machine = "arm64"
    if system == "linux" and "musl" in (sys.implementation._multiarch or ""):
        system = "musl"
    name = f"{system}-{machine}"
    if name not in TARGETS:
        raise SystemExit(f"no kernels can be built for {sys.platform} on {platform.machine()}")
    return name
