"""The UDP tunnel, both ends, over real sockets on loopback."""

from __future__ import annotations

import contextlib
import random
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drone_client.errors import LinkError
from drone_client.link.udp import UdpLink
from edge_service.errors import AddressError
from edge_service.transport.udp import RESETS_BURST, UdpTransport
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.tunnel.faults import REST_S
from rgbd_wire.tunnel.handshake import INIT_BYTES, pack_hello, pack_init, parse_cookie
from rgbd_wire.tunnel.keys import KeyFile
from rgbd_wire.tunnel.packet import Type, first_byte
from rgbd_wire.tunnel.seal import Cipher
from tests.integration.udp_ends import KEYS, Drone, Relay, Worker, eventually, write_keys

UP = first_byte(Type.UP)


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    return write_keys(tmp_path / "keys", KEYS)


@pytest.fixture
def stage() -> Iterator[Callable[[Any], Any]]:
    """Closes what is put on it, the last first."""
    with contextlib.ExitStack() as stack:

        def put(thing: Any) -> Any:
            inner = getattr(thing, "link", None) or getattr(thing, "transport", thing)
            stack.callback(inner.close)
            return thing

        yield put


def frame(seed: int, length: int = 60_000) -> bytes:
    return random.Random(seed).randbytes(length)


def test_frames_go_there_and_answers_come_back(keys: Path, stage: Any) -> None:
    """60 kB frames, probes and statuses, each whole, under the drone's name, stamped on arrival."""
    worker = stage(Worker(keys))
    drone = stage(Drone(worker.port))
    drone.up("worker-a")
    began_ns = time.monotonic_ns()
    for i in range(20):
        drone.ask(frame(i))
    drone.link.send_urgent("worker-a", b"p" * 64)
    eventually(lambda: b"p" * 64 in drone.got)
    worker.transport.publish(b"status")
    eventually(lambda: b"status" in drone.got)
    assert {name for name, _, _ in worker.got} == {"drone-1"}
    assert all(began_ns < t2_ns < time.monotonic_ns() for _, _, t2_ns in worker.got)
    assert drone.changes == [("worker-a",)]
    state = drone.link.state("worker-a")
    assert state.goodput_bps > 0
    assert state.srtt_ns > 0
    assert worker.counts() == {}
    assert not any(drone.link.counters().values())


@pytest.mark.parametrize("every", [50, 12])
def test_losses_are_made_good(keys: Path, stage: Any, every: int) -> None:
    """Every 50th, every 12th sealed datagram of a frame is lost: all frames arrive."""
    worker = stage(Worker(keys))
    count = [0]

    def lost(up: bool, datagram: bytes) -> bool:
        count[0] += up and len(datagram) > 600
        return up and len(datagram) > 600 and count[0] % every == 0

    relay = stage(Relay(worker.port, lost))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    for i in range(30):
        drone.ask(frame(i))
    assert [data for _, data, _ in worker.got] == [frame(i) for i in range(30)]


def test_lost_handshakes_are_tried_again(keys: Path, stage: Any) -> None:
    """The first of each packet of the handshake is lost: the session comes, and only one."""
    worker = stage(Worker(keys))
    first = {Type.INIT, Type.COOKIE, Type.HELLO, Type.WELCOME}

    def lost(up: bool, datagram: bytes) -> bool:
        kind = Type(datagram[0] & 15)
        if kind in first:
            first.discard(kind)
            return True
        return False

    relay = stage(Relay(worker.port, lost))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    assert not first
    assert worker.transport.sessions() == 1
    drone.ask(frame(1))


def test_a_restarted_worker_resets_and_is_found_again(keys: Path, stage: Any) -> None:
    """A worker that knows no session says so; the drone shakes hands and goes on."""
    worker = Worker(keys)
    relay = stage(Relay(worker.port, lambda up, datagram: False))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    drone.ask(frame(1))
    # Killed, not stopped: nobody says goodbye
    worker.transport._announced = False
    worker.transport.close()
    again = stage(Worker(keys, port=worker.port))
    eventually(lambda: again.transport.sessions() == 1)
    eventually(lambda: (drone.link.send("worker-a", frame(2), 10**9), again.got)[1])
    assert again.counts().get("unknown_session")
    assert any(datagram[0] & 15 == Type.RESET for up, datagram in relay.seen if not up)


def test_a_worker_that_is_gone_is_noticed_at_once(keys: Path, stage: Any) -> None:
    """The port is closed: the next sign of life says so, and a new worker there is found."""
    worker = Worker(keys)
    drone = stage(Drone(worker.port))
    drone.up("worker-a")
    worker.transport._announced = False
    worker.transport.close()
    drone.up()
    again = stage(Worker(keys, name="worker-b", port=worker.port))
    drone.up("worker-b")
    drone.ask(frame(1), "worker-b")
    assert again.got
    assert drone.changes == [("worker-a",), (), ("worker-b",)]


def test_a_port_unreachable_ends_a_session_for_good(keys: Path, stage: Any) -> None:
    """Also if the worker is there, and answers in it: the next session brings it back."""
    worker = stage(Worker(keys))
    relay = stage(Relay(worker.port, lambda up, datagram: False))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    (endpoint,) = drone.link._endpoints
    line = endpoint.line
    line.refused = True
    drone.link._rouse()
    eventually(lambda: drone.changes == [("worker-a",), (), ("worker-a",)])
    assert endpoint.line is not line
    assert worker.transport.sessions() == 2
    drone.ask(frame(1))


def test_a_draining_worker_leaves_the_list_and_still_answers(keys: Path, stage: Any) -> None:
    """A goodbye takes a worker out; what is under way is answered; announced again it is back."""
    worker = stage(Worker(keys))
    drone = stage(Drone(worker.port))
    drone.up("worker-a")
    worker.transport.withdraw()
    drone.up()
    assert worker.transport.send("drone-1", b"late answer")
    eventually(lambda: b"late answer" in drone.got)
    assert drone.link.workers() == ()  # what still comes in that session does not bring it back
    worker.transport.announce()
    drone.up("worker-a")
    drone.ask(frame(1))


def test_a_goodbye_that_is_lost_is_said_again(keys: Path, stage: Any) -> None:
    """Nothing comes down while the worker withdraws; the drone learns it afterwards."""
    worker = stage(Worker(keys))
    deaf = [False]
    relay = stage(Relay(worker.port, lambda up, datagram: deaf[0] and not up))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    deaf[0] = True
    worker.transport.withdraw()
    deaf[0] = False
    drone.up()


def test_before_announce_nobody_is_welcomed(keys: Path, stage: Any) -> None:
    """Hellos are counted and not answered until the worker takes frames."""
    transport = stage(UdpTransport("worker-a", "udp/127.0.0.1:0", KeyFile(keys)))
    transport.open()
    transport.start(lambda drone, data, t2_ns: None)
    drone = stage(Drone(transport.port))
    eventually(lambda: transport.counters()["not_announced"] > 1)
    assert drone.link.workers() == ()
    transport.announce()
    drone.up("worker-a")


def test_unheard_takes_another_port(keys: Path, stage: Any) -> None:
    """A path that swallows everything from one port: the new port gets through."""
    worker = stage(Worker(keys))
    dead: set[bytes] = set()
    relay = stage(Relay(worker.port, lambda up, datagram: up and datagram[1:9] in dead))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    sessions = {datagram[1:9] for up, datagram in relay.seen if up and datagram[0] == UP}
    dead |= sessions
    drone.link.unheard("worker-a")
    eventually(lambda: {d[1:9] for up, d in list(relay.seen) if up and d[0] == UP} - sessions)
    drone.ask(frame(1))
    assert drone.changes == [("worker-a",)]


def test_a_silent_worker_is_down_after_a_second_and_up_again(keys: Path, stage: Any) -> None:
    """Everything is lost for a while: the worker leaves the list, and comes back with the path."""
    worker = stage(Worker(keys))
    cut = [False]
    relay = stage(Relay(worker.port, lambda up, datagram: cut[0]))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    cut[0] = True
    drone.up()
    cut[0] = False
    drone.up("worker-a")
    drone.ask(frame(1))


def test_a_session_follows_its_drone_to_another_address(keys: Path, stage: Any) -> None:
    """A NAT gives the drone another port in mid-session: answers follow the newest datagram."""
    worker = stage(Worker(keys))
    relay = stage(Relay(worker.port, lambda up, datagram: False))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    drone.ask(frame(1))
    relay._backs.clear()
    drone.ask(frame(2))
    assert worker.transport.sessions() == 1


def test_two_workers_and_two_ways_to_one(keys: Path, stage: Any) -> None:
    """Every worker is there once, also if two endpoints lead to it."""
    a, b = stage(Worker(keys)), stage(Worker(keys, name="worker-b"))
    relay = stage(Relay(a.port, lambda up, datagram: False))
    drone = stage(Drone(a.port, relay.port, b.port))
    drone.up("worker-a", "worker-b")
    drone.ask(frame(1), "worker-a")
    drone.ask(frame(2), "worker-b")
    assert [len(a.got), len(b.got)] == [1, 1]


def test_many_drones_at_once(keys: Path, stage: Any) -> None:
    """Eight drones of one worker: each gets its own answers and nobody else's."""
    worker = stage(Worker(keys))
    drones = [stage(Drone(worker.port, name=name)) for name in KEYS]
    for drone in drones:
        drone.up("worker-a")
    for i, drone in enumerate(drones):
        drone.ask(frame(i))
    for i, drone in enumerate(drones):
        assert drone.got == [frame(i)[:500]]


def test_a_key_that_is_taken_away_ends_its_session(keys: Path, stage: Any) -> None:
    """The file changes while the worker runs: one drone is out, the other one flies on."""
    worker = stage(Worker(keys))
    out, stays = stage(Drone(worker.port)), stage(Drone(worker.port, name="drone-2"))
    out.up("worker-a")
    stays.up("worker-a")
    write_keys(keys, {"drone-2": KEYS["drone-2"]})
    out.up()
    assert stays.link.workers() == ("worker-a",)
    stays.ask(frame(1))
    assert not worker.transport.send("drone-1", b"x")
    eventually(lambda: worker.counts().get("unknown_drone"))
    write_keys(keys, KEYS)
    out.up("worker-a")


def test_a_wrong_key_gets_no_answer(keys: Path, stage: Any) -> None:
    """Who does not hold the drone's key learns nothing, and no session is made."""
    worker = stage(Worker(keys))
    drone = stage(Drone(worker.port, key=b"x" * 32))
    eventually(lambda: worker.counts().get("bad_mac"))
    assert worker.transport.sessions() == 0
    assert drone.link.workers() == ()


def test_replayed_and_reflected_datagrams_change_nothing(keys: Path, stage: Any) -> None:
    """All that was ever sent, sent again from elsewhere, to both ends: nothing comes of it."""
    worker = stage(Worker(keys))
    relay = stage(Relay(worker.port, lambda up, datagram: False))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    drone.ask(frame(1))
    drone.ask(frame(2))
    recorded = list(relay.seen)
    came = len(drone.got)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        thief.bind(("127.0.0.1", 0))
        for _, datagram in recorded:
            thief.sendto(datagram, ("127.0.0.1", worker.port))
    client = next(iter(relay._backs))
    for up, datagram in recorded:
        if up:  # its own words, from where the worker's come
            relay._front.sendto(datagram, client)
    drone.ask(frame(3))
    assert [data for _, data, _ in worker.got] == [frame(i) for i in (1, 2, 3)]
    assert len(drone.got) == came + 1
    assert worker.transport.sessions() == 1
    counts = worker.counts()
    assert counts["replayed"] > 100
    assert counts["bad_cookie"] >= 1  # the HELLO, from another address


def test_a_flood_of_hellos_makes_no_session(keys: Path, stage: Any) -> None:
    """INITs from many ports, HELLOs with a wrong MAC: nothing is kept, drones are served."""
    worker = stage(Worker(keys))
    drone = stage(Drone(worker.port))
    drone.up("worker-a")
    place = ("127.0.0.1", worker.port)
    with contextlib.ExitStack() as stack:
        for i in range(100):
            sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            sock.settimeout(5)
            sock.connect(place)
            nonce = i.to_bytes(16, "big")
            sock.send(pack_init(nonce))
            answer = sock.recv(2048)
            assert len(answer) <= INIT_BYTES
            _, cookie = parse_cookie(answer)
            for name in ("drone-1", "nobody"):
                sock.send(pack_hello(name, b"y" * 32, nonce, cookie, bytes(32), Cipher.AES_256_GCM))
        eventually(lambda: worker.counts().get("unknown_drone", 0) >= 100)
    assert worker.counts()["bad_mac"] == 100
    assert worker.transport.sessions() == 1
    drone.ask(frame(1))
    stage(Drone(worker.port, name="drone-2")).up("worker-a")


def test_nothing_is_answered_with_more_than_came(keys: Path, stage: Any) -> None:
    """Noise of every length and every first byte: answers are shorter, and RESETs are rationed."""
    worker = stage(Worker(keys))
    rng = random.Random(5)
    answers = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", worker.port))
        sock.settimeout(0.2)
        for kind in range(16):
            for length in (1, 9, 10, 30, 31, 63, 64, 65, 160, 1200):
                sock.setblocking(True)
                sock.send(bytes([16 | kind]) + rng.randbytes(length - 1))
                sock.settimeout(0.02)
                with contextlib.suppress(TimeoutError):
                    assert len(sock.recv(2048)) <= length
                    answers += 1
    # An INIT of the right length, and RESETs for sealed datagrams of no session
    assert 1 < answers < 16
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", worker.port))
        for _ in range(4 * RESETS_BURST):
            sock.send(bytes([UP]) + rng.randbytes(99))
        eventually(lambda: worker.counts()["unknown_session"] >= 4 * RESETS_BURST)
        sock.settimeout(0.1)
        resets = 0
        with contextlib.suppress(TimeoutError):
            while sock.recv(2048):
                resets += 1
    assert 0 < resets < 3 * RESETS_BURST


def test_a_forged_reset_ends_nothing(keys: Path, stage: Any) -> None:
    """A RESET that anybody could have sent leads to a handshake; the drone is served throughout."""
    worker = stage(Worker(keys))
    relay = stage(Relay(worker.port, lambda up, datagram: False))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    session = next(d[1:9] for up, d in relay.seen if d[0] == UP)
    client = next(iter(relay._backs))
    relay._front.sendto(bytes([first_byte(Type.RESET)]) + session, client)
    for i in range(10):
        drone.ask(frame(i))
    assert drone.changes == [("worker-a",)]


def test_a_drone_that_floods_is_held_to_its_quota(keys: Path, stage: Any) -> None:
    """What is past a drone's quota is dropped, and the frames of another one all arrive."""
    worker = stage(Worker(keys))
    flood, calm = stage(Drone(worker.port, name="drone-2")), stage(Drone(worker.port))
    flood.up("worker-a")
    calm.up("worker-a")
    for i in range(15):
        for _ in range(100):
            flood.link.send_urgent("worker-a", frame(99, 64))
        calm.ask(frame(i))
    assert worker.counts()["drone_rate"] > 0
    assert [d for name, d, _ in worker.got if name == "drone-1"] == [frame(i) for i in range(15)]


def test_addresses_and_keys_that_cannot_be_used_are_named(keys: Path, stage: Any) -> None:
    """Both ends say what is wrong with what they were given."""
    worker = stage(Worker(keys))
    with pytest.raises(AddressError, match=f"udp/127.0.0.1:{worker.port}: .* in use"):
        UdpTransport("b", f"udp/127.0.0.1:{worker.port}", KeyFile(keys)).open()
    with pytest.raises(AddressError, match="did you mean udp/127.0.0.1:1?"):
        UdpTransport("b", "127.0.0.1:1", KeyFile(keys)).open()
    clock = MonotonicClock()
    with pytest.raises(LinkError, match="0 endpoints"):
        UdpLink("drone-1", (), KEYS["drone-1"], clock)
    with pytest.raises(LinkError, match="is not udp/HOST:PORT"):
        UdpLink("drone-1", ("tcp/127.0.0.1:1",), KEYS["drone-1"], clock)
    with pytest.raises(LinkError, match="a key of 5 bytes"):
        UdpLink("drone-1", ("udp/127.0.0.1:1",), b"short", clock)


def test_a_name_is_resolved_until_one_of_its_addresses_answers(keys: Path, stage: Any) -> None:
    """``localhost`` may be ::1 first: the next try takes its next address."""
    worker = stage(Worker(keys))
    drone = stage(Drone(worker.port, host="localhost"))
    drone.up("worker-a")
    drone.ask(frame(1))


def test_a_host_that_is_no_name_is_told_of_and_costs_no_other(
    keys: Path, stage: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """A label of 64 letters is refused by the resolver in a way of its own."""
    worker = stage(Worker(keys))
    endpoints = (f"udp/{'a' * 64}.example:1", f"udp/127.0.0.1:{worker.port}")
    link = stage(UdpLink("drone-1", endpoints, KEYS["drone-1"], MonotonicClock()))
    link.start(lambda message, t4_ns: None, lambda: None)
    eventually(lambda: link.workers() == ("worker-a",))
    eventually(lambda: "not a host name" in caplog.text)
    assert link.counters()["fault"] == 0


def test_keys_are_renewed_in_flight(
    keys: Path, stage: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After so many datagrams comes another session, and no frame is lost over it."""
    monkeypatch.setattr("drone_client.link.udp_endpoint.RESEAL_AFTER", 200)
    worker = stage(Worker(keys))
    relay = stage(Relay(worker.port, lambda up, datagram: False))
    drone = stage(Drone(relay.port))
    drone.up("worker-a")
    for i in range(20):
        drone.ask(frame(i))
    assert len({datagram[1:9] for up, datagram in relay.seen if datagram[0] == UP}) > 2
    assert drone.changes == [("worker-a",)]


def test_an_application_that_raises_costs_one_message(
    keys: Path, stage: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """On either end: counted, logged once, both go on, and the worker counts as alive."""
    worker = stage(Worker(keys))
    drone = stage(Drone(worker.port))
    drone.up("worker-a")
    good = worker.transport._on_message, drone.link._on_message

    def bad(*_: object) -> None:
        raise RuntimeError("of the application's own")

    worker.transport._on_message = bad
    for i in range(3):
        drone.link.send("worker-a", frame(i, 500), 10**9)
    eventually(lambda: worker.counts().get("fault") == 3)
    worker.transport._on_message, drone.link._on_message = good[0], bad
    drone.link.send("worker-a", frame(3, 500), 10**9)
    eventually(lambda: drone.link.counters()["fault"] == 1)
    drone.link._on_message = good[1]
    drone.ask(frame(4))
    assert worker.transport.is_alive
    assert [r.message for r in caplog.records] == ["fault in the application; it goes on"] * 2


def test_a_thread_that_fails_goes_on_and_rests(
    keys: Path, stage: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sockets, timers and the pump raise what nobody thought of: all goes on once they are well."""
    worker = stage(Worker(keys))
    drone = stage(Drone(worker.port))
    drone.up("worker-a")

    def bad(*_: object) -> None:
        raise RuntimeError("unheard of")

    with monkeypatch.context() as patch:
        patch.setattr("rgbd_wire.tunnel.channel.Channel.pump", bad)
        drone.link.send("worker-a", frame(1, 400_000), 10**9)
        eventually(lambda: drone.link.counters()["fault"])
        patch.setattr("rgbd_wire.tunnel.datagrams.DatagramSocket.receive", bad)
        patch.setattr("rgbd_wire.tunnel.sessions.Sessions.expire", bad)
        drone.link.send("worker-a", frame(2), 10**9)
        began_s = time.monotonic()
        eventually(lambda: worker.counts().get("fault", 0) > 5)
        faults, waited_s = worker.counts()["fault"], time.monotonic() - began_s
        assert faults < 5 + 2 * waited_s / REST_S  # it does not spin
    drone.up("worker-a")
    drone.ask(frame(3))


def test_a_worker_whose_thread_is_gone_is_not_alive(keys: Path, stage: Any) -> None:
    """What no boundary holds ends the thread: the worker is neither alive nor open."""
    worker = stage(Worker(keys))
    assert worker.transport.is_alive
    pump = worker.transport._pump
    pump.close()
    assert not worker.transport.is_alive
    assert not worker.transport.is_open


def test_nothing_runs_on_after_close(keys: Path) -> None:
    """Closed ends send and hand over nothing, and may be closed again."""
    worker, drone = Worker(keys), Drone(1)
    for _ in range(2):
        worker.transport.close()
        drone.link.close()
    assert not worker.transport.is_open
    assert not worker.transport.send("drone-1", b"x")
    drone.link.send("worker-a", b"x", 1)
    assert drone.link.counters()["not_sent"] == 1
