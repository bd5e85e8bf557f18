"""Every number of the safety filter, in one frozen value; docs/cbf.md section 9 says where from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

from drone_client.bounds import check_bounds
from drone_client.cbf.funnel import Funnel
from drone_client.cbf.variants import Barrier, CuspFunnel, Variant, paper_funnel

_BOUNDS: dict[str, tuple[float, float]] = {
    "v_max_mps": (0.0, 2.0),
    "yaw_rate_max_radps": (0.0, 2.0),
    "yaw_speed_share": (0.0, 0.5),
    "touch_mps": (0.005, 0.2),
    "brake_mps2": (0.05, 3.0),
    "lag_s": (0.0, 1.0),
    "depth_max_m": (0.02, 0.1),
    "outside_m": (0.001, 1.0),
    "clear_m": (0.001, 0.5),
    "alpha_near": (0.1, 5.0),
    "alpha_far": (0.1, 5.0),
    "near_m": (0.1, 5.0),
    "far_m": (0.2, 10.0),
    "period_s": (0.002, 0.1),
    "delta_base_m": (0.0, 0.1),
    "delta_range_gain": (0.0, 0.1),
    "sigma_gain": (0.0, 5.0),
    "drift_mps": (0.0, 0.1),
    "unconfirmed_mps": (0.0, 0.1),
    "age_max_ns": (1_000_000, 2_000_000_000),
    "hold_ns": (1_000_000, 5_000_000_000),
    "retreat_ns": (1_000_000, 10_000_000_000),
    "retreat_mps": (0.0, 0.5),
    "standoff_m": (0.3, 5.0),
}


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Limits and gains of the safety filter.

    Raises:
        ValueError: a value is out of its bounds, two of them contradict each other, or an unsafe
            variant is asked for without ``allow_unsafe_variant``.
    """

    funnel: Funnel = field(default_factory=Funnel)
    """The safe set of ``Variant.SMOOTH``."""

    v_max_mps: float = 0.4
    """Speed limit of the body."""
    yaw_rate_max_radps: float = 0.5
    """Yaw rate limit."""
    yaw_speed_share: float = 0.25
    """Share of ``v_max_mps`` that may go into undoing the tip's swing when the body yaws."""
    touch_mps: float = 0.08
    """Largest closing speed of the tip when it touches."""
    brake_mps2: float = 0.1
    """Deceleration that the closing speed in front of the board is made for."""
    lag_s: float = 0.3
    """Time in which the vehicle follows a velocity: the closing speed is commanded so much
    earlier."""
    depth_max_m: float = 0.04
    """How far the unloaded tip may go behind the board's plane: what the arm can give way."""
    outside_m: float = 0.05
    """So far below zero the robust barrier lets the tip close in no more; it is slower before."""
    clear_m: float = 0.05
    """Nearer than this a tip that is outside backs off."""

    alpha_near: float = 1.2
    """Class-K gain [1/s] within ``near_m`` of the target."""
    alpha_far: float = 2.5
    """Class-K gain [1/s] farther than ``far_m`` from it."""
    near_m: float = 0.5
    """Distance of the tip at which ``alpha_near`` begins to give way."""
    far_m: float = 1.0
    """Distance of the tip at which ``alpha_far`` is reached."""
    period_s: float = 0.02
    """How long a command is held: the control period."""

    delta_base_m: float = 0.005
    """Error of the tip's place that is always there: arm, mounting, calibration."""
    delta_range_gain: float = 0.01
    """Error per metre of the range at which the target was measured: scale and angle."""
    sigma_gain: float = 2.0
    """Standard deviations of the measurement that count as error."""
    drift_mps: float = 0.01
    """Drift of the drone's own odometry, which ages a measurement."""
    unconfirmed_mps: float = 0.01
    """By how much the error grows while the drone alone sees the target: as if its odometry had
    drifted since the edge's last word, so that a long outage turns into a retreat by itself."""

    age_max_ns: int = 300_000_000
    """Up to this age the drone may close in: tau_max (250 ms) and a frame interval or two."""
    hold_ns: int = 600_000_000
    """Up to this age it holds its distance; past it, it stops."""
    retreat_ns: int = 1_500_000_000
    """Past this age it goes back to the stand-off distance."""
    retreat_mps: float = 0.15
    """Speed of every blind retreat; docs/cbf.md shows that the growing ball asks for less."""
    standoff_m: float = 1.0
    """Distance of the tip from the board at which a retreat ends."""

    variant: Variant = Variant.SMOOTH
    """Which barrier."""
    allow_unsafe_variant: bool = False
    """Must be True for any other variant than SMOOTH; for comparison plots only."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)
        for smaller, larger in (
            ("alpha_near", "alpha_far"),
            ("near_m", "far_m"),
            ("age_max_ns", "hold_ns"),
            ("hold_ns", "retreat_ns"),
        ):
            low, high = getattr(self, smaller), getattr(self, larger)
            if low > high or (low == high and smaller != "alpha_near"):
                raise ValueError(
                    f"FilterSettings.{smaller} = {low} must be less than {larger} = {high}"
                )
        if self.touch_mps <= self.brake_mps2 * self.command_lag_s:
            raise ValueError(
                f"FilterSettings.touch_mps = {self.touch_mps} must exceed brake_mps2 (lag_s + "
                f"period_s) = {self.brake_mps2 * self.command_lag_s:.3g}: nothing would be left to "
                "command at the touch; brake more gently"
            )
        if self.variant is not Variant.SMOOTH and not self.allow_unsafe_variant:
            raise ValueError(
                f"FilterSettings.variant = {self.variant} is for comparison plots, not for flight: "
                "set allow_unsafe_variant=True if that is what you do"
            )

    @property
    def command_lag_s(self) -> float:
        """The vehicle's lag, and the period for which a command is held."""
        return self.lag_s + self.period_s

    def with_age_max(self, age_max_ns: int) -> Self:
        """The same with another age up to which the drone may close in.

        The phases after it keep their lengths and begin earlier or later. An age beyond what a
        drone may fly on (2 s) counts as that bound: the client
        may well wait for older results, but it does not close in on them.
        """
        low, high = _BOUNDS["age_max_ns"]
        age_max_ns = int(min(max(age_max_ns, low), high))
        later_ns = age_max_ns - self.age_max_ns
        return replace(
            self,
            age_max_ns=age_max_ns,
            hold_ns=min(self.hold_ns + later_ns, int(_BOUNDS["hold_ns"][1])),
            retreat_ns=min(self.retreat_ns + later_ns, int(_BOUNDS["retreat_ns"][1])),
        )

    @property
    def barrier(self) -> Barrier:
        """The safe set of the variant."""
        if self.variant is Variant.SMOOTH:  # at every tick of every flight
            return self.funnel
        return (
            CuspFunnel(self.funnel.a)
            if self.variant is Variant.CUSP
            else paper_funnel(self.funnel.a)
        )
