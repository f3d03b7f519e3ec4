"""Files beside the meshes: reports and pictures, and what they must not replace.

Every command calls ``refuse_target`` before it works.  Symbolic and hard links can lead to any
file, and only its content shows what a file is, so neither names nor paths are trusted.

Annotations for GitHub Actions are lines in the log of a step.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msal_cli.batch import interrupts
from msal_cli.cli import console
from msal_cli.cli.options import STREAM
from msal_cli.errors import OutputError, UsageError
from msal_cli.job.output import write_output
from msal_cli.job.settings import DEFAULT_BACKUP
from msal_cli.storage import urls
from msal_cli.storage.atomic import is_own
from msal_cli.storage.regular import LOOKED_AT, open_regular
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from msal_cli.job.records import MeshRecord, Run
    from msal_cli.report.html import Gallery


# For each suffix of a report, the function that renders a run and its records as bytes.
_WRITERS = {
    ".json": ("data", "render_json"),
    ".jsonl": ("data", "render_lines"),
    ".csv": ("data", "render_csv"),
    ".md": ("build_services", "render_markdown"),
    ".xml": ("build_services", "render_junit"),
    ".html": ("html", "render"),
}


def _suffix(name: str) -> str:
    return os.path.splitext(name)[1].lower()


def check(names: Sequence[str], taken: Iterable[str]) -> None:
    """Raise UsageError for reports that cannot be written, or that would replace one of the paths
    ``taken``, another mesh or a file of msal's own; also for an unknown suffix or a name that is
    given twice."""
    taken = tuple(taken)
    seen: set[str] = set()
    for name in names:
        if name == "-":
            raise UsageError(
                "a report needs the name of a file", hint="--json prints records to standard output"
            )
        if _suffix(name) not in _WRITERS:
            raise UsageError(
                f"unknown report format: {name!r}", hint=f"known are {', '.join(_WRITERS)}"
            )
        is_remote = is_url(name)
        path = urls.identity(name) if is_remote else os.path.normcase(os.path.realpath(name))
        if path in seen:
            raise UsageError(f"the report {name!r} is given twice")
        seen.add(path)
        refuse_target(name, "the report", taken, replaces=REPORT)


def write(
    names: Sequence[str],
    run: Run,
    records: Sequence[MeshRecord],
    *,
    named: Sequence[MeshRecord] = (),
    backup: str | None = None,
    csv_columns: str | None = None,
    without_pictures: bool = False,
    quiet: bool = False,
) -> None:
    """Write every report, whole or not at all; OutputError names the first that cannot be.

    If one cannot be written, the others still are.

    Parameters
    ----------
    named : the records with the names of inputs that Markdown and JUnit show, if others.
    backup : what was added to the names of originals that were replaced, if it is known.
    csv_columns : ``all``; by default those of ``data.COMMON_COLUMNS``.
    without_pictures : leave them out of pages, because the run is to end soon.
    quiet : show no bar while pictures are made.
    """
    first: OutputError | None = None
    # Pages take longest and come last: after Ctrl-C the other reports are there.
    pages = {name for name in names if _suffix(name) == ".html"}
    pictures: Gallery | None = None
    for name in sorted(names, key=pages.__contains__):
        if name in pages and pictures is None and not without_pictures:
            from msal_cli.cli import progress
            from msal_cli.report.html import build_gallery

            backup = DEFAULT_BACKUP if backup is None else backup
            with progress.picture_bar(quiet=quiet) as on_file:
                pictures = build_gallery(records, backup=backup, on_file=on_file)
        try:
            module, function = _WRITERS[_suffix(name)]
            render = getattr(import_module(f"msal_cli.report.{module}"), function)
            options: dict[str, Any] = {}
            shown: tuple[str, ...] = ()
            if name in pages and pictures is not None:
                options, shown = {"gallery": pictures}, tuple(pictures.pictures)
            elif function == "render_csv":
                options = {"has_all": csv_columns == "all"}
            has_other = bool(named) and module == "build_services"
            data = render(run, named if has_other else records, **options)
            # A signal must not leave a temporary file, which no later run would remove.
            with interrupts.catch_signals():
                # A page gets no wider permissions than the meshes that it shows.
                write_output(name, data, sources=shown)
        except OutputError as error:
            first = first or error
    if first is not None:
        raise first


REPORT = (
    r'\{\s*"schema": "msal\.report/|\{"input":[^\n]*"schema":"msal\.report/'
    r"|input,status,output,(?:schema|format),"
    r'|## [^\n]{1,6} msal denoise: |<\?xml[^\n]*\n<testsuites>\s*<testsuite id="0" package="msal" '
    r'|<!DOCTYPE html>.*<meta name="generator" content="msal '
)
"""How the bytes of msal's reports begin; the sign of a Markdown report has up to 6 bytes."""

_ANOTHER = "give it another name"


def require_files(names: Iterable[str]) -> None:
    """Raise UsageError unless each name is that of a file: no folder, pattern or stream."""
    from msal_cli.batch.inputs import find_type

    for name in names:
        if name == STREAM:
            raise UsageError("- is no file", hint="write the stream to a file first")
        if (kind := find_type(name)[0]) != "file":
            raise UsageError(f"{name!r} is a {kind}", hint="name one file", path=name)


def refuse_target(
    name: str, what: str, taken: Iterable[str] = (), *, replaces: str | None = None
) -> None:
    """Refuse to write ``what`` (such as ``the report``) to ``name`` if that would do harm.

    Parameters
    ----------
    taken : paths and URLs of inputs and outputs, which must not be replaced.
    replaces : a pattern for the beginning of files that may be replaced, although they may be
        meshes; by default all files that are no meshes.

    Raises UsageError if ``name`` is that of a mesh (unless it may be one), of a file of msal's own,
    of a folder, a device or a pipe, or one of ``taken``; and if another mesh is there.
    """
    from msal_cli.batch.plan import identify
    from msal_cli.codecs.detection import content_format, format_of_name

    is_remote = is_url(name)
    for path in (name,) if is_remote else (name, os.path.realpath(name)):
        # Where case does not matter, a name in another case is the same file.
        if is_own((urls.name(path) if is_remote else Path(path).name).lower()):
            raise UsageError(
                f"{what} {name!r} would have the name of a file of msal's own", hint=_ANOTHER
            )
        if replaces is None and format_of_name(path):
            raise UsageError(f"{what} {name!r} would be called like a mesh", hint=_ANOTHER)
    here = identify(name)
    for path in taken:
        if here == identify(path):
            raise UsageError(f"{what} {name!r} would replace {path!r}", hint=_ANOTHER)
    if is_remote:
        return
    # The folder may not exist yet, as often for outputs.
    folder = next(parent for parent in Path(name).absolute().parents if parent.exists())
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        raise UsageError(
            f"{what} {name!r} cannot be written to the folder {str(folder)!r}",
            hint="choose another place",
        )
    # A broken link is replaced.
    if not os.path.exists(name):
        return
    if os.path.isdir(name):
        raise UsageError(f"{what} {name!r} is a folder", hint="name a file in it")
    if not os.path.isfile(name):
        raise UsageError(f"{what} {name!r} is a device or a pipe, not a file", hint=_ANOTHER)
    try:
        with open_regular(name) as file:
            head, size = file.read(LOOKED_AT), os.fstat(file.fileno()).st_size
    except OSError:
        raise UsageError(f"{what} {name!r} is there, and cannot be read", hint=_ANOTHER) from None
    if replaces is None:
        if found := content_format(head, size=size):
            raise UsageError(
                f"{what} {name!r} would replace a mesh ({found.upper()})", hint=_ANOTHER
            )
    elif head and not re.match(replaces.encode(), head, re.DOTALL):
        raise UsageError(
            f"{what} {name!r} would replace a file that is none of its kind",
            hint="move it away, or give another name",
        )


def annotate(records: Sequence[MeshRecord]) -> None:
    """Mark the worst files that failed or broke a gate, if this runs in GitHub Actions."""
    if os.environ.get("GITHUB_ACTIONS") != "true":
        return
    from msal_cli.report.build_services import list_annotations

    # The current folder as a path from the root of the repository; empty outside of it.
    here = ""
    if root := os.environ.get("GITHUB_WORKSPACE"):
        with suppress(OSError, ValueError):
            here = os.path.relpath(os.path.realpath("."), os.path.realpath(root))
    here = "" if here == "." or here.startswith("..") else here.replace(os.sep, "/")
    # The runner reads both streams, and standard output is for data.
    for command in list_annotations(records, here):
        console.say(command)
