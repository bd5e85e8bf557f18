"""A process of ours that engages and flies east, for tests that stop it: takes an ADDRESS."""

from __future__ import annotations

import sys
import time

import numpy as np

from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.choose import open_autopilot
from rgbd_wire.clock import MonotonicClock

clock = MonotonicClock()
autopilot = open_autopilot(sys.argv[1], clock)
engaged = False
while True:
    state = autopilot.state()
    if state is not None and not engaged:
        autopilot.engage()
        engaged = True
    autopilot.command(VelocityCommand(np.array([0.3, 0.0, 0.0]), 0.0, clock.now_ns()))
    time.sleep(0.01)
