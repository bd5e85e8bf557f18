"""Somebody hostile at a real service: the drones that belong there do not notice."""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import threading

import pytest

from rgbd_wire.messages import Outcome
from rgbd_wire.tunnel.handshake import pack_hello, pack_init
from rgbd_wire.tunnel.seal import Cipher
from tests.integration.hostile import (
    KEYS,
    UP,
    Service,
    ask,
    ask_until_answered,
    frame,
    received_bytes,
    udp_socket,
    until,
)
from tests.integration.udp_drone import tunnelling
from tests.integration.udp_ends import Relay, write_keys
from tests.integration.zenoh_drone import flying

TCP_REPAIR = 19
MAX_GROWTH_BYTES = 24 * 1024 * 1024
"""Of the service under a flood: what a frame and the allocator take, not a session for each."""


CALM_S = 0.05
"""Between two frames of a drone that keeps to its rate, however fast it is answered."""


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """One for all of these tests: what one adversary leaves behind, the next drone has to bear."""
    service = Service(tmp_path_factory.mktemp("adversaries"))
    service.process.start()
    try:
        service.process.wait_ready()
        yield service
        assert service.process.stop() == 0
        assert "Traceback" not in service.process.log.read_text()
    finally:
        if service.process.process.poll() is None:
            service.process.kill()


@contextlib.contextmanager
def relayed(service, name):
    """A drone that reaches the service through a relay, which records."""
    relay = Relay(service.udp_port, lambda up, datagram: False)
    try:
        with tunnelling(f"udp/127.0.0.1:{relay.port}", KEYS[name], name) as drone:
            yield relay, drone
    finally:
        relay.close()


def test_what_was_recorded_is_replayed_and_reflected(service):
    """From elsewhere and from the drone's own address, to both ends: no frame is taken twice."""
    with relayed(service, "d1") as (relay, drone):
        asked = [ask(drone, "d1") for _ in range(4)]
        recorded = list(relay.seen)
        before = service.refused("replayed")
        back, client = next((b, c) for c, b in relay._backs.items())
        with contextlib.closing(udp_socket()) as thief:
            for up, datagram in recorded:
                thief.sendto(datagram, service.place)  # both directions: replay and reflection
                back.send(datagram)
                if up:
                    relay._front.sendto(datagram, client)
            asked.append(ask(drone, "d1"))
            sealed = sum(up and datagram[0] == UP for up, datagram in recorded)
            until(lambda: service.refused("replayed") >= before + sealed)
            assert received_bytes(thief) <= sum(len(datagram) for _, datagram in recorded)
        assert drone.acks == asked
        assert [r.sequence for r in drone.results] == asked
        assert drone.link.workers() == ("w1",)
    assert service.refused("bad_cookie") >= 1  # the HELLO, from another address


def test_a_stolen_session_id_moves_nothing(service):
    """Made-up ciphertext under a drone's session id: the answers go on to the drone alone."""
    rng = random.Random(3)
    with relayed(service, "d1") as (relay, drone), contextlib.closing(udp_socket()) as thief:
        ask(drone, "d1")
        session = next(d[1:9] for up, d in relay.seen if up and d[0] == UP)
        before = service.refused("not_authentic")
        for n in range(10):
            for _ in range(200):
                number = rng.choice((n, 100, 2**20, 2**40 - 1)).to_bytes(5, "little")
                fake = bytes([UP]) + session + number + rng.randbytes(rng.choice((40, 1186)))
                with contextlib.suppress(BlockingIOError):
                    thief.sendto(fake, service.place)
            ask_until_answered(drone, "d1")
        assert received_bytes(thief) == 0
        assert service.refused("not_authentic") > before + 100
        assert service.refused("drone_rate") == 0  # the drone's quota is not the thief's to spend


def test_a_flood_from_many_ports_leaves_nothing_behind(service):
    """20 000 INITs and HELLOs from 500 ports: no memory, fewer bytes back, and a drone gets in."""
    rng = random.Random(4)
    with tunnelling(service.udp, KEYS["d2"], "d2") as old, contextlib.ExitStack() as stack:
        ask(old, "d2")
        sockets = [stack.enter_context(contextlib.closing(udp_socket())) for _ in range(500)]
        resident = service.resident_bytes()
        sent = answered = 0

        def flood():
            nonlocal sent, answered
            for round_ in range(40):
                for sock in sockets:
                    nonce = rng.randbytes(16)
                    hello = pack_hello(
                        rng.choice(("d1", "d2", "nobody")),
                        rng.randbytes(32),
                        nonce,
                        rng.randbytes(20),
                        rng.randbytes(32),
                        Cipher.AES_256_GCM,
                    )
                    what = pack_init(nonce) if round_ % 2 else hello
                    with contextlib.suppress(BlockingIOError):
                        sent += sock.sendto(what, service.place)
                answered += sum(received_bytes(sock) for sock in sockets)

        attack = threading.Thread(target=flood)
        attack.start()
        with tunnelling(service.udp, KEYS["d3"], "d3") as new:  # in the middle of it
            ask_until_answered(new, "d3")
            ask_until_answered(old, "d2")
        attack.join()
        ask_until_answered(old, "d2")
        answered += sum(received_bytes(sock) for sock in sockets)
        assert sent > 20_000 * 64
        assert 0 < answered < sent
        assert service.resident_bytes() - resident < MAX_GROWTH_BYTES
        assert service.refused("bad_cookie") > 1000


def test_with_cookies_but_no_key_nobody_gets_in(service):
    """HELLOs from addresses that answer, and an honest drone's software with a wrong key."""
    before = service.refused("bad_mac")
    with contextlib.closing(udp_socket()) as sock:
        sock.setblocking(True)
        sock.settimeout(5)
        for i in range(50):
            nonce = i.to_bytes(16, "big")
            sock.sendto(pack_init(nonce), service.place)
            cookie = sock.recv(2048)[17:37]
            hello = pack_hello("d1", bytes(range(32)), nonce, cookie, bytes(32), Cipher.AES_256_GCM)
            sock.sendto(hello, service.place)
        until(lambda: service.refused("bad_mac") >= before + 50)
        sock.setblocking(False)
        assert received_bytes(sock) == 0


def test_a_key_that_is_taken_away_is_out_for_good(service):
    """A session of it ends, its drone cannot come back, and the other one does not notice."""
    with (
        tunnelling(service.udp, KEYS["d4"], "d4") as out,
        tunnelling(service.udp, KEYS["d5"], "d5") as stays,
    ):
        ask(out, "d4")
        ask(stays, "d5")
        write_keys(service.keys, {n: k for n, k in KEYS.items() if n != "d4"})
        try:
            out.wait_for(lambda d: d.link.workers() == ())
            until(lambda: service.refused("unknown_drone") > 0)
            ask(stays, "d5")
            assert out.link.workers() == ()
        finally:
            write_keys(service.keys, KEYS)
        out.wait_for(lambda d: d.link.workers() == ("w1",))
        ask(out, "d4")


def garbage(rng):
    """Bytes that are no frame, that are one up to a point, and a frame that is spoilt."""
    _, whole = frame("d6")
    spoilt = bytearray(whole)
    spoilt[rng.randrange(len(spoilt))] ^= 0xFF
    return rng.choice((rng.randbytes(rng.choice((1, 64, 5000))), whole[:-9], bytes(spoilt)))


@pytest.mark.parametrize("network", ["udp", "zenoh"])
@pytest.mark.parametrize("what", ["frames", "garbage"])
def test_a_drone_gone_mad_takes_nothing_from_another(service, network, what):
    """Ten times its rate, or garbage in its session: the other one's frames are all answered."""
    rng, stop = random.Random(6), threading.Event()
    before = service.metrics()

    def reach(name):
        if network == "zenoh":
            return flying(service.process.endpoint, name)
        return tunnelling(service.udp, KEYS[name], name)

    with reach("d6") as mad, reach("d1") as calm:
        thrown = 0

        def rage():
            nonlocal thrown
            while not stop.wait(1 / 300):
                thrown += 1
                mad.send(frame("d6")[1] if what == "frames" else garbage(rng))

        attack = threading.Thread(target=rage)
        attack.start()
        asked = []
        try:
            while len(asked) < 40 or thrown < 200:
                asked.append(ask(calm, "d1"))
                stop.wait(CALM_S)
        finally:
            stop.set()
            attack.join()
        after = service.metrics()
        assert [r.sequence for r in calm.results] == asked
    more = {name: after[name] - before.get(name, 0) for name in after}
    turned_away = sum(n for name, n in more.items() if name.startswith("edge_rejected_total"))
    turned_away += more['edge_tunnel_refused_total{reason="drone_rate"}']
    assert turned_away > thrown / 4
    if what == "frames":
        looked_at = sum(
            more[f'edge_frames_total{{outcome="{outcome}"}}']
            for outcome in Outcome
            if outcome.looked_at
        )
        assert looked_at < len(asked) + thrown / 2


def vanish(sock):
    """Close a connection without a FIN, where that is allowed; else by a reset."""
    try:
        sock.setsockopt(socket.IPPROTO_TCP, TCP_REPAIR, 1)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    sock.close()


def test_half_open_connections_keep_nobody_out(service):
    """100 TCP connections that say nothing, and 20 that are gone without a word."""
    host, port = service.process.endpoint.removeprefix("tcp/").split(":")
    with contextlib.ExitStack() as stack:
        for _ in range(100):
            stack.enter_context(socket.create_connection((host, int(port)), timeout=5))
        for _ in range(20):
            gone = socket.create_connection((host, int(port)), timeout=5)
            gone.send(b"\x05\x00hello")
            vanish(gone)
        with flying(service.process.endpoint, "d1") as drone:
            ask(drone, "d1")
