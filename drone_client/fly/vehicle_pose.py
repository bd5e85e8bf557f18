"""Where the drone is, from what the autopilot says of itself, at the moment that is asked for."""

from __future__ import annotations

from collections.abc import Callable

from drone_client.autopilot import VehicleState
from rgbd_wire.geometry import Pose

MAX_AHEAD_NS = 150_000_000
"""So long after its newest pose a drone that told its velocity is where that leads to. Half a
metre a second per second is 6 mm off by then."""


class VehiclePose:
    """Keeps each pose of the autopilot at its own time, and carries the newest on to now."""

    def __init__(
        self, state: Callable[[], VehicleState | None], keep: Callable[[int, Pose], None]
    ) -> None:
        """Take over the callbacks.

        Args:
            state: the vehicle's newest.
            keep: stores ``world_from_body`` at a time on the drone's clock.
        """
        self._state = state
        self._keep = keep
        self._kept_ns: int | None = None

    def __call__(self, now_ns: int) -> Pose | None:
        """``world_from_body`` at ``now_ns`` on the drone's clock; None: it cannot be known."""
        state = self._state()
        if state is None or state.t_pose_ns is None or state.world_from_body is None:
            return None
        if state.t_pose_ns != self._kept_ns:
            self._keep(state.t_pose_ns, state.world_from_body)
            self._kept_ns = state.t_pose_ns
        ahead_ns = now_ns - state.t_pose_ns
        if not -MAX_AHEAD_NS <= ahead_ns <= MAX_AHEAD_NS:
            return None
        if state.velocity_world is None or ahead_ns <= 0:
            return state.world_from_body
        here = state.world_from_body
        return Pose(here.translation + state.velocity_world * (ahead_ns * 1e-9), here.q_wxyz)
