"""A camera's stamps on the drone's clock: within the stated bound, never after the arrival."""

from __future__ import annotations

import random
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from drone_client.source.clock_map import DRIFT, WINDOW_S, ClockMap
from tests.unit.drone_client.builders import MS, SECOND

PERIOD_NS = 33_333_333
WRAP_NS = (1 << 32) * 1000
LEAST_WAY_NS = 4 * MS


class Device:
    """A camera with its own crystal: true times to 32-bit microseconds."""

    def __init__(self, zero_ns: int, drift: float) -> None:
        self.zero_ns = zero_ns
        self.drift = drift

    def ticks(self, t_true_ns: int) -> int:
        """The counter at a time of the drone's clock."""
        return int((self.zero_ns + t_true_ns * (1 + self.drift)) // 1000) % (1 << 32)


def arrivals(seed: int, count: int, start_ns: int, most_ns: int = 60 * MS):
    """True times and arrivals: a least way, a long tail, in order."""
    rng = random.Random(seed)
    last = 0
    for n in range(count):
        true_ns = start_ns + n * PERIOD_NS
        way_ns = LEAST_WAY_NS + min(most_ns, int(rng.expovariate(1 / (3 * MS))))
        last = max(last, true_ns + way_ns)
        yield true_ns, last


@given(
    st.integers(0, 1 << 32),
    st.floats(-0.95 * DRIFT, 0.95 * DRIFT),
    st.integers(0, WRAP_NS),
    st.integers(0, 10**16),
)
def test_the_error_stays_within_the_stated_bound(seed, drift, zero_ns, start_ns):
    """Any zero, so with the wrap somewhere; any drift that is allowed; 12 s of jittered frames."""
    clock, device = ClockMap(), Device(zero_ns, drift)
    window: list[tuple[int, int]] = []  # way and arrival of each picture
    for true_ns, arrival_ns in arrivals(seed, 360, start_ns):
        seen = clock.see(device.ticks(true_ns), arrival_ns)
        assert not seen.odd
        assert not seen.jumped
        mapped_ns = clock.drone_from_device_ns(seen.t_device_ns, arrival_ns)
        assert mapped_ns <= arrival_ns
        window.append((arrival_ns - true_ns, arrival_ns))
        inside = [w for w in window if arrival_ns - w[1] < WINDOW_S * SECOND]
        bound_ns = sorted(way + 2 * DRIFT * (arrival_ns - t) for way, t in inside)[:2][-1]
        # A tick of the counter, and what the clocks drift apart while a picture is on its way
        slack_ns = 2_000 + 2 * DRIFT * 70 * MS
        assert mapped_ns - true_ns <= bound_ns + slack_ns
        assert mapped_ns - true_ns >= LEAST_WAY_NS - slack_ns


def test_a_steady_camera_is_known_to_a_fraction_of_a_millisecond():
    """A minute at 30 Hz with a mean jitter of 3 ms and 50 ppm: half a millisecond, past 1 s."""
    clock, device = ClockMap(), Device(123_456_789_000, 50e-6)
    errors = []
    for true_ns, arrival_ns in arrivals(7, 1800, 5 * SECOND):
        seen = clock.see(device.ticks(true_ns), arrival_ns)
        mapped_ns = clock.drone_from_device_ns(seen.t_device_ns, arrival_ns)
        errors.append(mapped_ns - true_ns - LEAST_WAY_NS)
    assert max(errors[30:]) < 0.5 * MS
    assert min(errors) > -0.01 * MS


def test_the_wrap_is_no_jump():
    """71.6 minutes after the counter's zero, and in a pause that is longer than that."""
    clock, device = ClockMap(), Device(WRAP_NS - SECOND, 0)
    times = [n * PERIOD_NS for n in range(90)]
    times += [times[-1] + 2 * WRAP_NS + n * PERIOD_NS for n in range(30)]
    seen = [clock.see(device.ticks(t), t + LEAST_WAY_NS) for t in times]
    assert not any(s.jumped or s.odd for s in seen)
    for (s0, s1), (t0, t1) in zip(pairwise(seen), pairwise(times), strict=True):
        assert abs((s1.t_device_ns - s0.t_device_ns) - (t1 - t0)) <= 2000


def fed(clock: ClockMap, device: Device, first_ns: int, count: int):
    """Pictures that come by their least way: the stamps as understood, and the last mapped time."""
    seen, mapped = [], 0
    for n in range(count):
        true_ns = first_ns + n * PERIOD_NS
        arrival_ns = true_ns + LEAST_WAY_NS
        seen.append(clock.see(device.ticks(true_ns), arrival_ns))
        mapped = clock.drone_from_device_ns(seen[-1].t_device_ns, arrival_ns) - true_ns
    return seen, mapped


def test_a_restarted_counter_is_a_jump_after_a_second_of_silence():
    """Zero again in mid-flight: pictures are refused while it is not clear what happened."""
    clock = ClockMap()
    fed(clock, Device(3000 * SECOND, 0), 0, 90)
    seen, mapped = fed(clock, Device(0, 0), 4 * SECOND, 90)
    jump = next(n for n, s in enumerate(seen) if s.jumped)
    assert all(s.odd for s in seen[:jump])
    assert jump * PERIOD_NS >= SECOND > (jump - 2) * PERIOD_NS
    assert not any(s.odd or s.jumped for s in seen[jump + 1 :])
    assert (clock.jumps, clock.odd) == (1, jump)
    assert abs(mapped - LEAST_WAY_NS) < 2_000


def test_after_a_reset_any_zero_is_taken_at_once():
    """The source knows that it opened the device anew."""
    clock = ClockMap()
    fed(clock, Device(3000 * SECOND, 0), 0, 90)
    clock.reset()
    seen, mapped = fed(clock, Device(0, 0), 4 * SECOND, 2)
    assert not any(s.odd or s.jumped for s in seen)
    assert abs(mapped - LEAST_WAY_NS) < 2_000


def test_a_process_that_hung_takes_no_old_picture_for_a_fresh_one():
    """3 s in which nobody took pictures out of the driver: the old ones are odd, no new zero."""
    clock, device = ClockMap(), Device(0, 0)
    fed(clock, device, 0, 90)
    hung_ns = 3 * SECOND
    for n in range(16):  # what the driver held, all at once
        seen = clock.see(device.ticks(hung_ns + n * PERIOD_NS), hung_ns + 3 * SECOND + n * MS)
        assert seen.odd
    seen, mapped = fed(clock, device, hung_ns + 3 * SECOND + 20 * MS, 30)
    assert not any(s.odd or s.jumped for s in seen)
    assert clock.jumps == 0
    assert abs(mapped - LEAST_WAY_NS) < 2_000


@given(st.integers(-(1 << 31), 1 << 31))
def test_one_absurd_stamp_bends_nothing(off_ticks):
    """Whatever a single stamp says, the others are mapped as without it."""
    clock, device = ClockMap(), Device(100 * SECOND, 0)
    fed(clock, device, 0, 30)
    now_ns = 30 * PERIOD_NS
    stamp = (device.ticks(now_ns) + off_ticks) % (1 << 32)
    absurd = clock.see(stamp, now_ns + LEAST_WAY_NS)
    mapped = clock.drone_from_device_ns(absurd.t_device_ns, now_ns + LEAST_WAY_NS)
    assert absurd.odd or mapped <= now_ns + LEAST_WAY_NS
    seen, mapped = fed(clock, device, now_ns + PERIOD_NS, 60)
    assert not any(s.odd or s.jumped for s in seen)
    assert abs(mapped - LEAST_WAY_NS) <= 2 * DRIFT * 4 * SECOND + 2_000


def test_both_ways_between_the_clocks():
    """And before the first stamp nothing is known but the arrival."""
    clock = ClockMap()
    assert clock.device_from_drone_ns(5) is None
    assert clock.drone_from_device_ns(7, 5) == 5
    fed(clock, Device(100 * SECOND, 0), 0, 30)
    assert clock.device_from_drone_ns(29 * PERIOD_NS + LEAST_WAY_NS) is not None
    back = clock.device_from_drone_ns(SECOND)
    assert clock.drone_from_device_ns(back, SECOND) == SECOND


def test_a_wall_clock_that_is_set_back_is_a_jump():
    """Without metadata the driver stamps by the host's wall clock: nanoseconds, no wrap."""
    clock = ClockMap(tick_ns=1, wrap_bits=None)
    epoch_ns = 1_700_000_000 * SECOND
    for n in range(150):
        true_ns = n * PERIOD_NS
        stamp = epoch_ns + true_ns - (7200 * SECOND if n >= 50 else 0)
        seen = clock.see(stamp, true_ns + LEAST_WAY_NS)
    assert clock.jumps == 1
    assert clock.drone_from_device_ns(seen.t_device_ns, true_ns + 9 * MS) - true_ns <= 9 * MS
