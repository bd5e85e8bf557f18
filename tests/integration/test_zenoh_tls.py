"""Mutual TLS and the access rules, over real sessions on the loopback."""

from __future__ import annotations

import queue
import socket
import ssl
from datetime import timedelta

import pytest
import zenoh

from drone_client.errors import LinkError
from drone_client.link.zenoh import ZenohLink
from edge_service.errors import AddressError
from edge_service.transport.zenoh import ZenohAddress, ZenohTransport
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.streams import FRAME, PREFIX, RESULT, worker_key, worker_status_key
from rgbd_wire.tls_files import tls_files
from tests.certificates import make_ending, make_ends
from tests.integration.zenoh_drone import open_session
from tests.service_process import free_port
from tests.unit.drone_client.builders import eventually

DRONES = ("drone-1", "drone-2")
BUDGET_NS = 250_000_000
WAIT_S = 20.0


class Worker:
    """A transport with TLS that sends each message back to the drone of its key."""

    def __init__(self, folder, name="worker-a", **address):
        self.endpoint = f"tls/localhost:{free_port()}"
        self.got = queue.Queue()
        fields = {"listen": (self.endpoint,), "drones": DRONES} | address
        self.transport = ZenohTransport(name, ZenohAddress(tls=tls_files(folder), **fields))
        self.transport.open()
        self.transport.start(self._on_message)
        self.transport.announce()

    def _on_message(self, drone, data, _t2_ns):
        self.got.put((drone, bytes(data)))
        self.transport.send(drone, data)


class Drone:
    """A link with TLS and what came in over it."""

    def __init__(self, folder, name, *endpoints):
        self.got = queue.Queue()
        self.link = ZenohLink(name, endpoints, MonotonicClock(), tls_files(folder))
        self.link.start(lambda data, _t4_ns: self.got.put(data), lambda: None)

    def sees(self, *workers):
        """Whether these workers are there before long."""
        return eventually(lambda: self.link.workers() == workers, timeout_s=WAIT_S)


@pytest.fixture(scope="module")
def ends(tmp_path_factory):
    """Folders of two drones and a worker under one authority."""
    return make_ends(tmp_path_factory.mktemp("ends"))


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """The same names under another authority."""
    return make_ends(tmp_path_factory.mktemp("foreign"))


@pytest.fixture(scope="module")
def worker(ends):
    """A worker that lives."""
    worker = Worker(ends / "worker-a")
    yield worker
    worker.transport.close()


@pytest.fixture
def start_drone(ends, worker):
    """Starts drones, and closes their links whatever becomes of the test."""
    started = []

    def start(name, *endpoints):
        started.append(Drone(ends / name, name, *(endpoints or (worker.endpoint,))))
        return started[-1]

    yield start
    for drone in started:
        drone.link.close()


@pytest.fixture
def second(ends, worker):
    """A bare session with the certificate of drone-2, which may try whatever it likes."""
    files = tls_files(ends / "drone-2")
    tls = {
        "transport/link/tls/root_ca_certificate": str(files.ca),
        "transport/link/tls/connect_certificate": str(files.certificate),
        "transport/link/tls/connect_private_key": str(files.key),
        "transport/link/tls/enable_mtls": True,
    }
    with open_session("peer", connect=[worker.endpoint], more=tls) as session:
        publisher = session.declare_publisher(FRAME.key("drone-2", "worker-a"))
        assert eventually(lambda: publisher.matching_status.matching, timeout_s=WAIT_S)
        yield session


def put(session, key, data):
    """Publish so that nothing is lost."""
    session.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)


def test_a_drone_with_its_own_certificate_is_served(worker, start_drone):
    """Token, frame, probe, answer and status all pass the rules."""
    drone = start_drone("drone-1")
    assert drone.sees("worker-a")
    drone.link.send("worker-a", b"frame", BUDGET_NS)
    assert worker.got.get(timeout=WAIT_S) == ("drone-1", b"frame")
    assert drone.got.get(timeout=WAIT_S) == b"frame"
    drone.link.send_urgent("worker-a", b"probe")
    assert worker.got.get(timeout=WAIT_S) == ("drone-1", b"probe")
    assert drone.got.get(timeout=WAIT_S) == b"probe"
    worker.transport.publish(b"status")
    assert drone.got.get(timeout=WAIT_S) == b"status"
    worker.transport.withdraw()
    assert drone.sees()
    worker.transport.announce()
    assert drone.sees("worker-a")


def test_a_drone_cannot_send_as_another(worker, second):
    """What drone-2 sends under the name of drone-1 never arrives; what it sends as itself does."""
    put(second, FRAME.key("drone-1", "worker-a"), b"forged")
    put(second, FRAME.key("drone-2", "worker-a"), b"honest")
    assert worker.got.get(timeout=WAIT_S) == ("drone-2", b"honest")
    assert worker.got.empty()


@pytest.mark.parametrize("key", [RESULT.key("drone-1", "*"), f"{PREFIX}/**", "**"])
def test_a_drone_cannot_read_what_is_for_another(worker, second, start_drone, key):
    """Neither by its key nor by a wildcard; its own answers still come."""
    heard = queue.Queue()
    second.declare_subscriber(key, heard.put)
    own = queue.Queue()
    second.declare_subscriber(RESULT.key("drone-2", "*"), own.put)
    drone = start_drone("drone-1")
    assert drone.sees("worker-a")
    for i in range(5):
        drone.link.send("worker-a", b"%d" % i, BUDGET_NS)
        assert drone.got.get(timeout=WAIT_S) == b"%d" % i
        assert worker.got.get(timeout=WAIT_S) == ("drone-1", b"%d" % i)
    put(second, FRAME.key("drone-2", "worker-a"), b"own")
    assert own.get(timeout=WAIT_S).payload.to_bytes() == b"own"
    assert worker.got.get(timeout=WAIT_S) == ("drone-2", b"own")
    keys = set()
    while not heard.empty():
        keys.add(str(heard.get().key_expr))
    assert not any("drone-1" in k for k in keys)


def test_a_drone_cannot_pass_for_a_worker(worker, second, start_drone):
    """It can put up no token, and nothing that it says as a worker reaches another drone."""
    drone = start_drone("drone-1")
    assert drone.sees("worker-a")
    second.liveliness().declare_token(worker_key("rogue"))
    put(second, worker_status_key("worker-a"), b"false status")
    put(second, RESULT.key("drone-1", "worker-a"), b"false answer")
    put(second, FRAME.key("drone-2", "worker-a"), b"after them")
    assert worker.got.get(timeout=WAIT_S) == ("drone-2", b"after them")
    drone.link.send("worker-a", b"last", BUDGET_NS)
    assert drone.got.get(timeout=WAIT_S) == b"last"
    assert worker.got.get(timeout=WAIT_S) == ("drone-1", b"last")
    assert drone.link.workers() == ("worker-a",)


def test_a_drones_certificate_is_none_of_a_worker(ends, worker, start_drone):
    """A drone that listens where a worker should be is not connected to."""
    rogue = Worker(ends / "drone-2", "rogue")
    drone = start_drone("drone-1", rogue.endpoint, worker.endpoint)
    assert drone.sees("worker-a")
    rogue.transport.close()


def test_a_worker_at_an_address_that_its_certificate_does_not_name_is_none(
    ends, worker, start_drone
):
    """The right authority is not enough: the certificate says where its worker is reached."""
    elsewhere = f"tls/127.0.0.2:{free_port()}"
    moved = Worker(ends / "worker-a", "moved", listen=(elsewhere,))
    drone = start_drone("drone-1", elsewhere, worker.endpoint)
    assert drone.sees("worker-a")
    moved.transport.close()


def refused(endpoint, folder):
    """How a worker refuses a TLS handshake: the name of its alert; None: it does not."""
    context = ssl.create_default_context(cafile=str(folder / "ca.pem"))
    if (folder / "cert.pem").exists():
        context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
    port = int(endpoint.rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as raw:
        try:
            with context.wrap_socket(raw, server_hostname="localhost") as tls:
                tls.recv(1)  # the answer to our certificate comes after our half of the handshake
        except ssl.SSLCertVerificationError:
            return "we refuse it"
        except ssl.SSLError as error:
            return str(error.reason)
    return None


def test_only_a_valid_certificate_of_the_same_authority_opens_the_door(
    ends, foreign, worker, tmp_path
):
    """Expired, foreign and missing ones get an alert; the right one gets none."""
    expired = make_ending(ends, "drone-1", -timedelta(hours=1))
    bare = tmp_path / "bare"
    bare.mkdir()
    (bare / "ca.pem").write_bytes((ends / "drone-1" / "ca.pem").read_bytes())
    stranger = tmp_path / "stranger"  # believes our authority, and shows another's certificate
    stranger.mkdir()
    for name in ("cert.pem", "key.pem"):
        (stranger / name).write_bytes((foreign / "drone-1" / name).read_bytes())
    (stranger / "ca.pem").write_bytes((ends / "drone-1" / "ca.pem").read_bytes())
    assert refused(worker.endpoint, ends / "drone-1") is None
    assert "EXPIRED" in refused(worker.endpoint, expired)
    assert refused(worker.endpoint, bare)
    assert refused(worker.endpoint, stranger)
    assert refused(worker.endpoint, foreign / "drone-1") == "we refuse it"


def test_a_connection_ends_with_its_certificate(ends, worker):
    """A drone that has been let in stays no longer than its certificate says."""
    files = tls_files(make_ending(ends, "drone-1", timedelta(seconds=4)))
    assert "expires on" in files.warnings[0]
    seen = queue.Queue()
    link = ZenohLink("drone-1", (worker.endpoint,), MonotonicClock(), files)
    link.start(lambda *_: None, lambda: seen.put(link.workers()))
    assert seen.get(timeout=WAIT_S) == ("worker-a",)
    assert seen.get(timeout=WAIT_S) == ()
    link.close()


def test_a_peer_without_tls_gets_nowhere(worker):
    """The port speaks TLS: plain Zenoh is answered by an alert, or by the end."""
    port = int(worker.endpoint.rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as raw:
        raw.sendall(b"\x11\x00\x41\x09\x0a" + bytes(20))
        assert raw.recv(1) in (b"\x15", b"")


def test_a_drone_that_is_not_named_is_connected_and_deaf(ends, foreign, tmp_path):
    """A valid certificate is not enough: the worker names who flies here."""
    worker = Worker(ends / "worker-a", drones=("drone-1",))
    try:
        first = Drone(ends / "drone-1", "drone-1", worker.endpoint)
        other = Drone(ends / "drone-2", "drone-2", worker.endpoint)
        assert first.sees("worker-a")
        assert eventually(lambda: other.link._session.info.routers_zid(), timeout_s=WAIT_S)
        other.link.send("worker-a", b"unknown", BUDGET_NS)
        first.link.send("worker-a", b"known", BUDGET_NS)
        assert worker.got.get(timeout=WAIT_S) == ("drone-1", b"known")
        assert other.link.workers() == ()
        first.link.close()
        other.link.close()
    finally:
        worker.transport.close()


def test_a_worker_joins_another_with_its_certificate(tmp_path):
    """The drone sees both behind one address, and each answers under its own name."""
    ends = make_ends(tmp_path / "ends", workers=("worker-a", "worker-b"))
    router = Worker(ends / "worker-a", workers=("worker-b",))
    joined = Worker(ends / "worker-b", "worker-b", listen=(), connect=(router.endpoint,), drones=())
    drone = Drone(ends / "drone-1", "drone-1", router.endpoint)
    try:
        assert drone.sees("worker-a", "worker-b")
        for message in (b"one", b"two"):
            drone.link.send("worker-b", message, BUDGET_NS)
            assert joined.got.get(timeout=WAIT_S) == ("drone-1", message)
            assert drone.got.get(timeout=WAIT_S) == message
        joined.transport.publish(b"status")
        assert drone.got.get(timeout=WAIT_S) == b"status"
        assert router.got.empty()
    finally:
        drone.link.close()
        joined.transport.close()
        router.transport.close()


def test_a_drone_with_the_certificate_of_another_is_told_before_it_connects(ends):
    """The line names both."""
    with pytest.raises(LinkError, match="'drone-2'.*'drone-1'"):
        ZenohLink("drone-1", ("tls/localhost:1",), MonotonicClock(), tls_files(ends / "drone-2"))


def test_plain_and_encrypted_do_not_mix(ends):
    """A plain endpoint beside certificates would be a door without a lock."""
    files = tls_files(ends / "drone-1")
    with pytest.raises(LinkError, match="tcp/a:1 is not encrypted"):
        ZenohLink("drone-1", ("tls/b:1", "tcp/a:1"), MonotonicClock(), files)
    with pytest.raises(LinkError, match="DRONE_TLS"):
        ZenohLink("drone-1", ("tls/b:1",), MonotonicClock())
    files = tls_files(ends / "worker-a")
    with pytest.raises(AddressError, match="would let in whoever comes"):
        ZenohAddress(listen=("tcp/0.0.0.0:7447",), tls=files, drones=DRONES).config()
    with pytest.raises(AddressError, match="EDGE_ZENOH_DRONES"):
        ZenohAddress(listen=("tls/0.0.0.0:7447",), tls=files).config()
    for name in ("workers", "Drone", "*"):
        with pytest.raises(AddressError, match="cannot be the name of a drone"):
            ZenohAddress(listen=("tls/0.0.0.0:7447",), tls=files, drones=(name,)).config()
