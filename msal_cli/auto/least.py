"""What is done where no filter seems to be worth its harm: nothing, or the least that a wish means.

A mesh without noise to speak of stays as it is.  But what is asked for explicitly is done: more
smoothing than the automatic choice means some smoothing, and the mildest setting for the upper end
of the noise's interval is taken.  A wish that does not mean smoothing gets a reason, and the
command that smooths all the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msal_cli import methods
from msal_cli.analysis.noise_estimate import SURE
from msal_cli.auto.candidates import wiener_al
from msal_cli.auto.wishes import NONE, Choice, Wishes

if TYPE_CHECKING:
    from msal_cli.analysis.noise_estimate import NoiseLevel

LEAST = 0.05
"""Mean edge lengths: noise that a mesh is smoothed for at least, where smoothing is asked for."""

STRENGTH = 1.2
"""Factor of the noise that is reckoned with for each step of ``Wishes.strength``."""

SHAPE = 1.25
"""The same where the smooth shape is to be kept."""


def choose_least(
    noise: NoiseLevel, wishes: Wishes, why: str, surface: str, is_harm: bool = False
) -> Choice:
    """The choice for a mesh where ``why`` no filter is worth its harm, such as ``clean``; if
    ``is_harm``, that is not because noise is missing."""
    what = f"noise {noise.mean_edges:.2g} e; {why}"
    is_less = wishes.strength < 0.0 or wishes.keep == "texture"
    is_more = wishes.strength > 0.0 or wishes.keep == "shape"
    if wishes == Wishes() or (is_less and not is_more):
        return Choice(NONE, {}, f"{what}; left as it is", surface, noise)
    level = max(noise.high, noise.mean_edges)
    if is_more:
        level = max(level, LEAST) * STRENGTH**wishes.strength
        level *= SHAPE if wishes.keep == "shape" else 1.0
    elif level < SURE or is_harm:
        hint = "--strength 1 smooths it all the same"
        return Choice(NONE, {}, f"{what}; left as it is; {hint}", surface, noise)
    level = round(level, 4)
    candidate = wiener_al(level)
    return Choice(
        candidate.method,
        methods.find(candidate.method).validate(candidate.settings(level)),
        f"{what}; smoothed as if it had {level:.2g} e, for that is wished; {candidate.label}",
        surface,
        noise,
    )
