"""The safe set: a smooth funnel that narrows to a mouth on the target (docs/cbf.md, section 2)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from drone_client.cbf.vector import Vec3


@dataclass(frozen=True, slots=True)
class Funnel:
    r"""The set ``h(p) >= 0`` of allowed tip positions ``p`` in frame ``target``.

    .. math:: h(p; \delta) = x - \delta - a \left( \sqrt{s + \delta} - \sqrt{s_c} \right),
        \quad s = \sqrt{y^2 + z^2 + e^2}, \quad s_c = \sqrt{r_c^2 + e^2}

    With ``delta = 0`` it is the paper's funnel, rounded at its tip and opened to a mouth of radius
    ``r_c``. With ``delta > 0`` it is a lower bound of that over the whole ball of radius ``delta``
    around ``p`` (docs/cbf.md, section 3), and as smooth.

    Raises:
        ValueError: a parameter is out of bounds.
    """

    a: float = 3.0
    """How fast the funnel opens [sqrt(m)]; the paper's value."""
    e_m: float = 0.003
    """Rounding of the tip [m]; bounds the gradient, and defines it on the axis."""
    r_c_m: float = 0.025
    """Radius of the mouth in the plane of the board [m]: contact is allowed inside it."""
    _shift: float = field(init=False, repr=False, compare=False, default=0.0)
    """``sqrt(s_c)``: the same at every tick."""

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("a", self.a, 0.1, 10.0),
            ("e_m", self.e_m, 1e-4, 0.1),
            ("r_c_m", self.r_c_m, 0.0, 0.5),
        ):
            if not low <= value <= high:
                raise ValueError(f"Funnel.{name} = {value} is not in [{low}, {high}]")
        object.__setattr__(self, "_shift", math.sqrt(math.hypot(self.r_c_m, self.e_m)))

    def h(self, p_target: Vec3, delta_m: float = 0.0) -> float:
        """Value of the barrier [m]; at least zero inside.

        Args:
            p_target: Tip in frame ``target`` [m].
            delta_m: Radius of the ball that holds the true tip [m], at least zero.
        """
        x, y, z = p_target
        s = math.hypot(y, z, self.e_m)
        return x - delta_m - self.a * (math.sqrt(s + delta_m) - self._shift)

    def gradient(self, p_target: Vec3, delta_m: float = 0.0) -> Vec3:
        """Gradient of ``h`` with respect to the tip, dimensionless; its x component is one."""
        _, y, z = p_target
        s = math.hypot(y, z, self.e_m)
        k = -0.5 * self.a / (math.sqrt(s + delta_m) * s)
        return 1.0, k * y, k * z

    def dh_ddelta(self, p_target: Vec3, delta_m: float) -> float:
        """Derivative of ``h`` with respect to ``delta``, dimensionless; at most -1."""
        _, y, z = p_target
        s = math.hypot(y, z, self.e_m)
        return -1.0 - 0.5 * self.a / math.sqrt(s + delta_m)
