"""What the filter did, said in one word with every command."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """Outcome of one control tick; there is no command without one."""

    INACTIVE = "inactive"
    """The funnel asked for nothing: the nominal velocity, within the speed limits."""
    ACTIVE = "active"
    """The funnel changed the velocity as little as it had to."""
    MAX_HDOT = "max_hdot"
    """No velocity within the limit is enough: the fastest way back into the funnel."""
    STALE = "stale"
    """What is known of the target is too old to close in: hold, stop or back off."""
    ABORT = "abort"
    """The tip is where it may not be (back straight off), or an input is no number (stop)."""
