"""What a simulator sends beside HIL_SENSOR, and how often: a table, a clock and a packer."""

from __future__ import annotations

import math
from typing import Final

from pymavlink.dialects.v20 import common as mav

from contact_sim.hil import messages
from contact_sim.hil.instruments import Reading
from contact_sim.hil.place import Place
from contact_sim.hil.reader import Interval, Unknown, Word
from contact_sim.simulation import Simulation
from drone_client.autopilot.messages import distance_sensor, odometry

INTERVALS_NS: Final = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: 1_000_000_000,
    mav.MAVLINK_MSG_ID_HIL_GPS: 200_000_000,
    mav.MAVLINK_MSG_ID_ODOMETRY: 20_000_000,
    mav.MAVLINK_MSG_ID_DISTANCE_SENSOR: 20_000_000,
    mav.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: 20_000_000,
}
"""Simulated time from one to the next, in the order in which they leave."""
LONGEST_US: Final = 3.6e9
OWN_SYSTEM, OWN_COMPONENT = 1, mav.MAV_COMP_ID_USER1


class Outgoing:
    """Makes the bytes of a question. Stamps are simulated time."""

    def __init__(self, place: Place, *, gps: bool, vio: bool) -> None:
        """Begin with the usual rates.

        Args:
            place: where the world stands.
            gps: send HIL_GPS.
            vio: send ODOMETRY and DISTANCE_SENSOR, of the simulated VIO and lidar.
        """
        self._place = place
        self._intervals_ns: dict[int, int | None] = dict(INTERVALS_NS)
        if not gps:
            del self._intervals_ns[mav.MAVLINK_MSG_ID_HIL_GPS]
        if not vio:
            del self._intervals_ns[mav.MAVLINK_MSG_ID_ODOMETRY]
            del self._intervals_ns[mav.MAVLINK_MSG_ID_DISTANCE_SENSOR]
        self._due_ns = dict.fromkeys(self._intervals_ns, 0)
        self._packer = mav.MAVLink(None, srcSystem=OWN_SYSTEM, srcComponent=OWN_COMPONENT)
        self._answers: list[mav.MAVLink_message] = []

    def heed(self, wish: Word) -> None:
        """Take a wish: a rate that is asked for is kept within bounds, and acknowledged."""
        if isinstance(wish, Interval):
            taken = wish.message in self._intervals_ns and not math.isnan(wish.interval_us)
            if taken:
                self._intervals_ns[wish.message] = _interval_ns(wish)
                self._due_ns[wish.message] = 0
            self._answers.append(
                messages.acknowledged(mav.MAV_CMD_SET_MESSAGE_INTERVAL, taken=taken)
            )
        elif isinstance(wish, Unknown):
            self._answers.append(messages.acknowledged(wish.command, taken=False))

    def question(self, simulation: Simulation, reading: Reading) -> bytes:
        """All that is due, HIL_SENSOR last.

        With it PX4's clock moves on; what came before it has arrived by then, every time alike.
        """
        due, self._answers = self._answers, []
        for number, interval_ns in self._intervals_ns.items():
            if interval_ns is None or reading.t_ns < self._due_ns[number]:
                continue
            self._due_ns[number] = reading.t_ns + interval_ns
            message = self._message(number, simulation, reading)
            if message is not None:
                due.append(message)
        due.append(messages.hil_sensor(reading))
        return b"".join(self._packed(message) for message in due)

    def _message(
        self, number: int, simulation: Simulation, reading: Reading
    ) -> mav.MAVLink_message | None:
        match number:
            case mav.MAVLINK_MSG_ID_HEARTBEAT:
                return messages.heartbeat()
            case mav.MAVLINK_MSG_ID_HIL_GPS:
                return messages.hil_gps(simulation.truth, self._place)
            case mav.MAVLINK_MSG_ID_ODOMETRY:
                sample = simulation.vio
                return None if sample is None else odometry(sample)
            case mav.MAVLINK_MSG_ID_DISTANCE_SENSOR:
                height = simulation.height
                return None if height is None else distance_sensor(height)
            case _:
                return messages.hil_state(simulation.truth, reading, self._place)

    def _packed(self, message: mav.MAVLink_message) -> bytes:
        data: bytes = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        return data


def _interval_ns(wish: Interval) -> int | None:
    """None: never."""
    if wish.interval_us < 0.0:
        return None
    if wish.interval_us == 0.0:
        return INTERVALS_NS[wish.message]
    return round(min(wish.interval_us, LONGEST_US) * 1000.0)
