"""How we speak with the autopilot: rate, ids, limits and times."""

from __future__ import annotations

from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot.dead_man import DeadManSettings
from drone_client.autopilot.mode_order import OrderSettings


@dataclass(frozen=True, slots=True)
class AutopilotSettings:
    """All of it.

    Raises:
        ValueError: a value is out of its bounds.
    """

    rate_hz: float = 50.0
    """Of the setpoints."""
    system: int | None = None
    """The autopilot's system id; None: the first autopilot that is heard."""
    component: int = mav.MAV_COMP_ID_AUTOPILOT1
    own_system: int | None = None
    """Ours; None: the vehicle's, as is usual for a computer on board."""
    own_component: int = mav.MAV_COMP_ID_ONBOARD_COMPUTER
    dead_man: DeadManSettings = field(default_factory=DeadManSettings)
    order: OrderSettings = field(default_factory=OrderSettings)

    def __post_init__(self) -> None:
        if not 20.0 <= self.rate_hz <= 100.0:
            raise ValueError(f"autopilot: rate_hz = {self.rate_hz} is not in [20, 100]")
        for name in ("system", "component", "own_system", "own_component"):
            value = getattr(self, name)
            if value is not None and not 1 <= value <= 255:
                raise ValueError(f"autopilot: {name} = {value} is not in [1, 255]")
