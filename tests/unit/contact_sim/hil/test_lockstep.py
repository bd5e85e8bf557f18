"""Question and answer, on a line without a socket and a clock that the line moves."""

from __future__ import annotations

from collections import deque

import pytest
from pymavlink.dialects.v20 import common as mav

from contact_sim.errors import HilError, PeerGoneError
from contact_sim.hil.lockstep import MAX_ANSWER_BYTES, Lockstep, Patience
from contact_sim.hil.reader import Interval
from rgbd_wire.clock import ManualClock

WAITS = Patience(first_s=1.0, idle_s=0.004, armed_s=0.5, hung_s=2.0, boot_s=3.0)


class Line:
    """Says what the test has put into it: bytes after a delay."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.sent: list[bytes] = []
        self.gone = False
        self._coming: deque[tuple[int, bytes]] = deque()
        self._packer = mav.MAVLink(None, srcSystem=1, srcComponent=1)

    def say(self, *messages, after_s: float = 0.001) -> None:
        data = b"".join(bytes(m.pack(self._packer)) for m in messages)
        self._coming.append((self.clock.now_ns() + round(after_s * 1e9), data))

    def controls(self, t_us: int, *, armed: bool = True, flags: int = 1, after_s: float = 0.001):
        mode = 128 if armed else 0
        self.say(
            mav.MAVLink_hil_actuator_controls_message(t_us, [0.5] * 16, mode, flags),
            after_s=after_s,
        )

    def send(self, data: bytes) -> None:
        self.sent.append(data)

    def receive(self, timeout_s: float) -> bytes:
        if self.gone:
            raise PeerGoneError("the peer closed the connection")
        end_ns = self.clock.now_ns() + round(timeout_s * 1e9)
        if self._coming and self._coming[0][0] <= end_ns:
            at_ns, data = self._coming.popleft()
            self.clock.advance(max(0, at_ns - self.clock.now_ns()))
            return data
        self.clock.advance(end_ns - self.clock.now_ns())
        return b""


@pytest.fixture
def line() -> Line:
    return Line()


@pytest.fixture
def exchange(line: Line) -> Lockstep:
    return Lockstep(line, WAITS, line.clock)


def fly_up(line: Line, exchange: Lockstep) -> None:
    """Armed, with the first question answered."""
    line.controls(4000)
    exchange.ask(4000, b"q")


def ask_on(line: Line, exchange: Lockstep, first: int = 1, *, stamp_off_us: int = 0) -> None:
    """Ask until it is over; answers, if there are any, carry stamps that are off."""
    for i in range(first, 10_000):
        if stamp_off_us:
            line.controls(4000 * i + stamp_off_us)
        exchange.ask(4000 * i, b"q")


def waited_s(line: Line, exchange: Lockstep, t_us: int) -> float:
    begin_ns = line.clock.now_ns()
    exchange.ask(t_us, b"q")
    return (line.clock.now_ns() - begin_ns) / 1e9


def test_an_answer_is_taken_as_it_comes(line, exchange):
    """The question leaves whole; its answer is flown."""
    line.controls(4000, after_s=0.3)
    controls = exchange.ask(4000, b"question")
    assert line.sent == [b"question"]
    assert (controls.t_us, controls.armed) == (4000, True)
    assert line.clock.now_ns() == 300_000_000
    assert exchange.counts == {"asked": 1, "answered": 1}


def test_who_boots_is_waited_for_once_and_then_at_the_pace_of_time(line, exchange):
    """A second for the very first answer, 4 ms for each that follows; nothing is flown."""
    assert [waited_s(line, exchange, 4000 * i) for i in (1, 2, 3)] == pytest.approx(
        [1.0, 0.004, 0.004]
    )
    assert exchange.newest is None
    assert exchange.counts == {"asked": 3, "unanswered": 3}


def test_who_is_disarmed_need_not_answer_everything(line, exchange):
    """Its clock goes on meanwhile."""
    line.controls(4000, armed=False)
    exchange.ask(4000, b"q")
    assert waited_s(line, exchange, 8000) == pytest.approx(0.004)
    assert not exchange.armed


def test_who_flies_is_waited_for_longer(line, exchange):
    """And what was flown goes on being flown, once the time is up."""
    fly_up(line, exchange)
    assert waited_s(line, exchange, 8000) == pytest.approx(0.5)
    assert exchange.newest.t_us == 4000
    assert exchange.counts["unanswered"] == 1


def test_an_answer_that_comes_too_late_is_flown_until_there_is_a_better_one(line, exchange):
    """It tells that PX4 lives, and what it wants; but the next question still wants its own."""
    line.controls(4000, armed=False)
    exchange.ask(4000, b"q")
    line.controls(8000, armed=True, after_s=0.006)
    assert exchange.ask(8000, b"q").t_us == 4000
    late = exchange.ask(12_000, b"q")
    assert (late.t_us, exchange.armed) == (8000, True)
    line.controls(16_000)
    assert exchange.ask(16_000, b"q").t_us == 16_000
    assert exchange.counts == {"asked": 4, "answered": 2, "unanswered": 2, "late": 1}


def test_wrong_stamps_are_no_answers(line, exchange):
    """Older than what is flown, yet to come, or a second one: counted, and not flown."""
    fly_up(line, exchange)
    for t_us in (3000, 4000, 9000, 8000, 8000):
        line.controls(t_us)
    assert exchange.ask(8000, b"q").t_us == 8000
    line.controls(12_000)
    assert exchange.ask(12_000, b"q").t_us == 12_000
    assert exchange.counts["stale"] == 3  # the second 8000 is old by then
    assert exchange.counts["ahead"] == 1


def test_two_answers_at_once_are_one(line, exchange):
    """The first of them."""
    one, two = (
        mav.MAVLink_hil_actuator_controls_message(4000, [u] * 16, 128, 1) for u in (0.25, 0.75)
    )
    line.say(one, two)
    assert exchange.ask(4000, b"q").motors[0] == 0.25
    assert exchange.counts["again"] == 1


def test_who_hangs_in_flight_is_lost_with_words(line, exchange):
    """After two seconds of silence, in steps of half a second."""
    fly_up(line, exchange)
    with pytest.raises(HilError, match=r"no answer to HIL_SENSOR for 2\.0 s; it flew until then"):
        ask_on(line, exchange, 2)
    assert exchange.counts["unanswered"] == 4


def test_who_never_flies_is_lost_with_words(line, exchange):
    """Where to look is said."""
    with pytest.raises(HilError, match=r"3\.0 s; it never sent .*PWM_MAIN_FUNC1 to 4"):
        ask_on(line, exchange)


def test_who_goes_silent_on_the_ground_is_lost_with_words(line, exchange):
    """Disarmed silence is allowed for longer."""
    line.controls(4000, armed=False)
    with pytest.raises(HilError, match="it was disarmed: does it still run"):
        ask_on(line, exchange)
    assert line.clock.now_ns() >= 3_000_000_000


def test_a_clock_of_its_own_is_named(line, exchange):
    """Answers whose stamps never fit."""
    with pytest.raises(HilError, match="0 controls carried old stamps and .* that are yet to come"):
        ask_on(line, exchange, stamp_off_us=10**9)


def test_a_px4_without_lockstep_is_named(line, exchange):
    """It would not wait for us."""
    line.controls(4000, flags=0)
    with pytest.raises(HilError, match="built without lockstep"):
        exchange.ask(4000, b"q")


def test_who_talks_without_answering_is_not_listened_to_for_ever(line, exchange):
    """Heartbeats are no answers, however many."""
    fly_up(line, exchange)
    for i in range(2000):
        line.say(mav.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3), after_s=0.001 * (i + 1))
    begin_ns = line.clock.now_ns()
    exchange.ask(8000, b"q")
    assert 0.5e9 <= line.clock.now_ns() - begin_ns <= 1.1e9


def test_a_flood_is_an_end(line, exchange):
    """So many bytes in place of one answer are no PX4's."""
    beat = mav.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3)
    for _ in range(MAX_ANSWER_BYTES // 2000):
        line.say(*[beat] * 200, after_s=0.0)
    with pytest.raises(HilError, match="came in place of one answer"):
        exchange.ask(4000, b"q")


def test_wishes_are_kept_for_whoever_heeds_them(line, exchange):
    """Those since the last question."""
    line.say(mav.MAVLink_command_long_message(0, 0, 511, 0, 115, 5000, 0, 0, 0, 0, 0))
    line.controls(4000)
    exchange.ask(4000, b"q")
    assert exchange.wishes == [Interval(115, 5000.0)]
    line.controls(8000)
    exchange.ask(8000, b"q")
    assert exchange.wishes == []


def test_who_goes_is_gone(line, exchange):
    """What the line says comes through."""
    line.gone = True
    with pytest.raises(PeerGoneError, match="closed the connection"):
        exchange.ask(4000, b"q")


def test_waits_have_bounds():
    """A wait without end is none."""
    with pytest.raises(ValueError, match="hung_s"):
        Patience(hung_s=float("inf"))
