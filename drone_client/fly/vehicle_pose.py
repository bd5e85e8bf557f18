"""Where the drone is, from what the autopilot says of itself, at the moment that is asked for."""

from __future__ import annotations

import threading
from collections.abc import Callable

from drone_client.autopilot import VehicleState
from drone_client.odometry.jump import Jump, JumpSettings, JumpWatch, Motion
from rgbd_wire.geometry import Pose

MAX_AHEAD_NS = 150_000_000
"""So long after its newest pose a drone that told its velocity is where that leads to. Half a
metre a second per second is 6 mm off by then."""
JUMPED_NS = 500_000_000
"""So long after a jump it is told: at every tick that may still be at work on what was before."""


class VehiclePose:
    """Keeps each pose of the autopilot at its own time, and carries the newest on to now.

    It watches for jumps (docs/odometry.md). Whoever gets a pose of the new world from it gets it
    after ``on_jump`` has returned. May be called from several threads.
    """

    def __init__(
        self,
        state: Callable[[], VehicleState | None],
        keep: Callable[[int, Pose], None],
        on_jump: Callable[[Jump], None] = lambda jump: None,
        settings: JumpSettings | None = None,
    ) -> None:
        """Take over the callbacks, which must be quick.

        Args:
            state: the vehicle's newest.
            keep: stores ``world_from_body`` at a time on the drone's clock.
            on_jump: the poses that are kept from now on are told in another world.
            settings: what is a jump.
        """
        self._state = state
        self._keep = keep
        self._on_jump = on_jump
        self._watch = JumpWatch(settings)
        self._lock = threading.Lock()
        self._seen: Motion | None = None
        self._jumped_ns: int | None = None

    def __call__(self, now_ns: int) -> Pose | None:
        """``world_from_body`` at ``now_ns`` on the drone's clock; None: it cannot be known."""
        with self._lock:
            state = self._state()
            if state is not None and state.t_pose_ns is not None:
                self._take(state, state.t_pose_ns, now_ns)
            newest = self._watch.newest
        if newest is None:
            return None
        ahead_ns = now_ns - newest.t_ns
        if not -MAX_AHEAD_NS <= ahead_ns <= MAX_AHEAD_NS:
            return None
        here = newest.world_from_body
        if newest.velocity_world is None or ahead_ns <= 0:
            return here
        return Pose(here.translation + newest.velocity_world * (ahead_ns * 1e-9), here.q_wxyz)

    def jumped(self, now_ns: int) -> bool:
        """Whether it jumped a moment ago."""
        jumped_ns = self._jumped_ns
        return jumped_ns is not None and now_ns - jumped_ns < JUMPED_NS

    def _take(self, state: VehicleState, t_ns: int, now_ns: int) -> None:
        """Hold the vehicle's newest pose against the one before, once."""
        if state.world_from_body is None:
            return
        motion = Motion(t_ns, state.world_from_body, state.velocity_world, state.pose_resets)
        if self._seen is not None and (t_ns, motion.resets) == (self._seen.t_ns, self._seen.resets):
            return
        self._seen = motion
        jump = self._watch.see(motion)
        if jump is not None:
            self._jumped_ns = now_ns
            self._on_jump(jump)
        if self._watch.newest is motion:
            self._keep(t_ns, motion.world_from_body)
