"""Whole missions in a world that can go wrong: how they end, why, and that nobody is hurt.

Whatever a test does to a flight, the same facts hold for all of it (``assert_safe``): the tip is
behind the board's plane only within the mouth, it touches gently, no command exceeds the limits,
nothing closes in by what is old, and after the end nothing moves towards the board.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from drone_client.cbf import Freshness
from drone_client.mission import Order, Phase, Reason
from tests.unit.drone_client.builders import SECOND, pose
from tests.unit.drone_client.mission_world import (
    AIRFRAME,
    DELAY_TICKS,
    FLYING,
    LAG_S,
    TARGET_FROM_WORLD,
    TICK_NS,
    TICK_S,
    World,
    controls,
)

SETTINGS = controls(search_max_s=4.0, waiting_max_s=2.0)
MOUTH_M = SETTINGS.filter.funnel.r_c_m
STANDOFF_M = SETTINGS.mission.standoff_m - SETTINGS.mission.standoff_tolerance_m
TOUCH_MPS = 0.05
TILTED_MPS = 0.002
"""What an axis that is known to half a degree makes of a sideways velocity."""
BEFORE_THE_BOARD_M = 0.06
USUAL = [
    Reason.VEHICLE_READY,
    Reason.TARGET_SEEN,
    Reason.ALIGNED,
    Reason.TOUCHED,
    Reason.DWELT,
    Reason.BACK,
]
STAGES = ["search", "align", "approach", "near", "contact", "retreat", "hold", "brake"]
PHASES = {stage: Phase(stage) for stage in STAGES if stage != "near"} | {"near": Phase.APPROACH}


@cache
def _kept(stage: str) -> World:
    """A usual flight, stopped at a stage."""
    match stage:
        case "search":
            world = World(1, settings=SETTINGS, sees=False)
            return world.fly(0.6)
        case "align" | "approach":
            return World(1, settings=SETTINGS).fly_until(Phase(stage))
        case "near":
            world = flown_to("approach")
            while world.tip[0] > BEFORE_THE_BOARD_M:
                world.step()
            assert world.phase is Phase.APPROACH
            return world
        case "contact" | "retreat":
            return flown_to("near").fly_until(Phase(stage))
        case "hold":
            world = flown_to("near")
            world.order = Order.HOLD
            world.fly_until(Phase.HOLD)
            world.order = Order.GO
            return world
        case _:
            world = flown_to("near")
            world.link = False
            world.fly_until(Phase.BRAKE)
            world.link = True
            return world


def flown_to(stage: str) -> World:
    """Another one of it, to go on with."""
    world = _kept(stage).fork()
    world.sees = True
    return world


def assert_safe(world: World) -> None:
    """What holds for every flight of this file."""
    tips = np.array(world.tips)
    behind = tips[:, 0] < 0.0
    assert np.hypot(tips[behind, 1], tips[behind, 2]).max(initial=0.0) <= MOUTH_M
    assert max(world.closing, default=0.0) <= TOUCH_MPS
    assert tips[:, 0].min() >= -SETTINGS.filter.depth_max_m
    limits = SETTINGS.filter
    over = False
    for decision, outward_mps in zip(world.decisions, world.outward_mps, strict=True):
        command, mission, intent = decision.command, decision.mission, decision.intent
        assert np.linalg.norm(command.velocity_world) <= limits.v_max_mps + 1e-9
        assert abs(command.yaw_rate_radps) <= limits.yaw_rate_max_radps + 1e-9
        old = decision.safe is None or decision.safe.freshness is not Freshness.FRESH
        if old or over or mission.phase not in (Phase.ALIGN, Phase.APPROACH, Phase.CONTACT):
            assert outward_mps >= -TILTED_MPS, (mission.phase, outward_mps)
        assert mission.phase.final or not over
        assert intent.give_back or not mission.given_back
        over = mission.phase.final
    ended = next((k for k, d in enumerate(world.decisions) if d.mission.phase.final), None)
    if ended is not None:
        closing_mps = (tips[ended - 1, 0] - tips[ended, 0]) / TICK_S
        stop_m = max(0.0, closing_mps) * (LAG_S + DELAY_TICKS * TICK_S) + 0.002
        assert tips[ended:, 0].min() >= tips[ended, 0] - stop_m


def assert_backed_off(world: World) -> None:
    """At the stand-off point or beyond it, at rest, and given back."""
    assert world.tip[0] >= STANDOFF_M - 0.02
    assert world.mission.given_back
    assert np.linalg.norm(world.velocity) < 0.01


def speeds(world: World, since: int) -> float:
    """Fastest command from a tick on."""
    return max(float(np.linalg.norm(d.command.velocity_world)) for d in world.decisions[since:])


def new_reasons(world: World, stage: str) -> list[Reason]:
    """Why it went on as it did, from a stage on."""
    return world.reasons[len(_kept(stage).reasons) :]


def test_the_tip_is_where_the_transforms_say() -> None:
    """The world's own short form against the composed poses."""
    world = flown_to("align")
    composed = TARGET_FROM_WORLD @ (world.world_from_body @ AIRFRAME.body_from_tip.translation)
    np.testing.assert_allclose(world.tip, composed, atol=1e-12)


@pytest.mark.parametrize(
    ("seed", "start"),
    [
        (0, (3.0, 0.15, 1.6)),
        (2, (1.5, 0.9, 1.0)),
        (3, (4.2, -0.9, 1.2)),  # beside the funnel, near the wall
        (4, (4.44, 0.01, 1.52)),  # a centimetre before the board
    ],
)
def test_a_whole_mission_touches_once_and_comes_back(seed, start) -> None:
    """From before the target and from outside the funnel, in one attempt, without an interlude."""
    world = World(seed, start, SETTINGS).fly(60)
    assert world.reasons == USUAL
    assert world.mission.attempts == 1
    assert len(world.closing) >= 1
    pressed = [tip for tip in world.tips if tip[0] < 0.0]
    assert max(float(np.hypot(tip[1], tip[2])) for tip in pressed) < 0.01
    assert_safe(world)
    assert_backed_off(world)


@pytest.mark.parametrize("stage", STAGES)
def test_a_link_that_is_lost_for_good_ends_at_a_distance(stage) -> None:
    """Holds, brakes, backs off, searches in vain; what was touched already is simply done."""
    world = flown_to(stage)
    world.link = False
    world.fly(25)
    if stage == "retreat":
        assert (world.phase, world.mission.reason) == (Phase.DONE, Reason.BACK)
    else:
        assert (world.phase, world.mission.reason) == (Phase.ABORT, Reason.SEARCH_TOO_LONG)
    if stage in ("approach", "near", "contact"):
        assert new_reasons(world, stage) == [
            Reason.TARGET_OLD,
            Reason.TARGET_LOST,
            Reason.TARGET_LOST,
            Reason.TARGET_LOST,
            Reason.SEARCH_TOO_LONG,
        ]
    assert_safe(world)
    if stage != "search":
        assert_backed_off(world)


def test_a_target_that_is_occluded_for_a_while_is_touched_in_another_attempt() -> None:
    """Three seconds without a picture: back to the stand-off point, and again."""
    world = flown_to("contact")
    world.sees = False
    world.fly(3.0)
    assert world.reasons[-1] is Reason.TARGET_LOST
    world.sees = True
    world.fly(60)
    assert (world.phase, world.mission.reason) == (Phase.DONE, Reason.BACK)
    assert world.mission.attempts == 2
    assert_safe(world)


def test_a_short_outage_only_holds() -> None:
    """A quarter of a second without answers: the same attempt goes on."""
    world = flown_to("near")
    world.link = False
    world.fly(0.25)
    world.link = True
    world.fly_until(Phase.CONTACT)
    assert new_reasons(world, "near") == [Reason.TARGET_OLD, Reason.GOOD_AGAIN, Reason.TOUCHED]
    assert world.mission.attempts == 1
    assert_safe(world)


@pytest.mark.parametrize("stage", STAGES)
def test_a_jump_of_the_odometry_stops_and_starts_from_afar(stage) -> None:
    """At once and blind, until the target was measured in the new world; then back off first."""
    world = flown_to(stage)
    world.jump(pose((0.3, -0.2, 0.1), (0, 0, 0.3)))
    since = len(world.decisions)
    while world.jumped:
        world.step()
        assert world.phase is Phase.BRAKE
        if world.jumped:
            assert world.decisions[-1].intent.blind
            assert speeds(world, len(world.decisions) - 1) == 0.0
    world.fly(2.0)
    if stage != "brake":
        assert world.transitions[len(_kept(stage).transitions)].reason is Reason.ODOMETRY_JUMPED
    assert new_reasons(world, stage)[stage != "brake"] is Reason.BRAKED
    assert speeds(world, since) > 0.0
    assert_safe(world)


def test_after_a_jump_the_mission_is_flown_to_its_end() -> None:
    """In another attempt."""
    world = flown_to("near")
    world.jump(pose((0.3, -0.2, 0.1), (0, 0, 0.3)))
    world.fly(60)
    assert new_reasons(world, "near")[:3] == [
        Reason.ODOMETRY_JUMPED,
        Reason.BRAKED,
        Reason.TRY_AGAIN,
    ]
    assert (world.phase, world.mission.attempts) == (Phase.DONE, 2)
    assert_safe(world)


@pytest.mark.parametrize("stage", ["approach", "near", "contact"])
@pytest.mark.parametrize("by", [(-0.3, 0, 0), (0.3, 0, 0), (0, 0.2, 0), (0, 0, -0.15)])
def test_a_jump_that_nobody_noticed_is_seen_by_the_mission(stage, by) -> None:
    """The tip cannot move so far between two ticks: brake, back off."""
    world = flown_to(stage)
    world.jump(pose(by), noticed=False)
    world.fly(1.2)
    assert world.transitions[len(_kept(stage).transitions)].reason is Reason.TARGET_LEAPT
    assert_safe(world)


@pytest.mark.parametrize("stage", STAGES)
def test_a_pilot_who_takes_over_is_never_fought(stage) -> None:
    """From the tick on that says so: no command but to stand, not even if it obeys again."""
    world = flown_to(stage)
    since = len(world.decisions)
    world.vehicle = replace(FLYING, obeying=False, mode="POSCTL")
    world.step()
    assert (world.phase, world.mission.reason) == (Phase.ABORT, Reason.PILOT)
    assert world.mission.given_back
    world.vehicle = FLYING
    for _ in range(100):
        world.step()
    assert speeds(world, since) == 0.0
    assert world.phase is Phase.ABORT
    assert_safe(world)


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("why", [Reason.BATTERY_LOW, Reason.ORDERED_ABORT])
def test_an_end_in_any_phase_backs_off_and_gives_back(stage, why) -> None:
    """An empty battery and a person's word: out to the stand-off distance, and no further."""
    world = flown_to(stage)
    if why is Reason.BATTERY_LOW:
        world.vehicle = replace(FLYING, battery_fraction=0.19)
    else:
        world.order = Order.ABORT
    world.fly(15)
    assert (world.phase, world.mission.reason) == (Phase.ABORT, why)
    assert_safe(world)
    if stage != "search":
        assert_backed_off(world)
        assert world.tip[0] < 2.0


@pytest.mark.parametrize("stage", STAGES)
def test_a_person_who_says_hold_is_obeyed_until_go(stage) -> None:
    """It stands, as far as the safety filter lets it, and then goes on."""
    world = flown_to(stage)
    world.order = Order.HOLD
    world.fly(1.5)
    assert (world.phase, world.mission.reason) == (Phase.HOLD, Reason.ORDERED_HOLD)
    at = world.tip
    world.fly(1.0)
    assert world.phase is Phase.HOLD
    assert np.linalg.norm(world.tip - at) < 0.01
    world.order = Order.GO
    world.fly(0.7)
    assert world.phase is not Phase.HOLD
    assert_safe(world)


def test_one_wrong_pose_changes_nothing() -> None:
    """The target filter keeps it out; the mission goes on in the same attempt."""
    world = flown_to("near")
    world.wrong_by, world.wrong = (0.1, 0.05, 0.0), 1
    world.fly_until(Phase.CONTACT)
    assert new_reasons(world, "near") == [Reason.TOUCHED]
    assert_safe(world)


def test_two_wrong_poses_in_a_row_are_waited_out() -> None:
    """They contradict what is known, so that the drone holds until something agrees again."""
    world = flown_to("near")
    world.frame_ticks = 2  # so that the second comes while what is known is still fresh
    world.fly(0.3)
    world.wrong_by, world.wrong = (0.1, 0.05, 0.0), 2
    world.fly_until(Phase.CONTACT)
    assert new_reasons(world, "near") == [Reason.TARGET_DOUBTED, Reason.GOOD_AGAIN, Reason.TOUCHED]
    assert_safe(world)


@pytest.mark.parametrize("stage", ["approach", "near", "contact"])
def test_a_target_that_goes_on_being_elsewhere_starts_the_approach_anew(stage) -> None:
    """Believed after four measurements: then all that was in line is in line no more."""
    world = flown_to(stage)
    world.wrong_by, world.wrong = (0.25, 0.0, 0.0), 8
    world.fly(2.5)
    assert world.phase not in (Phase.APPROACH, Phase.CONTACT)
    assert_safe(world)


@pytest.mark.parametrize("seed", range(3))
def test_several_things_go_wrong_one_after_the_other(seed) -> None:
    """Whatever, whenever: the facts hold."""
    rng = np.random.default_rng(seed)
    world = flown_to(rng.choice(["align", "approach", "near", "contact"]))
    for what in rng.permutation(["link", "sees", "moves", "jump", "wrong", "order"]):
        match str(what):
            case "jump":
                world.jump(pose(rng.uniform(-0.5, 0.5, 3), (0, 0, rng.uniform(-0.3, 0.3))))
            case "wrong":
                world.wrong_by, world.wrong = (0.2, -0.1, 0.1), 3
            case "order":
                world.order = Order.HOLD
            case flag:
                setattr(world, flag, False)
        world.fly(rng.uniform(0.1, 1.5))
        world.link = world.sees = world.moves = True
        world.order = Order.GO
        world.fly(rng.uniform(0.1, 1.5))
    assert_safe(world)


def test_a_vehicle_that_never_obeys_is_given_up() -> None:
    """Nothing was commanded, and nothing is left behind."""
    world = World(settings=SETTINGS, vehicle=replace(FLYING, obeying=False, mode="POSCTL")).fly(5)
    assert world.reasons == [Reason.WAITED_TOO_LONG]
    assert speeds(world, 0) == 0.0
    assert world.mission.given_back


def test_a_vehicle_that_obeys_for_one_tick_is_not_asked_again() -> None:
    """Whoever took it back keeps it."""
    manual = replace(FLYING, obeying=False, mode="POSCTL")
    world = World(settings=SETTINGS, vehicle=manual).fly(0.4)
    world.vehicle = FLYING
    world.step()
    assert world.phase is Phase.SEARCH
    world.vehicle = manual
    world.step()
    world.vehicle = FLYING
    for _ in range(100):
        world.step()
    assert world.reasons == [Reason.VEHICLE_READY, Reason.PILOT]
    assert speeds(world, 0) == 0.0


@pytest.mark.parametrize(
    ("stage", "reason"), [("align", Reason.ALIGN_TOO_LONG), ("approach", Reason.NO_PROGRESS)]
)
def test_a_vehicle_that_says_it_obeys_and_does_not_move_is_given_up(stage, reason) -> None:
    """Each phase has its time."""
    world = flown_to(stage)
    world.settings = controls(align_max_s=5.0, progress_s=3.0, retreat_max_s=3.0)
    world.moves = False
    world.fly(16)
    assert reason in world.reasons
    assert world.phase is Phase.ABORT
    assert_safe(world)


def test_stages_are_what_they_are_called() -> None:
    """And each has lasted a moment when a test takes it up."""
    for stage in STAGES:
        world = flown_to(stage)
        assert world.phase is PHASES[stage]
        assert world.now_ns - world.mission.since_ns >= 0.2 * SECOND - TICK_NS
