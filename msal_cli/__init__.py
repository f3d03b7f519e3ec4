"""Denoise triangle meshes with the multiscale anisotropic Laplacian of Huang and Ascher.

The package is a command, ``msal`` (see ``msal --help``), and a library::

    import msal_cli as msal

    smooth = msal.denoise(vertices, faces)  # arrays in, a result with new vertices out
    mesh = msal.denoise(mesh)  # trimesh, pyvista, meshio, open3d: the same type back

Importing it costs next to nothing and loads no numerical library: the functions are loaded where
they are first used (see ``msal_cli.api``).
"""

# ruff: noqa: F403, F405
from msal_cli.version import __version__

# As in ``typing``, which costs more than all the rest of this module.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from msal_cli.api import *

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
    "__version__",
    "add_noise",
    "compare",
    "denoise",
    "denoise_file",
    "denoise_folder",
    "estimate_noise",
    "list_methods",
]


if not TYPE_CHECKING:
    # Hidden from type checkers: they would take any name for one of the module.
    def __getattr__(name):
        """A name of the Python API, loaded when it is first used."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        import importlib

        value = globals()[name] = getattr(importlib.import_module("msal_cli.api"), name)
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
