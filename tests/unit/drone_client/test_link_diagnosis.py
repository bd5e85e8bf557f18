"""A silent endpoint is told in a sentence that says what to look at."""

from __future__ import annotations

import contextlib
import socket
from datetime import timedelta

import pytest

from drone_client.link.diagnosis import diagnose
from edge_service.transport.zenoh import ZenohAddress, ZenohTransport
from rgbd_wire.tls_files import tls_files
from tests.certificates import make_ending, make_ends
from tests.service_process import free_port

PATIENT_S = 20.0
"""For what is answered: a busy machine takes its time, and an idle one none of this."""


@pytest.fixture(scope="module")
def ends(tmp_path_factory):
    """Folders of two drones and a worker under one authority."""
    return make_ends(tmp_path_factory.mktemp("ends"))


@contextlib.contextmanager
def worker(protocol, **address):
    """An open transport's endpoint."""
    endpoint = f"{protocol}/localhost:{free_port()}"
    transport = ZenohTransport("w1", ZenohAddress(listen=(endpoint,), **address))
    transport.open()
    try:
        yield endpoint
    finally:
        transport.close()


@pytest.fixture(scope="module")
def secure(ends):
    """A worker with certificates that lives."""
    with worker("tls", tls=tls_files(ends / "worker-a"), drones=("drone-1",)) as endpoint:
        yield endpoint


def test_a_name_that_is_none():
    """Nobody of that name."""
    assert "no host called nowhere.invalid" in diagnose("tcp/nowhere.invalid:7447")
    assert "no host called a..b" in diagnose("tcp/a..b:7447")


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_a_port_where_nobody_listens(protocol):
    """The machine is there and the service is not."""
    words = diagnose(f"{protocol}/127.0.0.1:{free_port()}")
    assert "Connection refused: is edge-service running there?" in words


def test_an_address_that_never_answers():
    """A listener whose backlog is full swallows every packet, as a firewall does."""
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(socket.socket())
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for _ in range(4):
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(listener.getsockname())
        words = diagnose(f"tcp/127.0.0.1:{listener.getsockname()[1]}", timeout_s=0.2)
    assert "no answer within 0.2 s" in words


def test_plain_at_a_worker_that_speaks_tls(secure):
    """The sentence says what to write instead."""
    words = diagnose(secure.replace("tls/", "tcp/"), timeout_s=PATIENT_S)
    assert "it speaks TLS: write tls/localhost" in words
    assert "DRONE_TLS" in words


def test_tls_at_a_worker_that_is_plain(ends):
    """Zenoh's plain listener does not answer a handshake."""
    with worker("tcp") as endpoint:
        words = diagnose(endpoint.replace("tcp/", "tls/"), tls_files(ends / "drone-1"), 0.5)
        assert "does not speak TLS" in words
        assert "is it edge-service, and is it ready?" in diagnose(endpoint, timeout_s=0.5)


def test_a_worker_that_takes_us(secure, ends):
    """All is well as far as TLS goes: what is left is the list of drones."""
    files = tls_files(ends / "drone-1")
    for timeout_s in (0.3, 3.0, PATIENT_S):  # taken, it waits for all of it
        words = diagnose(secure, files, timeout_s)
        if "EDGE_ZENOH_DRONES" in words:
            break
    assert "EDGE_ZENOH_DRONES" in words


def test_a_worker_of_another_authority(secure, tmp_path):
    """Ours does not vouch for it."""
    foreign = make_ends(tmp_path / "foreign")
    words = diagnose(secure, tls_files(foreign / "drone-1"), PATIENT_S)
    assert "the worker's certificate is not to be trusted" in words


def test_a_worker_under_a_name_that_its_certificate_does_not_have(ends):
    """The sentence gives the name that was looked for."""
    endpoint = f"tls/127.0.0.2:{free_port()}"
    address = ZenohAddress(listen=(endpoint,), tls=tls_files(ends / "worker-a"), drones=("d",))
    transport = ZenohTransport("w1", address)
    transport.open()
    words = diagnose(endpoint, tls_files(ends / "drone-1"), PATIENT_S)
    transport.close()
    assert "127.0.0.2" in words.partition(": ")[2]


def test_a_certificate_that_ended_after_the_start(secure, ends):
    """The files were good when they were read; the worker's alert is told."""
    soon = make_ending(ends, "drone-1", timedelta(hours=1))
    files = tls_files(soon)
    make_ending(ends, "drone-1", -timedelta(hours=1))
    words = diagnose(secure, files, PATIENT_S)
    assert "refuses our certificate" in words
    assert "expired" in words
