"""The Python API: the names of ``import msal_cli``.

Functions take numpy arrays, objects of other mesh libraries, or paths.  They print nothing; the
log goes to the logger ``msal``.  Errors are those of ``msal_cli.errors``.
"""

# ``as`` exports a name, also for type checkers.
# ruff: noqa: I001
import logging

from msal_cli.api.denoise import (
    DenoiseResult as DenoiseResult,
    MethodInfo as MethodInfo,
    denoise as denoise,
    denoise_file as denoise_file,
    denoise_folder as denoise_folder,
    list_methods as list_methods,
)
from msal_cli.api.measure import (
    add_noise as add_noise,
    compare as compare,
    estimate_noise as estimate_noise,
)
from msal_cli.batch.inputs import NothingMatched as NothingMatched
from msal_cli.errors import (
    ContentError as ContentError,
    FormatError as FormatError,
    InputError as InputError,
    InternalError as InternalError,
    LossError as LossError,
    MissingFileError as MissingFileError,
    MissingInputError as MissingInputError,
    MsalError as MsalError,
    OutputError as OutputError,
    ResourceError as ResourceError,
    TooLargeError as TooLargeError,
    TruncatedError as TruncatedError,
    UnsupportedError as UnsupportedError,
    UsageError as UsageError,
)
from msal_cli.job.records import (
    Area as Area,
    ChoiceMade as ChoiceMade,
    ComparisonRecord as ComparisonRecord,
    Displacement as Displacement,
    Failure as Failure,
    GateResult as GateResult,
    MeshRecord as MeshRecord,
    MethodUsed as MethodUsed,
    NoiseEstimate as NoiseEstimate,
    NoiseReading as NoiseReading,
    NormalChange as NormalChange,
    Seconds as Seconds,
    SelfIntersections as SelfIntersections,
    SurfaceDistance as SurfaceDistance,
    Volume as Volume,
)

# Without a handler Python would print warnings to standard error.
logging.getLogger("msal").addHandler(logging.NullHandler())
