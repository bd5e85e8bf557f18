"""A message between the network and the mailbox: counted, acknowledged, answered."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from rgbd_wire.envelope import Kind, seal
from rgbd_wire.errors import Reject
from rgbd_wire.messages import Ack, Outcome, Result
from rgbd_wire.probe import Probe, seal_probe
from tests.unit.edge_service.edge_fakes import Bench, HeldDetector, message

GOOD = message()


def flipped(at):
    data = bytearray(GOOD)
    data[at] ^= 0x10
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", Reject.TRUNCATED),
        (GOOD[:-1], Reject.TRUNCATED),
        (GOOD + b"x", Reject.WRONG_SIZE),
        (flipped(0), Reject.WRONG_MAGIC),
        (flipped(4), Reject.WRONG_VERSION),
        (flipped(5), Reject.WRONG_KIND),
        (flipped(len(GOOD) - 9), Reject.CHECKSUM),
        (seal(Kind.FRAME, b"\1"), Reject.TRUNCATED),
        (seal(Kind.FRAME, b"\xff\xff\0\0", bytes(65535)), Reject.OVERSIZED),
        (seal(Kind.FRAME, b"\3\0\0\0", b"abc"), Reject.BAD_HEADER),
    ],
)
def test_a_bad_message_is_counted_and_not_answered(data, reason):
    """Each fault has its own counter, and the next good frame is served as if nothing had been."""
    bench = Bench()
    bench.service.start()
    bench.deliver(data)
    assert bench.count("edge_rejected_total", reason=reason.value) == 1
    assert bench.transport.sent == []
    bench.deliver(GOOD)
    bench.drain()
    assert [r.outcome for r in bench.transport.results()] == [Outcome.TARGET]


@given(st.data())
@hypothesis_settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])
def test_no_damage_gets_past_the_checks(data):
    """Any damage to a message is counted under one reason, raises nothing and gets no answer."""
    damaged = bytearray(GOOD)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(GOOD) - 1))] ^= data.draw(st.integers(1, 255))
    damaged = bytes(damaged)[: data.draw(st.integers(0, len(GOOD)))]
    bench = Bench()
    bench.service.start()
    bench.deliver(damaged)
    bench.drain()
    counts = [bench.count("edge_rejected_total", reason=r.value) for r in Reject]
    if damaged != GOOD:
        assert sum(counts) == 1
        assert bench.transport.sent == []


def test_the_ack_comes_first_and_names_this_start_of_the_worker():
    """Ack, then result, both with the boot id of this start and the frame's own stamps."""
    bench = Bench()
    bench.service.start()
    bench.deliver(message(drone="d9", sequence=4, boot_id=77, t1_ns=123))
    bench.drain()
    (to_ack, ack), (to_result, result) = bench.transport.sent
    assert (to_ack, to_result) == ("d9", "d9")
    assert (type(ack), type(result)) == (Ack, Result)
    assert (ack.boot_id, ack.sequence, ack.worker) == (77, 4, "w1")
    assert (result.boot_id, result.sequence) == (77, 4)
    assert (result.t1_ns, result.t_capture_ns) == (123, 5)
    assert result.worker_boot_id == ack.worker_boot_id
    other = Bench()
    other.service.start()
    other.deliver(GOOD)
    other.drain()
    assert other.transport.acks()[0].worker_boot_id != ack.worker_boot_id


def test_a_frame_cannot_be_taken_before_its_ack_is_sent():
    """A result must never overtake its ack, however fast the worker is."""
    detector = HeldDetector()
    bench = Bench(detector)
    waiting_at_ack = []
    send = bench.transport.send

    def spy(drone, payload):
        waiting_at_ack.append(bench.state.mailbox.waiting)
        return send(drone, payload)

    bench.transport.send = spy
    bench.service.start()
    bench.deliver(message(sequence=0))
    assert detector.entered.acquire(timeout=20)  # the worker is busy: what is put would wait
    bench.deliver(message(sequence=1))
    assert waiting_at_ack == [0, 0]
    assert bench.state.mailbox.waiting == 1
    detector.go.release(2)
    bench.drain()


def test_a_repeated_frame_is_counted_and_not_answered_again():
    """The same frame twice gets one ack and one result."""
    bench = Bench()
    bench.service.start()
    bench.deliver(GOOD)
    bench.deliver(GOOD)
    bench.drain()
    assert len(bench.transport.acks()) == len(bench.transport.results()) == 1
    assert bench.count("edge_rejected_total", reason="repeated") == 1


def test_displaced_overtaken_and_surplus_frames_are_told_at_once():
    """While the worker is busy: newest wins, the late one and one drone too many are told why."""
    detector = HeldDetector()
    bench = Bench(detector, max_drones=1)
    bench.service.start()
    bench.deliver(message(sequence=0))
    assert detector.entered.acquire(timeout=20)
    for sequence in (3, 5, 4):
        bench.deliver(message(sequence=sequence))
    bench.deliver(message(drone="d2"))
    told = {(r.drone, r.sequence): r.outcome for r in bench.transport.results()}
    assert told == {
        ("d1", 3): Outcome.SUPERSEDED,
        ("d1", 4): Outcome.SUPERSEDED,
        ("d2", 0): Outcome.OVERLOADED,
    }
    detector.go.release(2)
    bench.drain()
    results = [(r.drone, r.sequence, r.outcome) for r in bench.transport.results()[3:]]
    assert results == [("d1", 0, Outcome.TARGET), ("d1", 5, Outcome.TARGET)]
    assert len(bench.transport.acks()) == 5
    assert bench.count("edge_frames_total", outcome="superseded") == 2
    assert bench.count("edge_service_seconds_count") == 2  # those that were worked on


def test_a_drone_cannot_speak_for_another():
    """A frame that names another drone than the one it came from is counted, and nobody is told."""
    bench = Bench()
    bench.service.start()
    bench.deliver(message(drone="d2"), drone="d1")
    assert bench.count("edge_rejected_total", reason="wrong_drone") == 1
    assert bench.transport.sent == []
    bench.deliver(message(drone="d2"))  # the true one is not taken for a repetition
    bench.drain()
    assert [r.drone for r in bench.transport.results()] == ["d2"]


def test_a_message_of_nobody_is_counted():
    """What the network brings under no drone's name is refused like any other that fails."""
    bench = Bench()
    bench.service.start()
    for _ in range(3):
        bench.transport.deliver(None, b"", bench.clock.now_ns())
    assert bench.count("edge_rejected_total", reason="no_drone") == 3
    assert bench.transport.sent == []
    assert bench.state.mailbox.drones == 0
    bench.drain()


def test_a_probe_comes_back_at_once_with_the_workers_stamps():
    """Its own three numbers, then t2, t3 and the boot id that acks and results carry as well."""
    bench = Bench()
    bench.service.start()
    bench.deliver(message())
    t2_ns = bench.clock.now_ns()
    bench.clock.advance(40)
    bench.transport.deliver("d7", seal_probe(Probe(boot_id=7, sequence=3, t1_ns=99)), t2_ns)
    ((to, echo),) = [s for s in bench.transport.sent if isinstance(s[1], Probe)]
    worker_boot_id = bench.transport.acks()[0].worker_boot_id
    assert (to, echo) == ("d7", Probe(7, 3, 99, t2_ns, t2_ns + 40, worker_boot_id))
    assert bench.count("edge_probes_total") == 1
    assert bench.state.mailbox.drones == 1  # who only probes takes nobody's place
    bench.drain()


def test_a_drone_that_floods_is_turned_away_and_the_others_are_served():
    """At the rate: served. Over it: told, and then not even that. Nobody else notices."""
    bench = Bench(max_rate_hz=30)
    bench.service.start()
    for sequence in range(100):
        bench.deliver(message(drone="loud", sequence=sequence))
    bench.deliver(message(drone="quiet"))
    bench.drain()
    told = Counter((r.drone, r.outcome) for r in bench.transport.results())
    assert told["quiet", Outcome.TARGET] == 1
    assert told["loud", Outcome.TARGET] + told["loud", Outcome.SUPERSEDED] == 8
    assert told["loud", Outcome.OVERLOADED] == 8
    assert sum(told.values()) == 17
    assert bench.count("edge_rejected_total", reason="too_fast") == 92


def test_of_a_frame_that_is_too_much_only_the_header_is_looked_at():
    """The checksum of its pictures is not worth the time; the header must be this drone's own."""
    bench = Bench(max_rate_hz=1)
    bench.service.start()
    for sequence in range(8):
        bench.deliver(message(sequence=sequence))
    bench.transport.wait_for_results(8)
    broken = bytearray(message(sequence=8))
    broken[-1] ^= 1
    bench.deliver(bytes(broken))
    last = bench.transport.results()[-1]
    assert (last.sequence, last.outcome) == (8, Outcome.OVERLOADED)
    for data in (message(drone="d2"), b"", b"junk", seal(Kind.FRAME, b"\xff" * 9)):
        bench.deliver(data, drone="d1")
    assert len(bench.transport.results()) == 9
    assert bench.count("edge_rejected_total", reason="too_fast") == 5
    bench.drain()


def test_probes_have_a_rate_of_their_own():
    """A flood of them is bounded, and takes nothing from the drone's frames."""
    bench = Bench()
    bench.service.start()
    for sequence in range(100):
        bench.deliver(seal_probe(Probe(7, sequence, 1)))
    assert len(bench.transport.echoes()) == 15
    assert bench.count("edge_rejected_total", reason="too_fast") == 85
    bench.deliver(message())
    bench.drain()
    assert [r.outcome for r in bench.transport.results()] == [Outcome.TARGET]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (seal(Kind.PROBE, bytes(47)), Reject.WRONG_SIZE),
        (seal(Kind.PROBE, bytes(40) + b"\xff" * 8), Reject.BAD_HEADER),
        (seal_probe(Probe(1, 2, 3))[:-1] + b"x", Reject.CHECKSUM),
        (seal(Kind.STATUS, bytes(48)), Reject.WRONG_KIND),
    ],
)
def test_a_bad_probe_is_counted_and_not_echoed(data, reason):
    """What is nearly a probe, or of a kind that only workers send, goes nowhere."""
    bench = Bench()
    bench.service.start()
    bench.deliver(data)
    assert bench.count("edge_rejected_total", reason=reason.value) == 1
    assert bench.transport.sent == []
    bench.drain()


def test_a_refusal_is_logged_once_for_each_reason(caplog):
    """The counter tells how often; the log only that it is so."""
    bench = Bench()
    bench.service.start()
    for _ in range(3):
        bench.deliver(b"junk")
    bench.deliver(flipped(4))
    bench.drain()
    assert [r.reason for r in caplog.records] == ["truncated", "wrong_version"]


def test_a_fault_of_the_workers_own_ends_no_network_thread(monkeypatch, caplog):
    """What nobody thought of costs its message: counted, logged once, the next one is served."""
    bench = Bench()
    bench.service.start()

    def bad(*_):
        raise RuntimeError("unheard of")

    with monkeypatch.context() as patch:
        patch.setattr("edge_service.mailbox.Mailbox.admit", bad)
        for sequence in range(3):
            bench.deliver(message(sequence=sequence))
    bench.deliver(message(sequence=3))
    bench.drain()
    assert bench.count("edge_rejected_total", reason="fault") == 3
    assert [r.message for r in caplog.records] == ["message refused"]
    assert caplog.records[0].exc_info
    assert [r.sequence for r in bench.transport.results()] == [3]
