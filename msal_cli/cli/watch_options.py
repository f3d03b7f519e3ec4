"""The options of ``msal watch``: those of ``msal denoise`` for single files, and its own."""

from __future__ import annotations

import click

from msal_cli.cli import denoise_options as denoise
from msal_cli.cli import options
from msal_cli.cli.command import MORE, group

WATCHING = group(
    "Watching",
    click.option(
        "--settle",
        metavar="TIME",
        default="2s",
        show_default=True,
        type=options.parse_duration,
        help="How long size and time of a file must stand still before it is taken; longer is "
        "safer where programs pause while they write.",
    ),
    click.option(
        "--idle-exit",
        metavar="TIME",
        type=options.parse_duration,
        help="End after so long without a new file.  [default: never]",
    ),
    click.option(
        "--poll",
        is_flag=True,
        help="List the folder every second, where the system reports no changes.  [default: on "
        "network folders]",
    ),
)

INPUT_AND_OUTPUT = group(
    "Input and output",
    click.option(
        "-o",
        "--output",
        metavar="OUT",
        required=True,
        type=options.PATH,
        help="Folder to write; it gets the tree of the input.",
    ),
    MORE,
    options.FORCE,
)

MANY_FILES = group(
    "Many files",
    options.FILES,
    denoise.JOBS,
    denoise.FRESH,
    MORE,
    denoise.RETRY_FAILED,
    denoise.TIMEOUT,
    denoise.MEMORY_LIMIT,
    denoise.TILED,
    denoise.SCRATCH,
    denoise.MAX_FACES,
    denoise.RETRIES,
    denoise.FAIL_FAST,
    denoise.MAX_FAILURES,
)

REPORTS = group(
    "Reports",
    denoise.REPORT,
    denoise.FAIL_ON,
    MORE,
    options.CSV_COLUMNS,
    denoise.REFERENCE,
    options.CHECK,
    denoise.FIELDS,
)

OPTIONS = options.combine(
    WATCHING,
    INPUT_AND_OUTPUT,
    denoise.WHAT_TO_DO,
    denoise.AUTOMATIC_CHOICE,
    denoise.LIMITS_ON_MOVEMENT,
    denoise.FORMATS,
    MANY_FILES,
    REPORTS,
    denoise.MESSAGES_AND_HELP,
)

OF_FILES = {
    "in_place": False,
    "backup": None,
    "no_backup": False,
    "dry_run": False,
    "tile_set": False,
    "weld": None,
    "shard": None,
    "engine": "workers",
    "scheduler": None,
    "as_json": False,
}
"""The options of ``msal denoise`` that a watch does not have, as if they were not given."""
