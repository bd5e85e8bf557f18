"""Flies a small square by velocities and says what the vehicle did: the first flight of a link.

The vehicle must be armed and hover in a pilot's mode: this arms nothing, and asks first. A switch
of the mode by hand ends it:    python examples/px4/velocity_square.py udp/127.0.0.1:14540
"""

import argparse
import sys
import time
from collections.abc import Callable

import numpy as np

from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.choose import open_autopilot
from drone_client.autopilot.mavlink import MavlinkAutopilot
from drone_client.errors import ClientError
from rgbd_wire.clock import MonotonicClock

CLOCK = MonotonicClock()
PERIOD_S = 0.02
SIDES = (((1, 0, 0), "east"), ((0, 1, 0), "north"), ((-1, 0, 0), "west"), ((0, -1, 0), "south"))


def wait(condition: Callable[[], object], seconds: float, what: str):
    """Wait for something, or end with what is missing."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            sys.exit(f"error: {what} within {seconds} s")
        time.sleep(PERIOD_S)


def fly(autopilot: MavlinkAutopilot, velocity: np.ndarray, seconds: float):
    """Command one velocity for a while; False: the vehicle is not ours any more."""
    for _ in range(round(seconds / PERIOD_S)):
        autopilot.command(VelocityCommand(velocity, 0.0, CLOCK.now_ns()))
        time.sleep(PERIOD_S)
        if autopilot.phase != "engaged":
            return False
    return True


def square(autopilot: MavlinkAutopilot, side_s: float):
    """Wait for the vehicle, fly the four sides, give it back."""
    wait(lambda: getattr(autopilot.state(), "t_pose_ns", None), 10, "no heartbeat with a pose")
    state, (offset_ns, bound_ns) = autopilot.state(), autopilot.clock_offset_ns()
    print(f"heard: {state.mode}, armed: {state.armed}, battery: {state.battery_fraction}")
    print(f"clock: {offset_ns / 1e9:+.3f} s from ours, to within {bound_ns / 1e6:.2f} ms")
    if not state.armed:
        sys.exit("error: not armed; arm and take off as a pilot does, then start again")
    if not options.yes and input("take the vehicle? [y/N] ").strip().lower() != "y":
        sys.exit("not taken")
    autopilot.engage()
    wait(lambda: autopilot.phase in ("engaged", "silent"), 20, "no answer")
    for direction, name in SIDES:
        before = autopilot.state().world_from_body.translation
        if not fly(autopilot, 0.3 * np.array(direction), side_s):
            sys.exit(f"error: given up: {autopilot.reason}")
        fly(autopilot, np.zeros(3), 1.0)
        moved = autopilot.state().world_from_body.translation - before
        print(f"{name:5}  moved {moved[0]:+.2f} east {moved[1]:+.2f} north {moved[2]:+.2f} up [m]")
    autopilot.release()
    wait(lambda: autopilot.phase == "silent", 10, "not given back")
    print(f"{autopilot.reason}; {autopilot.setpoints} setpoints sent")


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("address", help="such as udp/127.0.0.1:14540 or serial//dev/ttyACM0:921600")
parser.add_argument("--yes", action="store_true", help="do not ask")
parser.add_argument("--side-s", type=float, default=3.0, help="time of a side [s] (default: 3)")
options = parser.parse_args()
try:
    link = open_autopilot(options.address, CLOCK)
except ClientError as error:
    sys.exit(f"error: {error}")
try:
    square(link, options.side_s)
finally:
    link.close()
