"""Playing a recording: on the drone's clock, at its own speed or as fast as it is answered."""

import queue
import threading

import numpy as np

from drone_client.airframe import Airframe
from drone_client.playback import Lockstep, RealTime
from drone_client.source import Capture
from drone_client.source.memory import MemorySource
from rgbd_wire.clock import ManualClock
from tests.unit.drone_client.builders import CAMERA, MS, SECOND, eventually, frame, pose

T_SOURCE_NS = 1_700_000_000 * SECOND
AIRFRAME = Airframe()


def recording(times_ms, known=None) -> MemorySource:
    """Captures at these times; the camera moves 1 m along x in 100 ms."""
    f = frame()
    captures = [
        Capture(T_SOURCE_NS + t * MS, f.color_rgb, f.depth_units, f"{t}.png") for t in times_ms
    ]
    trajectory = [
        (T_SOURCE_NS + t * MS, pose((t / 100, 0, 0), (0, 0, t / 200))) for t in known or times_ms
    ]
    return MemorySource(CAMERA, captures, trajectory)


def body_matrix(x: float, turn: float) -> np.ndarray:
    """Where the body is when the camera is there: by 4x4 matrices."""
    camera = pose((x, 0, 0), (0, 0, turn)).matrix
    return camera @ np.linalg.inv(AIRFRAME.body_from_camera.matrix)


def test_real_time_maps_the_recordings_time_line_on_the_drones_clock():
    """The first capture is now; each other comes as much later as it was taken."""
    clock = ManualClock(5 * SECOND)
    playback = RealTime(recording([0, 1, 3]), AIRFRAME, clock, threading.Event())
    due = [(t_ns, capture.name) for t_ns, capture in playback.captures()]
    assert due == [
        (5 * SECOND, "0.png"),
        (5 * SECOND + 1 * MS, "1.png"),
        (5 * SECOND + 3 * MS, "3.png"),
    ]


def test_real_time_does_not_wait_for_what_is_already_due():
    """A capture that is late is stamped with the time of its exposure, not of its coming."""
    clock = ManualClock(0)
    playback = RealTime(recording([0, 60_000]), AIRFRAME, clock, threading.Event())
    captures = playback.captures()
    assert next(captures)[0] == 0
    clock.advance(90 * SECOND)
    assert next(captures)[0] == 60 * SECOND


def test_real_time_knows_the_body_between_captures_and_not_outside():
    """Interpolated ground truth, from the camera to the body; None before the first capture."""
    clock = ManualClock(7 * SECOND)
    playback = RealTime(recording([0, 1], known=[0, 100]), AIRFRAME, clock, threading.Event())
    assert playback.world_from_body(7 * SECOND) is None
    next(playback.captures())
    got = playback.world_from_body(7 * SECOND + 50 * MS)
    np.testing.assert_allclose(got.matrix, body_matrix(0.5, 0.25), atol=1e-9)
    assert playback.world_from_body(7 * SECOND + 130 * MS) is None


def test_real_time_ends_when_it_is_stopped():
    """Even while it waits for a capture that is an hour away."""
    stop = threading.Event()
    playback = RealTime(recording([0, 3_600_000]), AIRFRAME, ManualClock(), stop)
    captures = playback.captures()
    next(captures)
    stop.set()
    assert list(captures) == []


def test_lockstep_gives_each_capture_when_the_one_before_is_settled():
    """Stamped with the time at which it is given; none is left out."""
    clock, settled = ManualClock(0), threading.Event()
    source = recording([0, 33, 66])
    playback = Lockstep(source, AIRFRAME, clock, threading.Event(), settled)
    got = []
    for t_ns, capture in playback.captures():
        assert not settled.is_set()
        got.append((t_ns, capture.name))
        clock.advance(7 * MS)
        settled.set()
    assert got == [(0, "0.png"), (7 * MS, "33.png"), (14 * MS, "66.png")]


def test_lockstep_stands_at_the_capture_under_way_and_nowhere_until_it_is_told():
    """Between two captures the drone jumps; no tick may see the new place before its exposure."""
    settled = threading.Event()
    playback = Lockstep(recording([0, 100]), AIRFRAME, ManualClock(), threading.Event(), settled)
    given: queue.Queue[int] = queue.Queue()
    told: queue.Queue[None] = queue.Queue()

    def fly() -> None:
        for t_ns, _ in playback.captures():
            given.put(t_ns)
            told.get(timeout=10)

    flying = threading.Thread(target=fly, daemon=True)
    flying.start()
    for x in (0.0, 1.0):
        given.get(timeout=10)
        assert playback.world_from_body(0) is None
        told.put(None)
        assert eventually(lambda: playback.world_from_body(0) is not None)
        np.testing.assert_allclose(
            playback.world_from_body(0).matrix, body_matrix(x, x / 2), atol=1e-9
        )
        settled.set()
    flying.join(10)
    assert not flying.is_alive()


def test_lockstep_does_not_make_up_a_pose():
    """Where the recording knows none, the drone knows none."""
    source = recording([0, 1000], known=[0])
    settled = threading.Event()
    playback = Lockstep(source, AIRFRAME, ManualClock(), threading.Event(), settled)
    known = []
    for _ in playback.captures():
        settled.set()
        known.append(playback.world_from_body(0))
    assert known == [None, None]
    assert playback.world_from_body(0) is None


def test_lockstep_ends_when_it_is_stopped():
    """Even if the frame under way is never settled."""
    stop = threading.Event()
    playback = Lockstep(recording([0, 33]), AIRFRAME, ManualClock(), stop, threading.Event())
    captures = playback.captures()
    next(captures)
    stop.set()
    assert list(captures) == []
