"""What hatchling calls to build msal: the kernels are compiled into a library of the wheel."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

sys.path.insert(0, str(Path(__file__).parent))

from kernel_build.linking import system_compiler


class KernelBuildHook(BuildHookInterface):  # type: ignore[misc, type-arg]
    """Builds the kernels for this machine, or for the system that MSAL_BUILD_TARGET names."""

    def dependencies(self) -> list[str]:
        """zig, where there is no C compiler, or for another system."""
        if self.target_name != "wheel":
            return []
        is_native = not os.environ.get("MSAL_BUILD_TARGET")
        return [] if is_native and system_compiler() else ["ziglang>=0.14"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the library and say where it goes."""
        if self.target_name != "wheel":
            return
        from kernel_build import build, linking
        from kernel_build.targets import TARGETS, native_target

        if version == "editable":
            product = build.build_for_checkout()
        else:
            wanted = os.environ.get("MSAL_BUILD_TARGET")
            name = wanted or native_target()
            product = build.build(name, compiler=linking.ZIG if wanted else None)
            suffix = TARGETS[name].suffix
            build_data["force_include"] |= {
                str(product.library): f"msal_cli/kernels/_kernels{suffix}",
                str(product.table): "msal_cli/kernels/_kernels.txt",
            }
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{product.wheel_tag}"
