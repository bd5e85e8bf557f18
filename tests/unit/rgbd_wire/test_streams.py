"""The stream table and its keys."""

from __future__ import annotations

import re

import pytest

from rgbd_wire.streams import FRAME, PREFIX, RESULT, Stream, Urgency, worker_key, worker_of_key

STREAMS = [FRAME, RESULT]


def test_keys_are_versioned_and_directed():
    """A key names the protocol's version, the drone, the stream and the worker, in that order."""
    assert FRAME.key("drone-1", "worker-a") == "aerial/v1/drone-1/frame/worker-a"
    assert RESULT.key("drone-1", "worker-a") == "aerial/v1/drone-1/result/worker-a"
    assert worker_key("worker-a") == "aerial/v1/workers/worker-a"


@pytest.mark.parametrize("key", [FRAME.key("d", "w-1"), RESULT.key("*", "w-1"), worker_key("w-1")])
def test_the_worker_is_the_last_chunk(key):
    """Every key gives its worker back."""
    assert key.startswith(f"{PREFIX}/")
    assert worker_of_key(key) == "w-1"


def test_no_drone_can_sit_on_another_stream():
    """Keys of different streams, drones and workers never meet, nor the worker's own key."""
    names = ["a", "b", "workers", "frame"]
    keys = [s.key(drone, worker) for s in STREAMS for drone in names for worker in names]
    keys += [worker_key(worker) for worker in names]
    assert len(set(keys)) == len(keys)


@pytest.mark.parametrize("stream", STREAMS)
def test_limits_make_sense(stream: Stream):
    """Rates and ages are positive, and a result may be older than the frame that it answers."""
    assert stream.rate_hz > 0
    assert stream.max_age_ms > 0
    assert re.fullmatch(r"[a-z]+", stream.name)


def test_results_go_before_frames():
    """What is small and urgent does not wait behind a picture."""
    assert RESULT.urgency is Urgency.REAL_TIME
    assert FRAME.urgency is Urgency.DATA
    assert RESULT.max_age_ms > FRAME.max_age_ms
