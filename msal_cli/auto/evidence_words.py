"""The noise in the sentence that says what was chosen."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from msal_cli.analysis.noise_estimate import NoiseLevel

PLAIN = ("none", "white", "impulsive", "unknown")
"""Kinds that need no words beside the level."""


def describe_noise(noise: NoiseLevel) -> str:
    """Such as ``noise 0.21 e, shared over two rings``."""
    if noise.is_impulsive:
        text = f"impulsive noise {noise.rms_edges:.2g} e"
    else:
        text = f"noise {noise.mean_edges:.2g} e"
    character = noise.character
    return text if character.kind in PLAIN else f"{text}, {character.words}"
