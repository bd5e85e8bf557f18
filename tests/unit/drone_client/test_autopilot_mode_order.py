"""The order into the mode that takes commands, and out of it."""

from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from drone_client.autopilot.mode_order import (
    Answer,
    Ask,
    Flow,
    Heard,
    ModeOrder,
    OrderSettings,
    Phase,
    Step,
)

MS = 1_000_000


class World:
    """A vehicle on a clock, and the order that deals with it."""

    def __init__(self) -> None:
        self.order = ModeOrder("OFFBOARD", OrderSettings())
        self.now_ms = 100_000
        self.mode = "POSCTL"
        self.armed = True
        self.asked: list[Ask] = []

    def hear(self) -> None:
        self.order.heard(Heard(self.now_ms * MS, self.mode, self.armed))

    def tick(self, ms: int = 20) -> Step:
        self.now_ms += ms
        step = self.order.step(self.now_ms * MS)
        if step.ask is not None:
            self.asked.append(step.ask)
        return step

    def run(self, ms: int, heartbeat_ms: int = 1000) -> list[Step]:
        steps = []
        for _ in range(ms // 20):
            steps.append(self.tick())
            if self.now_ms % heartbeat_ms == 0:
                self.hear()
        return steps

    def engage_until_asked(self) -> None:
        self.hear()
        self.order.engage(self.now_ms * MS)
        self.run(1200)
        self.hear()
        assert self.tick().ask is Ask.TAKE

    def engage(self) -> None:
        self.engage_until_asked()
        self.mode = "OFFBOARD"
        self.order.answered(Answer.ACCEPTED, self.now_ms * MS)
        self.hear()
        assert self.order.phase is Phase.ENGAGED


def test_setpoints_come_first_and_the_question_after() -> None:
    """Zero velocities for 1.2 s, then DO_SET_MODE once, then the commands."""
    world = World()
    world.hear()
    assert world.tick() == Step(Flow.NOTHING)
    world.order.engage(world.now_ms * MS)
    assert set(world.run(1180)) == {Step(Flow.ZERO)}
    world.hear()
    assert [world.tick() for _ in range(2)] == [Step(Flow.ZERO)] * 2  # that one came before
    world.hear()
    assert world.tick() == Step(Flow.ZERO, Ask.TAKE)
    world.mode = "OFFBOARD"
    world.hear()
    assert world.tick() == Step(Flow.COMMANDS)


def test_without_a_heartbeat_nothing_is_asked() -> None:
    """It waits for the vehicle for ten seconds and gives up."""
    world = World()
    world.order.engage(world.now_ms * MS)
    steps = [world.tick() for _ in range(600)]
    assert all(s.ask is None for s in steps)
    assert steps[-1] == Step(Flow.NOTHING)
    assert "heartbeat" in world.order.reason


def test_refusals_are_bounded() -> None:
    """Six questions, each after a heartbeat that still says the old mode; then silence."""
    world = World()
    world.hear()
    world.order.engage(world.now_ms * MS)
    for _ in range(1000):
        step = world.tick()
        if step.ask is not None:
            world.order.answered(Answer.LATER, world.now_ms * MS)
        if world.now_ms % 1000 == 0:
            world.hear()
    assert world.asked == [Ask.TAKE] * 6
    assert world.order.phase is Phase.SILENT
    assert "refused" in world.order.reason


def test_what_it_does_not_know_is_asked_once() -> None:
    """UNSUPPORTED ends the order at once."""
    world = World()
    world.engage_until_asked()
    world.order.answered(Answer.NEVER, world.now_ms * MS)
    assert world.tick() == Step(Flow.NOTHING)
    assert world.asked == [Ask.TAKE]


def test_an_accepted_question_is_not_asked_again() -> None:
    """Accepted, then the pilot takes it back before a heartbeat told: no second question."""
    world = World()
    world.engage_until_asked()
    world.order.answered(Answer.ACCEPTED, world.now_ms * MS)
    world.run(6000)
    assert world.asked == [Ask.TAKE]
    assert world.order.phase is Phase.SILENT


def test_a_pilot_who_switches_while_it_asks_is_obeyed() -> None:
    """POSCTL becomes ALTCTL: somebody is at the sticks."""
    world = World()
    world.engage_until_asked()
    world.mode = "ALTCTL"
    world.hear()
    assert world.order.phase is Phase.SILENT
    assert "ALTCTL" in world.order.reason
    assert world.tick() == Step(Flow.NOTHING)


@pytest.mark.parametrize("mode", ["ALTCTL", "AUTO.RTL"])
def test_a_pilot_who_switches_between_the_last_heartbeat_and_the_question_is_obeyed(mode: str):
    """The question waits for a heartbeat of its own, and that one tells of the switch."""
    world = World()
    world.hear()
    world.order.engage(world.now_ms * MS)
    world.run(1180)
    world.hear()  # the last that says POSCTL; then the pilot switches
    world.mode = mode
    assert all(world.tick().ask is None for _ in range(40))
    world.hear()
    assert set(world.run(5000)) == {Step(Flow.NOTHING)}
    assert mode in world.order.reason
    assert world.asked == []


def test_a_question_that_comes_late_after_the_heartbeat_waits_for_the_next():
    """A pacer that was held up does not ask on an old word."""
    world = World()
    world.hear()
    world.order.engage(world.now_ms * MS)
    world.run(1220)
    world.hear()
    assert world.tick(120).ask is None
    world.hear()
    assert world.tick().ask is Ask.TAKE


@pytest.mark.parametrize("mode", ["ALTCTL", "AUTO.RTL"])
def test_a_pilot_who_switches_before_it_asks_is_obeyed(mode: str) -> None:
    """While the setpoints warm up, too: the mode is not asked for any more."""
    world = World()
    world.hear()
    world.order.engage(world.now_ms * MS)
    world.run(600)
    world.mode = mode
    world.hear()
    assert set(world.run(5000)) == {Step(Flow.NOTHING)}
    assert mode in world.order.reason
    assert world.asked == []


def test_a_pilot_who_takes_the_mode_before_it_asks_is_followed() -> None:
    """The switch may stand for OFFBOARD itself."""
    world = World()
    world.hear()
    world.order.engage(world.now_ms * MS)
    world.run(600)
    world.mode = "OFFBOARD"
    world.run(2000)
    assert world.order.phase is Phase.ENGAGED


@pytest.mark.parametrize("mode", ["POSCTL", "AUTO.LAND", "AUTO.RTL", "MANUAL"])
def test_a_switch_ends_it_at_once_and_for_good(mode: str) -> None:
    """From the heartbeat on: silence, whatever time passes, until a person engages."""
    world = World()
    world.engage()
    world.mode = mode
    world.hear()
    assert set(world.run(5000)) == {Step(Flow.NOTHING)}
    assert mode in world.order.reason
    world.mode = "OFFBOARD"  # not even when somebody else switches it there
    world.hear()
    assert set(world.run(1000)) == {Step(Flow.NOTHING)}
    world.mode = "POSCTL"
    world.asked.clear()
    world.engage()
    assert world.asked == [Ask.TAKE]


def test_disarming_ends_it() -> None:
    """What lies on the ground and is armed again is not flown by an old engagement."""
    world = World()
    world.engage()
    world.armed = False
    world.hear()
    assert world.order.phase is Phase.SILENT


def test_engaged_before_arming_stays_engaged() -> None:
    """OFFBOARD first, arming by the pilot after it, is a usual order."""
    world = World()
    world.armed = False
    world.engage()
    world.run(2000)
    world.armed = True
    world.hear()
    assert world.tick() == Step(Flow.COMMANDS)


def test_lost_heartbeats_end_it() -> None:
    """Three seconds without the vehicle's word, and PX4's own failsafe shall act."""
    world = World()
    world.engage()
    steps = [world.tick() for _ in range(200)]
    assert steps[140] == Step(Flow.COMMANDS)
    assert steps[-1] == Step(Flow.NOTHING)


def test_giving_up_is_silence() -> None:
    """What should fly it is gone; while it is not ours, that changes nothing."""
    world = World()
    world.order.give_up(world.now_ms * MS, "gone")
    assert world.order.reason == "not engaged"
    world.engage()
    world.order.give_up(world.now_ms * MS, "gone")
    assert world.tick() == Step(Flow.NOTHING)
    assert world.order.reason == "gone"


def test_release_is_zero_then_hold_then_silence() -> None:
    """The mode that holds is asked for while zeros flow; they end when it is there."""
    world = World()
    world.engage()
    world.asked.clear()
    world.order.release(world.now_ms * MS)
    assert world.tick() == Step(Flow.ZERO, Ask.HOLD)
    world.mode = "AUTO.LOITER"
    world.hear()
    assert world.tick() == Step(Flow.NOTHING)
    assert world.order.reason == "released: AUTO.LOITER"


def test_a_pilot_who_switches_as_it_is_given_back_is_not_undone() -> None:
    """Since the last heartbeat he may have: zeros flow until the next one, and no question."""
    world = World()
    world.engage()
    world.asked.clear()
    world.tick()
    world.order.release(world.now_ms * MS)
    assert {world.tick() for _ in range(20)} == {Step(Flow.ZERO)}
    world.mode = "POSCTL"
    world.hear()
    assert set(world.run(5000)) == {Step(Flow.NOTHING)}
    assert world.asked == []


def test_the_mode_that_holds_is_asked_for_after_a_heartbeat() -> None:
    """One that says that the vehicle is still ours."""
    world = World()
    world.engage()
    world.asked.clear()
    world.tick()
    world.order.release(world.now_ms * MS)
    assert world.tick() == Step(Flow.ZERO)
    world.hear()
    assert world.tick() == Step(Flow.ZERO, Ask.HOLD)


def test_release_without_an_answer_ends_too() -> None:
    """A vehicle that does not take HOLD is left to its failsafe."""
    world = World()
    world.engage()
    world.asked.clear()
    world.order.release(world.now_ms * MS)
    world.run(10_000)
    assert world.asked == [Ask.HOLD] * 6
    assert world.order.phase is Phase.SILENT


def test_release_while_warming_asks_for_nothing() -> None:
    """The vehicle was never taken: its mode is the pilot's."""
    world = World()
    world.hear()
    world.order.engage(world.now_ms * MS)
    world.run(500)
    world.order.release(world.now_ms * MS)
    assert set(world.run(1000)) == {Step(Flow.NOTHING)}
    assert world.asked == []


def asking_and_refused() -> World:
    world = World()
    world.engage_until_asked()
    world.order.answered(Answer.LATER, world.now_ms * MS)
    world.asked.clear()
    world.order.release(world.now_ms * MS)
    return world


def test_release_while_it_asks_does_not_take_the_vehicle_from_its_pilot() -> None:
    """Refused so far, and a Ctrl-C: its mode is the pilot's, and stays."""
    world = asking_and_refused()
    steps = world.run(5000)
    assert world.asked == []
    assert steps[0] == Step(Flow.ZERO)  # the question may be answered yet
    assert steps[-1] == Step(Flow.NOTHING)
    assert world.order.reason == "released"


def test_release_while_it_asks_and_the_pilot_switches() -> None:
    """POSCTL to STABILIZED: silence from that heartbeat on."""
    world = asking_and_refused()
    world.hear()
    world.mode = "STABILIZED"
    world.hear()
    assert set(world.run(5000)) == {Step(Flow.NOTHING)}
    assert world.asked == []


def test_a_mode_that_is_taken_after_all_is_left_again() -> None:
    """The question was under way as a person gave up: the vehicle is ours, and is given back."""
    world = asking_and_refused()
    world.tick()
    world.mode = "OFFBOARD"
    world.hear()
    assert world.tick() == Step(Flow.ZERO, Ask.HOLD)
    world.mode = "AUTO.LOITER"
    world.hear()
    assert world.tick() == Step(Flow.NOTHING)


def test_release_while_it_asks_and_nothing_is_heard_any_more_ends_too() -> None:
    """Zeros do not flow for ever."""
    world = asking_and_refused()
    steps = [world.tick() for _ in range(200)]
    assert steps[-1] == Step(Flow.NOTHING)
    assert world.asked == []


def test_settings_are_bounded() -> None:
    """PX4 wants setpoints for more than a second."""
    with pytest.raises(ValueError, match="warm_ms"):
        OrderSettings(warm_ms=500.0)


class Anything(RuleBasedStateMachine):
    """Any sequence of people, heartbeats, answers and ticks."""

    @initialize()
    def begin(self) -> None:
        self.world = World()
        self.step = Step(Flow.NOTHING)
        self.person_engaged = False

    @rule()
    def engage(self) -> None:
        self.world.order.engage(self.world.now_ms * MS)
        self.person_engaged = True

    @rule()
    def release(self) -> None:
        self.world.order.release(self.world.now_ms * MS)

    @rule(
        mode=st.sampled_from(["POSCTL", "OFFBOARD", "AUTO.LOITER", "AUTO.LAND"]),
        armed=st.booleans(),
    )
    def hear(self, mode: str, armed: bool) -> None:
        self.world.mode, self.world.armed = mode, armed
        self.world.hear()
        if self.world.order.phase is Phase.SILENT:
            self.person_engaged = False

    @rule(answer=st.sampled_from(list(Answer)))
    def answer(self, answer: Answer) -> None:
        self.world.order.answered(answer, self.world.now_ms * MS)

    @rule(ms=st.sampled_from([20, 20, 600, 1300, 4000]))
    def tick(self, ms: int) -> None:
        self.step = self.world.tick(ms)
        if self.step.ask is Ask.TAKE:
            assert self.person_engaged, "the mode is asked for without a person"
            assert self.step.flow is Flow.ZERO
        if self.step.ask is Ask.HOLD:
            assert self.world.mode == "OFFBOARD", "a mode that was never ours is taken away"
        if self.step.flow is Flow.COMMANDS:
            assert self.world.mode == "OFFBOARD"
            assert self.person_engaged
        if self.world.order.phase is Phase.SILENT:
            self.person_engaged = False

    @invariant()
    def questions_are_bounded(self) -> None:
        if hasattr(self, "world"):
            assert self.world.order._asked <= 6


TestAnything = Anything.TestCase
TestAnything.settings = settings(max_examples=60, stateful_step_count=40)
