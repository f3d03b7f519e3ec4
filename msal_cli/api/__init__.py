"""The Python API: what ``import msal_cli`` offers.

Functions take arrays of numpy, objects of other mesh libraries, or paths.  They print nothing; the
log goes to the logger ``msal``.  Errors are those of ``msal_cli.errors``.
"""

from __future__ import annotations

import logging

from msal_cli.api.compare import compare
from msal_cli.api.denoise import DenoiseResult, denoise
from msal_cli.api.files import denoise_file, denoise_folder
from msal_cli.api.method_list import MethodInfo, list_methods
from msal_cli.api.noise import add_noise, estimate_noise
from msal_cli.batch.inputs import NothingMatched
from msal_cli.errors import (
    ContentError,
    FormatError,
    InputError,
    InternalError,
    LossError,
    MissingFileError,
    MissingInputError,
    MsalError,
    OutputError,
    ResourceError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
    UsageError,
)
from msal_cli.job.records import (
    Area,
    ChoiceMade,
    ComparisonRecord,
    Displacement,
    Failure,
    GateResult,
    MeshRecord,
    MethodUsed,
    NoiseEstimate,
    NoiseReading,
    NormalChange,
    Seconds,
    SelfIntersections,
    SurfaceDistance,
    Volume,
)

__all__ = [
    "Area",
    "ChoiceMade",
    "ComparisonRecord",
    "ContentError",
    "DenoiseResult",
    "Displacement",
    "Failure",
    "FormatError",
    "GateResult",
    "InputError",
    "InternalError",
    "LossError",
    "MeshRecord",
    "MethodInfo",
    "MethodUsed",
    "MissingFileError",
    "MissingInputError",
    "MsalError",
    "NoiseEstimate",
    "NoiseReading",
    "NormalChange",
    "NothingMatched",
    "OutputError",
    "ResourceError",
    "Seconds",
    "SelfIntersections",
    "SurfaceDistance",
    "TooLargeError",
    "TruncatedError",
    "UnsupportedError",
    "UsageError",
    "Volume",
    "add_noise",
    "compare",
    "denoise",
    "denoise_file",
    "denoise_folder",
    "estimate_noise",
    "list_methods",
]

# Without a handler Python would print warnings to standard error.
logging.getLogger("msal").addHandler(logging.NullHandler())
