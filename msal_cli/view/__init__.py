"""Pictures of meshes as PNG, without a graphics card and without a display."""

from __future__ import annotations

from msal_cli.view.camera import Camera, automatic_camera
from msal_cli.view.panels import Legend, labelled_panels, png_bytes
from msal_cli.view.shading import DARK, LIGHT, Style, shaded

__all__ = [
    "DARK",
    "LIGHT",
    "Camera",
    "Legend",
    "Style",
    "automatic_camera",
    "labelled_panels",
    "png_bytes",
    "shaded",
]
