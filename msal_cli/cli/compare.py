"""``msal compare``: a mesh, or a folder of meshes, against a reference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import exit_codes, talk
from msal_cli.dataclass import dataclass

if TYPE_CHECKING:
    from msal_cli.records import ComparisonRecord

_PATH = click.Path(readable=False, allow_dash=False)


@dataclass(frozen=True)
class Request:
    """The command line of ``msal compare``, as click has read it."""

    before: str
    after: str
    format: str | None
    as_json: bool
    verbose: int


@click.command(
    "compare",
    short_help="Measure a mesh against another.",
    epilog="""\b
Examples:
  msal compare truth.ply denoised.ply
  msal compare scans denoised --json
\b
Exit status: see msal --help.""",
)
@click.argument("before", metavar="A", type=_PATH)
@click.argument("after", metavar="B", type=_PATH)
@click.option(
    "--format",
    "format",
    metavar="FORMAT",
    help="The files' format, where neither their names nor their content tells.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print one JSON object for two files; for folders one document, whose records list holds "
    "an object per pair.",
)
@click.option(
    "-v", "--verbose", count=True, help="Tell more of what goes on; -vv tells everything."
)
def command(**options: Any) -> int:
    """Measure B against A, which is the reference: before and after, or truth and result.

    A and B are two files, or two folders whose files are matched by relative path. Told are the
    displacement, the angles between face normals (mean: the MSAE of the literature), the vertex
    error in % of the mean edge length of A, the change of volume and area, flipped faces, and the
    Hausdorff distance. Where the faces are not the same, the surfaces are compared. Nothing is
    written.
    """
    from msal_cli.cli import logs
    from msal_cli.files import urls

    request = Request(**urls.settled_in(options, "before", "after"))
    with logs.configured(request.verbose, None):
        return _compared(request)


def _compared(request: Request) -> int:
    from msal_cli import comparison, files
    from msal_cli.cli import words

    format = words.settled_format(request.format, files.readable_suffixes, "--format")
    record = comparison.compare_files(request.before, request.after, format)
    return _told_of_two(request, record)


def _told_of_two(request: Request, record: ComparisonRecord) -> int:
    from msal_cli.report import as_json, comparison_text, document

    if request.as_json:
        talk.put_bytes(as_json.json_bytes(document.plain_record(record)))
    if record.error is not None:
        talk.say_failure(record.after, record.error)
        return exit_codes.FATAL
    if not request.as_json:
        talk.put_lines(comparison_text.told(record))
    return exit_codes.SUCCESS
