"""Parity, pacing, and two ends of a session over a path of the test's own, in simulated time."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rgbd_wire.tunnel.bucket import Bucket
from rgbd_wire.tunnel.channel import Channel, Side
from rgbd_wire.tunnel.errors import Counters
from rgbd_wire.tunnel.handshake import SessionKeys
from rgbd_wire.tunnel.pacing import MAX_BPS, PACKET_BYTES, START_BPS, Pacer
from rgbd_wire.tunnel.parity import ParityControl
from rgbd_wire.tunnel.seal import Cipher, DirectionKey

MS = 1_000_000
S = 1000 * MS
KEYS = SessionKeys(
    7,
    Cipher.AES_256_GCM,
    DirectionKey(b"a" * 32, b"up up u"),
    DirectionKey(b"b" * 32, b"down do"),
)


def test_parity_follows_the_losses() -> None:
    """10 % before anything is known, 5 % without loss, none on a full link, 25 % at most."""
    control = ParityControl()
    assert control.symbols(52, crowded=False) == 6
    for _ in range(64):
        control.on_report(55, 0)
    assert not control.lossy
    assert control.symbols(52, crowded=False) == 3
    assert control.symbols(87, crowded=True) == 0
    for _ in range(4):
        control.on_report(50, 5)
    assert 6 <= control.symbols(52, crowded=False) <= 8
    for _ in range(4):
        control.on_report(20, 40)
    assert control.symbols(52, crowded=False) == 13
    assert control.symbols(52, crowded=True) == 6
    for _ in range(64):
        control.on_report(55, 0)
    assert control.symbols(52, crowded=False) == 3


@given(
    st.lists(st.tuples(st.integers(0, 99), st.integers(0, 99)), max_size=80),
    st.integers(2, 7233),
    st.booleans(),
)
def test_parity_stays_within_its_bounds(
    reports: list[tuple[int, int]], symbols: int, crowded: bool
) -> None:
    """Whatever is reported: 0 to 25 %, and what fits its byte."""
    control = ParityControl()
    for received, lost in reports:
        control.on_report(received, lost)
    assert 0 <= control.symbols(symbols, crowded=crowded) <= min(255, symbols // 4 + 1)


def test_the_pacer_takes_on_the_rate_of_the_path() -> None:
    """Trains that arrive at 20 Mbit/s make it send at 25; one that came in a lump does not."""
    pacer = Pacer(0)
    assert pacer.rate_bps == START_BPS
    for _ in range(10):
        pacer.on_report(87, 100_000, 40_000)
    pacer.on_report(87, 100_000, 10)
    pacer.on_report(87, 0, 0)
    assert pacer.goodput_bps == 20e6
    assert pacer.rate_bps == 25e6


def test_the_pacer_opens_up_where_nothing_holds_it() -> None:
    """On loopback every train comes in one batch: soon whole frames leave at once."""
    pacer = Pacer(0)
    for _ in range(40):
        pacer.on_report(52, 1228, 400)
    assert pacer.rate_bps == MAX_BPS
    assert pacer.packets(S) >= 64


@given(st.lists(st.tuples(st.integers(1, 64), st.integers(0, 2 * MS)), min_size=1))
def test_the_pacer_never_exceeds_its_rate(steps: list[tuple[int, int]]) -> None:
    """Over any time no more leaves than the rate allows and one burst."""
    pacer, now_ns, sent = Pacer(0), 0, 0
    for wanted, step_ns in steps:
        now_ns += step_ns
        count = min(wanted, pacer.packets(now_ns))
        pacer.spend(count)
        sent += count * PACKET_BYTES
        assert sent <= pacer.depth + now_ns * START_BPS / 8e9 + 1
        ready_ns = pacer.ready_ns(wanted)
        if ready_ns > now_ns:
            assert ready_ns - now_ns < 10 * MS


def test_a_full_path_is_noticed() -> None:
    """100 kB every 43 ms into 20 Mbit/s is nearly all it carries; every 100 ms is not."""
    for every_ms, crowded in ((43, True), (100, False)):
        pacer = Pacer(0)
        for i in range(40):
            pacer.on_report(87, 100_000, 40_000)
            pacer.on_message(87, i * every_ms * MS)
        assert pacer.crowded == crowded


@given(st.lists(st.integers(0, S), max_size=100))
def test_a_bucket_gives_its_rate_and_one_burst(steps: list[int]) -> None:
    """Never more than the burst and what came in since."""
    bucket, now_ns, taken = Bucket(10.0, 5, 0), 0, 0
    for step_ns in steps:
        now_ns += step_ns
        taken += bucket.take(now_ns)
        assert taken <= 5 + now_ns * 10 / S + 1e-6


class Path:
    """Two channels, and between them a delay, a rate and losses, in simulated time."""

    def __init__(
        self,
        lost: Callable[[], bool],
        one_way_ns: int = 10 * MS,
        rate_bps: float = 50e6,
        late_ns: int = 0,
    ) -> None:
        self.now_ns = 0
        self.late_ns = late_ns
        self.queue_ns = 0
        self.counters = Counters()
        self.arrived: dict[bytes, int] = {}
        self._lost, self._one_way_ns, self.rate_bps = lost, one_way_ns, rate_bps
        self._free_ns = [0, 0]
        self._flying: list[tuple[int, int, int, bytes]] = []
        self._order = itertools.count()
        self._pump_ns: list[int | None] = [None, None]
        self.drone, self.worker = self.ends = [
            Channel(KEYS, side, self._sender(i), self.counters, 0)
            for i, side in enumerate((Side.DRONE, Side.WORKER))
        ]

    def _sender(self, end: int) -> Callable[[Sequence[bytes]], int]:
        def send(datagrams: Sequence[bytes]) -> int:
            for datagram in datagrams:
                start_ns = max(self.now_ns, self._free_ns[end])
                self._free_ns[end] = start_ns + int((len(datagram) + 28) * 8e9 / self.rate_bps)
                self.queue_ns = max(self.queue_ns, self._free_ns[end] - self.now_ns)
                if not self._lost():
                    there_ns = self._free_ns[end] + self._one_way_ns
                    entry = (there_ns, next(self._order), 1 - end, datagram)
                    heapq.heappush(self._flying, entry)
            return len(datagrams)

        return send

    def send(self, message: bytes, budget_ns: int = 100 * MS) -> None:
        self._pump_at(0, self.drone.send(message, budget_ns, self.now_ns))

    def _pump_at(self, end: int, due_ns: int | None) -> None:
        self._pump_ns[end] = None if due_ns is None else due_ns + self.late_ns

    def urgent(self, end: int, message: bytes) -> None:
        self._pump_at(end, self.ends[end].send_urgent(message, 100 * MS, self.now_ns))

    def run_until(self, end_ns: int) -> None:
        while True:
            ticks = [end.tick(self.now_ns) for end in self.ends]
            times = [t for t in [*self._pump_ns, *ticks] if t is not None]
            if self._flying:
                times.append(self._flying[0][0])
            next_ns = max(self.now_ns + 1000, min(times, default=end_ns))
            if next_ns >= end_ns:
                self.now_ns = end_ns
                return
            self.now_ns = next_ns
            while self._flying and self._flying[0][0] <= self.now_ns:
                _, _, end, datagram = heapq.heappop(self._flying)
                view = memoryview(datagram)
                for message in self.ends[end].receive(view, len(view), self.now_ns):
                    assert message not in self.arrived
                    self.arrived[message] = self.now_ns
                self.ends[end].settle(self.now_ns)
            for i, due_ns in enumerate(self._pump_ns):
                if due_ns is not None and due_ns <= self.now_ns:
                    self._pump_at(i, self.ends[i].pump(self.now_ns))


def delays(path: Path, frames: int, length: int = 60_000, every_ns: int = 33 * MS) -> list[float]:
    """Delay [ms] of each frame, infinite for one that was lost; signs of life as in flight."""
    rng = random.Random(path.now_ns)
    sent = []
    for i in range(frames):
        if i % 8 == 0:
            path.drone.ping(path.now_ns)
        sent.append((rng.randbytes(length), path.now_ns))
        path.send(sent[-1][0])
        path.run_until(path.now_ns + every_ns)
    path.run_until(path.now_ns + 200 * MS)
    return [(path.arrived.get(m, 10**15) - t) / MS for m, t in sent]


def never() -> bool:
    return False


def losses(share: float, burst: int = 1, seed: int = 1) -> Callable[[], bool]:
    """Losses in runs that are ``burst`` long on average."""
    rng, bad = random.Random(seed), [False]

    def lost() -> bool:
        leave = 1 / burst
        enter = leave * share / (1 - share)
        bad[0] = rng.random() < ((1 - leave) if bad[0] else enter)
        return bad[0]

    return lost


def share_within(times: list[float], limit_ms: float) -> float:
    return sum(t <= limit_ms for t in times) / len(times)


def test_without_loss_a_frame_takes_its_serialisation_and_the_delay() -> None:
    """60 kB over 50 Mbit/s and 10 ms: 10.2 ms and 10 ms, and nothing is refused."""
    path = Path(never)
    times = delays(path, 60)
    assert max(times) < 22
    assert not any(path.counters.snapshot().values())
    state = path.drone.state()
    assert 45e6 < state.goodput_bps < 52e6
    assert state.loss == 0
    assert 19 * MS < state.srtt_ns < 33 * MS


def test_one_percent_of_loss_costs_no_round_trip() -> None:
    """99 % of the frames arrive within 1.5 times the time without loss."""
    clean = max(delays(Path(never), 60))
    times = delays(Path(losses(0.01)), 400)
    assert share_within(times, 1.5 * clean) >= 0.99


def test_bursts_are_asked_for_again() -> None:
    """3 % in bursts of 4: 97 % within 50 ms."""
    times = delays(Path(losses(0.03, burst=4)), 400)
    assert share_within(times, 50) >= 0.97


LATE_MS = (0.1, 1, 5, 10)


@pytest.mark.parametrize("late_ms", LATE_MS)
@pytest.mark.parametrize("one_way_ms", [0.1, 5, 100])
def test_a_sender_that_comes_late_finds_a_fast_path(late_ms: float, one_way_ms: float) -> None:
    """It wakes late each time: within a second a frame leaves at once, or at its second waking."""
    path = Path(never, int(one_way_ms * MS), rate_bps=10e9, late_ns=int(late_ms * MS))
    times = delays(path, 60, length=70_000)
    assert max(times[30:]) < one_way_ms + late_ms + 5
    assert path.drone.state().goodput_bps > 300e6


@pytest.mark.parametrize("late_ms", LATE_MS)
@pytest.mark.parametrize("rate_bps", [2e6, 8e6, 20e6, 50e6, 200e6])
def test_a_sender_that_comes_late_floods_no_slow_path(late_ms: float, rate_bps: float) -> None:
    """As fast frames as the path takes: the rate is found, and of a frame little queues."""
    length = 60_000 if rate_bps >= 8e6 else 20_000
    takes_ms = length * 8e3 / rate_bps
    path = Path(never, 5 * MS, rate_bps, int(late_ms * MS))
    every_ns = int(max(33, 1.3 * takes_ms) * MS)
    delays(path, 30, length, every_ns)
    path.queue_ns = 0
    times = delays(path, 60, length, every_ns)
    burst_ms = max(8, late_ms * 1.25 * rate_bps / 8e3 / 1228) * 1228 * 8e3 / rate_bps
    assert path.queue_ns / MS < 0.3 * takes_ms + burst_ms + 5
    assert 0.8 * rate_bps < path.drone.state().goodput_bps < 1.2 * rate_bps
    assert max(times) < 1.1 * takes_ms + 2 * late_ms + 10


@pytest.mark.parametrize("late_ms", LATE_MS)
@pytest.mark.parametrize(("before_bps", "after_bps"), [(10e9, 8e6), (8e6, 10e9)])
def test_a_sender_that_comes_late_follows_the_path(
    late_ms: float, before_bps: float, after_bps: float
) -> None:
    """A path becomes slow, or fast: known after ten frames, or a second."""
    path = Path(never, 5 * MS, before_bps, int(late_ms * MS))
    delays(path, 40, every_ns=80 * MS)
    path.rate_bps = after_bps
    delays(path, 14, every_ns=80 * MS)
    assert path.drone.state().rate_bps < 15e6 or after_bps > 8e6
    times = delays(path, 10, every_ns=80 * MS)
    assert max(times) < 60_000 * 8e3 / after_bps + 15 + late_ms


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.sampled_from([4e6, 20e6, 100e6]))
def test_waking_at_random_floods_nothing(seed: int, rate_bps: float) -> None:
    """However late it comes each time, and whatever is lost: no more queues than half a frame."""
    rng = random.Random(seed)
    path = Path(losses(rng.choice([0, 0.02]), 2, seed), 10 * MS, rate_bps)
    takes_ns = int(60_000 * 8e9 / rate_bps)
    for i in range(50):
        if i == 25:
            path.queue_ns = 0
        path.late_ns = int(rng.choice([0, 0.3, 2, 8, 15, 40]) * MS)
        if i % 8 == 0:
            path.drone.ping(path.now_ns)
        path.send(rng.randbytes(60_000))
        path.run_until(path.now_ns + max(33 * MS, 2 * takes_ns))
    assert path.queue_ns < 0.6 * takes_ns + 45 * MS


def test_a_full_link_is_not_spent_on_parity() -> None:
    """100 kB frames one after the other into 20 Mbit/s: parity goes away."""
    path = Path(never, rate_bps=20e6)
    delays(path, 60, length=100_000, every_ns=43 * MS)
    assert path.drone.state().parity == 0


@pytest.mark.parametrize(("one_way_ns", "parity"), [(200_000, 0), (10 * MS, 3)])
def test_parity_waits_where_a_report_is_quick(one_way_ns: int, parity: int) -> None:
    """On a short way without loss the report comes first, and parity is neither made nor sent."""
    big = [0]

    def count() -> bool:
        big[0] += 1
        return False

    path = Path(count, one_way_ns, rate_bps=1e9)
    delays(path, 100)
    big[0] = 0
    path.send(bytes(60_000))
    path.run_until(path.now_ns + 100 * MS)
    assert big[0] == 52 + parity + 1  # and the report
    assert path.drone.state().parity > 0


def test_a_sender_that_stalls_is_not_asked_twice() -> None:
    """It gets no core for 40 ms: the NACK that this leads to is answered by the rest alone."""
    big = [0]

    def count() -> bool:
        big[0] += 1
        return False

    path = Path(count)
    path.send(random.Random(1).randbytes(60_000))
    path._pump_ns[0] = 40 * MS
    path.run_until(200 * MS)
    assert len(path.arrived) == 1
    nacks = 2
    assert big[0] <= 52 + 6 + nacks + 1  # data, parity, and the report


def test_what_cannot_come_in_time_is_not_sent_again() -> None:
    """A budget shorter than a round trip: the NACK is counted as late."""
    path = Path(losses(0.5))
    for i in range(10):
        path.send(random.Random(i).randbytes(60_000), budget_ns=5 * MS)
        path.run_until(path.now_ns + 100 * MS)
    assert path.counters.snapshot()["late"] > 0


def test_a_small_message_goes_twice_where_datagrams_are_lost() -> None:
    """After a loss was seen, losing every first copy still delivers every answer, once."""
    path = Path(never)
    drop = [False]
    path._lost = lambda: drop[0]
    drop[0] = True
    path.drone.ping(0)
    drop[0] = False
    path.drone.ping(0)  # its number shows that one is missing
    path.run_until(20 * MS)
    path.worker.ping(path.now_ns)
    path.run_until(40 * MS)
    for i in range(20):
        drop[0] = True
        path.urgent(0, b"probe %d" % i)
        drop[0] = False
        path.run_until(path.now_ns + 50 * MS)
    assert len(path.arrived) == 20


def test_signs_of_life_and_goodbye() -> None:
    """A ping is answered, the round trip is known on both sides, a goodbye is heard."""
    path = Path(never)
    path.drone.ping(0)
    path.run_until(30 * MS)
    path.drone.ping(path.now_ns)
    path.run_until(60 * MS)
    for end in path.ends:
        assert 20 * MS <= end.state().srtt_ns < 21 * MS
    path.worker.goodbye()
    path.run_until(80 * MS)
    assert path.drone.said_goodbye


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.floats(0, 0.6), st.integers(1, 20), st.integers(20, 200_000))
def test_no_pattern_of_losses_makes_a_wrong_message(
    seed: int, share: float, burst: int, length: int
) -> None:
    """Whatever is lost on either way: what arrives is what was sent, once, and nothing sticks."""
    path = Path(losses(share, burst, seed))
    sent = [random.Random(seed + i).randbytes(length) for i in range(4)]
    for message in sent:
        path.send(message)
        path.run_until(path.now_ns + 30 * MS)
    path.run_until(path.now_ns + 2 * S)
    assert set(path.arrived) <= set(sent)
    assert not path.worker.in_pieces


@pytest.mark.parametrize("length", [0, 9_000_000])
def test_a_message_out_of_bounds_is_the_callers_fault(length: int) -> None:
    """Nothing and too much are refused where they are handed in."""
    with pytest.raises(ValueError, match=f"a message of {length} bytes"):
        Path(never).drone.send(bytes(length), MS, 0)
