"""Files that a mesh file names, such as materials and images.

The names come from strangers: nothing outside the folder of the mesh file is opened, and nothing
but regular files.
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PureWindowsPath

from msal_cli.errors import ContentError
from msal_cli.storage.regular import NotRegularError, open_regular

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")


def read_beside(name: str, folder: Path | None, most_bytes: int) -> bytes:
    """The file ``name`` in ``folder``, which a mesh file names; ContentError where it cannot be
    had."""
    plain = name.replace("\\", "/")
    shown = name[:200]
    if folder is None:
        raise ContentError(f"{shown!r} cannot be found from here")
    is_outside = (
        plain.startswith("/")
        or "\0" in plain
        or ".." in plain.split("/")
        or PureWindowsPath(plain).drive
        or _SCHEME.match(plain) is not None
    )
    path = os.path.realpath(folder / plain) if not is_outside else ""
    if is_outside or not Path(path).is_relative_to(os.path.realpath(folder)):
        raise ContentError(f"{shown!r} is not in the folder of the mesh")
    try:
        with open_regular(path) as file:
            if os.fstat(file.fileno()).st_size > most_bytes:
                raise ContentError(f"{shown!r} has more than {most_bytes:,} bytes")
            return file.read()
    except NotRegularError:
        raise ContentError(f"{shown!r} is not a regular file") from None
    except (OSError, ValueError) as failure:
        reason = getattr(failure, "strerror", None) or str(failure)
        raise ContentError(f"{shown!r} cannot be read: {reason}") from None
