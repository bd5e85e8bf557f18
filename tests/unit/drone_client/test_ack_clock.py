"""The ack clock: never more frames in the network than the window."""

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from drone_client.ack_clock import AckClock

TIMEOUT_NS = 500


class AckClockMachine(RuleBasedStateMachine):
    """Any order of sends, releases and time-outs, beside a plain dict that says what must be."""

    @initialize(window=st.integers(1, 16))
    def start(self, window):
        self.window = window
        self.clock = AckClock(window, TIMEOUT_NS)
        self.in_flight: dict[int, int] = {}
        self.now_ns = 0
        self.sequence = 0

    @rule()
    def send(self):
        if len(self.in_flight) < self.window:
            self.clock.send(self.sequence, self.now_ns)
            self.in_flight[self.sequence] = self.now_ns
        else:
            with pytest.raises(ValueError, match="full"):
                self.clock.send(self.sequence, self.now_ns)
        self.sequence += 1

    @rule(back=st.integers(-1, 20))
    def release(self, back):
        sequence = self.sequence - back
        held = self.in_flight.pop(sequence, None) is not None
        assert self.clock.release(sequence) is held

    @rule(step_ns=st.integers(0, TIMEOUT_NS + 100))
    def expire(self, step_ns):
        self.now_ns += step_ns
        late = {s for s, t in self.in_flight.items() if self.now_ns - t >= TIMEOUT_NS}
        assert set(self.clock.expire(self.now_ns)) == late
        for sequence in late:
            del self.in_flight[sequence]

    @invariant()
    def never_more_than_the_window(self):
        assert self.clock.in_flight == len(self.in_flight) <= self.window
        assert self.clock.has_room() is (len(self.in_flight) < self.window)


TestAckClock = AckClockMachine.TestCase
TestAckClock.settings = settings(max_examples=30)


def test_a_slot_is_freed_by_force_exactly_at_the_timeout():
    """One nanosecond before it is held, at the time-out it is free."""
    clock = AckClock(1, TIMEOUT_NS)
    clock.send(3, 100)
    assert clock.expire(100 + TIMEOUT_NS - 1) == ()
    assert not clock.has_room()
    assert clock.expire(100 + TIMEOUT_NS) == (3,)
    assert clock.has_room()


def test_an_ack_that_comes_too_late_frees_nothing():
    """A frame whose slot was freed by force holds none, and a repeated ack neither."""
    clock = AckClock(2, TIMEOUT_NS)
    clock.send(1, 0)
    clock.expire(TIMEOUT_NS)
    clock.send(2, TIMEOUT_NS)
    assert not clock.release(1)
    assert clock.release(2)
    assert not clock.release(2)


@pytest.mark.parametrize(("window", "timeout_ns"), [(0, 1), (17, 1), (1, 0), (1, -5)])
def test_a_window_or_timeout_that_makes_no_sense_is_refused(window, timeout_ns):
    """A window holds 1 to 16 frames, a time-out is positive."""
    with pytest.raises(ValueError, match="1 to 16|positive"):
        AckClock(window, timeout_ns)
