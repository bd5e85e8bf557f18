"""What a vehicle does with the commands that reach it: modes, the dead man, the loss of commands.

For vehicles that are simulated, whatever moves them. The order of modes is that of PX4, except that
the mode is there at once.
"""

from __future__ import annotations

from typing import Final

from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.dead_man import (
    DeadManSettings,
    Refused,
    Setpoint,
    checked,
    leaving,
    stand_still,
)

OFFBOARD: Final = "OFFBOARD"
HOLD: Final = "AUTO.LOITER"
LOST_AFTER_NS: Final = 500_000_000
"""Without a setpoint for so long the vehicle holds its position by itself, as PX4's failsafe."""


class OffboardRules:
    """The vehicle's side of the mode that takes commands. Not thread-safe; time is an argument."""

    def __init__(self, *, armed: bool = True, dead_man: DeadManSettings | None = None) -> None:
        """Begin in the mode in which a pilot flies.

        Args:
            armed: whether the motors run.
            dead_man: ages and limits.
        """
        self.mode = "POSCTL"
        """Set it to switch the mode as a pilot does."""
        self.armed = armed
        self.failsafe = ""
        self.refused = 0
        """Commands that counted as none."""
        self._dead_man = dead_man or DeadManSettings()
        self._newest: Setpoint | None = None

    @property
    def obeying(self) -> bool:
        """Whether commands are flown."""
        return self.armed and self.mode == OFFBOARD

    @property
    def idle(self) -> bool:
        """Whether it is in another mode than ours."""
        return self.mode != OFFBOARD

    @property
    def reason(self) -> str:
        """The mode is there at once."""
        return f"in mode {self.mode}" if self.idle else ""

    def command(self, command: VelocityCommand, now_ns: int) -> None:
        """Take the newest command."""
        newest_ns = None if self._newest is None else self._newest.t_ns
        result = checked(command, now_ns, newest_ns, self._dead_man)
        if isinstance(result, Refused):
            self.refused += 1
        else:
            self._newest = result

    def engage(self, now_ns: int) -> None:
        """Into the mode that takes commands."""
        self._newest = stand_still(now_ns)
        self.failsafe = ""
        self.mode = OFFBOARD

    def release(self) -> None:
        """Into the mode that holds the position."""
        if self.mode == OFFBOARD:
            self.mode = HOLD

    def wanted(self, now_ns: int) -> Setpoint:
        """What the vehicle flies now; asked often, for the loss of commands is noticed here."""
        still = stand_still(now_ns)
        if not self.obeying:
            return still
        if self._newest is None or now_ns - self._newest.t_ns > LOST_AFTER_NS:
            self.mode, self.failsafe = HOLD, "no setpoints"
            return still
        return leaving(self._newest, now_ns, self._dead_man) or still
