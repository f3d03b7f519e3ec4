"""Which files and settings can be denoised by tiles, and why others cannot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msal_cli import methods
from msal_cli.errors import UnsupportedError
from msal_cli.job.settings import CHOOSING, Settings, Task, is_mesh_name, suffix
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from msal_cli.tiles.outlook import Found

NAMED = "give a method that can run by tiles: "


def refuse_settings(settings: Settings) -> None:
    """Refuse what cannot be done by tiles: UnsupportedError with what to do instead."""
    objections = (
        (settings.fields, "--fields needs", "leave it out"),
        (settings.checks, "counting self-intersections needs", "leave the check out"),
        (settings.despike, "--despike needs", "leave it out, or remove the outliers beforehand"),
        (
            settings.to or settings.encoding != "same" or settings.precision != "same",
            "another format or encoding of the output needs",
            "keep the input's, and convert before or afterwards",
        ),
    )
    for is_given, what, hint in objections:
        if is_given:
            raise _needs_whole(what, hint)
    if settings.method in CHOOSING:
        return
    method = methods.find(settings.method)
    if method.reach(settings.parameters) is None:
        raise _needs_whole(
            f"{method.name} with these parameters needs", NAMED + ", ".join(names_with_reach())
        )


def look_for_tiles(task: Task, settings: Settings) -> Found:
    """The input, opened to be read in pieces, of which its header and size are checked; of a text
    or a compressed file, which is converted before it is opened, what is to be expected.

    Raises
    ------
    UnsupportedError
        if it cannot be denoised by tiles, with the reason.
    InputError
        if it is damaged.
    """
    from msal_cli.codecs.streamed import open_streamed
    from msal_cli.tiles.outlook import look_ahead

    refuse_settings(settings)
    if is_url(task.input) or is_url(task.output):
        raise _needs_whole("a mesh in a store needs", "copy it to this machine, and back")
    named = suffix(task.output).lstrip(".") if is_mesh_name(task.output) else None
    found: Found | None = look_ahead(task.input, settings.format)
    if found is None:
        found = open_streamed(task.input, settings.format)
    if named and named != found.format:
        raise _needs_whole(
            "another format of the output needs", "give the output the suffix of the input"
        )
    return found


def names_with_reach() -> list[str]:
    """The methods that can run by tiles at their defaults."""
    found = ((name, methods.find(name)) for name in methods.names())
    return [name for name, one in found if one.reach(one.validate({})) is not None]


def _needs_whole(what: str, hint: str) -> UnsupportedError:
    return UnsupportedError(f"{what} the whole mesh in memory", hint=hint)
