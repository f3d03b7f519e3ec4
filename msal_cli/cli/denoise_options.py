"""The options of ``msal denoise`` by theme: what most people need, and more."""

from __future__ import annotations

import click

from msal_cli.cli import options
from msal_cli.cli.command import MESSAGES, MORE, group
from msal_cli.job.settings import DEFAULT_BACKUP

INPUT_AND_OUTPUT = group(
    "Input and output",
    click.option(
        "-o",
        "--output",
        metavar="OUT",
        type=options.PATH,
        help="File or folder to write; a folder gets the tree of the inputs. "
        "- is standard output, the default when INPUT is -.",
    ),
    click.option(
        "--in-place", is_flag=True, help="Replace the inputs; originals are kept beside them."
    ),
    MORE,
    click.option(
        "--backup",
        metavar="SUFFIX",
        help=f"With --in-place: what is added to the original's name.  [default: {DEFAULT_BACKUP}]",
    ),
    click.option("--no-backup", is_flag=True, help="With --in-place: keep no originals."),
    options.FORCE,
)

WHAT_TO_DO = group(
    "What to do",
    click.option(
        "--method",
        metavar="NAME",
        shell_complete=options.complete_method,
        help="How to denoise; `msal methods` lists them, and auto is --auto.  [default: adaptive, "
        "which chooses the parameters of AL and MSAL for each mesh and leaves clean ones alone]",
    ),
    click.option(
        "-n",
        "--iterations",
        metavar="N",
        help="Sweeps of the method, of msal if none is named. So any number, 4 too, selects the "
        "paper's filter with its own parameters, and nothing is chosen for the mesh. "
        "More is smoother, but not for msal: its smoothing fades from sweep to sweep while the "
        "pull to the scan stays, so more than about 6 sweeps lead back to the input.  [default: "
        "chosen for each mesh; 4 with --method msal]",
    ),
    click.option(
        "-K",
        "K",
        metavar="K",
        help="Factor on the smoothing per sweep, of msal if none is named. Greater is smoother, "
        "less keeps more texture; 0 < K <= 1, for --schedule multiscale or robust. A number "
        "selects msal, as with -n.  [default: chosen for each mesh; 0.5 with --method msal]",
    ),
    MORE,
    options.METHOD_PARAMETER,
    click.option(
        "--mollify",
        metavar="N",
        help="Passes that average the normals first; more gives flatter flats and softer edges, "
        "0 suits lightly noisy scans. A number selects msal, as with -n.  [default: chosen for "
        "each mesh; 1 with --method msal]",
    ),
    click.option(
        "--schedule",
        type=click.Choice(["plain", "constant", "multiscale", "robust", "wiener"]),
        help="How the sweeps of msal, al, umbrella and the like go on: alike, with a constant pull "
        "to the data, multiscale, robust beside spikes, or with what is more than noise given back "
        "at the end. It selects msal, as -n does.  [default: chosen for each mesh; "
        "multiscale with --method msal, else plain]",
    ),
    click.option(
        "--despike/--no-despike",
        default=None,
        help="Bring vertices that lie far off the surface back to it before the method runs.  "
        "[default: where a method is chosen and they are clearly outliers]",
    ),
    click.option(
        "--weights",
        metavar="PROPERTY",
        help="PLY vertex property, such as confidence, as trust: the pull to the scanned position "
        "is scaled by it. For msal, and methods with a --schedule other than plain.",
    ),
    click.option(
        "--min-noise",
        metavar="LEVEL|auto",
        help="Leave meshes as they are whose estimated noise is less everywhere: 0.03e is mean "
        "edge lengths, 0.01 file units; auto where there is none to speak of.  [default: none]",
    ),
)

AUTOMATIC_CHOICE = group(
    "Automatic choice",
    click.option(
        "--auto",
        is_flag=True,
        help="Choose method and parameters for each mesh; from its noise and its surface. The "
        "report says what was chosen, and why. --keep, --strength, --prefer and --auto-budget "
        "imply it.",
    ),
    click.option(
        "--keep",
        type=click.Choice(["texture", "edges", "shape"]),
        help="What must not suffer; fine relief, sharp edges, or the smooth shape beneath the "
        "noise.  [default: as the surface looks]",
    ),
    click.option(
        "--strength",
        metavar="-2..2",
        type=options.number(-2.0, 2.0),
        help="Greater is smoother, less keeps more; 0 is the automatic choice.  [default: 0]",
    ),
    MORE,
    click.option(
        "--assume",
        type=click.Choice(["noise", "texture"]),
        help="What the roughness of a mesh is where the estimate cannot tell noise from texture; "
        "it changes nothing where it can. Also without --auto.  [default: a mild filter that is "
        "not much worse either way]",
    ),
    click.option(
        "--prefer",
        type=click.Choice(["positions", "normals", "volume"]),
        help="What is to come out best: places of vertices, directions of faces, or the enclosed "
        "volume.  [default: a balance]",
    ),
    click.option(
        "--auto-budget",
        "budget",
        metavar="N",
        type=options.number(1.0),
        help="Most time for choosing and denoising together, in runs of the default method over "
        "the same mesh.  [default: 60]",
    ),
)

LIMITS_ON_MOVEMENT = group(
    "Limits on movement",
    click.option(
        "--max-move",
        metavar="LENGTH",
        help="Longest move of a vertex, such as 0.3e; that is mean edge lengths, 0.05 is file "
        "units.  [default: none]",
    ),
    click.option(
        "--lock",
        metavar="EXPR",
        multiple=True,
        help="Vertices that stay, such as 'boundary'; 'confidence < 0.2' compares a PLY vertex "
        "property with a number. Repeatable.",
    ),
    MORE,
    options.UNIT,
)

FORMATS = group(
    "Formats",
    MORE,
    click.option(
        "--to",
        metavar="FORMAT",
        help="Write another format (ply, obj, stl, glb, 3mf, ...); what it cannot carry is a "
        "warning.  [default: that of the input, or of OUT's suffix]",
    ),
    click.option(
        "--encoding",
        type=click.Choice(["same", "ascii", "binary"]),
        default="same",
        show_default=True,
        help="How the output stores numbers.",
    ),
    click.option(
        "--precision",
        type=click.Choice(["same", "float32", "float64"]),
        default="same",
        show_default=True,
        help="Bits of the output's positions.",
    ),
    click.option("--strict", is_flag=True, help="Fail where a conversion loses something."),
    options.FORMAT,
)

# Options of every command that denoises many files.

JOBS = click.option(
    "-j",
    "--jobs",
    metavar="N|auto",
    default="auto",
    show_default=True,
    type=options.parse_jobs,
    help="Files at the same time; more is faster and takes more memory. auto is one per core, "
    "as far as memory allows. The results do not depend on it.",
)

FRESH = click.option(
    "--fresh", is_flag=True, help="Denoise again what an earlier run has done already."
)

RETRY_FAILED = click.option(
    "--retry-failed",
    is_flag=True,
    help="Try again what failed in an earlier run and would fail again.",
)

TIMEOUT = click.option(
    "--timeout",
    metavar="TIME",
    type=options.parse_duration,
    help="Most time for one file: seconds, or 90s, 5m, 1h.  [default: none]",
)

MEMORY_LIMIT = click.option(
    "--memory-limit",
    metavar="SIZE",
    type=options.parse_size,
    help="Most memory for one file and for each worker: 500M, 2G, 1.5GiB.  [default: none]",
)

SCRATCH = click.option(
    "--scratch",
    metavar="FOLDER",
    type=options.PATH,
    help="Folder for the arrays of meshes that exceed the memory.  [default: that of the output]",
)

MAX_FACES = click.option(
    "--max-faces",
    metavar="N",
    type=click.IntRange(min=1),
    help="Refuse files with more faces.  [default: none]",
)

RETRIES = click.option(
    "--retries",
    metavar="N",
    type=click.IntRange(min=0),
    help="How often a file is tried again, alone, that was lost to a crash, memory or time.  "
    "[default: 1]",
)

FAIL_FAST = click.option(
    "--fail-fast", is_flag=True, help="Begin no more files once one has failed."
)

MAX_FAILURES = click.option(
    "--max-failures",
    metavar="N",
    type=click.IntRange(min=1),
    help="Begin no more files once N have failed.  [default: none]",
)

MANY_FILES = group(
    "Many files",
    options.FILES,
    JOBS,
    click.option("--dry-run", is_flag=True, help="List what would be written, and touch nothing."),
    FRESH,
    MORE,
    RETRY_FAILED,
    click.option(
        "--tile-set",
        is_flag=True,
        help="The files are tiles that touch: denoise them as the one mesh that they are, so that "
        "vertices which they share stay the same.",
    ),
    TIMEOUT,
    MEMORY_LIMIT,
    SCRATCH,
    MAX_FACES,
    RETRIES,
    FAIL_FAST,
    MAX_FAILURES,
    click.option(
        "--shard",
        metavar="K/N|auto",
        help="Take only the K-th of N parts of the files; N such runs do them all, on one machine "
        "or many. auto asks Slurm, AWS Batch or Kubernetes; auto/N gives N where they do not.",
    ),
    click.option(
        "--engine",
        type=click.Choice(["workers", "dask"]),
        default="workers",
        show_default=True,
        help="Who does the work: worker processes here, or a Dask cluster (msal-cli[dask]).",
    ),
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="With --engine dask: the scheduler, such as tcp://host:8786 or tls://host:8786.",
    ),
)

REPORT = click.option(
    "--report",
    "reports",
    metavar="FILE",
    multiple=True,
    type=options.PATH,
    help="Write a record of every file; .json, .jsonl, .csv, .md (Markdown), .xml (JUnit) or "
    ".html (a page with pictures) by suffix. Repeatable.",
)

FAIL_ON = click.option(
    "--fail-on",
    metavar="EXPR",
    multiple=True,
    help="Exit with 4 if this is so for any file; such as 'abs(volume_change) > 1%', "
    "'max_displacement > 0.5e' (mean edge lengths) or 'flipped_faces > 0'. Repeatable.",
)

REFERENCE = click.option(
    "--reference",
    metavar="TRUTH",
    type=options.PATH,
    help="Measure the outputs against the true mesh, as msal compare does: a file, or a folder "
    "whose files have the relative paths of the inputs.",
)

FIELDS = click.option(
    "--fields",
    metavar="NAME,...",
    type=options.parse_list,
    help="Write lambda, sigma, noise, displacement or curvature of every vertex to a PLY "
    "beside each output (scan.fields.ply): properties, and the first one as colours too.",
)

REPORTS = group(
    "Reports",
    REPORT,
    FAIL_ON,
    options.JSON_REPORT,
    MORE,
    options.CSV_COLUMNS,
    REFERENCE,
    options.CHECK,
    FIELDS,
)

MESSAGES_AND_HELP = group(
    MESSAGES,
    options.QUIET,
    click.option(
        "-v", "--verbose", count=True, help="Show every file and step; -vv shows everything."
    ),
    MORE,
    click.option(
        "--log-file",
        metavar="FILE",
        type=options.PATH,
        help="Append everything, with times, to a file.",
    ),
)

OPTIONS = options.combine(
    INPUT_AND_OUTPUT,
    WHAT_TO_DO,
    AUTOMATIC_CHOICE,
    LIMITS_ON_MOVEMENT,
    FORMATS,
    MANY_FILES,
    REPORTS,
    MESSAGES_AND_HELP,
)
