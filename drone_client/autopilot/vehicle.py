"""What the autopilot's messages say of the vehicle: pure decoding into a ``VehicleState``.

A number that is no number is not taken: it leaves the field as it was, and is counted.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot import VehicleState
from drone_client.autopilot.ned import (
    covariance_from_triangle,
    swap_attitude,
    swap_world,
)
from drone_client.odometry import OdometrySample
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Array, Pose, rotation_from_quaternion

ODOMETRY_FIRST_NS = 1_000_000_000
"""While ODOMETRY has come within this, LOCAL_POSITION_NED and ATTITUDE_QUATERNION are not used."""
PAIR_APART_MAX_NS = 50_000_000
"""A place and an attitude make a pose when their stamps are at most this far apart."""
AGE_MAX_NS = 1_000_000_000
"""A stamp further back is no stamp of now: the clock is not known any more."""
WORDS_FRESH_NS = 10_000_000_000
STAMP_AHEAD_MAX_NS = 20_000_000
"""A stamp may lie ahead of its arrival by the error of the offset, and by no more."""

_FAILING = {
    mav.MAV_STATE_CRITICAL: "a failsafe acts",
    mav.MAV_STATE_EMERGENCY: "emergency",
    mav.MAV_STATE_POWEROFF: "powering off",
    mav.MAV_STATE_FLIGHT_TERMINATION: "flight is being terminated",
}
_BATTERY_FAILING = {
    mav.MAV_BATTERY_CHARGE_STATE_CRITICAL: "battery critical",
    mav.MAV_BATTERY_CHARGE_STATE_EMERGENCY: "battery empty",
    mav.MAV_BATTERY_CHARGE_STATE_FAILED: "battery failed",
    mav.MAV_BATTERY_CHARGE_STATE_UNHEALTHY: "battery unhealthy",
}
_LANDED = {
    mav.MAV_LANDED_STATE_ON_GROUND: True,
    mav.MAV_LANDED_STATE_IN_AIR: False,
    mav.MAV_LANDED_STATE_TAKEOFF: False,
    mav.MAV_LANDED_STATE_LANDING: False,
}
_WORLD_FRAMES = frozenset((mav.MAV_FRAME_LOCAL_NED, mav.MAV_FRAME_LOCAL_FRD))
_BODY_FRAMES = frozenset((mav.MAV_FRAME_BODY_FRD, mav.MAV_FRAME_BODY_NED))


@dataclass(slots=True)
class _Words:
    """The autopilot's last warning."""

    t_ns: int = 0
    text: str = ""


class Vehicle:
    """All that was said of one vehicle; not thread-safe."""

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        """Contents that were not taken, by reason."""
        self.odometry: OdometrySample | None = None
        """The autopilot's own estimate, drone's clock."""
        self._t_heard_ns: int | None = None
        self._mode = ""
        self._armed = False
        self._status = mav.MAV_STATE_UNINIT
        self._charge = mav.MAV_BATTERY_CHARGE_STATE_UNDEFINED
        self._battery: float | None = None
        self._landed: bool | None = None
        self._words = _Words()
        self._position: tuple[int, Array, Array] | None = None
        self._attitude: tuple[int, Array] | None = None
        self._odometry_heard_ns: int | None = None

    @property
    def mode(self) -> str:
        """Name of the mode in the last heartbeat."""
        return self._mode

    @property
    def armed(self) -> bool:
        """As the last heartbeat said."""
        return self._armed

    def heartbeat(self, message: mav.MAVLink_message, mode: str, now_ns: int) -> None:
        """Take a HEARTBEAT whose mode has that name."""
        self._t_heard_ns = now_ns
        self._mode = mode
        self._armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
        self._status = int(message.system_status)

    def battery(self, message: mav.MAVLink_message) -> None:
        """Take a BATTERY_STATUS of the first battery."""
        if message.id != 0:
            return
        remaining = int(message.battery_remaining)
        self._battery = remaining / 100.0 if 0 <= remaining <= 100 else None
        self._charge = int(message.charge_state)

    def extended_state(self, message: mav.MAVLink_message) -> None:
        """Take an EXTENDED_SYS_STATE."""
        self._landed = _LANDED.get(int(message.landed_state))

    def status_text(self, message: mav.MAVLink_message, now_ns: int) -> None:
        """Take a STATUSTEXT: the words for a failsafe that acts."""
        if message.severity <= mav.MAV_SEVERITY_WARNING:
            text = "".join(c if c.isprintable() else " " for c in str(message.text)[:50])
            self._words = _Words(now_ns, text.strip())

    def odometry_in(self, message: mav.MAVLink_message, t_ns: int | None, now_ns: int) -> None:
        """Take an ODOMETRY that was valid at ``t_ns`` on the drone's clock (None: not known)."""
        if message.frame_id not in _WORLD_FRAMES:
            self.refused["odometry_frame"] += 1
            return
        velocity = np.array([message.vx, message.vy, message.vz], dtype=np.float64)
        q_ned_wxyz = np.array(message.q, dtype=np.float64)
        if message.child_frame_id in _BODY_FRAMES:
            velocity = rotation_from_quaternion(q_ned_wxyz) @ velocity
        elif message.child_frame_id not in _WORLD_FRAMES:
            self.refused["odometry_frame"] += 1
            return
        place = np.array([message.x, message.y, message.z], dtype=np.float64)
        covariance = covariance_from_triangle(message.pose_covariance)
        taken = self._take(
            place, velocity, q_ned_wxyz, t_ns, now_ns, covariance, int(message.reset_counter)
        )
        if taken:
            self._odometry_heard_ns = now_ns

    def position(self, message: mav.MAVLink_message, t_ns: int | None, now_ns: int) -> None:
        """Take a LOCAL_POSITION_NED: with an attitude of the same time, a pose."""
        if t_ns is not None:
            place = np.array([message.x, message.y, message.z], dtype=np.float64)
            velocity = np.array([message.vx, message.vy, message.vz], dtype=np.float64)
            self._position = (t_ns, place, velocity)
            self._pair(now_ns)

    def attitude(self, message: mav.MAVLink_message, t_ns: int | None, now_ns: int) -> None:
        """Take an ATTITUDE_QUATERNION."""
        if t_ns is not None:
            q = np.array([message.q1, message.q2, message.q3, message.q4], dtype=np.float64)
            self._attitude = (t_ns, q)
            self._pair(now_ns)

    def state(self, obeying: bool, now_ns: int) -> VehicleState | None:
        """All of it; None: no heartbeat yet.

        Args:
            obeying: whether our setpoints are what it flies, as far as the order of modes goes.
            now_ns: drone's clock.
        """
        if self._t_heard_ns is None:
            return None
        sample = self.odometry
        return VehicleState(
            t_heard_ns=self._t_heard_ns,
            mode=self._mode,
            armed=self._armed,
            obeying=obeying and self._armed,
            t_pose_ns=None if sample is None else sample.t_ns,
            world_from_body=None if sample is None else sample.world_from_body,
            velocity_world=None if sample is None else sample.velocity_world,
            battery_fraction=self._battery,
            landed=self._landed,
            failsafe=self._failsafe(now_ns),
            pose_resets=0 if sample is None else sample.resets,
        )

    def _failsafe(self, now_ns: int) -> str:
        reasons = [_FAILING.get(self._status, ""), _BATTERY_FAILING.get(self._charge, "")]
        if reasons[0] and self._words.text and now_ns - self._words.t_ns <= WORDS_FRESH_NS:
            reasons[0] += f' ("{self._words.text}")'
        return ", ".join(r for r in reasons if r)

    def _pair(self, now_ns: int) -> None:
        if self._position is None or self._attitude is None:
            return
        heard_ns = self._odometry_heard_ns
        if heard_ns is not None and now_ns - heard_ns < ODOMETRY_FIRST_NS:
            return
        t_ns, place, velocity = self._position
        t_attitude_ns, q_ned_wxyz = self._attitude
        if abs(t_ns - t_attitude_ns) <= PAIR_APART_MAX_NS:
            self._position = None
            self._take(place, velocity, q_ned_wxyz, t_ns, now_ns, None, 0)

    def _take(
        self,
        place_ned: Array,
        velocity_ned: Array,
        q_ned_from_frd_wxyz: Array,
        t_ns: int | None,
        now_ns: int,
        covariance: Array | None,
        resets: int,
    ) -> bool:
        if t_ns is None:
            self.refused["clock_not_known"] += 1
            return False
        if not now_ns - AGE_MAX_NS <= t_ns <= now_ns + STAMP_AHEAD_MAX_NS:
            self.refused["stamp"] += 1
            return False
        if not np.isfinite(velocity_ned).all():
            self.refused["not_finite"] += 1
            return False
        try:
            ned = Pose(
                place_ned, q_ned_from_frd_wxyz
            )  # refuses what is not finite or not a rotation
        except GeometryError:
            self.refused["not_a_pose"] += 1
            return False
        stamp_ns = min(t_ns, now_ns)
        if self.odometry is not None and stamp_ns < self.odometry.t_ns:
            self.refused["out_of_order"] += 1
            return False
        self.odometry = OdometrySample(
            t_ns=stamp_ns,
            world_from_body=Pose(swap_world(ned.translation), swap_attitude(ned.q_wxyz)),
            velocity_world=swap_world(velocity_ned),
            covariance=covariance,
            resets=resets,
        )
        return True
