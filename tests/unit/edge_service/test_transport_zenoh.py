"""The worker's Zenoh transport by itself, with bare drones on the loopback."""

from __future__ import annotations

import json
import queue
import threading
import time

import pytest
import zenoh

from edge_service.errors import AddressError
from edge_service.transport.zenoh import MAX_FRAME_BYTES, ZenohAddress, ZenohTransport
from rgbd_wire.probe import PROBE_BYTES
from rgbd_wire.streams import FRAME, PROBE, worker_status_key
from tests.integration.zenoh_drone import open_session
from tests.service_process import free_port
from tests.unit.drone_client.builders import eventually


@pytest.fixture
def endpoint():
    """Where the worker listens."""
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def transport(endpoint):
    """An open transport, closed afterwards."""
    transport = ZenohTransport("w1", ZenohAddress(listen=(endpoint,)))
    transport.open()
    yield transport
    transport.close()


@pytest.fixture
def got(transport):
    """What a started transport hands over."""
    got = queue.Queue()
    transport.start(lambda drone, data, t2_ns: got.put((drone, bytes(data), t2_ns)))
    return got


@pytest.fixture
def session(endpoint, got):
    """A drone's session that reaches both of the worker's subscribers."""
    with open_session("peer", connect=[endpoint]) as session:
        for stream in (FRAME, PROBE):
            publisher = session.declare_publisher(stream.key("d1", "w1"))
            assert eventually(lambda p=publisher: p.matching_status.matching, timeout_s=20)
        yield session


def put(session, key, data):
    """Publish so that nothing is lost."""
    session.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)


def test_frames_and_probes_come_with_the_drone_of_their_key(session, got):
    """The drone is what the network says, not what the bytes say; t2 goes up."""
    put(session, FRAME.key("d1", "w1"), b"frame")
    put(session, PROBE.key("d2", "w1"), b"probe")
    put(session, FRAME.key("d1", "w2"), b"of another worker")
    put(session, FRAME.key("d1", "w1"), b"last")
    told = [got.get(timeout=20) for _ in range(3)]
    assert [t[:2] for t in told] == [("d1", b"frame"), ("d2", b"probe"), ("d1", b"last")]
    stamps = [t[2] for t in told]
    assert stamps == sorted(stamps)


def test_what_is_too_long_is_cut_and_a_frame_does_not_pass_as_a_probe(session, got):
    """One byte more than may be, so that the envelope sees it."""
    put(session, PROBE.key("d1", "w1"), bytes(5000))
    put(session, FRAME.key("d1", "w1"), bytes(MAX_FRAME_BYTES + 5000))
    assert sorted(len(got.get(timeout=20)[1]) for _ in range(2)) == [
        PROBE_BYTES + 1,
        MAX_FRAME_BYTES + 1,
    ]


def test_a_key_that_names_no_drone_is_nobody(session, got):
    """Nothing could be answered: it is handed over unread and without a drone, to be counted."""
    for nobody in ("NOT", "with.dot", "x" * 33, "-d"):
        put(session, FRAME.key(nobody, "w1"), b"frame")
    put(session, FRAME.key("d1", "w1"), b"last")
    told = [got.get(timeout=20)[:2] for _ in range(5)]
    assert told == [(None, b"")] * 4 + [("d1", b"last")]


def test_a_status_reaches_every_drone_that_listens(endpoint, transport):
    """Real-time, express and dropped rather than waited for."""
    samples = queue.Queue()
    with (
        open_session("peer", connect=[endpoint]) as first,
        open_session("peer", connect=[endpoint]) as second,
    ):
        for session in (first, second):
            session.declare_subscriber(worker_status_key("*"), samples.put)
        seen = set()

        def both() -> bool:
            transport.publish(b"status")
            while not samples.empty():
                seen.add(samples.get())
            return len({id(s) for s in seen}) >= 2

        assert eventually(both, timeout_s=20)
    for sample in seen:
        assert (sample.priority, sample.express) == (zenoh.Priority.REAL_TIME, True)
        assert sample.congestion_control == zenoh.CongestionControl.DROP
        assert str(sample.key_expr) == "aerial/v1/workers/w1/status"


def test_the_next_message_is_not_touched_before_the_one_before_it_is_taken(endpoint):
    """The hand-over is on the thread that reads: there is no queue between it and the consumer."""
    entered, go = threading.Semaphore(0), threading.Semaphore(0)
    stamps_ns = []

    def slow(_drone, _data, t2_ns):
        stamps_ns.append(t2_ns)
        entered.release()
        assert go.acquire(timeout=20)

    transport = ZenohTransport("w1", ZenohAddress(listen=(endpoint,)))
    transport.open()
    transport.start(slow)
    with open_session("peer", connect=[endpoint]) as session:
        publisher = session.declare_publisher(FRAME.key("d1", "w1"))
        assert eventually(lambda: publisher.matching_status.matching, timeout_s=20)
        put(session, FRAME.key("d1", "w1"), b"0")
        put(session, FRAME.key("d1", "w1"), b"1")
        assert entered.acquire(timeout=20)
        released_ns = time.monotonic_ns()
        go.release(2)
        assert entered.acquire(timeout=20)
    transport.close()
    assert stamps_ns[0] < released_ns < stamps_ns[1]


def test_after_the_end_nothing_is_handed_over(session, got, transport):
    """Closing twice is no harm, and a status then goes nowhere."""
    transport.close()
    transport.publish(b"nobody hears it")
    assert not transport.send("d1", b"nobody hears it")
    session.put(FRAME.key("d1", "w1"), b"late")
    assert got.empty()


def test_only_the_protocol_that_was_asked_for_is_spoken(endpoint):
    """A configuration names its protocols; no other can be listened on by a slip."""
    config = ZenohAddress(listen=(endpoint,)).config()
    assert json.loads(config.get_json("transport/link/protocols")) == ["tcp"]


@pytest.mark.parametrize("listen", ["tls/127.0.0.1:7447"])
def test_tls_without_files_is_told(listen):
    """The line names the setting and the script."""
    with pytest.raises(AddressError, match="EDGE_ZENOH_TLS") as error:
        ZenohAddress(listen=(listen,)).config()
    assert "scripts/certificates" in str(error.value)
