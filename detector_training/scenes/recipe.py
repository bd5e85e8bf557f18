"""What a picture shall show: the paper's eight bad conditions, a few more, and the mix of training.

A recipe names a plan; a plan is what chance may do, as probabilities and ranges. The eight of the
paper (Table I): blur, low light, obstruction, surface distortion, far, orientation, flare, close.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from rgbd_wire.camera import CameraIntrinsics


class Recipe(StrEnum):
    """The kind of pictures to make."""

    MIXED = "mixed"
    """For training: any of the others, and pictures where several conditions meet."""
    NOMINAL = "nominal"
    """0.5 to 6 m, whole, at most 35 degrees of tilt, fairly lit and sharp."""
    BLUR = "blur"
    LOW_LIGHT = "low_light"
    OBSTRUCTION = "obstruction"
    DISTORTION = "distortion"
    """The print is bent, creased or crumpled."""
    FAR = "far"
    """Boards of 14 to 40 px."""
    ORIENTATION = "orientation"
    """Tilts of 40 to 68 degrees, any roll."""
    FLARE = "flare"
    CLOSE = "close"
    """Boards of 300 to 620 px, some cut by the border."""
    OVER_EXPOSED = "over_exposed"
    GLOSSY = "glossy"
    """Under a cover that mirrors lamps and the room."""
    SCRATCHED = "scratched"
    HARD_NEGATIVES = "hard_negatives"
    """No target, and one or more things that look like one."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What chance may do with one picture; probabilities are in [0, 1]."""

    camera: CameraIntrinsics | None = None
    """Who looks; None: any of the common ones."""
    negative: float = 0.0
    """That there is no target."""
    board_px: tuple[float, float] = (14.0, 320.0)
    """Apparent side of the board head-on, uniform in its logarithm ..."""
    distance_m: tuple[float, float] | None = None
    """... or its distance, uniform, when given."""
    cut: float = 0.0
    """That the border may cut the board."""
    whole: bool = False
    """Nothing of it lies outside the picture, however it is tilted; for a plan that cuts none."""
    tilt_deg: tuple[float, float] | None = None
    """Uniform between these; None: about normal with 28 degrees, at most 70."""
    any_roll: float = 0.1
    wall: float = 0.45
    lookalikes: float = 0.4
    """Mean number beside a target."""
    lookalikes_alone: float = 1.6
    """Mean number in a picture without a target ..."""
    lookalikes_least: int = 0
    """... and at least so many there."""
    worn: tuple[float, float, float] = (0.3, 0.05, 0.5)
    """Probability, least and most strength of dirt and scratches."""
    relief: float = 0.0
    """That the print is not flat."""
    gloss: float = 0.1
    mirror: float = 0.0
    """That a glossy cover shows the room as well."""
    shadow: float = 0.2
    occluder: float = 0.0
    arm: float = 0.0
    flare: float = 0.0
    motion: tuple[float, float] = (0.1, 0.15)
    """Probability, and the longest smear as a share of the outer disc."""
    defocus: tuple[float, float] = (0.1, 0.04)
    """Probability, and the widest blur radius as a share of the outer disc."""
    soft_px: tuple[float, float] = (0.3, 0.9)
    """Sigma of the blur that a lens has at its best, uniform."""
    dark: float = 0.0
    dark_stops: tuple[float, float] = (-3.8, -1.8)
    """Exposure of a dark picture, uniform ..."""
    dark_noise: float = 4.0
    """... and by what it divides the electrons at white: light that lacks is made up by gain."""
    bright: float = 0.0
    stops: float = 0.6
    """Standard deviation of the exposure otherwise."""
    full_well: tuple[float, float] = (2_000.0, 20_000.0)
    """Electrons at white, uniform in the logarithm; few make noise."""
    quality: tuple[int, int] = (50, 97)
    """JPEG."""


_NOMINAL = Plan(distance_m=(0.5, 6.0), tilt_deg=(0.0, 35.0), any_roll=0.05)
_COMPOUND = Plan(
    negative=0.12,
    board_px=(12.0, 560.0),
    cut=0.15,
    lookalikes=0.5,
    worn=(0.45, 0.1, 1.0),
    relief=0.15,
    gloss=0.2,
    mirror=0.3,
    shadow=0.25,
    occluder=0.25,
    arm=0.12,
    flare=0.1,
    motion=(0.35, 0.35),
    defocus=(0.2, 0.1),
    dark=0.12,
    bright=0.08,
    stops=0.7,
    full_well=(300.0, 20_000.0),
    quality=(35, 97),
)

PLANS: dict[Recipe, Plan] = {
    Recipe.MIXED: _COMPOUND,
    Recipe.NOMINAL: _NOMINAL,
    Recipe.BLUR: replace(_NOMINAL, motion=(0.6, 0.35), defocus=(0.6, 0.1)),
    Recipe.LOW_LIGHT: replace(_NOMINAL, dark=1.0, full_well=(600.0, 20_000.0)),
    Recipe.OBSTRUCTION: replace(_NOMINAL, occluder=0.8, arm=0.4),
    Recipe.DISTORTION: replace(_NOMINAL, relief=1.0),
    Recipe.FAR: replace(_NOMINAL, distance_m=None, board_px=(14.0, 40.0)),
    Recipe.ORIENTATION: replace(_NOMINAL, tilt_deg=(40.0, 68.0), any_roll=0.5),
    Recipe.FLARE: replace(_NOMINAL, flare=1.0),
    Recipe.CLOSE: replace(_NOMINAL, distance_m=None, board_px=(300.0, 620.0), cut=0.4),
    Recipe.OVER_EXPOSED: replace(_NOMINAL, bright=1.0),
    Recipe.GLOSSY: replace(_NOMINAL, gloss=0.85, mirror=0.75),
    Recipe.SCRATCHED: replace(_NOMINAL, worn=(1.0, 0.6, 1.3)),
    Recipe.HARD_NEGATIVES: replace(
        _COMPOUND, negative=1.0, lookalikes_alone=2.0, lookalikes_least=1
    ),
}

_MIX: dict[Recipe, float] = {
    Recipe.MIXED: 0.36,
    Recipe.HARD_NEGATIVES: 0.14,
    Recipe.NOMINAL: 0.06,
    Recipe.BLUR: 0.06,
    Recipe.LOW_LIGHT: 0.05,
    Recipe.OBSTRUCTION: 0.05,
    Recipe.DISTORTION: 0.05,
    Recipe.FAR: 0.07,
    Recipe.ORIENTATION: 0.06,
    Recipe.FLARE: 0.03,
    Recipe.CLOSE: 0.03,
    Recipe.OVER_EXPOSED: 0.02,
    Recipe.GLOSSY: 0.01,
    Recipe.SCRATCHED: 0.01,
}
"""Shares of training pictures; the hard ones more often than the easy ones."""


def choose_plan(rng: np.random.Generator, recipe: Recipe) -> tuple[Recipe, Plan]:
    """The plan of one picture, and what it is named after (``MIXED``: several conditions meet)."""
    if recipe is Recipe.MIXED:
        kinds = list(_MIX)
        recipe = kinds[int(rng.choice(len(kinds), p=np.array(list(_MIX.values()))))]
    return recipe, PLANS[recipe]
