"""The denoising methods, one file each, found by name."""

import functools
import importlib
import pkgutil

from msal_cli.errors import UsageError
from msal_cli.methods._contract import Method, OnSweep, ParameterSpec, Result

__all__ = ["Method", "OnSweep", "ParameterSpec", "Result", "find", "names"]


@functools.cache
def names() -> tuple[str, ...]:
    """The names of all methods, in alphabetical order."""
    found = (module.name for module in pkgutil.iter_modules(__path__))
    return tuple(sorted(name for name in found if not name.startswith("_")))


def find(name: str) -> Method:
    """The method of that name; UsageError, with the closest names as a hint, if there is none."""
    if name not in names():
        import difflib

        close = difflib.get_close_matches(str(name), names(), n=3)
        hint = f"did you mean {' or '.join(close)}?" if close else "see `msal methods`"
        if name == "auto":
            hint = "`msal denoise --auto` chooses one for each mesh"
        raise UsageError(f"there is no method '{name}'", hint=hint)
    return Method(name, importlib.import_module(f"{__name__}.{name}"))
