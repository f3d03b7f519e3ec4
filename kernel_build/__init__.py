"""Compiles the kernels of msal into one shared library; part of a checkout, not of a wheel.

    python -m kernel_build

``msal_cli.kernels.library`` asks the functions here whether a checkout's library is up to date.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from kernel_build.hashing import source_hash
from kernel_build.signatures import listed
from msal_cli.kernels.compiled import Kernel

__all__ = ["compile_now", "is_listed", "source_hash"]


def is_listed(signature: str) -> bool:
    """Whether the library should have a kernel for these argument types."""
    return signature in listed()


def compile_now(kernel: Kernel) -> Callable[..., Any]:
    """The kernel compiled by numba, which takes a second or so and is not kept.

    Raises
    ------
    InternalError
        where there is no numba.
    """
    from kernel_build.numba_kernels import to_dispatcher
    from msal_cli.errors import InternalError

    try:
        compiled: Callable[..., Any] = to_dispatcher(kernel)
    except ImportError:
        raise InternalError(
            f"the kernel library does not have {kernel.name} as its source is now",
            hint="build it: python -m kernel_build (numba is needed: pip install -e '.[dev]')",
        ) from None
    return compiled
