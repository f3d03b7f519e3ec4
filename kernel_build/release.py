"""Build the wheels of a release, for all systems from one Linux machine, and the sdist:

    pip install -e '.[release]'
    python -m kernel_build.release [-o FOLDER] [TARGET...]

zig links them; every library is checked before its wheel counts: its system and processor, and
that it needs nothing newer than its tag promises.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import zipfile
from pathlib import Path

from kernel_build.binaries import faults
from kernel_build.targets import TARGETS

ROOT = Path(__file__).parents[1]


def build_wheel(name: str, folder: Path) -> Path:
    """Build and check the wheel of a target.

    Raises
    ------
    SystemExit
        where the build fails or the wheel is not what its tag says.
    """
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    environment = os.environ | {"MSAL_BUILD_TARGET": name}
    ran = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if ran.returncode:
        raise SystemExit(f"{name}:\n{ran.stdout}{ran.stderr}")
    tag = TARGETS[name].wheel_tag
    (wheel,) = folder.glob(f"*-py3-none-{tag}.whl")
    wrong = check_wheel(wheel, name)
    if wrong:
        raise SystemExit("\n".join(f"{wheel.name}: {one}" for one in wrong))
    return wheel


def check_wheel(wheel: Path, name: str) -> list[str]:
    """What is wrong with the wheel of a target."""
    target = TARGETS[name]
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        inner = f"msal_cli/kernels/_kernels{target.suffix}"
        wanted = (inner, "msal_cli/kernels/_kernels.txt")
        wrong = [f"it has no {one}" for one in wanted if one not in names]
        wrong += [f"it has {one}" for one in names if one.startswith("kernel_build")]
        (about,) = [one for one in names if one.endswith(".dist-info/WHEEL")]
        if f"Tag: py3-none-{target.wheel_tag}" not in archive.read(about).decode():
            wrong.append("its tag is another")
        return wrong or faults(archive.read(inner), name)


def main(words: list[str] | None = None) -> None:
    """Build the wheels and the sdist."""
    parser = argparse.ArgumentParser(prog="python -m kernel_build.release", description=__doc__)
    parser.add_argument("-o", dest="folder", type=Path, default=ROOT / "dist")
    parser.add_argument("targets", nargs="*", choices=[*TARGETS, []], metavar="TARGET")
    arguments = parser.parse_args(words)
    folder = arguments.folder.resolve()
    for name in arguments.targets or TARGETS:
        wheel = build_wheel(name, folder)
        print(f"{wheel.name}  {wheel.stat().st_size / 1e6:.2f} MB", flush=True)
    command = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()
