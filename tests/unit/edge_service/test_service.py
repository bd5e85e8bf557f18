"""Up and down in order: ready last, unready first, and every frame answered."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from edge_service import service
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import FrameStamp, compress, pack
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import MAX_POSE_NUMBER, Outcome
from tests.unit.drone_client.builders import eventually
from tests.unit.edge_service.edge_fakes import (
    CAMERA,
    COLOR,
    DEPTH,
    SECOND_NS,
    WORLD_FROM_CAMERA,
    Bench,
    HeldDetector,
    message,
)


def test_ready_only_when_all_of_it_stands():
    """Readiness names what is missing, from the first moment to the last."""
    bench = Bench()
    bench.state.pipeline, pipeline = None, bench.state.pipeline
    bench.state.transport, transport = None, bench.state.transport
    assert bench.state.readiness() == {
        "model_warm": False,
        "link_open": False,
        "not_draining": True,
    }
    bench.state.pipeline, bench.state.transport = pipeline, transport
    assert not bench.transport.announced
    bench.service.start()
    assert bench.transport.announced
    assert all(bench.state.readiness().values())
    bench.drain()
    assert not bench.transport.announced
    assert bench.state.readiness() == {
        "model_warm": True,
        "link_open": False,
        "not_draining": False,
    }


def test_a_drain_answers_everything_and_says_so_in_every_result():
    """In work: served. Waiting: served. Coming: told to go elsewhere. Exactly one result each."""
    detector = HeldDetector()
    bench = Bench(detector)
    bench.service.start()
    bench.deliver(message(drone="d1"))
    assert detector.entered.acquire(timeout=20)
    bench.deliver(message(drone="d2"))

    def meanwhile(seconds):
        """Runs where the drain lingers for frames that are on their way."""
        assert seconds > 0
        bench.deliver(message(drone="d1", sequence=1))
        bench.deliver(message(drone="d3"))

    detector.go.release(2)
    assert bench.service.drain(meanwhile)
    told = {(r.drone, r.sequence): r.outcome for r in bench.transport.results()}
    assert told == {
        ("d1", 0): Outcome.TARGET,
        ("d2", 0): Outcome.TARGET,
        ("d1", 1): Outcome.DRAINING,
        ("d3", 0): Outcome.DRAINING,
    }
    assert Counter((a.drone, a.sequence) for a in bench.transport.acks()) == Counter(told.keys())
    assert bench.transport.results()[-1].draining
    assert not bench.transport.is_open


def test_when_the_time_is_up_what_waits_is_told_to_go_elsewhere(monkeypatch):
    """The frame in work is still finished; those behind it are told, and all is answered."""
    detector = HeldDetector()
    bench = Bench(detector, drain_s=0)
    bench.service.start()
    bench.deliver(message(drone="d1"))
    assert detector.entered.acquire(timeout=20)
    bench.deliver(message(drone="d2"))
    monkeypatch.setattr(service, "LAST_FRAME_S", 20.0)
    assert bench.service.drain(lambda _: detector.go.release())
    told = [(r.drone, r.outcome) for r in bench.transport.results()]
    assert told == [("d2", Outcome.DRAINING), ("d1", Outcome.TARGET)]


def test_a_stuck_worker_does_not_hold_the_drain(monkeypatch):
    """Past its bound the drain gives up the frame in work, and reports that it was so."""
    detector = HeldDetector()
    bench = Bench(detector, drain_s=0)
    bench.service.start()
    bench.deliver(message())
    assert detector.entered.acquire(timeout=20)
    monkeypatch.setattr(service, "LAST_FRAME_S", 0.0)
    assert not bench.drain()
    detector.go.release()


def test_an_answer_that_finds_the_link_closed_is_counted(monkeypatch):
    """A worker that comes round after the link has closed counts, and does not fail."""
    detector = HeldDetector()
    bench = Bench(detector, drain_s=0)
    bench.service.start()
    bench.deliver(message())
    assert detector.entered.acquire(timeout=20)
    monkeypatch.setattr(service, "LAST_FRAME_S", 0.0)
    bench.drain()
    detector.go.release()
    assert bench.state.worker.join(20)
    assert bench.count("edge_unsent_total") == 1


@pytest.mark.parametrize("name", ["edge_ready 1.0", "edge_drones 1.0", 'outcome="target"} 1.0'])
def test_metrics_show_the_state_as_it_is(name):
    """Gauges are read when they are asked for."""
    bench = Bench()
    bench.service.start()
    bench.deliver(message())
    bench.transport.wait_for_results(1)
    # The answer leaves before it is counted
    assert eventually(lambda: name in bench.state.metrics_text().decode())
    bench.drain()


def test_a_world_pose_that_the_wire_does_not_take_is_left_out():
    """A drone at the very edge of the world still gets the target in its camera."""
    bench = Bench()
    far = Pose(np.array([MAX_POSE_NUMBER, 0, 0]), WORLD_FROM_CAMERA.q_wxyz)
    frame = RgbdFrame(COLOR, DEPTH, CAMERA, 0, far)
    bench.service.start()
    bench.deliver(pack(compress(frame), FrameStamp("d1", 1, 0, 0, SECOND_NS)))
    bench.drain()
    (result,) = bench.transport.results()
    assert result.outcome is Outcome.TARGET
    assert result.target.world_from_target is None
