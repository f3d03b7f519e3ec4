"""Errors as Python programs see them: only the documented classes, with place and hint as notes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from msal_cli.errors import InputError, MsalError
from msal_cli.job.opened_mesh import to_known_error

ARRAYS = "arrays"
"""What a mesh without a file is called."""


@contextmanager
def explained_errors(name: str = ARRAYS, path: str = "") -> Iterator[None]:
    """Turn every error of the block into a ``MsalError`` whose traceback says what to do.

    ``name`` is what is at work, for the log; ``path`` the file, which errors of its own know.
    """
    try:
        yield
    except Exception as error:
        known = to_known_error(error, path or name)
        if isinstance(known, InputError):
            known.path = known.path or path
        _add_note(known)
        if known is error:
            raise
        raise known from error


def _add_note(error: MsalError) -> None:
    """Add code, place and hint, which the message leaves out, once."""
    if getattr(error, "__notes__", None):
        return
    place = ", ".join(part for part in (error.path, error.where) if part)
    error.add_note(f"{error.code}{f' at {place}' if place else ''}")
    if error.hint:
        error.add_note(f"hint: {error.hint}")
