"""The vehicle in memory: lag, dead man, modes; and the contract that all share."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.autopilot import FlyingAutopilot, VelocityCommand
from drone_client.autopilot.simulated import SimulatedAutopilot
from rgbd_wire.clock import ManualClock
from rgbd_wire.geometry import Pose

MS = 1_000_000


def vehicle(**options: float) -> tuple[ManualClock, SimulatedAutopilot]:
    clock = ManualClock(10**9)
    return clock, SimulatedAutopilot(clock, Pose.identity(), **options)


def fly(
    clock: ManualClock,
    autopilot: SimulatedAutopilot,
    velocity: tuple[float, float, float],
    ms: int,
    yaw_rate: float = 0.0,
    step_ms: int = 20,
) -> None:
    for _ in range(ms // step_ms):
        autopilot.command(VelocityCommand(np.array(velocity), yaw_rate, clock.now_ns()))
        clock.advance(step_ms * MS)


def test_it_is_a_flying_autopilot() -> None:
    """The type checker's contract holds at run time for what a loop calls."""
    _, simulated = vehicle()
    autopilot: FlyingAutopilot = simulated
    autopilot.engage()
    assert autopilot.state().obeying
    autopilot.close()


@given(st.sampled_from([5, 10, 20, 50]))
def test_velocity_follows_with_its_lag(step_ms: int) -> None:
    """After t at u from rest: v = u (1 - exp(-t/T)), p = u (t - T + T exp(-t/T))."""
    clock, autopilot = vehicle(lag_s=0.3)
    autopilot.engage()
    fly(clock, autopilot, (0.5, 0.0, -0.2), 600, step_ms=step_ms)
    state = autopilot.state()
    share = 1.0 - math.exp(-2.0)
    assert state.velocity_world == pytest.approx([0.5 * share, 0.0, -0.2 * share])
    way_s = 0.6 - 0.3 * share
    assert state.world_from_body.translation == pytest.approx([0.5 * way_s, 0.0, -0.2 * way_s])


def test_yaw_turns_about_up() -> None:
    """Counter-clockwise, seen from above."""
    clock, autopilot = vehicle(lag_s=0.0)
    autopilot.engage()
    fly(clock, autopilot, (0.0, 0.0, 0.0), 1000, yaw_rate=0.5)
    forward = autopilot.state().world_from_body.rotation[:, 0]
    assert math.atan2(forward[1], forward[0]) == pytest.approx(0.5)


def test_commands_without_engaging_move_nothing() -> None:
    """In the pilot's mode our commands are air."""
    clock, autopilot = vehicle()
    fly(clock, autopilot, (1.0, 0.0, 0.0), 1000)
    assert autopilot.state().world_from_body.translation == pytest.approx([0.0, 0.0, 0.0])


def test_without_commands_it_stops_and_then_holds_by_itself() -> None:
    """60 ms flown, then zero, then after half a second the failsafe's mode."""
    clock, autopilot = vehicle(lag_s=0.0)
    autopilot.engage()
    autopilot.command(VelocityCommand(np.array([1.0, 0.0, 0.0]), 0.0, clock.now_ns()))
    clock.advance(3000 * MS)
    state = autopilot.state()
    assert state.world_from_body.translation[0] == pytest.approx(0.065)
    assert state.mode == "AUTO.LOITER"
    assert state.failsafe == "no setpoints"
    assert not state.obeying


def test_a_pilots_switch_stops_our_commands() -> None:
    """And releasing afterwards does not touch the pilot's mode."""
    clock, autopilot = vehicle(lag_s=0.0)
    autopilot.engage()
    autopilot.mode = "POSCTL"
    fly(clock, autopilot, (1.0, 0.0, 0.0), 400)
    autopilot.release()
    state = autopilot.state()
    assert state.mode == "POSCTL"
    assert state.world_from_body.translation[0] == 0.0


def test_what_cannot_be_flown_counts_as_none() -> None:
    """NaN and too fast are counted; the newest good one stays."""
    clock, autopilot = vehicle()
    autopilot.engage()
    autopilot.command(VelocityCommand(np.array([math.nan, 0, 0]), 0.0, clock.now_ns()))
    autopilot.command(VelocityCommand(np.array([99.0, 0, 0]), 0.0, clock.now_ns()))
    assert autopilot.refused == 2
