"""What a log, a report or a picture must not replace: a mesh, an input, a file of msal's own.

Every command asks here before it works.  Names lead to files by links of both kinds, and what a
file is shows in its content, so neither a name nor a path alone is trusted.
"""

from __future__ import annotations

import io
import os
import re
import stat
from collections.abc import Iterable
from pathlib import Path

from msal_cli.errors import UsageError

_LOG_LINE = rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} "
"""How every line of a log begins."""

REPORT = (
    r'\{\s*"schema": "msal\.report/|\{"input":[^\n]*"schema":"msal\.report/'
    r"|input,status,output,(?:schema|format),"
    r'|## [^\n]{1,4} msal denoise: |<\?xml[^\n]*\n<testsuites>\s*<testsuite id="0" package="msal" '
    r'|<!DOCTYPE html>.*<meta name="generator" content="msal '
)
"""How the reports of msal begin."""

_ANOTHER = "give it another name"


def refuse_target(
    name: str, what: str, taken: Iterable[str] = (), *, replaces: str | None = None
) -> None:
    """Refuse to write ``what`` (``the report``) to ``name``, where that would do harm.

    Parameters
    ----------
    taken : paths and URLs of inputs and outputs, which it must not replace.
    replaces : a pattern of how files begin that it may replace, although they may be meshes; by
        default all that are no mesh.

    Raises
    ------
    UsageError
        for the name of a mesh that may not be one, of a file of msal's own, of a folder, a device
        or a pipe; for one of ``taken``, and for another mesh that is there.
    """
    from msal_cli.batch.plan_checks import identify_file
    from msal_cli.job.settings import is_mesh_name
    from msal_cli.storage.urls import is_url

    is_remote = is_url(name)
    for path in (name,) if is_remote else (name, os.path.realpath(name)):
        _refuse_own(path, f"{what} {name!r}")
        if replaces is None and is_mesh_name(path):
            raise UsageError(f"{what} {name!r} would be called like a mesh", hint=_ANOTHER)
    here = identify_file(name) or os.path.realpath(name)
    for path in taken:
        if here == (identify_file(path) or os.path.realpath(path)):
            raise UsageError(f"{what} {name!r} would replace {path!r}", hint=_ANOTHER)
    if is_remote or not os.path.lexists(name):
        return
    if os.path.isdir(name):
        raise UsageError(f"{what} {name!r} is a folder", hint="name a file in it")
    if os.path.exists(name) and not os.path.isfile(name):
        raise UsageError(f"{what} {name!r} is a device or a pipe, not a file", hint=_ANOTHER)
    _refuse_mesh(name, what, replaces)


def _refuse_own(path: str, what: str) -> None:
    from msal_cli.batch.temporary_files import is_own
    from msal_cli.storage import urls

    last = urls.name(path) if urls.is_url(path) else Path(path).name
    # Where case does not count, another case is the same file.
    if is_own(last.lower()):
        raise UsageError(f"{what} would have the name of a file of msal's own", hint=_ANOTHER)


def _refuse_mesh(name: str, what: str, replaces: str | None) -> None:
    from msal_cli.codecs.detection import content_format
    from msal_cli.storage.limits import LOOKED_AT
    from msal_cli.storage.regular import open_regular

    try:
        with open_regular(name) as file:
            head, size = file.read(LOOKED_AT), os.fstat(file.fileno()).st_size
    except OSError:
        # A link to nowhere; or what cannot be read, and is not known to be ours.
        if os.path.exists(name):
            raise UsageError(
                f"{what} {name!r} is there, and cannot be read", hint=_ANOTHER
            ) from None
        return
    if replaces is None:
        if found := content_format(head, size=size):
            raise UsageError(
                f"{what} {name!r} would replace a mesh ({found.upper()})", hint=_ANOTHER
            )
    elif not re.match(replaces.encode(), head, re.DOTALL):
        raise UsageError(
            f"{what} {name!r} would replace a file that is none of its kind",
            hint="move it away, or give another name",
        )


def open_log(name: str) -> io.TextIOWrapper:
    """Open a log to append to it: a new file, an empty one, or what begins as a log of msal does.

    A terminal, /dev/null and a pipe with a reader will do, too.

    Raises
    ------
    UsageError
        for any other file, which might be a mesh, an input or a file of msal's own.
    OSError, ValueError
        if it cannot be opened.
    """
    from msal_cli.job.settings import is_mesh_name
    from msal_cli.storage.regular import open_regular

    for path in (name, os.path.realpath(name)):
        _refuse_own(path, f"the log file {name!r}")
        if is_mesh_name(path):
            raise UsageError(f"the log file {name!r} would be called like a mesh", hint=_ANOTHER)
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT
    # A pipe without a reader is an error, and is not waited for.
    for flag in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_NOINHERIT"):
        flags |= getattr(os, flag, 0)
    handle = os.open(name, flags, 0o666)
    try:
        status = os.fstat(handle)
        if stat.S_ISREG(status.st_mode) and status.st_size:
            with open_regular(name) as file:
                is_same = os.path.samestat(os.fstat(file.fileno()), status)
                if not is_same or re.match(_LOG_LINE, file.read(64)) is None:
                    raise UsageError(
                        f"the log file {name!r} is there, and is no log of msal",
                        hint="only a log is appended to; give another name",
                    )
        if hasattr(os, "set_blocking"):
            os.set_blocking(handle, True)
        return open(handle, "a", encoding="utf-8", errors="backslashreplace")
    except BaseException:
        os.close(handle)
        raise
