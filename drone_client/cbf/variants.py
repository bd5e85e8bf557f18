"""The barrier as an interface, and the paper's own two, which are for comparison plots only."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from drone_client.cbf.vector import Vec3

AXIS_M = 1e-9
"""Nearer to the axis than this [m] the cusp has no gradient, and the nominal velocity is used."""


class Barrier(Protocol):
    """A function of the tip that is at least zero where the tip may be."""

    def h(self, p_target: Vec3, delta_m: float = 0.0) -> float:
        """Value [m]."""
        ...

    def gradient(self, p_target: Vec3, delta_m: float = 0.0) -> Vec3:
        """Gradient with respect to the tip."""
        ...

    def dh_ddelta(self, p_target: Vec3, delta_m: float) -> float:
        """Derivative with respect to the radius of the error ball."""
        ...


class Variant(StrEnum):
    """Which barrier the filter uses."""

    SMOOTH = "smooth"
    """The smooth funnel, robust to errors. The only one to fly."""
    CUSP = "cusp"
    """The paper's h with its true gradient: a cusp that no real estimate fits into."""
    PAPER = "paper"
    """The paper's h with the gradient that it prints, which is not the gradient of h."""


@dataclass(frozen=True, slots=True)
class CuspFunnel:
    """The paper's ``h = x - a sqrt(l)``, ``l = sqrt(y^2 + z^2)``. Knows no error ball."""

    a: float = 3.0
    """How fast the funnel opens [sqrt(m)]."""
    exponent: float = 1.5
    """Of ``l`` in the lateral gradient ``-a (y, z) / (2 l^exponent)``: 3/2 is true."""

    def h(self, p_target: Vec3, delta_m: float = 0.0) -> float:
        """Value [m] for the tip ``p_target`` [m]; ``delta_m`` is ignored."""
        x, y, z = p_target
        return x - self.a * math.sqrt(math.hypot(y, z))

    def gradient(self, p_target: Vec3, delta_m: float = 0.0) -> Vec3:
        """Gradient at the tip ``p_target`` [m]; on the axis, where there is none, (1, 0, 0)."""
        _, y, z = p_target
        l = math.hypot(y, z)
        if l < AXIS_M:
            return 1.0, 0.0, 0.0
        k = -0.5 * self.a / l**self.exponent
        return 1.0, k * y, k * z

    def dh_ddelta(self, p_target: Vec3, delta_m: float) -> float:
        """Zero: the cusp ignores the error ball."""
        return 0.0


def paper_funnel(a: float = 3.0) -> CuspFunnel:
    """The cusp with the exponent 3/4 that the paper prints for the gradient."""
    return CuspFunnel(a, exponent=0.75)
