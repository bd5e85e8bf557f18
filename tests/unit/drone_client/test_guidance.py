"""What the drone wants: towards the target, square to it, and gently."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.guidance import STILL, Aim, Goal, GuidanceSettings, guide, yaw_error_rad
from rgbd_wire.geometry import Pose, rotation_from_vector

SETTINGS = GuidanceSettings()
UP = (0.0, 0.0, 1.0)
coordinates = st.floats(-3, 3)
angles = st.floats(-math.pi, math.pi)


def facing(x: float, y: float, z: float, yaw_error: float = 0.0) -> Pose:
    """A tip at (x, y, z) in frame ``target`` that must still turn by ``yaw_error``."""
    yaw = math.pi - yaw_error
    return Pose.from_rotation(rotation_from_vector(np.array([0.0, 0.0, yaw])), np.array([x, y, z]))


def test_in_line_it_closes_in() -> None:
    """On the axis and square, the wish is -(touch + k_x x) along x."""
    nominal = guide(facing(0.3, 0.0, 0.0), SETTINGS, UP)
    assert nominal.velocity_tip_target == pytest.approx((-0.027 - 0.4 * 0.3, 0.0, 0.0))
    assert nominal.yaw_rate_radps == pytest.approx(0.0, abs=1e-12)


def test_across_it_is_three_times_as_eager() -> None:
    """The lateral gain is the larger, so that the tip lines up before it arrives."""
    vx, vy, vz = guide(facing(0.1, 0.02, -0.01), SETTINGS, UP).velocity_tip_target
    assert (vx, vy, vz) == pytest.approx((-0.027 - 0.4 * 0.1, -1.2 * 0.02, 1.2 * 0.01))


def test_the_goal_lies_behind_the_board() -> None:
    """At the push depth it wants to rest, deeper it wants out."""
    assert guide(facing(-0.025, 0.0, 0.0), SETTINGS, UP).velocity_tip_target[0] == pytest.approx(
        0.0
    )
    assert guide(facing(-0.035, 0.0, 0.0), SETTINGS, UP).velocity_tip_target[0] > 0.0
    assert guide(facing(0.0, 0.0, 0.0), SETTINGS, UP).velocity_tip_target[0] < 0.0


@given(coordinates, coordinates, coordinates, angles)
def test_every_wish_is_within_its_limits(x, y, z, yaw_error) -> None:
    """Speed, yaw rate, and the closing speed at the touch."""
    nominal = guide(facing(x, y, z, yaw_error), SETTINGS, UP)
    assert math.hypot(*nominal.velocity_tip_target) <= SETTINGS.speed_max_mps + 1e-12
    assert abs(nominal.yaw_rate_radps) <= SETTINGS.yaw_rate_max_radps
    if x <= 0:
        assert nominal.velocity_tip_target[0] >= -SETTINGS.touch_mps - 1e-12


@pytest.mark.parametrize("k_x", [0.1, 0.25, 0.4])
@pytest.mark.parametrize("late_s", [0.0, 0.15])
def test_a_vehicle_that_follows_late_still_touches_gently(k_x, late_s) -> None:
    """A lag of 0.3 s, and a delay before it: the closing profile leaves what its docstring says."""
    settings = GuidanceSettings(k_x=k_x)
    x, v, dt = 1.0, 0.0, 0.001
    commands = [0.0] * (1 + round(late_s / dt))
    while x > 0.0:
        commands.append(guide(facing(x, 0, 0), settings, UP).velocity_tip_target[0])
        v += dt / 0.3 * (commands.pop(0) - v)
        x += dt * v
    assert -v == pytest.approx(0.027 / (1 - k_x * (0.3 + late_s)), rel=0.05)


def test_far_away_it_may_only_be_as_fast_as_it_can_brake() -> None:
    """The square root bounds what the gain asks for where the vehicle brakes badly."""
    weak = GuidanceSettings(brake_mps2=0.05)
    vx, _, _ = guide(facing(0.8, 0.0, 0.0), weak, UP).velocity_tip_target
    assert vx == pytest.approx(-math.sqrt(0.027**2 + 2 * 0.05 * 0.8))


@given(angles.filter(lambda a: abs(a) < 3.1))
def test_the_yaw_error_is_the_angle_still_to_turn(error) -> None:
    """Turning by it makes the arm point into the board; the rate has its sign."""
    tip = facing(1.0, 0.0, 0.0, error)
    arm = tuple(tip.rotation[:, 0].tolist())
    assert yaw_error_rad(arm, UP) == pytest.approx(error, abs=1e-9)
    turned = rotation_from_vector(np.array([0.0, 0.0, error])) @ tip.rotation[:, 0]
    np.testing.assert_allclose(turned, [-1, 0, 0], atol=1e-9)
    rate = guide(tip, SETTINGS, UP).yaw_rate_radps
    assert rate == pytest.approx(max(-0.5, min(0.5, 0.8 * error)), abs=1e-9)


def test_the_yaw_error_takes_the_short_way() -> None:
    """From 170 degrees on either side the turn is 170 degrees, not 190."""
    for degrees in (170, -170, 350, -350):
        short = (degrees + 180) % 360 - 180
        error = facing(1.0, 0.0, 0.0, math.radians(degrees)).rotation[:, 0]
        found = math.degrees(yaw_error_rad(tuple(error.tolist()), UP))
        assert found == pytest.approx(short)


def test_a_slanted_board_is_faced_by_heading_alone() -> None:
    """With the board leaning back by 20 degrees, up in its frame is tilted and yaw is about up."""
    lean = math.radians(20)
    up = (math.sin(lean), 0.0, math.cos(lean))
    level_arm = (-math.cos(lean), 0.0, math.sin(lean))
    assert yaw_error_rad(level_arm, up) == pytest.approx(0.0, abs=1e-12)
    turn = rotation_from_vector(-0.3 * np.array(up))
    turned_arm = tuple((turn @ np.array(level_arm)).tolist())
    assert yaw_error_rad(turned_arm, up) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("arm", "up"),
    [
        ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)),  # a board on the floor
        ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0)),  # an arm straight up
        ((-1.0, 0.0, 0.0), (math.nan, 0.0, 0.0)),
    ],
)
def test_without_a_heading_there_is_no_yaw_error(arm, up) -> None:
    """Where up says nothing about the heading, the drone does not turn."""
    assert yaw_error_rad(arm, up) == 0.0


def test_a_slanted_arm_waits() -> None:
    """The approach slows with the yaw error and stops at half a radian; aligning goes on."""
    square = guide(facing(0.5, 0.1, 0.0), SETTINGS, UP).velocity_tip_target
    slanted = guide(facing(0.5, 0.1, 0.0, 0.4), SETTINGS, UP).velocity_tip_target
    crooked = guide(facing(0.5, 0.1, 0.0, -0.6), SETTINGS, UP).velocity_tip_target
    assert square[0] < slanted[0] < crooked[0] == 0.0
    assert square[1] == slanted[1] == crooked[1] == pytest.approx(-0.12)


def test_a_far_target_is_approached_at_the_speed_limit_in_the_same_direction() -> None:
    """The wish is shortened as a whole, not cut per axis."""
    vx, vy, vz = guide(facing(2.0, 1.5, 0.0), SETTINGS, UP).velocity_tip_target
    assert math.hypot(vx, vy, vz) == pytest.approx(0.4)
    assert vy / vx == pytest.approx(1.2 * 1.5 / (0.027 + 0.4 * 2.0))


@given(coordinates, coordinates, coordinates, angles, st.sampled_from(Aim))
def test_every_aim_keeps_the_limits(x, y, z, yaw_error, aim) -> None:
    """Whatever the mission wants."""
    nominal = guide(facing(x, y, z, yaw_error), SETTINGS, UP, Goal(aim, 1.0))
    assert math.hypot(*nominal.velocity_tip_target) <= SETTINGS.speed_max_mps + 1e-12
    assert abs(nominal.yaw_rate_radps) <= SETTINGS.yaw_rate_max_radps
    if aim is Aim.RETREAT:
        assert nominal.velocity_tip_target[0] >= 0.0


def test_still_is_still() -> None:
    """However crooked and far."""
    nominal = guide(facing(2.0, 1.0, -1.0, 1.0), SETTINGS, UP, STILL)
    assert (nominal.velocity_tip_target, nominal.yaw_rate_radps) == ((0.0, 0.0, 0.0), 0.0)


@pytest.mark.parametrize(("x", "sign"), [(2.0, -1), (0.3, 1)])
def test_to_a_stand_off_point_from_both_sides(x, sign) -> None:
    """Inwards from afar and outwards from near, to the same place."""
    goal = Goal(Aim.STANDOFF, 1.0)
    vx, vy, _ = guide(facing(x, 0.1, 0.0), SETTINGS, UP, goal).velocity_tip_target
    assert sign * vx > 0.1
    assert vy < 0.0
    assert guide(facing(1.0, 0, 0), SETTINGS, UP, goal).velocity_tip_target == pytest.approx(
        (0.0, 0.0, 0.0)
    )


def test_pressing_is_straight_and_ends_at_the_push_depth() -> None:
    """No sideways drag and no turn, however crooked; beyond the depth it comes back."""
    press = Goal(Aim.PRESS)
    nominal = guide(facing(0.0, 0.01, 0.01, 0.3), SETTINGS, UP, press)
    assert nominal.velocity_tip_target == (-SETTINGS.press_mps, 0.0, 0.0)
    assert nominal.yaw_rate_radps == 0.0
    at_depth = guide(facing(-SETTINGS.push_m, 0, 0), SETTINGS, UP, press).velocity_tip_target
    assert at_depth == pytest.approx((0.0, 0.0, 0.0))
    assert guide(facing(-0.035, 0, 0), SETTINGS, UP, press).velocity_tip_target[0] > 0.0


def test_a_retreat_is_straight_at_first() -> None:
    """Pressed, the tip leaves along x alone; clear of the board it comes back to the axis."""
    back = Goal(Aim.RETREAT, 1.0)
    pressed = guide(facing(-0.02, 0.02, 0.0, 0.2), SETTINGS, UP, back)
    assert pressed.velocity_tip_target == (SETTINGS.retreat_mps, 0.0, 0.0)
    assert pressed.yaw_rate_radps == 0.0
    clear = guide(facing(0.2, 0.02, 0.0, 0.2), SETTINGS, UP, back)
    assert clear.velocity_tip_target == pytest.approx((SETTINGS.retreat_mps, -0.024, 0.0))
    assert clear.yaw_rate_radps > 0.0


@pytest.mark.parametrize("aim", [Aim.STANDOFF, Aim.CONTACT, Aim.PRESS])
def test_what_is_no_number_stays_none(aim) -> None:
    """A tip that is NaN makes a wish that is NaN, which the safety filter turns into a stop."""
    tip = facing(1.0, 0.0, 0.0)
    object.__setattr__(tip, "translation", np.full(3, math.nan))
    assert math.isnan(guide(tip, SETTINGS, UP, Goal(aim, 1.0)).velocity_tip_target[0])


@pytest.mark.parametrize("name", list(GuidanceSettings.__dataclass_fields__))
@pytest.mark.parametrize("value", [-1.0, 1e6, math.nan])
def test_every_setting_is_bounded(name, value) -> None:
    """The message names the setting and its range."""
    with pytest.raises(ValueError, match=rf"^GuidanceSettings\.{name} = .* is not in \["):
        GuidanceSettings(**{name: value})


def test_arriving_before_being_in_line_is_refused() -> None:
    """k_x may not exceed k_lateral."""
    with pytest.raises(ValueError, match="before it is in line"):
        GuidanceSettings(k_x=0.9, k_lateral=0.8)


def test_gains_that_swing_are_refused() -> None:
    """A gain above half of the inverse lag overshoots; the message says the largest one."""
    with pytest.raises(ValueError, match=r"k_lateral = 1.2 exceeds 0.5 / lag_s = 1"):
        GuidanceSettings(lag_s=0.5)
    assert GuidanceSettings(lag_s=0.0).k_lateral == 1.2
