"""``--report FILE``: refused before any work if it cannot be, written when the work is done."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli import report
from msal_cli.cli import github
from msal_cli.cli.side_files import refuse_target
from msal_cli.errors import OutputError, UsageError
from msal_cli.job.settings import DEFAULT_BACKUP

if TYPE_CHECKING:
    from msal_cli.job.records import MeshRecord
    from msal_cli.report.document import Run


def check(names: Sequence[str], taken: Iterable[str], csv_columns: str | None = None) -> None:
    """Refuse reports that cannot be written, or that would replace one of the paths ``taken``,
    another mesh or a file of msal's own.

    Raises
    ------
    UsageError
        for an unknown suffix, a name given twice, a place that cannot be written, or
        columns without a report in .csv.
    """
    if csv_columns is not None and not any(name.lower().endswith(".csv") for name in names):
        raise UsageError(
            f"--csv-columns {csv_columns}: there is no report in .csv", hint="name one, or leave it"
        )
    taken = tuple(taken)
    seen: set[str] = set()
    for name in names:
        if name == "-":
            raise UsageError(
                "a report needs the name of a file", hint="--json prints records to standard output"
            )
        if not github.is_step_summary(name):
            report.writer(name)
        path = _resolve(name)
        if path in seen:
            raise UsageError(f"the report {name!r} is given twice")
        seen.add(path)
        refuse_target(name, "the report", taken)
        _refuse_unwritable(name)


def write(
    names: Sequence[str],
    run: Run,
    records: Sequence[MeshRecord],
    *,
    backup: str | None = None,
    csv_columns: str | None = None,
    without_pictures: bool = False,
    quiet: bool = False,
) -> None:
    """Write every report, whole or not at all; OutputError names the first that cannot be.

    One that cannot be written does not keep the others from being written.

    Parameters
    ----------
    backup : what was added to the names of originals that were replaced, if it is known.
    csv_columns : ``all``; or those that ``csv_report.COMMON`` has.
    without_pictures : leave them out of pages, where a run is to end soon.
    quiet : show no bar while pictures are made.
    """
    if not names:
        return
    from msal_cli.batch import interrupts
    from msal_cli.job.output import write_output
    from msal_cli.report import markdown

    first: OutputError | None = None
    # Pages take longest: after Ctrl-C the other reports are there.
    for name in sorted(names, key=_is_page):
        try:
            if github.is_step_summary(name):
                data = markdown.render(run, records, most_bytes=github.room_in_summary(name))
                github.append_to_summary(name, data)
                continue
            if _is_page(name):
                data = _render_page(name, run, records, backup, without_pictures, quiet)
            else:
                data = report.writer(name, has_all_columns=csv_columns == "all")(run, records)
            # A signal must not leave a temporary file, which no later run would remove.
            with interrupts.noticed(interrupts.raise_for):
                write_output(name, data)
        except OutputError as error:
            first = first or error
    if first is not None:
        raise first


def _is_page(name: str) -> bool:
    return name.lower().endswith(".html") and not github.is_step_summary(name)


def _render_page(
    name: str,
    run: Run,
    records: Sequence[MeshRecord],
    backup: str | None,
    without_pictures: bool,
    quiet: bool,
) -> bytes:
    import time
    from contextlib import suppress

    from msal_cli.batch import interrupts
    from msal_cli.cli import console, progress
    from msal_cli.job.output import write_output
    from msal_cli.report import gallery, html
    from msal_cli.report.phrases import format_count, seconds_text
    from msal_cli.report.picture_cache import PictureCache, cache_path
    from msal_cli.storage.urls import is_url
    from msal_cli.view.illustrations import EMPTY

    pictures = EMPTY
    if not without_pictures:
        with progress.picture_bar(quiet=quiet) as on_file:
            begun = time.monotonic()
            kept = "" if is_url(name) else cache_path(name)
            cache = PictureCache(kept)
            backup = DEFAULT_BACKUP if backup is None else backup
            pictures = gallery.build_gallery(records, backup=backup, on_file=on_file, cache=cache)
        if cache.n_drawn and not quiet:
            files = format_count(cache.n_drawn, "file")
            console.say(f"pictures of {files} in {seconds_text(time.monotonic() - begun)}")
        archive = cache.to_bytes() if kept else None
        if archive is not None:
            # It saves time, and no page is worth less without it.
            with suppress(OutputError), interrupts.noticed(interrupts.raise_for):
                write_output(kept, archive)
    return html.render(run, records, pictures)


def _refuse_unwritable(name: str) -> None:
    from msal_cli.storage.urls import is_url

    if is_url(name):
        return
    path = Path(name)
    # The folder itself may still have to be made, as that of the outputs often has.
    folder = next((one for one in path.absolute().parents if one.exists()), None)
    if folder is None or not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise UsageError(
            f"the report {name!r} cannot be written to the folder {str(folder)!r}",
            hint="choose another place",
        )


def _resolve(name: str) -> str:
    from msal_cli.storage import urls

    return urls.identity(name) if urls.is_url(name) else os.path.normcase(os.path.realpath(name))
