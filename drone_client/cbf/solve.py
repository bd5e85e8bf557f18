"""The nearest safe velocity, in closed form (docs/cbf.md, section 5, with its KKT conditions)."""

from __future__ import annotations

import math
from typing import NamedTuple

from drone_client.cbf.half_space import HalfSpace
from drone_client.cbf.status import Status
from drone_client.cbf.vector import ZERO, Vec3

LARGEST = 1e9
"""Numbers beyond this are not a problem about a drone; they and NaN get the answer ABORT."""
SMALLEST_NORMAL = 1e-9
"""A shorter normal has no direction. The gradient of a barrier has length one or more."""


class Solution(NamedTuple):
    """A velocity, and what had to be done to the nominal one."""

    u: Vec3
    """[m/s], at most ``v_max`` long."""
    status: Status
    """INACTIVE, ACTIVE or MAX_HDOT; ABORT (with zero velocity) where the input is no problem."""


def solve(u_nominal: Vec3, half_space: HalfSpace, v_max: float) -> Solution:
    """Minimise ``|u - u_nominal|`` subject to ``normal . u >= offset`` and ``|u| <= v_max``.

    Never raises. If no velocity does both, the one that gives the largest ``normal . u``.

    Args:
        u_nominal: Wanted velocity [m/s].
        half_space: What the barrier asks.
        v_max: Speed limit [m/s]; a negative one counts as zero.
    """
    (ux, uy, uz), ((nx, ny, nz), offset) = u_nominal, half_space
    size = abs(ux) + abs(uy) + abs(uz) + abs(nx) + abs(ny) + abs(nz) + abs(offset) + abs(v_max)
    length = math.hypot(nx, ny, nz)
    # A comparison with NaN is False: everything that is not a plain number ends here.
    if not (size <= LARGEST and length >= SMALLEST_NORMAL):
        return Solution(ZERO, Status.ABORT)
    v = max(v_max, 0.0)
    nx, ny, nz, d = nx / length, ny / length, nz / length, offset / length

    # 1. The speed limit alone.
    speed = math.hypot(ux, uy, uz)
    k = v / speed if speed > v else 1.0
    if (nx * ux + ny * uy + nz * uz) * k >= d:
        return Solution((ux * k, uy * k, uz * k), Status.INACTIVE)
    # 2. Empty: the plane is out of the ball's reach.
    if d > v:
        return Solution((nx * v, ny * v, nz * v), Status.MAX_HDOT)
    # 3. The plane alone: t is the part of the nominal velocity along it.
    along = nx * ux + ny * uy + nz * uz
    tx, ty, tz = ux - along * nx, uy - along * ny, uz - along * nz
    t = math.hypot(tx, ty, tz)
    radius = math.sqrt(max(v * v - d * d, 0.0))
    # 4. Both: the circle in which the plane cuts the ball; else k = 1 leaves t as it is.
    k = radius / t if t > radius else 1.0
    return Solution((d * nx + k * tx, d * ny + k * ty, d * nz + k * tz), Status.ACTIVE)
