"""Two simulated clocks and a bad link between them: the true offset is within the bound, always."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from drone_client.clock_offset import (
    MAX_SKEW_PPM,
    SKEW_BUCKETS,
    ClockOffset,
    Echo,
    Taken,
    envelope_slope,
    lower_hull,
    one_way,
)

S = 1_000_000_000
MS = 1_000_000
HOUR_NS = 3600 * S
PERIOD_NS = 66_666_667


@dataclass
class Pair:
    """A worker's clock against the drone's, and the way between them."""

    offset_ns: int
    skew_ppm: float
    base_ns: tuple[int, int]
    """Least delay up and down."""
    jitter_ns: int
    loss: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)

    def worker_ns(self, t_ns: int) -> int:
        return t_ns + self.theta_ns(t_ns)

    def theta_ns(self, t_ns: int) -> int:
        return self.offset_ns + math.floor(self.skew_ppm * t_ns / 1_000_000)

    def echo(self, t1_ns: int) -> tuple[Echo, int, int] | None:
        """An echo with the true d1 and d2, unless it is lost."""
        if self.random.random() < self.loss:
            return None
        up, down = (b + self._queue() for b in self.base_ns)
        held = self.random.randrange(0, 200_000)
        t2, t3 = self.worker_ns(t1_ns + up), self.worker_ns(t1_ns + up + held)
        return Echo(t1_ns, t2, t3, t1_ns + up + held + down, worker_boot_id=7), up, down

    def _queue(self) -> int:
        return int(self.random.expovariate(1.0) * self.jitter_ns)

    def run(self, clock: ClockOffset, begin_ns: int, end_ns: int):
        """Feed echoes; yields each with the true delays."""
        for t1_ns in range(begin_ns, end_ns, PERIOD_NS):
            if (got := self.echo(t1_ns)) is not None:
                assert clock.add(got[0]) in (Taken.FIRST, Taken.USED, Taken.STEP)
                yield got


pairs = st.builds(
    Pair,
    offset_ns=st.integers(-HOUR_NS, HOUR_NS),
    skew_ppm=st.floats(-200, 200),
    base_ns=st.tuples(st.integers(20_000, 60 * MS), st.integers(20_000, 60 * MS)),
    jitter_ns=st.integers(0, 40 * MS),
    loss=st.floats(0, 0.6),
    seed=st.integers(0, 2**32),
)


def assert_within(clock: ClockOffset, pair: Pair, now_ns: int) -> None:
    estimate = clock.estimate(now_ns)
    assert abs(estimate.offset_ns - pair.theta_ns(now_ns)) <= estimate.bound_ns


@given(pairs, st.integers(0, 3 * HOUR_NS), st.integers(0, 100 * S))
def test_the_true_offset_is_within_the_bound(pair, begin_ns, silence_ns):
    """After every echo, and however long nothing has come since."""
    clock = ClockOffset()
    for echo, _, _ in pair.run(clock, begin_ns, begin_ns + 15 * S):
        assert_within(clock, pair, echo.t4_ns)
        assert_within(clock, pair, echo.t4_ns + silence_ns)
    assert clock.steps == clock.restarts == clock.unused == 0


@given(pairs)
def test_the_bound_is_half_the_least_round_trip_and_the_drift_since(pair):
    """For each echo of the window: no echo makes the bound worse."""
    clock = ClockOffset()
    echoes = []
    for echo, _, _ in pair.run(clock, 0, 7 * S):
        echoes.append(echo)
        now_ns = max(e.t4_ns for e in echoes)
        estimate = clock.estimate(now_ns)
        assert estimate.rtt_min_ns == min(e.rtt_ns for e in echoes) <= estimate.rtt_p50_ns
        for e in echoes:
            drift_ns = ((now_ns - e.t1_ns) + (now_ns - e.t4_ns)) * MAX_SKEW_PPM / 1e6
            assert estimate.bound_ns <= (e.rtt_ns + drift_ns) / 2 + 5


def test_steady_clocks_and_empty_queues_give_half_the_round_trip():
    """20 ms there and back: 10 ms, and what a probe's period may drift."""
    pair = Pair(HOUR_NS, 0.0, (10 * MS, 10 * MS), 0)
    clock = ClockOffset()
    last = list(pair.run(clock, 0, 5 * S))[-1][0]
    estimate = clock.estimate(last.t4_ns)
    assert estimate.rtt_min_ns == estimate.rtt_p50_ns == 20 * MS
    assert 10 * MS <= estimate.bound_ns <= 10 * MS + 15_000
    assert abs(estimate.offset_ns - HOUR_NS) < 20_000


@given(pairs, st.data())
def test_the_two_ways_sum_to_what_is_exact_and_each_is_within_its_bound(pair, data):
    """d1 + d2 to the nanosecond; d1 and d2 apart as well as one can know them."""
    clock = ClockOffset()
    got = list(pair.run(clock, 0, 6 * S))
    if not got:
        return
    echo, up_ns, down_ns = data.draw(st.sampled_from(got))
    estimate = clock.estimate(got[-1][0].t4_ns)
    d1_ns, d2_ns, bound_ns = one_way(echo, estimate)
    assert d1_ns + d2_ns == (echo.t4_ns - echo.t1_ns) - (echo.t3_ns - echo.t2_ns)
    assert abs(d1_ns - up_ns) <= bound_ns
    assert abs(d2_ns - down_ns) <= bound_ns


stamps = st.integers(0, 2**63 - 1)


@given(stamps, stamps, stamps, stamps, st.integers(-(2**63), 2**63))
def test_the_sum_of_the_two_ways_knows_no_offset(t1, t2, t3, t4, offset_ns):
    """Whatever the stamps and the estimate are."""
    clock = ClockOffset()
    clock.add(Echo(0, offset_ns, offset_ns, 2 * MS))
    d1_ns, d2_ns, _ = one_way(Echo(t1, t2, t3, t4), clock.estimate(S))
    assert d1_ns + d2_ns == (t4 - t1) - (t3 - t2)


@settings(max_examples=15)
@given(
    skew_ppm=st.floats(-200, 200),
    base_ns=st.tuples(st.integers(20_000, 60 * MS), st.integers(20_000, 60 * MS)),
    jitter_ns=st.integers(0, 5 * MS),
    loss=st.floats(0, 0.3),
    seed=st.integers(0, 2**32),
)
def test_skew_after_two_minutes(skew_ppm, base_ns, jitter_ns, loss, seed):
    """Within its hard bound always, and far better than that where queues are empty at times."""
    pair = Pair(-HOUR_NS, skew_ppm, base_ns, jitter_ns, loss, seed)
    clock = ClockOffset()
    for echo, _, _ in pair.run(clock, 0, 120 * S):
        estimate = clock.estimate(echo.t4_ns)
        if estimate.skew_ppm is not None:
            # A point of an envelope is at most a whole nanosecond and 0.05 % of a delay off
            slack_ppm = 0.1
            assert abs(estimate.skew_ppm - skew_ppm) <= estimate.skew_bound_ppm + slack_ppm
    # The least of 15 queueing delays is jitter / 15 on average, and the line is 2 minutes long
    assert abs(estimate.skew_ppm - skew_ppm) <= 0.5 + jitter_ns / MS
    assert clock.steps == 0


@given(pairs, st.sampled_from([-1, 1]), st.integers(0, HOUR_NS))
def test_a_step_of_the_workers_clock_is_seen_at_the_first_echo(pair, sign, more_ns):
    """A step past the bound and the echo's own round trip cannot hide."""
    clock = ClockOffset()
    pair.loss = 0.0
    before = list(pair.run(clock, 0, 3 * S))
    echo, _, _ = pair.echo(before[-1][0].t4_ns + PERIOD_NS)
    step_ns = 2 * clock.estimate(echo.t4_ns).bound_ns + echo.rtt_ns + MS + more_ns
    pair.offset_ns += sign * step_ns
    shifted = Echo(
        echo.t1_ns, echo.t2_ns + sign * step_ns, echo.t3_ns + sign * step_ns, echo.t4_ns, 7
    )
    assert clock.add(shifted) is Taken.STEP
    assert clock.steps == 1
    assert_within(clock, pair, echo.t4_ns)
    for later, _, _ in pair.run(clock, echo.t4_ns, echo.t4_ns + 3 * S):
        assert_within(clock, pair, later.t4_ns)
    assert clock.steps == 1


def test_a_step_too_small_to_see_is_forgotten_with_the_window():
    """Within the bound and a round trip it contradicts nothing; 10 s later nothing old is left."""
    pair = Pair(0, 0.0, (10 * MS, 10 * MS), 0)
    clock = ClockOffset()
    list(pair.run(clock, 0, 5 * S))
    pair.offset_ns += 18 * MS
    last = list(pair.run(clock, 5 * S, 17 * S))[-1][0]
    assert clock.steps == 0
    assert_within(clock, pair, last.t4_ns)
    assert abs(clock.estimate(last.t4_ns).offset_ns - 18 * MS) < 100_000


def test_a_longer_route_is_the_least_round_trip_after_the_window():
    """Nothing old stands for what the network is like now."""
    pair = Pair(0, 0.0, (5 * MS, 5 * MS), 0)
    clock = ClockOffset()
    list(pair.run(clock, 0, 5 * S))
    pair.base_ns = (20 * MS, 20 * MS)
    last = list(pair.run(clock, 5 * S, 17 * S))[-1][0]
    assert clock.estimate(last.t4_ns).rtt_min_ns == 40 * MS


@pytest.mark.parametrize("theta_ns", [-0.9, -0.1, 0.1, 0.9])
def test_whole_nanoseconds_are_part_of_the_bound(theta_ns):
    """Clocks are read rounded down; with no delay at all that is what is left."""
    clock = ClockOffset()
    read_ns = math.floor(1000 + theta_ns)
    clock.add(Echo(1000, read_ns, read_ns, 1000))
    estimate = clock.estimate(1000)
    assert abs(estimate.offset_ns - theta_ns) <= estimate.bound_ns <= 2


def test_a_restart_of_the_worker_starts_afresh():
    """Another boot_id is another clock; what the old start still sends is not used."""
    clock = ClockOffset()
    assert clock.add(Echo(0, 5 * S, 5 * S, 2 * MS, worker_boot_id=1)) is Taken.FIRST
    assert clock.add(Echo(S, 9 * S, 9 * S, S + 8 * MS, worker_boot_id=2)) is Taken.RESTART
    assert clock.add(Echo(S, 6 * S, 6 * S, S + 2 * MS, worker_boot_id=1)) is Taken.OLD_START
    estimate = clock.estimate(S + 8 * MS)
    assert estimate.rtt_min_ns == 8 * MS
    assert abs(estimate.offset_ns - 8 * S) <= estimate.bound_ns
    assert (clock.restarts, clock.steps, clock.unused) == (1, 0, 1)


@pytest.mark.parametrize(
    "echo",
    [Echo(10, 5, 5, 9), Echo(0, 6, 5, 10), Echo(0, 5, 20, 10)],
    ids=["back before sent", "sent back before received", "held longer than away"],
)
def test_impossible_stamps_are_counted(echo):
    """They change nothing."""
    clock = ClockOffset()
    assert clock.add(echo) is Taken.IMPOSSIBLE
    assert clock.unused == 1
    assert clock.estimate(10) is None


def test_a_change_of_rate_is_no_step_and_the_skew_follows():
    """A clock slewed by 300 ppm from some time on: the bound holds, the skew comes after."""
    pair = Pair(0, 0.0, (MS, MS), 0)
    clock = ClockOffset()
    list(pair.run(clock, 0, 60 * S))
    pair.skew_ppm = 300.0
    pair.offset_ns -= pair.theta_ns(60 * S)  # no step where the rate changes
    for echo, _, _ in pair.run(clock, 60 * S, 90 * S):
        assert_within(clock, pair, echo.t4_ns)
    assert clock.steps == 0
    assert abs(clock.estimate(90 * S).skew_ppm - 300) < 5


def test_memory_is_bounded():
    """An hour of probes leaves as much as two minutes."""
    pair = Pair(0, 10.0, (MS, MS), MS)
    clock = ClockOffset()
    for _ in pair.run(clock, 0, 600 * S):
        pass
    assert len(clock._buckets) == SKEW_BUCKETS


points = st.lists(
    st.tuples(st.integers(0, 10**6), st.integers(0, 10**6)),
    min_size=3,
    max_size=40,
    unique_by=lambda p: p[0],
)


@given(points)
def test_no_point_is_below_the_hull(points):
    """And its corners are points."""
    hull = lower_hull(points)
    assert set(hull) <= set(points)
    x, y = np.array(sorted(points), float).T
    assert (np.interp(x, *np.array(hull, float).T) <= y + 1e-6).all()


@given(points)
def test_the_envelope_is_the_one_of_the_linear_programme(points):
    """Least sum of distances to a line below all points, as scipy's HiGHS finds it."""
    t, value = np.array(points, float).T / 1e6
    slope = envelope_slope(points)
    solution = linprog(
        c=[-len(t), -t.sum()],
        A_ub=np.column_stack([np.ones_like(t), t]),
        b_ub=value,
        bounds=[(None, None)] * 2,
    )
    assert solution.success
    line = (value - slope * t).min() + slope * t
    # Several lines may be best when the mean lies right above a corner: compare what they cost.
    assert (value - line).sum() == pytest.approx(
        (value - solution.x[0] - solution.x[1] * t).sum(), abs=1e-6
    )
