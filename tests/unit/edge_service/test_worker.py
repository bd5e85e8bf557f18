"""The loop that serves frames: it survives whatever a frame does to it, and shows that it lives."""

from __future__ import annotations

from rgbd_wire.clock import ManualClock
from rgbd_wire.messages import Outcome
from tests.unit.edge_service.edge_fakes import (
    SECOND_NS,
    Bench,
    HeldDetector,
    KnownDetector,
    message,
    with_broken_picture,
)


def outcomes(bench):
    return [r.outcome for r in bench.transport.results()]


def test_a_fault_of_its_own_is_an_outcome_and_is_logged(caplog):
    """An exception costs the frame its pose and nothing else: the next frame is served."""
    detector = KnownDetector(error=RuntimeError("secret of the house"))
    bench = Bench(detector)
    bench.service.start()
    bench.deliver(message(sequence=0))
    bench.transport.wait_for_results(1)
    detector.error = None
    bench.deliver(message(sequence=1))
    bench.drain()
    assert outcomes(bench) == [Outcome.FAILED, Outcome.TARGET]
    assert bench.transport.results()[0].reason == "RuntimeError"  # the rest is for the log
    assert "secret of the house" in caplog.text


def test_a_broken_picture_is_a_bad_frame():
    """A frame whose picture does not decode is answered, with the reason."""
    bench = Bench()
    bench.service.start()
    bench.deliver(with_broken_picture(message()))
    bench.drain()
    assert outcomes(bench) == [Outcome.BAD_FRAME]
    assert bench.count("edge_frames_total", outcome="bad_frame") == 1


def test_a_frame_that_waited_past_its_budget_is_not_worked_on():
    """Nobody waits for it any more, and time spent on it would make the next ones late as well."""
    detector = HeldDetector()
    bench = Bench(detector)
    bench.service.start()
    bench.deliver(message(drone="d1"))
    assert detector.entered.acquire(timeout=20)
    bench.deliver(message(drone="d2", budget_ns=SECOND_NS))
    bench.deliver(message(drone="d3", budget_ns=SECOND_NS + 1))
    bench.clock.advance(SECOND_NS + 1)
    detector.go.release(2)
    bench.drain()
    told = {r.drone: (r.outcome, r.reason) for r in bench.transport.results()}
    assert told["d2"] == (Outcome.OVERLOADED, "waited 1000 ms of a budget of 1000 ms")
    assert told["d3"] == (Outcome.TARGET, "")
    assert len(detector.seen) == 2


def test_stamps_and_stages_tell_waiting_from_work():
    """t3 - t2 is all the time on the worker, and the queue is a stage of its own."""
    detector = HeldDetector()
    bench = Bench(detector)
    bench.service.start()
    bench.deliver(message(drone="d1"))
    assert detector.entered.acquire(timeout=20)
    bench.deliver(message(drone="d2"))
    bench.clock.advance(30)
    detector.go.release()
    assert detector.entered.acquire(timeout=20)
    bench.clock.advance(12)
    detector.go.release()
    bench.drain()
    first, second = bench.transport.results()
    assert first.t3_ns - first.t2_ns == 30
    assert first.stages_ns == {"queue": 0, "decode": 0, "detect": 30, "nest": 0, "localise": 0}
    assert second.t3_ns - second.t2_ns == 42
    assert second.stages_ns == {"queue": 30, "decode": 0, "detect": 12, "nest": 0, "localise": 0}


def test_a_worker_that_is_stuck_is_not_alive():
    """The heartbeat is the loop's own: an inference that hangs stops it."""
    detector = HeldDetector()
    bench = Bench(detector, heartbeat_s=3)
    bench.service.start()
    bench.deliver(message())
    assert detector.entered.acquire(timeout=20)
    bench.clock.advance(3 * SECOND_NS)
    assert bench.state.alive
    bench.clock.advance(1)
    assert not bench.state.alive
    detector.go.release()
    bench.drain()


def test_a_worker_that_comes_round_is_alive_again():
    """Each frame that it begins shows that it lives, however long it had nothing to do."""
    detector = HeldDetector()
    bench = Bench(detector, heartbeat_s=3)
    bench.service.start()
    detector.go.release()
    bench.deliver(message(drone="d1"))
    bench.transport.wait_for_results(1)
    bench.clock.advance(3600 * SECOND_NS)
    for drone in ("d2", "d3"):  # the loop comes round between the two
        bench.deliver(message(drone=drone, budget_ns=7200 * SECOND_NS))
    assert detector.entered.acquire(timeout=20)
    assert detector.entered.acquire(timeout=20)
    detector.go.release()
    assert detector.entered.acquire(timeout=20)
    assert bench.state.alive
    detector.go.release()
    bench.drain()


def test_a_service_that_is_still_starting_is_alive():
    """Before there is a worker nothing is stuck."""
    bench = Bench()
    assert isinstance(bench.clock, ManualClock)
    bench.clock.advance(3600 * SECOND_NS)
    assert bench.state.alive
