"""The dead man: which setpoint leaves now, given how old the newest command is.

Pure. A command is flown while it is fresh, then the drone is told to stand still for a moment, then
nothing is sent at all: an autopilot that gets no setpoints acts by its own failsafe, and that is
better than a process that hangs and still says "stand still". Nothing is flown that is not finite,
too fast, or from the future.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from drone_client.autopilot import VelocityCommand
from drone_client.cbf.vector import ZERO, Vec3

NS_PER_MS = 1_000_000
ROUNDING = 1.0 + 1e-6
"""A command at the filter's own limit may be a little longer after it was turned."""


class Refused(StrEnum):
    """Why a command counts as none."""

    MALFORMED = "malformed"
    """Not three numbers."""
    NOT_FINITE = "not_finite"
    TOO_FAST = "too_fast"
    TURNS_TOO_FAST = "turns_too_fast"
    FROM_THE_FUTURE = "from_the_future"
    OLD = "old"
    """Older than the newest one, or than what is flown at all."""


@dataclass(frozen=True, slots=True)
class DeadManSettings:
    """Ages and limits.

    Raises:
        ValueError: a value is out of its bounds.
    """

    zero_after_ms: float = 60.0
    """A command older than this is not flown: zero velocity instead."""
    silent_after_ms: float = 300.0
    """So long after the newest command nothing is sent any more. Shorter than the autopilot's own
    COM_OF_LOSS_T, so that it is the autopilot that decides."""
    silence_max_ms: float = 400.0
    """After so long a silence the engagement is over. Less than COM_OF_LOSS_T: the autopilot is
    about to act by itself, and a process that wakes up must not take the vehicle back from it."""
    speed_max_mps: float = 2.0
    yaw_rate_max_radps: float = 2.0
    future_max_ms: float = 5.0
    """A stamp may lie ahead by this, for a thread that was put aside between clock and call."""

    def __post_init__(self) -> None:
        if not 0.0 < self.zero_after_ms <= self.silent_after_ms <= 1000.0:
            raise ValueError(
                f"dead man: 0 < zero_after_ms = {self.zero_after_ms:g} <= silent_after_ms = "
                f"{self.silent_after_ms:g} <= 1000 does not hold"
            )
        if not 100.0 <= self.silence_max_ms <= 3000.0:
            raise ValueError(
                f"dead man: silence_max_ms = {self.silence_max_ms:g} is not in [100, 3000]"
            )
        for name, high in (("speed_max_mps", 10.0), ("yaw_rate_max_radps", 4.0)):
            if not 0.0 < getattr(self, name) <= high:
                raise ValueError(
                    f"dead man: {name} = {getattr(self, name)} is not in (0, {high:g}]"
                )
        if not 0.0 <= self.future_max_ms <= 50.0:
            raise ValueError(f"dead man: future_max_ms = {self.future_max_ms} is not in [0, 50]")


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What is sent, in ENU."""

    velocity_world: Vec3
    """[m/s]."""
    yaw_rate_radps: float
    """About up."""
    t_ns: int
    """Of the command behind it, drone's clock."""


def stand_still(t_ns: int) -> Setpoint:
    """Zero velocity and no turn."""
    return Setpoint(ZERO, 0.0, t_ns)


def checked(
    command: VelocityCommand, now_ns: int, newest_ns: int | None, settings: DeadManSettings
) -> Setpoint | Refused:
    """The command as a setpoint, or why it is refused.

    Args:
        command: as it came; anything may be in it.
        now_ns: drone's clock.
        newest_ns: stamp of the newest command so far; None: there is none.
        settings: limits.
    """
    try:
        x, y, z = (float(c) for c in command.velocity_world)
        yaw_rate = float(command.yaw_rate_radps)
        t_ns = int(command.t_ns)
    except (TypeError, ValueError, OverflowError):
        return Refused.MALFORMED
    if not all(math.isfinite(c) for c in (x, y, z, yaw_rate)):
        return Refused.NOT_FINITE
    if math.hypot(x, y, z) > settings.speed_max_mps * ROUNDING:
        return Refused.TOO_FAST
    if abs(yaw_rate) > settings.yaw_rate_max_radps * ROUNDING:
        return Refused.TURNS_TOO_FAST
    if t_ns > now_ns + settings.future_max_ms * NS_PER_MS:
        return Refused.FROM_THE_FUTURE
    if now_ns - t_ns > settings.zero_after_ms * NS_PER_MS:
        return Refused.OLD
    if newest_ns is not None and t_ns < newest_ns:
        return Refused.OLD
    return Setpoint((x, y, z), yaw_rate, t_ns)


def leaving(newest: Setpoint | None, now_ns: int, settings: DeadManSettings) -> Setpoint | None:
    """What is sent now: the newest setpoint, zero velocity, or nothing (None).

    Args:
        newest: the newest that was not refused.
        now_ns: drone's clock.
        settings: ages.
    """
    if newest is None:
        return None
    age_ns = now_ns - newest.t_ns
    if age_ns <= settings.zero_after_ms * NS_PER_MS:
        return newest
    if age_ns <= settings.silent_after_ms * NS_PER_MS:
        return stand_still(newest.t_ns)
    return None


def given_up(sent_ns: int, now_ns: int, settings: DeadManSettings) -> bool:
    """Whether the last setpoint left so long ago (at ``sent_ns``) that the engagement is over."""
    return now_ns - sent_ns > settings.silence_max_ms * NS_PER_MS
