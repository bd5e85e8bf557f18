"""The stand-in with PX4's other line, too: what a client flies, and what flies in the simulator.

``px4_peer`` keeps PX4's rules on the line to the client (modes, OFFBOARD, failsafe, TIMESYNC);
``px4_hil_peer`` estimates and flies on the line to the simulator. Here they are one vehicle: its
clock is the simulated one, what it says of itself is its estimate, its VIO comes from the client,
and in OFFBOARD the velocities that it hears move the place that it holds.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math

from px4_hil_peer import Peer as Flyer
from px4_hil_peer import matrix
from px4_peer import Peer as Rules
from px4_peer import udp_ends

HOVERS_US = 5_000_000
"""After arming: it has climbed, and stands."""


class Vehicle(Rules):
    """PX4's rules on the estimate of a flyer."""

    def __init__(self, options):
        super().__init__(options)
        self.flyer = None
        self.sim_s = 0.0
        self.armed = False

    def now(self):
        return self.sim_s

    def send(self, message):
        if message.get_type() == "ODOMETRY":
            message.q = list(self.flyer.estimate.q)  # the rules know a heading alone
        super().send(message)

    def on_odometry(self, message):
        super().on_odometry(message)
        self.flyer.estimate.vio(message)


class Both(Flyer):
    """A flyer that listens to a client."""

    def __init__(self, options):
        super().__init__(options)
        self.vehicle = Vehicle(options)
        self.vehicle.flyer = self
        self.hovers = False
        _, self.vehicle.out, self.read = udp_ends(self.vehicle, options.udp)

    def motors(self, t_us):
        vehicle = self.vehicle
        vehicle.sim_s = t_us / 1e6
        self.listen()
        controls = super().motors(t_us)
        e = self.estimate
        if e.q is None:
            vehicle.next["odometry"] = vehicle.sim_s + 0.02  # nobody told it yet where it is
        else:
            rows = matrix(e.q)
            vehicle.fly(0.004)
            vehicle.position, vehicle.velocity = list(e.p), list(e.v)
            vehicle.yaw = math.atan2(rows[1][0], rows[0][0])
        vehicle.armed = self.armed_us is not None
        vehicle.telemetry()
        return controls

    def aim(self, t_us):
        """Climb as ever and hold; in OFFBOARD fly what is heard, and hold where that ended."""
        pilot, (velocity, yaw_rate) = self.pilot, self.vehicle.wanted
        if t_us - self.armed_us < HOVERS_US:
            super().aim(t_us)
            return
        if not self.hovers:
            self.hovers = True
            print("hovers", flush=True)
        pilot.goal_v = tuple(velocity)
        pilot.yaw += 0.004 * yaw_rate
        if self.vehicle.mode == "OFFBOARD":
            pilot.goal = None
        elif pilot.goal is None:
            pilot.goal = self.estimate.p

    def listen(self):
        while True:
            try:
                data = self.read()
            except OSError:
                return
            for message in self.vehicle.mav.parse_buffer(data) or []:
                self.vehicle.handle(message)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--connect", required=True)
    parser.add_argument("--udp", required=True)
    parser.add_argument("--seconds", type=float, default=1000.0)
    parser.set_defaults(
        system=1, refuse=0, lose_acks=0, lose_rates=0, clock_offset=0.0, boot_age=0.0,
        arm_s=1.0, height_m=1.2, fault="none", fault_s=0.0,
    )  # fmt: skip
    both = Both(parser.parse_args())
    with contextlib.suppress(ConnectionResetError, BrokenPipeError):
        both.run()
    report = both.vehicle.full_report()
    print(json.dumps({k: report[k] for k in ("violations", "mode", "mode_changes")}), flush=True)


if __name__ == "__main__":
    main()
