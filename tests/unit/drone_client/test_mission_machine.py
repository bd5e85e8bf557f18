"""The state machine: whatever a mission is shown, it stays in bounds, calm, and ends."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from drone_client.autopilot import VehicleState
from drone_client.cbf import Freshness, Status
from drone_client.guidance import STILL, Aim
from drone_client.mission import (
    Intent,
    MissionSettings,
    MissionState,
    Observation,
    Order,
    Phase,
    Reason,
    Seen,
    Senses,
    Told,
    begin,
    step,
)
from tests.unit.drone_client.builders import MS, SECOND

SETTINGS = MissionSettings()
TICK_NS = 20 * MS
MOST_PER_SECOND = 9
"""Transitions in any second, whatever happens: three holds of 0.3 s that are left and entered
again, and the way from there to an end."""


def vehicle(**more) -> VehicleState:
    given = {"t_heard_ns": 2**62, "mode": "OFFBOARD", "armed": True, "obeying": True}
    given["landed"] = False
    return VehicleState(**(given | more))


def seen(x: float = 1.0, **more) -> Seen:
    given = {
        "tip_target": (x, 0.0, 0.0),
        "tip_world": (-x, 0.0, 1.5),
        "axis_world": (-1.0, 0.0, 0.0),
        "yaw_error_rad": 0.0,
        "age_ns": 100 * MS,
        "freshness": Freshness.FRESH,
    }
    return Seen(**(given | more))


class Flown:
    """Steps a mission and remembers what it did."""

    def __init__(self, mission_settings: MissionSettings = SETTINGS) -> None:
        self.settings = mission_settings
        self.state, self.intent, self.now_ns = begin(0), Intent(), 0
        self.transitions = []

    def tick(self, what: Seen | None = None, *, told: Told | None = None, **more) -> Flown:
        own_pose = more.pop("own_pose", True)
        heading = more.pop("heading_rad", 0.0)
        senses = Senses(**({"vehicle": vehicle()} | more))
        self.now_ns += TICK_NS
        if told is not None:
            self.state = replace(self.state, told=told)
        before = self.state.phase
        obs = Observation(self.now_ns, what, own_pose, heading, senses)
        self.state, self.intent = step(self.state, obs, self.settings)
        self.state = replace(self.state, told=Told())
        if self.state.transition is not None:
            assert self.state.transition.before is before
            assert self.state.transition.after is self.state.phase is not before
            self.transitions.append(self.state.transition)
        else:
            assert self.state.phase is before
        return self

    def ticks(self, seconds: float, what: Seen | None = None, **more) -> Flown:
        for _ in range(round(seconds * SECOND / TICK_NS)):
            self.tick(what, **more)
        return self

    def glide(self, x: float, **more) -> Flown:
        """To another place along the axis, no faster than a drone."""
        at = self.state.tip_target[0]
        for _ in range(round(abs(x - at) / 0.04)):
            at += math.copysign(0.04, x - at)
            self.tick(seen(at), **more)
        return self

    @property
    def phase(self) -> Phase:
        return self.state.phase

    @property
    def reason(self) -> Reason:
        return self.state.reason


PRESSED = Told(Status.INACTIVE, 0.013, -0.03)
"""What the filter answers while the tip is told to go on."""


def in_phase(phase: Phase, mission_settings: MissionSettings = SETTINGS) -> Flown:
    """A mission that has come to a phase the usual way."""
    t = Flown(mission_settings)
    if phase is Phase.SEARCH:
        return t.ticks(0.5)
    t.ticks(2.0, seen(1.5))
    if phase is Phase.ALIGN:
        return t
    if phase is Phase.HOLD:
        return t.ticks(0.1, seen(1.5, freshness=Freshness.HOLD, age_ns=400 * MS))
    if phase is Phase.BRAKE:
        return t.ticks(0.1, seen(1.5, freshness=Freshness.BRAKE, age_ns=900 * MS))
    if phase is Phase.ABORT:
        return t.tick(seen(1.5), order=Order.ABORT)
    t.ticks(1.0, seen(1.0))
    assert t.phase is Phase.APPROACH
    if phase is Phase.APPROACH:
        return t.glide(0.9).ticks(0.5, seen(0.9))
    t.glide(0.0).ticks(1.5, seen(0.0), told=PRESSED)
    if phase is Phase.CONTACT:
        return t
    t.ticks(2.0, seen(0.0), told=PRESSED)
    if phase is Phase.RETREAT:
        return t
    assert phase is Phase.DONE
    return t.glide(0.6).ticks(0.4, seen(1.0))


def test_the_manual_names_every_phase_and_every_reason() -> None:
    """Whoever reads a reason in a ledger finds it there."""
    manual = (Path(__file__).parents[3] / "docs" / "mission.md").read_text()
    assert {p for p in Phase if p.name not in manual} == set()
    assert {r for r in Reason if f"`{r}`" not in manual} == set()


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_is_reached_the_usual_way(phase) -> None:
    """And each with a reason and a sentence with numbers."""
    t = in_phase(phase)
    assert t.phase is phase
    assert all(tr.sentence for tr in t.transitions)


def test_what_each_phase_wants() -> None:
    """The goals for the guidance."""
    wants = {p: in_phase(p).intent for p in Phase}
    aims = {p: i.goal.aim for p, i in wants.items()}
    assert aims == {
        Phase.SEARCH: Aim.STILL,
        Phase.ALIGN: Aim.STANDOFF,
        Phase.APPROACH: Aim.CONTACT,
        Phase.CONTACT: Aim.PRESS,
        Phase.RETREAT: Aim.RETREAT,
        Phase.DONE: Aim.STILL,
        Phase.HOLD: Aim.STILL,
        Phase.BRAKE: Aim.STILL,
        Phase.ABORT: Aim.STILL,  # it is far enough already
    }
    assert {p for p, i in wants.items() if i.give_back} == {Phase.DONE, Phase.ABORT}
    assert {p for p, i in wants.items() if i.blind} == {Phase.SEARCH}
    assert wants[Phase.RETREAT].goal.x_m == SETTINGS.standoff_m


def test_it_waits_for_a_vehicle_that_obeys_and_is_well() -> None:
    """Until then it stands blind, whatever it sees; not with a failsafe, landed, or unheard."""
    t = Flown().ticks(5.0, seen(), vehicle=None)
    for not_yet in (
        vehicle(obeying=False),
        vehicle(landed=True),
        vehicle(landed=None),
        vehicle(failsafe="battery"),
        vehicle(battery_fraction=0.1),
        vehicle(t_heard_ns=-4 * SECOND),
    ):
        t.ticks(1.0, seen(), vehicle=not_yet)
        assert (t.phase, t.reason, t.intent) == (Phase.HOLD, Reason.WAITING, Intent(blind=True))
    assert t.tick(seen()).phase is Phase.SEARCH
    assert t.reason is Reason.VEHICLE_READY


def test_without_a_vehicle_to_ask_a_replay_goes_on() -> None:
    """Only where the settings say that there is none."""
    t = Flown(MissionSettings(needs_vehicle=False)).ticks(1.0, seen(), vehicle=None)
    assert t.phase is Phase.ALIGN


@pytest.mark.parametrize("phase", [p for p in Phase if not p.final])
@pytest.mark.parametrize(
    ("taken", "reason"),
    [
        ({"vehicle": vehicle(obeying=False, mode="POSCTL")}, Reason.PILOT),
        ({"vehicle": vehicle(landed=True)}, Reason.LANDED),
        ({"vehicle": vehicle(failsafe="battery low")}, Reason.FAILSAFE),
        ({"vehicle": vehicle(t_heard_ns=-9 * SECOND)}, Reason.VEHICLE_SILENT),
        ({"vehicle": None}, Reason.VEHICLE_SILENT),
    ],
)
def test_what_is_taken_is_never_taken_back(phase, taken, reason) -> None:
    """One tick without the vehicle: over at once, standing blind, and for ever so."""
    t = in_phase(phase)
    t.tick(seen(1.5), **taken)
    assert (t.phase, t.reason) == (Phase.ABORT, reason)
    for _ in range(3):
        assert t.intent == Intent(STILL, blind=True, give_back=True)
        t.ticks(1.0, seen(0.3))
    assert t.phase is Phase.ABORT


@pytest.mark.parametrize("final", [Phase.DONE, Phase.ABORT])
def test_a_pilot_after_the_end_is_left_alone(final) -> None:
    """The phase stays what it is; the drone does nothing any more."""
    t = in_phase(final).tick(seen(), vehicle=vehicle(obeying=False)).ticks(1.0, seen(0.2))
    assert t.phase is final
    assert t.intent == Intent(STILL, blind=True, give_back=True)


@pytest.mark.parametrize("phase", [p for p in Phase if not p.final])
@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({"order": Order.ABORT}, Reason.ORDERED_ABORT),
        ({"told": Told(Status.ABORT)}, Reason.FILTER_ABORT),
        ({"vehicle": vehicle(battery_fraction=0.19)}, Reason.BATTERY_LOW),
        ({"odometry_silent": True}, Reason.ODOMETRY_SILENT),
    ],
)
def test_an_end_while_the_vehicle_is_ours_backs_off_first(phase, what, reason) -> None:
    """To the stand-off distance, then it gives the vehicle back and stays away."""
    t = in_phase(phase)
    at = seen(t.state.tip_target[0]) if t.state.tip_target else seen(0.5)
    t.tick(at, **what)
    assert (t.phase, t.reason) == (Phase.ABORT, reason)
    t.tick(seen(0.3)).tick(seen(0.3))
    if at.tip_target[0] < 0.9:
        assert t.intent.goal.aim is Aim.RETREAT
        assert not t.intent.give_back
    t.tick(seen(0.95))
    assert t.intent == Intent(STILL, give_back=True)
    t.ticks(2.0, seen(0.2))
    assert t.intent == Intent(STILL, give_back=True)


def test_a_moment_without_knowledge_does_not_end_the_backing_off() -> None:
    """What is given back is never taken again: half a second of it does, however old the abort."""
    t = in_phase(Phase.APPROACH).glide(0.3).tick(seen(0.3), order=Order.ABORT)
    t.ticks(2.0, seen(0.3))
    assert t.tick(None).intent == Intent(STILL, blind=True)
    assert t.tick(seen(0.3)).intent.goal.aim is Aim.RETREAT
    assert t.ticks(SETTINGS.brake_s - 0.1, None).intent == Intent(STILL, blind=True)
    assert t.ticks(0.2, None).intent == Intent(STILL, blind=True, give_back=True)


@pytest.mark.parametrize("phase", [p for p in Phase if not p.final])
def test_an_odometry_that_jumps_stops_everything(phase) -> None:
    """BRAKE, blind; what was measured before does not count; then back to the stand-off point."""
    t = in_phase(phase)
    t.tick(seen(0.9), odometry_jumped=True)
    assert t.intent.blind
    if phase is not Phase.BRAKE:
        assert (t.phase, t.reason) == (Phase.BRAKE, Reason.ODOMETRY_JUMPED)
    t.ticks(1.0, seen(0.4), odometry_jumped=True)
    stale = seen(0.4, age_ns=2 * SECOND)
    assert t.tick(stale).phase is Phase.BRAKE
    assert t.intent.blind
    t.tick(seen(0.4, age_ns=0))
    assert (t.phase, t.reason) == (Phase.RETREAT, Reason.BRAKED)
    assert not t.intent.blind


@pytest.mark.parametrize("phase", [p for p in Phase if not p.final])
def test_a_drone_that_does_not_know_where_it_is_stops(phase) -> None:
    """For good, if it does not learn it again: then it lets go."""
    t = in_phase(phase).tick(None, own_pose=False)
    assert t.phase is Phase.BRAKE
    assert t.intent == Intent(STILL, blind=True)
    t.ticks(SETTINGS.brake_max_s + 0.1, None, own_pose=False)
    assert (t.phase, t.reason) == (Phase.ABORT, Reason.BRAKE_TOO_LONG)
    t.ticks(1.0, None, own_pose=False)
    assert t.intent == Intent(STILL, blind=True, give_back=True)


@pytest.mark.parametrize("phase", [Phase.ALIGN, Phase.APPROACH, Phase.CONTACT])
def test_an_old_target_holds_then_brakes_then_backs_off(phase) -> None:
    """As the safety filter's own phases, each with its reason; out of sight, it searches again."""
    t = in_phase(phase)
    x = 1.5 if phase is Phase.ALIGN else 0.4 if phase is Phase.APPROACH else 0.0
    if phase is Phase.APPROACH:
        t.glide(0.4)
    n = len(t.transitions)
    t.ticks(0.3, seen(x, freshness=Freshness.HOLD, age_ns=400 * MS))
    t.ticks(0.9, seen(x, freshness=Freshness.BRAKE, age_ns=900 * MS))
    old = {"freshness": Freshness.RETREAT, "age_ns": 3 * SECOND}
    t.ticks(0.5, seen(x, **old)).ticks(0.5, seen(1.0, **old))
    assert [(m.after, m.reason) for m in t.transitions[n:]] == [
        (Phase.HOLD, Reason.TARGET_OLD),
        (Phase.BRAKE, Reason.TARGET_LOST),
        (Phase.RETREAT, Reason.TARGET_LOST),
        (Phase.SEARCH, Reason.TARGET_LOST),
    ]


def test_a_short_gap_only_holds() -> None:
    """Fresh again for a moment, the approach goes on where it was, in the same attempt."""
    t = in_phase(Phase.APPROACH)
    t.ticks(0.2, seen(0.9, freshness=Freshness.HOLD))
    t.ticks(0.28, seen(0.9))
    assert t.phase is Phase.HOLD
    t.ticks(0.1, seen(0.9))
    assert (t.phase, t.reason, t.state.attempts) == (Phase.APPROACH, Reason.GOOD_AGAIN, 1)


def test_a_leap_of_the_estimate_near_the_board_starts_the_approach_anew() -> None:
    """What moved further than the drone can fly is the estimate; while holding as well."""
    t = in_phase(Phase.APPROACH)
    t.tick(seen(0.9, tip_target=(0.9, 0.12, 0.0)))
    assert (t.phase, t.reason) == (Phase.BRAKE, Reason.TARGET_LEAPT)
    assert not t.intent.blind
    t.ticks(0.52, seen(0.9))
    assert (t.phase, t.reason) == (Phase.RETREAT, Reason.BRAKED)

    t = in_phase(Phase.APPROACH).tick(seen(0.9, freshness=Freshness.HOLD))
    t.tick(seen(0.9, tip_target=(0.9, 0.12, 0.0))).ticks(0.5, seen(0.9))
    assert (t.phase, t.reason) == (Phase.ALIGN, Reason.GOOD_AGAIN)


@pytest.mark.parametrize("phase", [Phase.SEARCH, Phase.ALIGN, Phase.APPROACH, Phase.CONTACT])
def test_a_target_that_is_contradicted_is_waited_for(phase) -> None:
    """Two measurements in a row against it hold; one does not."""
    t = in_phase(phase)
    x = {Phase.SEARCH: 1.5, Phase.ALIGN: 1.5, Phase.APPROACH: 0.9, Phase.CONTACT: 0.0}[phase]
    t.ticks(0.2, seen(x, outliers=1), told=PRESSED)
    assert t.phase is phase
    t.tick(seen(x, outliers=2), told=PRESSED)
    assert (t.phase, t.reason) == (Phase.HOLD, Reason.TARGET_DOUBTED)
    t.ticks(SETTINGS.hold_max_s + 0.1, seen(x, outliers=2))
    assert (t.transitions[-1].before, t.reason) in (
        (Phase.HOLD, Reason.HOLD_TOO_LONG),
        (Phase.SEARCH, Reason.TARGET_DOUBTED),
    )


@pytest.mark.parametrize(
    "phase", [Phase.SEARCH, Phase.ALIGN, Phase.APPROACH, Phase.CONTACT, Phase.RETREAT]
)
def test_a_person_halts_and_lets_go_on(phase) -> None:
    """From everywhere; contact is felt anew, from the approach."""
    t = in_phase(phase)
    at = seen(0.0 if phase in (Phase.CONTACT, Phase.RETREAT) else 0.9)
    t.tick(at, order=Order.HOLD)
    assert (t.phase, t.reason) == (Phase.HOLD, Reason.ORDERED_HOLD)
    t.ticks(30.0, at, order=Order.HOLD)
    assert t.phase is Phase.HOLD
    t.ticks(0.1, at)
    assert t.phase is (Phase.APPROACH if phase is Phase.CONTACT else phase)


@pytest.mark.parametrize(
    ("phase", "what", "reason"),
    [
        (Phase.SEARCH, None, Reason.SEARCH_TOO_LONG),
        (Phase.ALIGN, seen(1.5), Reason.ALIGN_TOO_LONG),
        (Phase.RETREAT, seen(0.5), Reason.RETREAT_TOO_LONG),
        (Phase.BRAKE, seen(0.5, freshness=Freshness.BRAKE), Reason.BRAKE_TOO_LONG),
    ],
)
def test_a_phase_that_does_not_end_ends_the_mission(phase, what, reason) -> None:
    """Each has its time."""
    t = in_phase(phase).ticks(61.0, what)
    assert (t.phase, t.reason) == (Phase.ABORT, reason)


def test_an_approach_without_progress_is_given_up_and_tried_again_a_few_times() -> None:
    """Three attempts, each with its reason; then the end."""
    t = in_phase(Phase.APPROACH)
    for _ in range(3):
        t.glide(0.9).ticks(SETTINGS.progress_s + 0.1, seen(0.9))
        assert (t.phase, t.reason) == (Phase.RETREAT, Reason.NO_PROGRESS)
        t.ticks(1.5, seen(1.0))
    assert (t.phase, t.reason) == (Phase.ABORT, Reason.ATTEMPTS_SPENT)
    assert [m.reason for m in t.transitions].count(Reason.TRY_AGAIN) == 2


@pytest.mark.parametrize(
    ("x_m", "closing_mps", "gives_up"),
    [
        (0.06, 0.1, True),  # pushed, 0.6 s before the touch
        (0.06, 0.07, False),  # no more than wind does every day
        (0.06, 0.16, False),  # too late to turn without pitching the tip up at the board
        (0.12, 0.2, False),  # far enough for the filter to slow it
        (0.06, -0.1, False),
        (0.06, math.nan, False),
        (0.06, math.inf, False),
    ],
)
def test_an_approach_that_is_pushed_on_is_given_up_while_it_can_be(x_m, closing_mps, gives_up):
    """Faster than it was told to, near the board, and with time to turn."""
    t = in_phase(Phase.APPROACH).glide(x_m)
    velocity = np.array([closing_mps, 0.0, 0.0])  # the board's axis points along -x of the world
    t.tick(seen(x_m), told=PRESSED, vehicle=vehicle(velocity_world=velocity))
    assert (t.reason is Reason.PUSHED) is gives_up
    assert t.phase is (Phase.RETREAT if gives_up else Phase.APPROACH)


def test_what_was_told_is_what_counts():
    """The same speed is no push where it was asked for; nor by a vehicle that tells no speed."""
    fast = vehicle(velocity_world=np.array([0.1, 0.0, 0.0]))
    t = in_phase(Phase.APPROACH).glide(0.06)
    t.tick(seen(0.06), told=Told(Status.INACTIVE, 0.01, -0.08), vehicle=fast)
    t.tick(seen(0.06), told=PRESSED)
    assert t.phase is Phase.APPROACH
    t.tick(seen(0.06), told=PRESSED, vehicle=fast)
    assert "closes in at 0.100 m/s, told to at 0.030" in t.transitions[-1].sentence


def halted(t: Flown, x_m: float) -> Flown:
    """Once, for knowledge that is old, and good again."""
    t.ticks(0.2, seen(x_m, freshness=Freshness.HOLD, age_ns=400 * MS))
    assert t.phase is Phase.HOLD
    return t.ticks(0.5, seen(x_m))


def test_an_attempt_that_flickers_near_the_board_is_given_up():
    """The third halt; the next attempt counts anew."""
    t = in_phase(Phase.APPROACH).glide(0.05)
    for _ in range(SETTINGS.flickers - 1):
        halted(t, 0.05)
        assert t.phase is Phase.APPROACH
    halted(t, 0.05)
    assert (t.phase, t.reason) == (Phase.RETREAT, Reason.FLICKERS)
    assert "3 times" in t.transitions[-1].sentence
    t.glide(1.0).ticks(3.0, seen(1.0)).glide(0.05)
    assert (t.phase, t.state.attempts, t.state.flickers) == (Phase.APPROACH, 2, 0)


def test_halts_far_from_the_board_or_for_a_person_do_not_count():
    """There is room there; and a person knows why."""
    t = in_phase(Phase.APPROACH)
    for _ in range(5):
        halted(t, 0.9)
    t.glide(0.05)
    for _ in range(5):
        t.tick(seen(0.05), order=Order.HOLD)
        assert t.reason is Reason.ORDERED_HOLD
        t.ticks(0.5, seen(0.05))
    assert (t.phase, t.state.flickers) == (Phase.APPROACH, 0)


def test_a_contact_that_is_lost_is_an_attempt_that_failed() -> None:
    """The tip springs back: away, and again."""
    t = in_phase(Phase.CONTACT)
    t.ticks(0.5, seen(0.031))
    assert (t.phase, t.reason) == (Phase.RETREAT, Reason.CONTACT_LOST)
    assert not t.state.touched


def test_a_whole_mission_has_its_time() -> None:
    """A person who never lets go on."""
    t = in_phase(Phase.ALIGN).ticks(SETTINGS.mission_max_s, seen(1.5), order=Order.HOLD)
    assert (t.phase, t.reason) == (Phase.ABORT, Reason.MISSION_TOO_LONG)


def test_nobody_waits_for_ever_for_a_vehicle() -> None:
    """Nor is one flown that comes too late."""
    t = Flown(MissionSettings(waiting_max_s=2.0)).ticks(2.1, vehicle=None)
    assert (t.phase, t.reason) == (Phase.ABORT, Reason.WAITED_TOO_LONG)


def test_what_a_vehicle_did_not_say_is_named_when_the_wait_is_over() -> None:
    """An autopilot that does not say whether it flies is not flown, and the log says so."""
    t = Flown(MissionSettings(waiting_max_s=2.0)).ticks(2.1, vehicle=vehicle(landed=None))
    assert "EXTENDED_SYS_STATE" in t.transitions[-1].sentence


def test_a_person_may_think_as_long_as_it_takes() -> None:
    """The wait for a vehicle begins with the word to go."""
    t = Flown(MissionSettings(waiting_max_s=2.0)).ticks(60.0, vehicle=None, order=Order.HOLD)
    assert t.reason is Reason.WAITING
    assert t.ticks(1.9, vehicle=None).reason is Reason.WAITING
    assert t.ticks(0.2, vehicle=None).reason is Reason.WAITED_TOO_LONG
    assert t.ticks(1.0, seen(0.2)).intent == Intent(STILL, blind=True, give_back=True)


def test_a_search_turns_back_and_forth_within_its_bounds() -> None:
    """Only where it is asked to; around the heading that it began with, over the seam as well."""
    assert in_phase(Phase.SEARCH).intent.yaw_rate_radps == 0.0
    asked = MissionSettings(scan_half_rad=0.5, scan_radps=0.2)
    t, heading, headings = Flown(asked), 3.0, []
    for _ in range(1500):
        wrapped = math.remainder(heading, math.tau)
        t.tick(heading_rad=wrapped)
        assert abs(t.intent.yaw_rate_radps) in (0.0, 0.2)
        heading += 0.02 * t.intent.yaw_rate_radps
        headings.append(heading)
    assert max(headings) == pytest.approx(3.5, abs=0.01)
    assert min(headings) == pytest.approx(2.5, abs=0.01)
    assert t.tick(heading_rad=math.nan).intent.yaw_rate_radps == 0.0
    assert t.tick(own_pose=False).intent.yaw_rate_radps == 0.0


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("back_ns", [0, 1, 10**30])
def test_a_clock_that_does_not_go_on_ends_the_mission(phase, back_ns) -> None:
    """Everything would look fresh for ever: after five such ticks it stands, and lets go."""
    t = in_phase(phase)
    x = 1.0 if t.state.tip_target is None else t.state.tip_target[0]

    def tick() -> None:
        t.now_ns = t.state.now_ns - back_ns - TICK_NS
        t.tick(seen(x), told=PRESSED)

    for _ in range(4):
        tick()
    assert t.phase is phase
    tick()
    assert t.phase is (phase if phase.final else Phase.ABORT)
    assert phase.final or t.reason is Reason.CLOCK_STANDS
    assert t.intent == Intent(STILL, blind=True, give_back=True)
    t.now_ns = t.state.now_ns
    t.ticks(1.0, seen(0.3))
    assert t.phase.final
    assert t.intent == Intent(STILL, blind=not phase.final, give_back=True)


def test_a_clock_that_stumbles_changes_nothing() -> None:
    """A few ticks back, and the mission's time stands still until the clock has caught up."""
    t = in_phase(Phase.APPROACH)
    later_ns = t.state.now_ns
    t.now_ns -= 4 * TICK_NS
    t.ticks(0.08, seen(0.9))
    assert t.state.now_ns == later_ns
    t.ticks(1.0, seen(0.9))
    assert t.phase is Phase.APPROACH
    assert t.state.now_ns > later_ns


def test_a_late_tick_allows_for_what_was_flown_meanwhile() -> None:
    """By the time that passed, up to a fifth of a second; over a longer pause it is a leap."""
    x = 0.9
    allowed_m = SETTINGS.leap_m + SETTINGS.leap_rad * x
    for pause_ns, flown_m, phase in (
        (TICK_NS, 0.05, Phase.BRAKE),
        (100 * MS, 0.05, Phase.APPROACH),
        (10 * SECOND, 0.3, Phase.BRAKE),
    ):
        t = in_phase(Phase.APPROACH)
        t.now_ns += pause_ns - TICK_NS
        t.tick(seen(x, tip_target=(x, allowed_m + flown_m - 0.005, 0.0)))
        assert t.phase is phase


def test_a_person_who_says_hold_lets_nothing_begin() -> None:
    """A vehicle that obeys already is waited with."""
    t = Flown().ticks(5.0, seen(), order=Order.HOLD)
    assert (t.phase, t.reason, t.intent) == (Phase.HOLD, Reason.WAITING, Intent(blind=True))
    assert t.ticks(0.32, seen()).phase is Phase.SEARCH


def test_a_person_who_says_hold_stops_the_way_back_of_an_abort() -> None:
    """There may be something behind the drone; it stands until GO, or until it gives it back."""
    t = in_phase(Phase.APPROACH).glide(0.4)
    t.tick(seen(0.4), vehicle=vehicle(battery_fraction=0.1))
    assert t.intent.goal.aim is Aim.RETREAT
    t.tick(seen(0.4), order=Order.HOLD)
    assert t.intent == Intent(STILL)
    t.tick(seen(0.4))
    assert t.intent.goal.aim is Aim.RETREAT
    t.ticks(SETTINGS.retreat_max_s, seen(0.4), order=Order.HOLD)
    assert t.intent == Intent(STILL, give_back=True)


def test_a_search_for_what_was_lost_near_the_board_does_not_turn() -> None:
    """Nobody knows how near: the arm would swing along the wall. Not after a hold, either."""
    asked = MissionSettings(scan_half_rad=0.5)
    t = in_phase(Phase.APPROACH, asked)
    t.ticks(0.6, None, heading_rad=0.0)
    assert (t.phase, t.reason) == (Phase.SEARCH, Reason.TARGET_LOST)
    t.ticks(1.0, None, order=Order.HOLD).ticks(1.0, None)
    assert t.phase is Phase.SEARCH
    assert t.intent == Intent(blind=True)


def test_a_search_that_was_stopped_before_anything_was_near_turns_on() -> None:
    """A moment without a pose in the first search: the drone has not been near any board."""
    t = Flown(MissionSettings(scan_half_rad=0.5, scan_radps=0.2)).ticks(0.6, None, heading_rad=0.0)
    assert t.phase is Phase.SEARCH
    t.ticks(0.1, None, own_pose=False, heading_rad=0.0)
    assert (t.phase, t.reason) == (Phase.BRAKE, Reason.OWN_POSE_UNKNOWN)
    t.ticks(2.0, None, heading_rad=0.0)
    assert t.phase is Phase.SEARCH
    assert t.intent.yaw_rate_radps == 0.2


def test_a_search_that_is_held_goes_on_around_the_same_heading() -> None:
    """However often a person halts it, it does not work its way round."""
    t = Flown(MissionSettings(scan_half_rad=0.5, scan_radps=0.2))
    t.ticks(0.6, None, heading_rad=1.0)
    t.ticks(1.0, None, order=Order.HOLD, heading_rad=1.4).ticks(0.4, None, heading_rad=1.49)
    assert t.intent.yaw_rate_radps == 0.2
    assert t.tick(None, heading_rad=1.51).intent.yaw_rate_radps == -0.2


numbers = st.floats(allow_nan=True, allow_infinity=True)
vectors = st.tuples(numbers, numbers, numbers)
any_seen = st.builds(
    Seen,
    tip_target=vectors,
    tip_world=vectors,
    axis_world=vectors | st.just((-1.0, 0.0, 0.0)),
    yaw_error_rad=numbers,
    age_ns=st.integers(-(2**70), 2**70),
    freshness=st.sampled_from(Freshness),
    outliers=st.integers(-1, 10**30),
    tip_ahead_m=numbers,
)
likely_seen = st.builds(
    seen,
    st.sampled_from([-0.02, 0.0, 0.01, 0.5, 0.95, 1.0, 1.5]),
    freshness=st.sampled_from([Freshness.FRESH, *Freshness]),
    age_ns=st.sampled_from([0, 100 * MS, 2 * SECOND]),
    outliers=st.sampled_from([0, 0, 0, 1, 2, 3]),
)
any_vehicle = st.builds(
    VehicleState,
    t_heard_ns=st.integers(-(2**70), 2**70),
    mode=st.text(max_size=100),
    armed=st.booleans(),
    obeying=st.booleans(),
    battery_fraction=st.none() | numbers,
    landed=st.none() | st.booleans(),
    failsafe=st.sampled_from(["", "", "x" * 200]),
)
any_senses = st.builds(
    Senses,
    vehicle=st.none() | any_vehicle,
    odometry_jumped=st.booleans(),
    forward_m=st.none() | numbers,
    order=st.sampled_from(Order),
)
kind_senses = st.builds(
    Senses,
    vehicle=st.just(vehicle()),
    odometry_jumped=st.sampled_from([False] * 9 + [True]),
    forward_m=st.none() | st.floats(0.3, 2),
    order=st.sampled_from([Order.GO] * 9 + [Order.HOLD]),
)
any_told = st.builds(Told, st.none() | st.sampled_from(Status), numbers, numbers)
kind_told = st.just(PRESSED)


class AnyMission(RuleBasedStateMachine):
    """A mission shown anything, in any order, for as long as anybody likes."""

    @initialize(quick=st.booleans(), needs_vehicle=st.booleans())
    def start(self, quick, needs_vehicle) -> None:
        short = {"search_max_s": 2.0, "progress_s": 1.0, "hold_max_s": 0.5, "brake_max_s": 1.0}
        short |= {"align_max_s": 2.0, "retreat_max_s": 2.0, "dwell_s": 0.2, "brake_s": 0.2}
        self.settings = MissionSettings(needs_vehicle=needs_vehicle, **(short if quick else {}))
        self.state: MissionState = begin(0)
        self.intent = Intent()
        self.now_ns = 0
        self.recent: deque[int] = deque()
        self.taken = self.gave_back = False

    def _step(self, what, own_pose, senses, told, heading=0.0, dt_ns=TICK_NS) -> None:
        before = self.state
        self.now_ns += dt_ns
        obs = Observation(self.now_ns, what, own_pose, heading, senses)
        self.state, self.intent = step(replace(before, told=told), obs, self.settings)
        if self.state.transition is not None:
            assert not before.phase.final
            assert self.state.transition.sentence.isprintable()
            assert len(self.state.transition.sentence) < 200
            self.recent.append(self.state.now_ns)
            while self.recent[-1] - self.recent[0] > SECOND:
                self.recent.popleft()
            assert len(self.recent) <= MOST_PER_SECOND
        else:
            assert self.state.phase is before.phase
        own = senses.vehicle
        if before.begun_ns is not None and own is not None and not own.obeying:
            self.taken = True
            assert self.state.phase.final

    @rule(
        what=st.none() | any_seen | likely_seen,
        own_pose=st.booleans(),
        senses=any_senses | kind_senses,
        told=any_told,
        heading=st.none() | numbers,
        dt_ns=st.integers(-(2**65), 2**65) | st.just(TICK_NS),
    )
    def anything(self, what, own_pose, senses, told, heading, dt_ns) -> None:
        self._step(what, own_pose, senses, told, heading, dt_ns)

    @rule(
        what=likely_seen,
        senses=kind_senses,
        told=kind_told,
        ticks=st.integers(1, 60),
    )
    def something_for_a_while(self, what, senses, told, ticks) -> None:
        for _ in range(ticks):
            self._step(what, True, senses, told)

    @invariant()
    def what_is_not_known_is_not_flown_by(self) -> None:
        if self.state.tip_target is None or self.state.begun_ns is None:
            assert self.intent.blind or self.state.now_ns == 0
        assert abs(self.intent.yaw_rate_radps) <= self.settings.scan_radps

    @invariant()
    def what_was_taken_is_left_alone(self) -> None:
        if self.taken:
            assert self.intent == Intent(STILL, blind=True, give_back=True)

    @invariant()
    def what_was_given_back_stays_so(self) -> None:
        assert self.intent.give_back or not self.gave_back
        self.gave_back = self.intent.give_back
        assert not self.gave_back or self.state.phase.final

    @invariant()
    def counts_are_bounded(self) -> None:
        assert 0 <= self.state.attempts <= self.settings.attempts
        assert self.state.resume in (Phase.SEARCH, Phase.ALIGN, Phase.APPROACH, Phase.RETREAT)


TestAnyMission = AnyMission.TestCase
TestAnyMission.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.none() | likely_seen, kind_senses), min_size=1, max_size=40),
    st.none() | likely_seen | any_seen,
    st.booleans(),
    st.booleans(),
)
def test_whatever_is_shown_for_long_enough_it_comes_to_an_end(history, last, own_pose, jumped):
    """From any phase that a history led to, and by any view that stays: DONE or ABORT in time."""
    t = Flown()
    for what, senses in history:
        for _ in range(10):
            t.tick(what, odometry_jumped=senses.odometry_jumped, order=senses.order)
    t.now_ns = t.state.now_ns
    for _ in range(2 * round(SETTINGS.mission_max_s)):
        t.now_ns += SECOND // 2 - TICK_NS  # coarse ticks: time-outs are what is asked about
        t.tick(last, own_pose=own_pose, odometry_jumped=jumped)
        if t.phase.final:
            break
    assert t.phase.final
    assert t.now_ns <= (SETTINGS.mission_max_s + SETTINGS.waiting_max_s) * SECOND


@given(st.lists(st.sampled_from(Freshness), min_size=150, max_size=300))
def test_a_link_that_flickers_does_not_rattle(flicker) -> None:
    """Fresh, old and fresh again from tick to tick: a few transitions a second at most."""
    t = in_phase(Phase.APPROACH)
    times = []
    for f in flicker:
        t.tick(seen(0.9, freshness=f))
        if t.state.transition is not None:
            times.append(t.now_ns)
    for first, last in pairwise(times[::MOST_PER_SECOND]):
        assert last - first > SECOND


@pytest.mark.parametrize(
    "name",
    [n for n in MissionSettings.__dataclass_fields__ if n not in ("contact", "needs_vehicle")],
)
@pytest.mark.parametrize("value", [-1.0, 1e6, math.nan])
def test_every_setting_is_bounded(name, value) -> None:
    """The message names the setting and its range."""
    with pytest.raises(ValueError, match=rf"^MissionSettings\.{name} = .* is not in \["):
        MissionSettings(**{name: value})


def test_settings_that_contradict_are_refused() -> None:
    """An attempt that outlasts its mission."""
    with pytest.raises(ValueError, match="attempt_max_s = 90.0 must be less than mission_max_s"):
        MissionSettings(mission_max_s=60.0)
