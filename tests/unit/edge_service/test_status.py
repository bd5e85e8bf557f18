"""The status: what it says, when, and that nothing stops it."""

from __future__ import annotations

from rgbd_wire.messages import Outcome
from tests.unit.edge_service.edge_fakes import SECOND_NS, Bench, HeldDetector, message

MS = 1_000_000


def test_it_says_how_the_worker_is():
    """Who, what waits, how many drones, how long answers took of late, which model."""
    detector = HeldDetector()
    bench = Bench(detector, max_drones=7)
    bench.service.start()
    for sequence, spent_ms in enumerate((30, 10, 20)):
        bench.deliver(message(sequence=sequence))
        assert detector.entered.acquire(timeout=20)
        bench.clock.advance(spent_ms * MS)
        detector.go.release()
        bench.transport.wait_for_results(sequence + 1)
    bench.deliver(message(sequence=3))
    assert detector.entered.acquire(timeout=20)
    bench.deliver(message(drone="d2"))
    seen = len(bench.transport.published)
    status = bench.transport.wait_for_statuses(seen + 2)[-1]
    assert (status.worker, status.worker_boot_id) == (
        "w1",
        bench.transport.acks()[0].worker_boot_id,
    )
    assert (status.waiting, status.drones, status.max_drones) == (1, 2, 7)
    assert (status.service_p50_ns, status.service_p95_ns) == (20 * MS, 30 * MS)
    assert status.model == detector.model_hash
    assert not status.draining
    detector.go.release(2)
    bench.drain()
    sequences = [s.sequence for _, s in bench.transport.published]
    assert sequences == sorted(set(sequences))


def test_only_frames_that_were_looked_at_count():
    """An answer that takes no time says nothing of how long one takes that does."""
    detector = HeldDetector()
    bench = Bench(detector)
    bench.service.start()
    bench.deliver(message())
    assert detector.entered.acquire(timeout=20)
    bench.deliver(message(drone="d2", budget_ns=0))
    bench.clock.advance(5 * MS)
    detector.go.release()
    bench.drain()
    assert {r.outcome for r in bench.transport.results()} == {Outcome.TARGET, Outcome.DROPPED}
    assert bench.transport.published[-1][1].service_p50_ns in {0, 5 * MS}


def test_a_drain_is_told_at_once_and_before_the_token_goes():
    """Drones that read the status go elsewhere before those that only see the token."""
    bench = Bench()
    bench.service.start()
    bench.drain()
    first = next(entry for entry in bench.transport.published if entry[1].draining)
    announced, status = first
    assert announced
    assert status.draining
    assert all(s.draining for _, s in bench.transport.published if s.sequence >= status.sequence)


def test_a_link_that_fails_does_not_end_it(caplog):
    """It is logged once, and the next status comes all the same."""
    bench = Bench(drain_s=1)
    publish, failures = bench.transport.publish, []

    def failing(status):
        if len(failures) < 2:
            failures.append(status)
            raise OSError("no way there")
        publish(status)

    bench.transport.publish = failing
    bench.service.start()
    bench.transport.wait_for_statuses(1)
    bench.drain()
    assert caplog.text.count("status not published") == 1
    assert bench.transport.published[0][1].sequence == 3


def test_without_a_frame_there_are_no_figures():
    """0 says that nothing is known, on a worker that has just begun."""
    bench = Bench()
    bench.service.start()
    status = bench.transport.wait_for_statuses(1)[0]
    assert (status.service_p50_ns, status.service_p95_ns, status.drones) == (0, 0, 0)
    bench.clock.advance(SECOND_NS)
    bench.drain()
