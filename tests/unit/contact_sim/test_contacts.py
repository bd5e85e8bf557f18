"""Contacts: parts, forces and speeds of what is touched."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from contact_sim.contacts import Contacts
from contact_sim.errors import VehicleError
from contact_sim.scene.drone import ARM, MASS_KG, add_drone
from contact_sim.vehicle.body import Body
from tests.unit.contact_sim.flights import (
    AIRFRAME,
    BOARD_X_M,
    HEIGHT_M,
    REACH_M,
    RIG,
    plain_world,
)
from tests.unit.drone_client.builders import pose

ZERO = (0.0, 0.0, 0.0)


class Thrown:
    """A drone without thrust that is let go somewhere with some velocity."""

    def __init__(self, place, velocity=ZERO, turn=ZERO, gravity=True):
        spec = plain_world()
        add_drone(spec, AIRFRAME, RIG, pose(place, turn))
        self.model = spec.compile()
        if not gravity:
            self.model.opt.gravity[:] = 0.0
        self.data = mujoco.MjData(self.model)
        self.data.joint("drone/free").qvel[:3] = velocity
        self.body = Body(self.model, self.data)
        self.contacts = Contacts(self.model)
        self.t_ns = 0

    def step(self, n=1):
        for _ in range(n):
            before = self.body.motion(self.body.read())
            mujoco.mj_step(self.model, self.data)
            self.contacts.look(self.data, self.t_ns, before)
            self.t_ns += 2_000_000
        return self


def test_in_the_air_nothing_is_touched():
    """No touch, no force."""
    thrown = Thrown((0.0, 0.0, 5.0)).step(10)
    assert thrown.contacts.touches == ()
    assert thrown.contacts.tip_force_n == 0.0
    assert thrown.contacts.impacts == []


@pytest.mark.parametrize("speed_mps", [0.03, 0.05, 0.5])
def test_the_tip_s_impact_has_its_closing_speed(speed_mps):
    """Flown straight into the board, what is told is the speed it came with, and when."""
    start_x = BOARD_X_M - REACH_M - 0.01
    thrown = Thrown((start_x, 0.0, HEIGHT_M), (speed_mps, 0.0, 0.0), gravity=False)
    thrown.step(round(0.012 / speed_mps / 0.002))
    impact = thrown.contacts.impacts[0]
    assert (impact.part, impact.other) == ("drone/tip", "board")
    assert impact.speed_mps == pytest.approx(speed_mps, rel=1e-6)
    assert impact.t_ns / 1e9 == pytest.approx(0.01 / speed_mps, abs=0.005)
    assert thrown.contacts.worst_impact_mps == {"drone/tip": impact.speed_mps}
    assert thrown.contacts.worst_force_n["drone/tip"] > 0.0


def test_only_the_speed_along_the_normal_counts():
    """Scraping along the board at 1 m/s while closing in at 5 cm/s is an impact of 5 cm/s."""
    start = (BOARD_X_M - REACH_M - 0.001, 0.0, HEIGHT_M)
    thrown = Thrown(start, (0.05, 1.0, 0.0), gravity=False).step(20)
    assert thrown.contacts.impacts[0].speed_mps == pytest.approx(0.05, rel=1e-6)


def test_a_propeller_is_told_from_the_tip():
    """Turned aside, the front right propeller meets the wall first."""
    turn = (0.0, 0.0, np.pi / 2)
    thrown = Thrown((BOARD_X_M - 0.45, 0.0, HEIGHT_M), (0.4, 0.0, 0.0), turn, gravity=False)
    thrown.step(150)
    parts = {impact.part for impact in thrown.contacts.impacts}
    assert parts
    assert all(part.startswith("drone/propeller_") for part in parts)
    assert {touch.other for touch in thrown.step(1).contacts.touches} <= {"board"}


def test_on_the_ground_the_forces_add_up_to_the_weight():
    """Dropped on the floor and come to rest, all touches together carry it."""
    thrown = Thrown((0.0, 0.0, 0.06)).step(1500)
    touches = thrown.contacts.touches
    assert {touch.other for touch in touches} == {"floor"}
    assert sum(touch.force_n for touch in touches) == pytest.approx(MASS_KG * 9.81, rel=0.01)


def test_a_fall_ends_at_the_speed_of_its_height():
    """Dropped flat from 10 cm, whatever of it comes first is as fast as Galilei says."""
    lowest_m = 0.035  # half the body's height
    thrown = Thrown((0.0, 0.0, 0.1 + lowest_m)).step(100)
    impact = thrown.contacts.impacts[0]
    assert (impact.part, impact.other) == ("drone/body", "floor")
    assert impact.speed_mps == pytest.approx(math.sqrt(2.0 * 9.81 * 0.1), rel=0.02)


def test_a_tip_that_springs_out_comes_with_the_arm_s_speed():
    """The body stands, the arm shoots out of 1 cm onto a board at half of it: the arm's speed."""
    start = (BOARD_X_M - REACH_M + 0.005, 0.0, HEIGHT_M)
    thrown = Thrown(start, gravity=False)
    thrown.data.joint("drone/arm").qpos[:] = -0.01
    speeds = []
    while not thrown.contacts.impacts:
        speeds.append(thrown.body.read().arm_mps)
        thrown.step(1)
    # without the arm's inertia: K/D times what it is pressed in at the board
    assert thrown.contacts.impacts[0].speed_mps == pytest.approx(speeds[-1], rel=0.02)
    assert speeds[-1] == pytest.approx(ARM.stiffness_npm / ARM.damping_nspm * 0.005, rel=0.3)


def test_a_touch_that_goes_on_is_one_impact():
    """What has come down lies: few parts, few impacts, however long it lies."""
    thrown = Thrown((0.0, 0.0, 0.06)).step(1500)
    count = len(thrown.contacts.impacts)
    assert count < 15
    thrown.step(1000)
    assert len(thrown.contacts.impacts) == count


def test_a_world_without_a_drone_is_refused():
    """The error says who makes one."""
    with pytest.raises(VehicleError, match="add_drone"):
        Contacts(plain_world().compile())
