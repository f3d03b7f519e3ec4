"""Denoise triangle meshes with the multiscale anisotropic Laplacian of Huang and Ascher.

The package is a command-line tool first (``msal --help``); importing it costs nothing and
pulls in no numerical library.
"""

__version__ = "0.1.0"
