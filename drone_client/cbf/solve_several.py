"""The nearest velocity within several half-spaces and a speed limit (docs/cbf.md, section 11).

Exact, without iterating towards anything where the problem has a solution: the answer lies on a
face of the set, a face is where at most three planes meet, and there are few of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from drone_client.cbf.half_space import HalfSpace
from drone_client.cbf.solve import LARGEST, SMALLEST_NORMAL, Solution, solve
from drone_client.cbf.status import Status
from drone_client.cbf.vector import ZERO, Vec3, cross, dot, moved, norm, scaled

TOLERANCE = 1e-9
"""By how much a velocity [m/s] may miss a half-space and count as inside."""
ROUNDING = 1e-12
"""The same where the simplest answer is looked at first."""
PARALLEL = 1e-9
"""Sine of the angle below which two normals are one, or a third lies in the plane of two."""
HALVINGS = 30
"""Of the violation that planes which contradict each other share; a billionth of it is left."""


class _Row(NamedTuple):
    """``normal . u >= offset`` with a normal of length one."""

    normal: Vec3
    offset: float


class _Face(NamedTuple):
    """Where some planes meet: the point nearest to zero, and the directions within."""

    point: Vec3
    axes: tuple[Vec3, ...]
    """Orthonormal; what spans the planes' normals."""

    def along(self, direction: Vec3) -> Vec3:
        """The part of a direction that stays in the face."""
        for axis in self.axes:
            direction = moved(direction, axis, -dot(axis, direction))
        return direction if len(self.axes) < 3 else ZERO


def solve_several(
    u_nominal: Vec3, keep_outs: Sequence[HalfSpace], wishes: Sequence[HalfSpace], v_max: float
) -> Solution:
    """Minimise ``|u - u_nominal|`` in all half-spaces and ``|u| <= v_max``; exact, never raises.

    Where no velocity is in all of them: the one whose largest violation of a keep-out is smallest;
    among those, wish by wish, the one that comes nearest to it; among those the nearest to the
    nominal velocity. The status is then MAX_HDOT.

    Args:
        u_nominal: Wanted velocity [m/s].
        keep_outs: What keeps the body from colliding; all of one rank.
        wishes: What matters after that, the first most.
        v_max: Speed limit [m/s]; a negative one counts as zero.
    """
    rows = [_row(half_space) for half_space in (*keep_outs, *wishes)]
    size = abs(u_nominal[0]) + abs(u_nominal[1]) + abs(u_nominal[2]) + abs(v_max)
    if not size <= LARGEST or None in rows:
        return Solution(ZERO, Status.ABORT)
    known = [row for row in rows if row is not None]
    v = max(v_max, 0.0)
    solution = _by_the_last_alone(u_nominal, wishes, v)
    others = known[:-1] if wishes else known
    if all(dot(row.normal, solution.u) >= row.offset - ROUNDING for row in others):
        return solution
    return _ranked(u_nominal, known[: len(keep_outs)], known[len(keep_outs) :], v)


def _by_the_last_alone(u_nominal: Vec3, wishes: Sequence[HalfSpace], v: float) -> Solution:
    """The answer if nothing but the last wish changes the nominal velocity."""
    if wishes:
        return solve(u_nominal, wishes[-1], v)
    speed = norm(u_nominal)
    return Solution(scaled(u_nominal, v / speed) if speed > v else u_nominal, Status.INACTIVE)


def _ranked(goal: Vec3, keep_outs: list[_Row], wishes: list[_Row], v: float) -> Solution:
    """The whole problem, rank by rank; each leaves a set that is not empty."""
    status, rows = Status.ACTIVE, keep_outs
    best = _nearest(goal, rows, v)
    if best is None:
        rows, status = _eased(rows, v), Status.MAX_HDOT
        best = _nearest(goal, rows, v) or ZERO
    for wish in wishes:
        nearest = _nearest(goal, [*rows, wish], v)
        if nearest is None:
            status = Status.MAX_HDOT
            best = _furthest(wish.normal, goal, rows, v) or best
            wish = _Row(wish.normal, dot(wish.normal, best))
            nearest = _nearest(goal, [*rows, wish], v)
        rows, best = [*rows, wish], nearest or best
    return Solution(best, status)


def _eased(rows: list[_Row], v: float) -> list[_Row]:
    """The same half-spaces, all moved back by the least that leaves a velocity in them."""
    # Zero velocity misses none by more than this.
    low, high = 0.0, max(row.offset for row in rows)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _is_empty(_moved_back(rows, middle), v):
            low = middle
        else:
            high = middle
    return _moved_back(rows, high)


def _moved_back(rows: list[_Row], by: float) -> list[_Row]:
    return [_Row(row.normal, row.offset - by) for row in rows]


def _is_empty(rows: list[_Row], v: float) -> bool:
    """Whether no velocity is in all of them: the point nearest to zero is that of its face."""
    for (x, y, z), _ in _faces(rows, v):
        for (nx, ny, nz), offset in rows:
            if nx * x + ny * y + nz * z < offset - TOLERANCE:
                break
        else:
            return False
    return True


def _nearest(goal: Vec3, rows: list[_Row], v: float) -> Vec3 | None:
    """Point of the set nearest to ``goal``; None: the set is empty.

    On its face the answer is the projection of the goal, pulled onto the sphere of radius ``v``
    where it is outside. Every point that is tried and lies in the set is at least as far.
    """
    best, least = None, math.inf
    for face in _faces(rows, v):
        u = _pulled(face, face.along(goal), v, stretch=False)
        if not all(dot(row.normal, u) >= row.offset - TOLERANCE for row in rows):
            continue
        distance = norm(moved(u, goal, -1.0))
        if distance < least:
            best, least = u, distance
    return best


def _furthest(direction: Vec3, goal: Vec3, rows: list[_Row], v: float) -> Vec3 | None:
    """Point of the set furthest along a unit direction; of several the nearest to ``goal``."""
    best, most, least = None, -math.inf, math.inf
    for face in _faces(rows, v):
        along = face.along(direction)
        if norm(along) > TOLERANCE:
            u = _pulled(face, along, v, stretch=True)
        else:
            u = _pulled(face, face.along(goal), v, stretch=False)
        if not all(dot(row.normal, u) >= row.offset - TOLERANCE for row in rows):
            continue
        reached, distance = dot(direction, u), norm(moved(u, goal, -1.0))
        if reached > most + TOLERANCE or (reached > most - TOLERANCE and distance < least):
            best, most, least = u, max(most, reached), distance
    return best


def _pulled(face: _Face, along: Vec3, v: float, *, stretch: bool) -> Vec3:
    """The point of a face at ``along`` from its middle, within the sphere; on it, if stretched."""
    x, y, z = face.point
    radius = math.sqrt(max(0.0, v * v - (x * x + y * y + z * z)))
    length = norm(along)
    k = radius / length if length > radius or (stretch and length > 0.0) else 1.0
    u = moved(face.point, along, k)
    speed = norm(u)
    return scaled(u, v / speed) if speed > v else u


def _faces(rows: list[_Row], v: float) -> Iterator[_Face]:
    """Every set in which at most three of the planes meet within the sphere.

    Planes that add no direction are passed over: they are parallel to what is there already. A
    face beyond the sphere is none, and nor is any smaller one within it.
    """
    middle = _Face(ZERO, ())
    yield middle
    for i, first in enumerate(rows):
        face = _cut(middle, first, v)
        if face is None:
            continue
        yield face
        for j in range(i + 1, len(rows)):
            edge = _cut(face, rows[j], v)
            if edge is None:
                continue
            yield edge
            for k in range(j + 1, len(rows)):
                corner = _cut(edge, rows[k], v)
                if corner is not None:
                    yield corner


def _cut(face: _Face, row: _Row, v: float) -> _Face | None:
    """The face cut with one more plane (a step of Gram and Schmidt's); None: not in the sphere."""
    (nx, ny, nz), offset = row
    if len(face.axes) == 2:
        axis = cross(*face.axes)
        sine = nx * axis[0] + ny * axis[1] + nz * axis[2]
        if abs(sine) < PARALLEL:
            return None
    else:
        x, y, z = face.along(row.normal)
        sine = math.hypot(x, y, z)
        if sine < PARALLEL:
            return None
        axis = x / sine, y / sine, z / sine
    x, y, z = face.point
    k = (offset - (nx * x + ny * y + nz * z)) / sine
    x, y, z = x + k * axis[0], y + k * axis[1], z + k * axis[2]
    if not math.hypot(x, y, z) <= v + TOLERANCE:
        return None
    return _Face((x, y, z), (*face.axes, axis))


def _row(half_space: HalfSpace) -> _Row | None:
    """With a normal of length one; None: not a problem about a drone."""
    (x, y, z), offset = half_space
    length = math.hypot(x, y, z)
    # A comparison with NaN is False.
    if not (SMALLEST_NORMAL <= length <= LARGEST and abs(offset) <= LARGEST):
        return None
    return _Row((x / length, y / length, z / length), offset / length)
