"""Four rotors in an X: which thrust each of them takes for a wanted thrust and torque.

The motors' lag is the model's own (a first-order filter before each rotor's force, solved exactly
by MuJoCo at every physics step); so is the torque by which a rotor's drag turns the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from contact_sim.errors import VehicleError
from drone_client.cbf.vector import Vec3

MAX_THRUST_N = 16.5
"""Of one rotor; four of them lift twice the drone's weight."""
LAG_S = 0.04
"""Time constant of a motor with a propeller of 13 inches."""
DRAG_TORQUE_M = 0.03
"""Torque about a rotor's axis by its drag, per thrust [N m / N]."""
YAW_SHARE = 0.15
"""So much of a rotor's range is kept for turning, when rolling or pitching would take it all."""

Thrusts: TypeAlias = tuple[float, float, float, float]


class Effort(NamedTuple):
    """What the velocity loop wants of the rotors."""

    thrust_n: float
    """Along the body's z."""
    torque_body: Vec3
    """[N m], FLU."""


@dataclass(frozen=True, slots=True)
class Mixer:
    """Where the rotors are; makes thrusts of efforts."""

    x_m: Thrusts
    y_m: Thrusts
    """Of each rotor in the body."""
    spin: Thrusts
    """1: its drag turns the body counter-clockwise, seen from above; -1: clockwise."""
    per_roll: Thrusts
    per_pitch: Thrusts
    per_yaw: Thrusts
    """Thrusts of a torque of 1 N m [N / N m]."""

    @classmethod
    def of(cls, places_body: Sequence[Vec3]) -> Mixer:
        """For rotors at these places [m], one in each quarter.

        Raises:
            VehicleError: they are no X of four.
        """
        if sorted((x > 0.0, y > 0.0) for x, y, _ in places_body) != [
            (False, False),
            (False, True),
            (True, False),
            (True, True),
        ]:
            raise VehicleError(
                "four rotors are needed, one in each quarter around the body's origin, not "
                f"{len(places_body)} at {[tuple(round(c, 3) for c in p) for p in places_body]}"
            )
        x, y = [p[0] for p in places_body], [p[1] for p in places_body]
        # as PX4's quadrotor x: front right and rear left turn counter-clockwise themselves, and
        # their drag turns the body the other way
        spin = [1.0 if a * b > 0.0 else -1.0 for a, b in zip(x, y, strict=True)]
        effort_from_thrusts = np.array(
            [[1.0] * 4, y, [-a for a in x], [DRAG_TORQUE_M * s for s in spin]]
        )
        try:
            columns = np.linalg.inv(effort_from_thrusts).T
        except np.linalg.LinAlgError:
            raise VehicleError(
                f"rotors at x = {x}, y = {y} cannot lift, roll, pitch and turn at will"
            ) from None
        return cls(_four(x), _four(y), _four(spin), *(_four(c) for c in columns[1:].tolist()))

    @property
    def authority_nm(self) -> Vec3:
        """Torque about each axis with half of the rotors at their most and the others at rest."""
        half_n = 0.5 * MAX_THRUST_N
        return (
            half_n * sum(abs(y) for y in self.y_m),
            half_n * sum(abs(x) for x in self.x_m),
            half_n * DRAG_TORQUE_M * 4.0,
        )

    def thrusts(self, effort: Effort) -> Thrusts:
        """What the rotors do for it [N], each within its range.

        What does not fit is given up in PX4's order: turning first, then lift, and rolling and
        pitching at the very last.
        """
        roll, pitch, yaw = effort.torque_body
        r, p, y = self.per_roll, self.per_pitch, self.per_yaw
        # Rotor by rotor: four are fewer than a loop over them costs
        tilting = (
            r[0] * roll + p[0] * pitch,
            r[1] * roll + p[1] * pitch,
            r[2] * roll + p[2] * pitch,
            r[3] * roll + p[3] * pitch,
        )
        turning = y[0] * yaw, y[1] * yaw, y[2] * yaw, y[3] * yaw
        low, high = min(tilting), max(tilting)
        fit = 1.0
        if high - low > MAX_THRUST_N:
            fit = MAX_THRUST_N / (high - low)
            low, high = fit * low, fit * high
        lift = min(max(0.25 * effort.thrust_n, -low), MAX_THRUST_N - high)
        a, b, c, d = tilting
        base = lift + fit * a, lift + fit * b, lift + fit * c, lift + fit * d
        a, b, c, d = _sum(base, turning)
        if min(a, b, c, d) >= 0.0 and max(a, b, c, d) <= MAX_THRUST_N:
            return a, b, c, d
        return _squeezed(base, turning)


def _sum(p: Thrusts, q: Thrusts) -> Thrusts:
    return p[0] + q[0], p[1] + q[1], p[2] + q[2], p[3] + q[3]


def _squeezed(base: Thrusts, turning: Thrusts) -> Thrusts:
    """With as much of the turning as fits, at least ``YAW_SHARE``; lift is given up for that."""
    share = 1.0
    for b, t in zip(base, turning, strict=True):
        if t > 0.0:
            share = min(share, (MAX_THRUST_N - b) / t)
        elif t < 0.0:
            share = min(share, -b / t)
    largest = max(abs(t) for t in turning)
    if largest > 0.0:
        share = max(share, 0.0, min(1.0, YAW_SHARE * MAX_THRUST_N / largest))
    a, b, c, d = (
        min(max(p + share * t, 0.0), MAX_THRUST_N) for p, t in zip(base, turning, strict=True)
    )
    return a, b, c, d


def _four(values: Sequence[float]) -> Thrusts:
    a, b, c, d = values
    return a, b, c, d
