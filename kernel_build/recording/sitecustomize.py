"""Python runs this at its start where ``kernel_build.record`` has put its folder on the path.

The signatures of all kernels that are used go to the file MSAL_RECORDED_SIGNATURES; those that the
library does not have are compiled by numba.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from kernel_build.numba_kernels import to_dispatcher
from msal_cli.errors import InternalError
from msal_cli.kernels import library
from msal_cli.kernels.library import Kernel

_load = library.load


def _load_and_record(kernel: Kernel, arg_types: tuple[library.ArgType, ...]) -> Callable[..., Any]:
    if not kernel.function.__module__.startswith("msal_cli.kernels."):
        return _load(kernel, arg_types)
    line = library.signature(kernel.name, arg_types)
    # One short write in append mode: lines of many processes do not mix.
    with open(os.environ["MSAL_RECORDED_SIGNATURES"], "ab", buffering=0) as file:
        file.write(f"{line}\n".encode())
    try:
        return _load(kernel, arg_types)
    except InternalError:
        compiled: Callable[..., Any] = to_dispatcher(kernel)
        return compiled


library.load = _load_and_record
