"""An approach flight: from the side and 3 m away to 0.8 m in front of the target, swaying."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.room import looking
from rgbd_wire.geometry import Pose, rotation_from_vector

START_M = (2.9, 0.75, 0.12)
"""Distance from the wall, to the north of the target and above it, at first ..."""
END_M = (0.8, 0.02, 0.0)
"""... and at last."""
APPROACH_S = (0.2, 3.5)
"""From when to when it moves."""
TURN_S = 1.5
"""How long it takes to turn towards the target."""
TURN_RAD = math.radians(52)
"""How far it looks past the target at first: out of a D455's picture."""


@dataclass(frozen=True, slots=True)
class Sway:
    """Smooth disturbance: a few sine waves per axis."""

    amplitude: NDArray[np.float64]  # (6, K): position [m], then rotation [rad]
    rate_rad_s: NDArray[np.float64]  # (6, K)
    phase_rad: NDArray[np.float64]  # (6, K)

    def at(self, t_s: float) -> NDArray[np.float64]:
        """Displacement (6,): metres, then radians."""
        wave = self.amplitude * np.sin(self.rate_rad_s * t_s + self.phase_rad)
        return np.asarray(wave.sum(1))


def random_sway(rng: np.random.Generator) -> Sway:
    """What gusts and a position controller leave: about 2 cm and 1 degree, 0.3 to 1.5 Hz."""
    size = np.array([0.012, 0.02, 0.015, 0.012, 0.012, 0.01])[:, None]
    rate = 2 * math.pi * rng.uniform(0.3, 1.5, (6, 3))
    return Sway(size * rng.uniform(0.4, 1.0, (6, 3)), rate, rng.uniform(0, 2 * math.pi, (6, 3)))


def world_from_camera(
    t_s: float, target_world: NDArray[np.float64], sway: Sway, pace: float = 1.0
) -> Pose:
    """Pose of the colour camera ``t_s`` after the start; ``target_world`` (3,) hangs at x = 0.

    At a ``pace`` of 0.5 the approach takes twice as long; it sways as quickly as ever.
    """
    s = _ease((t_s * pace - APPROACH_S[0]) / (APPROACH_S[1] - APPROACH_S[0]))
    away, north, up = np.array(START_M) + s * (np.array(END_M) - np.array(START_M))
    shake = sway.at(t_s)
    place = target_world + np.array([-away, north, up]) + shake[:3]
    past = TURN_RAD * (1 - _ease(t_s * pace / TURN_S))
    towards = rotation_from_vector(np.array([0.0, 0.0, past])) @ (target_world - place)
    steady = looking(place, towards)
    return Pose.from_rotation(steady.rotation @ rotation_from_vector(shake[3:]), place)


def _ease(s: float) -> float:
    """From 0 to 1 with soft ends and an even middle: the integral of a trapezoid with 20 % ramps.

    A minimum-jerk curve would be nearly twice as fast in the middle.
    """
    s = min(max(s, 0.0), 1.0)
    ramp = 0.2
    peak = 1 / (1 - ramp)
    if s < ramp:
        return peak * s * s / (2 * ramp)
    if s > 1 - ramp:
        return 1 - peak * (1 - s) ** 2 / (2 * ramp)
    return peak * (s - ramp / 2)
