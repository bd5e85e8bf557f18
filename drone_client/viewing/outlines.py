"""The drone, the board and the funnel as lines, for any viewer."""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from drone_client.cbf import Funnel
from drone_client.viewing.facts import FlightFacts

Rgb: TypeAlias = tuple[float, float, float]

CIRCLE_POINTS: Final = 49
FUNNEL_ENDS_M: Final = (0.0, 0.1, 0.3, 0.6, 1.0, 1.5)
"""Distances from the board's plane at which the funnel is shown as a ring."""
HULL_M: Final = (0.11, 0.09, 0.035)
"""Half sides of a box that stands for the body."""
DRONE: Final[Rgb] = (0.2, 0.75, 1.0)
BOARD: Final[Rgb] = (1.0, 1.0, 1.0)
FUNNEL: Final[Rgb] = (0.35, 0.85, 0.45)


class Outline(NamedTuple):
    """A line strip."""

    points: NDArray[np.float64]  # (n, 3) [m]
    color: Rgb


def circle(radius_m: float, normal: int, at: tuple[float, float, float]) -> NDArray[np.float64]:
    """Points (n, 3) of a circle around a place; ``normal`` is the number of its axis."""
    angle = np.linspace(0.0, 2.0 * math.pi, CIRCLE_POINTS)
    points = np.tile(np.array(at, dtype=np.float64), (CIRCLE_POINTS, 1))
    points[:, (normal + 1) % 3] += radius_m * np.cos(angle)
    points[:, (normal + 2) % 3] += radius_m * np.sin(angle)
    return points


def board_outlines(facts: FlightFacts) -> list[Outline]:
    """The printed target, in its own frame."""
    half = facts.board_side_m / 2
    square = np.array([(0.0, y * half, z * half) for y, z in _SQUARE])
    discs = [circle(d / 2, 0, (0.0, 0.0, 0.0)) for d in facts.discs_m]
    return [Outline(points, BOARD) for points in (square, *discs)]


def funnel_radius_m(funnel: Funnel, x_m: float) -> float:
    """Radius of the safe set at a distance from the board's plane: where ``h`` is zero."""
    root = x_m / funnel.a + math.sqrt(math.hypot(funnel.r_c_m, funnel.e_m))
    return math.sqrt(max(0.0, root**4 - funnel.e_m**2))


def funnel_outlines(facts: FlightFacts) -> list[Outline]:
    """Rings of the safe set of the tip, and four lines along it, in the target's frame."""
    funnel = facts.funnel
    rings = [circle(funnel_radius_m(funnel, x), 0, (x, 0.0, 0.0)) for x in FUNNEL_ENDS_M]
    along = np.linspace(FUNNEL_ENDS_M[0], FUNNEL_ENDS_M[-1], CIRCLE_POINTS)
    radii = np.array([funnel_radius_m(funnel, x) for x in along])
    ribs = [
        np.column_stack((along, y * radii, z * radii))
        for y, z in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
    ]
    return [Outline(points, FUNNEL) for points in (*rings, *ribs)]


def drone_outlines(facts: FlightFacts) -> list[Outline]:
    """Body, booms, propellers and the arm, in the body's frame."""
    x, y, z = HULL_M
    top, bottom = (np.array([(x * a, y * b, z * s) for a, b in _SQUARE]) for s in (1, -1))
    posts = [np.stack((top[i], bottom[i])) for i in range(4)]
    rods = [facts.body_from_tip.translation, *(np.array(p.center_body) for p in facts.propellers)]
    arms = [np.stack((np.zeros(3), end)) for end in rods]
    discs = [circle(p.radius_m, 2, p.center_body) for p in facts.propellers]
    return [Outline(points, DRONE) for points in (top, bottom, *posts, *arms, *discs)]


_SQUARE: Final = ((1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1))
