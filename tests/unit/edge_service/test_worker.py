"""The loop that serves frames: it survives whatever a frame does to it, and shows that it lives."""

from __future__ import annotations

from rgbd_wire.clock import ManualClock
from rgbd_wire.frame_codec import FrameStamp, compress, pack
from rgbd_wire.messages import Outcome
from tests.unit.edge_service.edge_fakes import (
    SECOND_NS,
    Bench,
    HeldDetector,
    KnownDetector,
    message,
    tiny_frame,
    with_broken_picture,
)

MS = 1_000_000


class ChokingDetector(HeldDetector):
    """Fails on batches, and on one of the pictures by itself."""

    choke_on = None

    def detect_batch(self, colors_rgb):
        raise RuntimeError("one of them")

    def detect(self, color_rgb):
        if self.choke_on is not None and len(self.seen) == self.choke_on:
            self.seen.append(color_rgb)
            raise RuntimeError("this one")
        return super().detect(color_rgb)


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
    words = "waited 1000 ms, service takes 1000 ms, budget 1000 ms"
    assert told["d2"] == (Outcome.DROPPED, words)
    assert told["d3"] == (Outcome.TARGET, "")  # late by all that is expected, but worth a try
    assert len(detector.seen) == 2
    assert bench.count("edge_dropped_total", where="worker") == 1


def measured(bench, detector, spent_ns):
    """Frames that take so long each; two, for the time of one is noted after its answer."""
    for sequence in range(2):
        bench.deliver(message(drone="slow", sequence=sequence))
        assert detector.entered.acquire(timeout=20)
        bench.clock.advance(spent_ns)
        detector.go.release()
        bench.transport.wait_for_results(sequence + 1)


def test_a_frame_that_will_be_late_is_dropped_when_it_comes():
    """By what the frames of late took; it is acknowledged and answered, so that the clock runs."""
    detector = HeldDetector()
    bench = Bench(detector)
    bench.service.start()
    measured(bench, detector, 30 * MS)
    for sequence in range(3):
        bench.deliver(message(drone="d1", sequence=sequence, budget_ns=29 * MS))
    assert detector.entered.acquire(timeout=20)  # the first one is tried
    told = [(r.outcome, r.reason) for r in bench.transport.results() if r.drone == "d1"]
    assert told == [(Outcome.DROPPED, "waited 0 ms, service takes 30 ms, budget 29 ms")] * 2
    assert [a.sequence for a in bench.transport.acks() if a.drone == "d1"] == [0, 1, 2]
    assert bench.count("edge_dropped_total", where="intake") == 2
    detector.go.release()
    bench.drain()


def test_the_expected_time_is_shown_and_forgotten():
    """What a frame takes of late is a metric, and after some silence it is not claimed any more."""
    detector = HeldDetector()
    bench = Bench(detector)
    bench.service.start()
    measured(bench, detector, 30 * MS)
    assert "edge_expected_service_seconds 0.03" in bench.state.metrics_text().decode()
    bench.clock.advance(3600 * SECOND_NS)
    bench.drain()
    assert "edge_expected_service_seconds 0.0\n" in bench.state.metrics_text().decode()


def waiting_for(bench, detector, n, **fields):
    """``n`` frames of different drones that wait while another one is in work."""
    bench.deliver(message(drone="first"))
    assert detector.entered.acquire(timeout=20)
    for k in range(n):
        bench.deliver(message(drone=f"d{k}", **fields))


def test_frames_of_different_drones_go_through_the_detector_together():
    """As many as may and as are there; each has its own result, in the order of the turns."""
    detector = HeldDetector()
    bench = Bench(detector, batch_max=3)
    bench.service.start()
    waiting_for(bench, detector, 4)
    detector.go.release(5)
    bench.drain()
    assert detector.batches == [3]
    assert [r.drone for r in bench.transport.results()] == ["first", "d0", "d1", "d2", "d3"]
    assert set(outcomes(bench)) == {Outcome.TARGET}
    assert bench.count("edge_batch_frames_sum") == 5
    assert bench.count("edge_batch_frames_count") == 3


def test_without_batches_each_goes_alone():
    """The default: nobody waits for anybody."""
    detector = HeldDetector()
    bench = Bench(detector)
    bench.service.start()
    waiting_for(bench, detector, 3)
    detector.go.release(4)
    bench.drain()
    assert detector.batches == []


def test_one_bad_frame_does_not_take_its_batch_down(caplog):
    """A picture that breaks, one that the detector chokes on: the others have their poses."""
    detector = ChokingDetector()
    bench = Bench(detector, batch_max=8)
    bench.service.start()
    waiting_for(bench, detector, 2)
    bench.deliver(with_broken_picture(message(drone="broken")))
    bench.deliver(message(drone="choke", bare=True))
    detector.choke_on = 3  # of those that it sees in the batch
    detector.go.release(20)
    bench.drain()
    told = {r.drone: r.outcome for r in bench.transport.results()}
    assert told == {
        "first": Outcome.TARGET,
        "d0": Outcome.TARGET,
        "d1": Outcome.TARGET,
        "broken": Outcome.BAD_FRAME,
        "choke": Outcome.FAILED,
    }
    assert "batch failed" in caplog.text


def test_a_tiny_picture_in_a_batch_leaves_a_batch_that_is_timed():
    """The others go together, and what two of them took is known for the next ones."""
    detector = HeldDetector()
    bench = Bench(detector, batch_max=4)
    bench.service.start()
    waiting_for(bench, detector, 2)
    tiny = compress(tiny_frame(8))
    bench.deliver(pack(tiny, FrameStamp("tiny", 7, 0, 11, SECOND_NS)))
    detector.go.release()
    assert detector.entered.acquire(timeout=20)  # the first of the batch
    bench.clock.advance(30 * MS)
    detector.go.release(2)
    bench.drain()
    assert detector.batches == [2]
    told = {r.drone: r.outcome for r in bench.transport.results()}
    assert told["tiny"] is Outcome.BAD_FRAME
    assert told["d0"] is told["d1"] is Outcome.TARGET
    assert bench.count("edge_batch_frames_sum") == 3
    assert bench.service._worker._times.expected_ns(bench.clock.now_ns(), 2) == 30 * MS


def test_a_frame_without_time_for_a_batch_goes_alone():
    """Two frames take 60 ms by what is known: one that has 59 takes nobody along."""
    detector = HeldDetector()
    bench = Bench(detector, batch_max=2)
    bench.service.start()
    measured(bench, detector, 30 * MS)
    waiting_for(bench, detector, 1, budget_ns=59 * MS)
    bench.deliver(message(drone="easy"))
    detector.go.release(3)
    bench.drain()
    assert detector.batches == []
    assert [r.drone for r in bench.transport.results()[-2:]] == ["d0", "easy"]


def test_a_stop_while_a_batch_waits_for_more_loses_nothing():
    """What is there is served, and the drain has its end."""
    detector = HeldDetector()
    bench = Bench(detector, batch_max=2, batch_wait_ms=100)
    bench.service.start()
    bench.deliver(message())
    detector.go.release()
    assert bench.drain()
    assert outcomes(bench) == [Outcome.TARGET]


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


def test_a_service_whose_link_has_lost_a_thread_is_not_alive():
    """Nothing would come in any more, whatever the worker's loop does."""
    bench = Bench()
    bench.service.start()
    assert bench.state.alive
    bench.transport.is_alive = False
    assert not bench.state.alive
    bench.drain()


def test_a_service_that_is_still_starting_is_alive():
    """Before there is a worker nothing is stuck."""
    bench = Bench()
    assert isinstance(bench.clock, ManualClock)
    bench.clock.advance(3600 * SECOND_NS)
    assert bench.state.alive
