"""The buffers of a .gltf file: inside its text as base64, or in files beside it.

The names come from strangers: nothing outside the folder of the .gltf is opened, and nothing but
regular files.
"""

from __future__ import annotations

import base64
import binascii
import errno
import os
from pathlib import Path, PureWindowsPath
from urllib.parse import unquote

from msal_cli.codecs.gltf_scene import has_scheme
from msal_cli.errors import (
    EXPORT_AGAIN,
    FormatError,
    InputError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.storage.buffers import Buffer
from msal_cli.storage.regular import NotRegularError, open_regular
from msal_cli.storage.urls import is_url

_BASE64 = ";base64,"
_MOST_BEHIND = 256 << 20
"""Bytes behind the declared end of a buffer that are carried along whatever its size."""

EMPTY_URI = "data:application/octet-stream;base64,"
"""A ``data:`` reference of no bytes."""

_PACK = "export it as .glb, which holds everything in one file"


def decode_data_uri(uri: str, where: str) -> bytes | None:
    """The content of a ``data:`` reference; None for any other.

    Raises
    ------
    FormatError
        if it is not base64.
    UnsupportedError
        if it is encoded in another way.
    """
    if uri[:5].lower() != "data:":
        return None
    comma = uri.find(",", 0, 1000)
    if not uri[: comma + 1].lower().endswith(_BASE64):
        raise UnsupportedError("data that are not base64 are not read", where=where, hint=_PACK)
    try:
        return base64.b64decode(uri[comma + 1 :], validate=True)
    except (binascii.Error, ValueError) as failure:
        said = str(failure)[:100]
        raise FormatError(
            f"the data are not base64: {said}", where=where, hint=EXPORT_AGAIN
        ) from None


def encode_data_uri(uri: str, content: Buffer) -> str:
    """The ``data:`` reference ``uri`` with other content."""
    comma = uri.index(",")
    return uri[: comma + 1] + base64.b64encode(content).decode("ascii")


def file_name(uri: str, where: str) -> str:
    """The path, with slashes, that a reference means relative to the folder of its .gltf.

    Raises
    ------
    UnsupportedError
        if it leads out of that folder, or is no path.
    """
    try:
        name = unquote(uri, errors="strict")
    except UnicodeDecodeError:  # percent signs that are no escapes
        name = uri
    parts = name.split("/")
    if (
        has_scheme(uri)
        or not name.strip()
        or name.startswith("/")
        or "\0" in name
        or ".." in parts
        or PureWindowsPath(name).drive
        or "\\" in name
    ):
        raise UnsupportedError(
            f"the buffer {uri[:200]!r} is not in the folder of the .gltf, and is not read",
            where=where,
            hint=f"put it beside the .gltf, or {_PACK}",
        )
    return name


def read_buffer(name: str, folder: Path, declared: int, room: int, where: str) -> bytes:
    """The bytes of the file ``name`` in ``folder``: from ``declared`` to ``room`` of them.

    Raises
    ------
    InputError
        with code ``E_READ`` if there is no such file, or the system does not let it be read.
    UnsupportedError
        if it is not a regular file, or a link that leads out of the folder.
    TruncatedError, TooLargeError
    """
    try:
        path = os.path.realpath(folder / name)
        if not Path(path).is_relative_to(os.path.realpath(folder)):
            raise UnsupportedError(
                f"the buffer {name!r} is a link that leads out of the folder, and is not read",
                where=where,
                hint="put the file itself beside the .gltf",
            )
        with open_regular(path) as file:
            status = os.fstat(file.fileno())
            if status.st_size > min(2 * declared + _MOST_BEHIND, room):
                raise TooLargeError(
                    f"the buffer {name!r} has {status.st_size:,} bytes, not {declared:,}",
                    where=where,
                    hint="export the mesh again",
                )
            content = file.read()
    except NotRegularError:
        raise UnsupportedError(
            f"the buffer {name!r} is not a regular file", where=where, hint=_PACK
        ) from None
    except (OSError, ValueError) as failure:
        is_missing = getattr(failure, "errno", None) in (errno.ENOENT, errno.ENOTDIR)
        reason = getattr(failure, "strerror", None) or str(failure)
        raise InputError(
            f"the buffer {name!r} is missing beside the .gltf"
            if is_missing
            else f"the buffer {name!r} cannot be read: {reason}",
            where=where,
            code="E_READ",
            hint="copy it beside the .gltf; a .gltf does not hold its mesh itself",
        ) from failure
    if len(content) < declared:
        raise TruncatedError(
            f"the buffer {name!r} should have {declared:,} bytes but has {len(content):,}",
            where=where,
            hint="the file was cut short; copy or export it again",
        )
    return content


def folder_of(name: str) -> Path | None:
    """The folder of the .gltf ``name``; None for a stream or an object in a store."""
    return None if name in ("", "-") or is_url(name) else Path(name).parent
