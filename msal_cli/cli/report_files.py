"""``--report FILE``: refused before any work if it cannot be, written when the work is done."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli import report
from msal_cli.cli import github
from msal_cli.errors import OutputError, UsageError
from msal_cli.job.settings import DEFAULT_BACKUP

if TYPE_CHECKING:
    from msal_cli.job.records import MeshRecord
    from msal_cli.report import Writer
    from msal_cli.report.document import Run
    from msal_cli.view.illustrations import Gallery


def check(names: Sequence[str], taken: Iterable[str]) -> None:
    """Refuse reports that cannot be written, or that would replace one of the paths ``taken``.

    Raises
    ------
    UsageError
        for an unknown suffix, a name given twice, a folder, or a place that cannot be written.
    """
    real = {_real(name): name for name in taken} if names else {}
    seen: set[str] = set()
    for name in names:
        if name == "-":
            raise UsageError(
                "a report needs the name of a file", hint="--json prints records to standard output"
            )
        _writer(name)
        path = _real(name)
        if path in seen:
            raise UsageError(f"the report {name!r} is given twice")
        if path in real:
            raise UsageError(
                f"the report {name!r} would replace the mesh {real[path]!r}",
                hint="give it another name",
            )
        seen.add(path)
        _refuse_unwritable(name)


def write(
    names: Sequence[str],
    run: Run,
    records: Sequence[MeshRecord],
    *,
    backup: str | None = None,
    is_in_haste: bool = False,
    is_quiet: bool = False,
) -> None:
    """Write every report, whole or not at all; OutputError names the first that cannot be.

    One that cannot be written does not keep the others from being written.

    Parameters
    ----------
    backup : what was added to the names of originals that were replaced, if it is known.
    is_in_haste : make no pictures, because somebody waits for the end.
    is_quiet : show no bar while pictures are made.
    """
    from msal_cli.batch import interrupts as signals
    from msal_cli.codecs import is_url, write_whole

    first: OutputError | None = None
    # Pages take longest: whoever loses patience has the other reports.
    for name in sorted(names, key=_is_page):
        if _is_page(name):
            shown = None if is_in_haste else _gallery(records, backup, is_quiet)
            data = _page(run, records, shown)
        else:
            data = _writer(name)(run, records)
        try:
            if github.is_step_summary(name):
                github.append_to_summary(name, data)
                continue
            if not is_url(name):
                _guarded(
                    lambda name=name: Path(name).parent.mkdir(parents=True, exist_ok=True),  # type: ignore[misc]
                    name,
                )
            # A signal must not leave a temporary file: nobody comes back to sweep it.
            with signals.noticed(signals.raise_for):
                write_whole(name, [data])
        except OutputError as error:
            first = first or error
    if first is not None:
        raise first


def _writer(name: str) -> Writer:
    """The function that makes the bytes of a report of this name; UsageError if there is none."""
    if github.is_step_summary(name):
        from functools import partial

        from msal_cli.report import markdown as as_markdown

        return partial(as_markdown.encoded, most_bytes=github.room_in_summary(name))
    return report.writer(name)


def _is_page(name: str) -> bool:
    return name.lower().endswith(".html") and not github.is_step_summary(name)


def _gallery(records: Sequence[MeshRecord], backup: str | None, is_quiet: bool) -> Gallery:
    from msal_cli.cli import progress
    from msal_cli.report import gallery

    with progress.picture_bar(quiet=is_quiet) as tell:
        return gallery.made(
            records, backup=DEFAULT_BACKUP if backup is None else backup, on_file=tell
        )


def _page(run: Run, records: Sequence[MeshRecord], shown: Gallery | None) -> bytes:
    from msal_cli.report import html as as_html
    from msal_cli.view.illustrations import EMPTY

    return as_html.encoded(run, records, shown or EMPTY)


def _guarded(effect: Callable[[], None], name: str) -> None:
    try:
        effect()
    except OSError as error:
        raise OutputError(
            f"the folder of the report {name!r} cannot be made: {error.strerror}", path=name
        ) from None


def _refuse_unwritable(name: str) -> None:
    from msal_cli.codecs import is_url

    if is_url(name):
        return
    path = Path(name)
    if path.is_dir():
        raise UsageError(f"the report {name!r} is a folder", hint="name a file in it")
    # The folder itself may still have to be made, as that of the outputs often has.
    folder = next((one for one in path.absolute().parents if one.exists()), None)
    if folder is None or not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise UsageError(
            f"the report {name!r} cannot be written to the folder {str(folder)!r}",
            hint="choose another place",
        )


def _real(name: str) -> str:
    from msal_cli.storage import urls

    return urls.identity(name) if urls.is_url(name) else os.path.normcase(os.path.realpath(name))
