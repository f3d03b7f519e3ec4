"""The options of ``msal denoise`` by theme: what most people need, and more."""

from __future__ import annotations

from msal_cli.cli.options import MESSAGES, complete_method, group, number
from msal_cli.job.settings import DEFAULT_BACKUP

_INPUT_AND_OUTPUT = group(
    "Input and output",
    f"""
-o, --output OUT
    File or folder to write; a folder gets the tree of the inputs. - is standard output, the
    default when INPUT is -.
--in-place
    Replace the inputs; originals are kept beside them.
more:
--backup SUFFIX
    With --in-place: what is added to the original's name. [default: {DEFAULT_BACKUP}]
--no-backup
    With --in-place: keep no originals.
--force
""",
)

HOW_TO_DENOISE = (
    group(
        "What to do",
        """
--method NAME
    How to denoise; `msal methods` lists them, and auto is --auto. [default: adaptive, which
    chooses the parameters of AL and MSAL for each mesh and leaves clean ones alone]
-n, --iterations N
    Sweeps of the method, of msal if none is named. So any number, 4 too, selects the paper's
    filter with its own parameters, and nothing is chosen for the mesh. More is smoother, but not
    for msal: its smoothing fades from sweep to sweep while the pull to the scan stays, so more
    than about 6 sweeps lead back to the input. [default: chosen for each mesh; 4 with --method
    msal]
-K K
    Factor on the smoothing per sweep, of msal if none is named. Greater is smoother, less keeps
    more texture; 0 < K <= 1, for --schedule multiscale or robust. A number selects msal, as with
    -n. [default: chosen for each mesh; 0.5 with --method msal]
more:
--set
--mollify N
    Passes that average the normals first; more gives flatter flats and softer edges, 0 suits
    lightly noisy scans. A number selects msal, as with -n. [default: chosen for each mesh; 1 with
    --method msal]
--schedule [plain|constant|multiscale|robust|wiener]
    How the sweeps of msal, al, umbrella and the like go on: alike, with a constant pull to the
    data, multiscale, robust beside spikes, or with what is more than noise given back at the end.
    It selects msal, as -n does. [default: chosen for each mesh; multiscale with --method msal,
    else plain]
--despike/--no-despike
    Bring vertices that lie far off the surface back to it before the method runs. [default: where
    a method is chosen and they are clearly outliers]
--weights PROPERTY
    PLY vertex property, such as confidence, as trust: the pull to the scanned position is scaled
    by it. For msal, and methods with a --schedule other than plain.
--min-noise LEVEL|auto
    Leave meshes as they are whose estimated noise is less everywhere: 0.03e is mean edge lengths,
    0.01 file units; auto where there is none to speak of. [default: none]
""",
        method={"shell_complete": complete_method},
        despike={"default": None},
    ),
    group(
        "Automatic choice",
        """
--auto
    Choose method and parameters for each mesh; from its noise and its surface. The report says
    what was chosen, and why. --keep, --strength and --prefer imply it.
--keep [texture|edges|shape]
    What must not suffer; fine relief, sharp edges, or the smooth shape beneath the noise.
    [default: as the surface looks]
--strength -2..2
    Greater is smoother, less keeps more; 0 is the automatic choice. [default: 0]
more:
--assume [noise|texture]
    What the roughness of a mesh is where the estimate cannot tell noise from texture; it changes
    nothing where it can. Also without --auto. [default: a mild filter that is not much worse
    either way]
--prefer [positions|normals|volume]
    What is to come out best: places of vertices, directions of faces, or the enclosed volume.
    [default: a balance]
""",
        strength=number(-2.0, 2.0),
    ),
    group(
        "Limits on movement",
        """
--max-move LENGTH
    Longest move of a vertex, such as 0.3e; that is mean edge lengths, 0.05 is file units.
    [default: none]
--lock EXPR ...
    Vertices that stay, such as 'boundary'; 'confidence < 0.2' compares a PLY vertex property with
    a number. Repeatable.
more:
--unit
""",
    ),
    group(
        "Formats",
        """
more:
--to FORMAT
    Write another format (ply, obj, stl, glb, 3mf, ...); what it cannot carry is a warning.
    [default: that of the input, or of OUT's suffix]
--encoding [same|ascii|binary] = same
    How the output stores numbers.
--precision [same|float32|float64] = same
    Bits of the output's positions.
--strict
    Fail where a conversion loses something.
--format
""",
    ),
)

_MANY_FILES = group(
    "Many files",
    """
--include
--exclude
--jobs
--dry-run
    List what would be written, and touch nothing.
--fresh
more:
--retry-failed
--tile-set
    The files are tiles that touch: denoise them as the one mesh that they are, so that vertices
    which they share stay the same.
--timeout
--memory-limit
--scratch FOLDER
    Folder for the arrays of meshes that exceed the memory. [default: that of the output]
--max-faces
--retries
--fail-fast
--max-failures
--shard K/N|auto
    Take only the K-th of N parts of the files; N such runs do them all, on one machine or many.
    auto asks Slurm, AWS Batch or Kubernetes; auto/N gives N where they do not.
--engine [workers|dask] = workers
    Who does the work: worker processes here, or a Dask cluster (msal-cli[dask]).
--scheduler ADDRESS
    With --engine dask: the scheduler, such as tcp://host:8786 or tls://host:8786.
""",
)

_REPORTS = group(
    "Reports",
    """
--report FILE ... -> reports
    Write a record of every file; .json, .jsonl, .csv, .md (Markdown), .xml (JUnit) or .html (a
    page with pictures) by suffix. Repeatable.
--fail-on EXPR ...
    Exit with 4 if this is so for any file; such as 'abs(volume_change) > 1%', 'max_displacement >
    0.5e' (mean edge lengths) or 'flipped_faces > 0'. Repeatable.
--json
more:
--csv-columns
--reference TRUTH
    Measure the outputs against the true mesh, as msal compare does: a file, or a folder whose
    files have the relative paths of the inputs.
--check
--fields
""",
)

MESSAGES_AND_HELP = group(
    MESSAGES,
    """
--quiet
-v, --verbose ...
    Show every file and step; -vv shows everything.
more:
--log-file FILE
    Append everything, with times, to a file.
""",
)

GROUPS = (_INPUT_AND_OUTPUT, *HOW_TO_DENOISE, _MANY_FILES, _REPORTS, MESSAGES_AND_HELP)
