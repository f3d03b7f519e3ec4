"""The library and its table, for one target."""

from __future__ import annotations

import ctypes
import dataclasses
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from kernel_build import linking
from kernel_build.objects import CACHE, build_objects
from kernel_build.signatures import listed
from kernel_build.targets import TARGETS, native_target
from msal_cli.kernels import library


class Product(NamedTuple):
    """What a build has made, and the wheel's tag for its platform."""

    library: Path
    table: Path
    wheel_tag: str


def build(
    name: str,
    *,
    is_checkout: bool = False,
    suffixes: Sequence[str] | None = None,
    compiler: Sequence[str] | None = None,
) -> Product:
    """Build the library of a target in ``build/kernels``.

    Parameters
    ----------
    name : of the target.
    is_checkout : whether the table gets the hashes of the sources.
    suffixes : levels of processor, all of them by default.
    compiler : the command that links, by default the system's compiler, else zig.
    """
    target = TARGETS[name]
    if suffixes is not None:
        chosen = {one: target.processors[one] for one in suffixes}
        target = dataclasses.replace(target, processors=chosen)
    if compiler is None:
        is_native = name == native_target()
        compiler = (linking.system_compiler() if is_native else ()) or linking.ZIG
    built = build_objects(listed(), target)
    objects = sorted({file for one in built for file in one.files})
    folder = CACHE / "-".join([name, *(one.strip("_") for one in target.processors if one)])
    made = folder / f"_kernels{target.suffix}"
    linking.link(objects, target, compiler, made)
    rows = [one.row if is_checkout else one.row.rpartition("\t")[0] + "\t" for one in built]
    table = folder / ("_kernels-checkout.txt" if is_checkout else "_kernels.txt")
    table.write_text("".join(f"{row}\n" for row in rows), encoding="utf-8", newline="\n")
    tag = target.wheel_tag
    if "ziglang" not in compiler and name.startswith("linux-"):
        # What the system's compiler links may need a libc as new as the system's.
        tag = name.replace("-", "_")
    return Product(made, table, tag)


def build_for_checkout(*, has_all_levels: bool = False) -> Product:
    """Build the library of this machine and put it into the package, for an editable install."""
    name = native_target()
    suffixes = list(TARGETS[name].processors)
    if not has_all_levels and len(suffixes) > 1:
        suffixes = [f"_v{cpu_level()}"]
    product = build(name, is_checkout=True, suffixes=suffixes)
    _install(product.library, library.LIBRARY)
    _install(product.table, library.TABLE)
    return product


def _install(made: Path, place: Path) -> None:
    if not place.exists() or place.read_bytes() != made.read_bytes():
        # Processes that have loaded the old file keep it.
        temporary = place.with_name(f"{place.name}.tmp")
        shutil.copyfile(made, temporary)
        temporary.replace(place)


def cpu_level() -> int:
    """The level of x86-64 that this processor has, as the library itself determines it."""
    target = dataclasses.replace(TARGETS[native_target()], processors={})
    made = CACHE / "level" / f"level{target.suffix}"
    linking.link([], target, linking.system_compiler() or linking.ZIG, made)
    level: int = ctypes.CDLL(str(made)).msal_cpu_level()
    return level
