"""The service's frame path over real Zenoh sessions on the loopback."""

from __future__ import annotations

import struct
from contextlib import contextmanager

import pytest
import zenoh

from edge_service.errors import AddressError
from edge_service.mailbox import Mailbox
from edge_service.metrics import Metrics
from edge_service.service import EdgeService
from edge_service.state import ServiceState
from edge_service.transport.zenoh import ZenohAddress, ZenohTransport
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.envelope import MAX_BODY_BYTES, PREFIX_BYTES, Kind
from rgbd_wire.messages import Ack, Outcome
from rgbd_wire.streams import worker_key
from tests.integration.zenoh_drone import flying, open_session
from tests.service_process import free_port
from tests.unit.edge_service.edge_fakes import (
    SECOND_NS,
    HeldDetector,
    message,
    pipeline,
    settings,
)

BURST = 8
"""Frames whose acks and results fit the link's queue, even if it is not emptied meanwhile."""
BUDGET_NS = 60 * SECOND_NS


class Running:
    """A service and the endpoint that it is reached by."""

    def __init__(self, address, endpoint, detector=None, **fields):
        self.endpoint = endpoint
        made = settings(**fields)
        mailbox = Mailbox(made.max_drones, int(made.drone_idle_s * 1e9))
        transport = ZenohTransport("w1", address)
        transport.open()
        self.state = ServiceState(made, Metrics(), mailbox, transport=transport)
        clock = MonotonicClock()
        stages = pipeline(detector, clock)
        self.service = EdgeService(made, stages, transport, self.state, clock)
        self.service.start()

    def count(self, name, **labels):
        """Value of a metric; 0 when it has none."""
        return self.state.metrics.registry.get_sample_value(name, labels) or 0


@contextmanager
def running(detector=None, **fields):
    """A service that is its own router."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    service = Running(ZenohAddress(listen=(endpoint,)), endpoint, detector, **fields)
    try:
        yield service
    finally:
        service.service.drain(lambda _: None)


def frame(sequence, **fields):
    return message(sequence=sequence, budget_ns=BUDGET_NS, **fields)


def settled(sequence):
    """Whether the frame has its result."""
    return lambda drone: any(r.sequence == sequence for r in drone.results)


def oversized(claimed, sent):
    """An envelope that claims, and carries, so many bytes."""
    return struct.pack("<4sBBHII", b"AERC", 1, 1, 0, claimed, 0) + bytes(sent)


def test_good_and_bad_frames_of_a_drone():
    """Good frames get an ack and then one result; each bad one its counter; nothing stops it."""
    limit = MAX_BODY_BYTES[Kind.FRAME]
    good = frame(0)
    flipped = bytearray(good)
    flipped[-7] ^= 1
    bad = {
        "truncated": good[: len(good) // 2],
        "checksum": bytes(flipped),
        "wrong_version": good[:4] + b"\x09" + good[5:],
        "wrong_magic": b"nonsense that is long enough",
        "oversized": oversized(limit + 1, limit + 1),
        "wrong_size": good + b"\0",
    }
    with running() as service, flying(service.endpoint) as drone:
        sequence = 0
        for data in bad.values():
            drone.send(data)
            drone.send(frame(sequence))
            drone.wait_for(settled(sequence))
            sequence += 1
        drone.send(oversized(5 * limit, 5 * limit - PREFIX_BYTES))  # cut off on the link itself
        drone.send(frame(sequence - 1))  # once more
        drone.send(frame(sequence))
        drone.wait_for(settled(sequence))
        for reason in bad:
            assert service.count("edge_rejected_total", reason=reason) == 1
        assert service.count("edge_rejected_total", reason="repeated") == 1
        assert drone.acks == list(range(sequence + 1))
        assert [r.outcome for r in drone.results] == [Outcome.TARGET] * (sequence + 1)
        assert [type(m) for m in drone.received[::2]] == [Ack] * (sequence + 1)
        result = drone.results[-1]
        assert 0 < sum(result.stages_ns.values()) <= result.t3_ns - result.t2_ns
    assert service.count("edge_frames_total", outcome="target") == sequence + 1


def test_newest_wins_over_the_real_link():
    """While the worker is busy only the newest waits; the late and the displaced are told."""
    detector = HeldDetector()
    with running(detector) as service, flying(service.endpoint) as drone:
        drone.send(frame(0))
        assert detector.entered.acquire(timeout=20)
        for sequence in (2, 5, 3):
            drone.send(frame(sequence))
        drone.wait_for(lambda d: len(d.results) == 2)
        detector.go.release(2)
        drone.wait_for(lambda d: len(d.results) == 4)
        told = [(r.sequence, r.outcome) for r in drone.results]
        assert told == [
            (2, Outcome.SUPERSEDED),
            (3, Outcome.SUPERSEDED),
            (0, Outcome.TARGET),
            (5, Outcome.TARGET),
        ]
        assert sorted(drone.acks) == [0, 2, 3, 5]


def test_a_detector_that_stands_still_lets_nothing_queue_up():
    """Of 200 frames behind one that hangs, each is acknowledged at once, and the newest remains."""
    detector = HeldDetector()
    n = 200
    with running(detector, max_rate_hz=1000) as service, flying(service.endpoint) as drone:
        drone.send(frame(0))
        assert detector.entered.acquire(timeout=20)
        for sequence in range(1, n + 1):
            drone.send(frame(sequence))
            drone.wait_for(lambda d, s=sequence: d.acks[-1:] == [s])
        drone.wait_for(lambda d: len(d.results) == n - 1)
        assert {r.outcome for r in drone.results} == {Outcome.SUPERSEDED}
        detector.go.release(2)
        drone.wait_for(lambda d: len(d.results) == n + 1)
        assert [(r.sequence, r.outcome) for r in drone.results[-2:]] == [
            (0, Outcome.TARGET),
            (n, Outcome.TARGET),
        ]


def test_probes_are_echoed_past_a_detector_that_stands_still():
    """The echo is the network's round trip and nothing else."""
    detector = HeldDetector()
    with running(detector) as service, flying(service.endpoint) as drone:
        drone.send(frame(0))
        assert detector.entered.acquire(timeout=20)
        drone.probe(7)
        drone.wait_for(lambda d: d.echoes)
        (echo,) = drone.echoes
        assert echo.sequence == 7
        assert 0 < echo.t2_ns <= echo.t3_ns
        assert echo.worker_boot_id != 0
        detector.go.release()
        drone.wait_for(settled(0))


def test_the_token_follows_the_service_and_a_drain_turns_frames_away():
    """Drones see the worker while it takes frames; what comes later is told to go elsewhere."""
    detector = HeldDetector()
    key = worker_key("w1")
    with running(detector) as service, flying(service.endpoint) as drone:
        drone.wait_for(lambda d: d.workers.get(key))
        drone.send(frame(0))
        assert detector.entered.acquire(timeout=20)

        def meanwhile(_):
            drone.wait_for(lambda d: d.workers[key] is False)
            drone.send(frame(1))
            drone.wait_for(settled(1))

        detector.go.release()
        assert service.service.drain(meanwhile)
        drone.wait_for(settled(0))
        told = {r.sequence: (r.outcome, r.draining) for r in drone.results}
        assert told == {0: (Outcome.TARGET, told[0][1]), 1: (Outcome.DRAINING, True)}


def test_no_answer_is_lost_in_a_burst():
    """Acks and results in quick succession all arrive: the link's queue has room for so many."""
    with running() as service, flying(service.endpoint) as drone:
        for sequence in range(BURST):
            drone.send(frame(sequence, bare=True))
        drone.wait_for(lambda d: len(d.results) == BURST)
        assert drone.acks == list(range(BURST))
        assert drone.results[-1].sequence == BURST - 1  # the newest is worked on last


def test_two_drones_are_served_apart():
    """Each drone gets its own results and nobody else's, before everything and never late."""
    with (
        running() as service,
        flying(service.endpoint, "d1") as first,
        flying(service.endpoint, "d2") as second,
    ):
        first.send(frame(0, drone="d1"))
        second.send(frame(9, drone="d2"))
        first.wait_for(settled(0))
        second.wait_for(settled(9))
        urgent = (str(zenoh.Priority.REAL_TIME), True, str(zenoh.CongestionControl.DROP))
        assert first.urgency == {urgent}
        assert {m.drone for m in first.received} == {"d1"}
        assert {m.drone for m in second.received} == {"d2"}


def test_it_joins_an_outside_router_that_comes_later():
    """Told to join a router, it opens no port, is not ready without it, and finds it in time."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    service = Running(ZenohAddress(connect=(endpoint,)), endpoint)
    assert not service.state.readiness()["link_open"]
    with open_session("router", listen=[endpoint]), flying(endpoint) as drone:
        assert service.state.readiness()["link_open"]
        drone.send(frame(0))
        drone.wait_for(settled(0))
        assert drone.results[0].outcome is Outcome.TARGET
        service.service.drain(lambda _: None)
    assert not service.state.readiness()["link_open"]


def test_a_taken_port_is_one_line():
    """The line says which address, what is wrong and what to do."""
    with running() as service, pytest.raises(AddressError) as error:
        ZenohTransport("w2", ZenohAddress(listen=(service.endpoint,))).open()
    line = str(error.value)
    assert line.startswith(f"Zenoh on {service.endpoint}: Address already in use")
    assert "--listen or EDGE_ZENOH_LISTEN" in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [
        ("tcp/127.0.0.1:99999", "invalid port"),
        ("tcp/192.0.2.1:7447", "Cannot assign requested address"),
        ("carrier-pigeon/loft:1", "not supported"),
        ("nonsense", "<protocol>/<address>"),
    ],
)
def test_an_impossible_address_is_one_line(endpoint, words):
    """Whatever Zenoh says of it, without the places in its own source."""
    with pytest.raises(AddressError) as error:
        ZenohTransport("w1", ZenohAddress(listen=(endpoint,))).open()
    line = str(error.value)
    assert words in line
    assert ".rs" not in line
    assert "\n" not in line


def test_closed_it_sends_no_more():
    """A send after the end says that nothing was sent, and closing twice is fine."""
    transport = ZenohTransport("w1", ZenohAddress(listen=(f"tcp/127.0.0.1:{free_port()}",)))
    assert not transport.send("d1", b"too early")
    transport.open()
    assert transport.is_open
    assert transport.send("d1", b"nobody hears it")
    transport.close()
    transport.close()
    assert not transport.is_open
    assert not transport.send("d1", b"too late")
