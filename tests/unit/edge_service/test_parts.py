"""The links that the settings ask for, opened for real on the loopback."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from edge_service.parts import make_links
from edge_service.transport.several import SeveralTransports
from edge_service.transport.udp import UdpTransport
from edge_service.transport.zenoh import ZenohTransport
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.errors import TlsFilesError
from rgbd_wire.tunnel.errors import KeyFileError
from tests.certificates import make_ends
from tests.service_process import free_port
from tests.unit.edge_service.edge_fakes import settings


@pytest.fixture
def keys(tmp_path):
    """A key file with one drone."""
    path = tmp_path / "keys"
    path.write_text(f"d1 {bytes(range(32)).hex()}\n")
    path.chmod(0o600)
    return path


def links(**fields):
    return make_links(settings(**fields), MonotonicClock())


def test_zenoh_alone_is_the_default():
    """One transport needs nothing around it."""
    made = links()
    assert isinstance(made.transport, ZenohTransport)
    assert made.tunnel is None
    assert made.lines() == ("zenoh  tcp/0.0.0.0:7447",)
    assert links(zenoh_connect="tcp/router:1").lines() == ("zenoh  joins tcp/router:1",)


def test_the_tunnel_alone(keys):
    """An empty list of endpoints is no Zenoh."""
    made = links(zenoh_listen="", udp_listen="127.0.0.1:0", tunnel_keys=keys)
    assert isinstance(made.transport, UdpTransport)
    assert made.transport is made.tunnel
    made.transport.open()
    assert made.lines() == (f"udp    127.0.0.1:{made.tunnel.port}, keys in {keys}",)
    assert made.tunnel.port > 0
    made.transport.close()


def crowd(sessions, drones):
    """A session of each of so many drones, all in use; how many there was room for."""
    for number in range(drones):
        if not sessions.make_room(f"d{number}"):
            return number
        channel = SimpleNamespace(session=number, heard_ns=0)
        used = SimpleNamespace(drone=f"d{number}", confirmed=True, channel=channel, made_ns=0)
        sessions.add(used, b"hello %d" % number)
    return drones


@pytest.mark.parametrize(("max_drones", "room"), [(1, 256), (64, 256), (1024, 1500)])
def test_the_tunnel_has_a_session_for_every_drone(keys, max_drones, room):
    """Four for each that may be served, and not fewer than by default."""
    fields = {"zenoh_listen": "", "udp_listen": "127.0.0.1:0", "tunnel_keys": keys}
    made = links(**fields, max_drones=max_drones)
    assert crowd(made.tunnel._sessions, 1500) == room


@pytest.mark.parametrize(("max_rate_hz", "taken"), [(1, 210), (60, 210), (1000, 1000)])
def test_the_tunnel_hands_over_what_a_drone_may_send(keys, max_rate_hz, taken):
    """A thousand messages in a second, one a millisecond: as many as the rate that was set."""
    fields = {"zenoh_listen": "", "udp_listen": "127.0.0.1:0", "tunnel_keys": keys}
    made = links(**fields, max_rate_hz=max_rate_hz)
    quota = made.tunnel._sessions.quota("d1", 0).messages
    assert sum(quota.take(1_000_000 * ms) for ms in range(1000)) == pytest.approx(taken, abs=2)


def test_a_file_without_keys_is_warned_of(tmp_path):
    """It may be filled later, and until then nobody can come in."""
    path = tmp_path / "keys"
    path.write_text("# none yet\n")
    path.chmod(0o640)
    (warning,) = links(zenoh_listen="", udp_listen="127.0.0.1:0", tunnel_keys=path).warnings
    assert warning.startswith(f"{path} holds no key")


def test_both_over_tls_open_and_close(keys, tmp_path):
    """The whole of it: certificates, keys, one transport made of two."""
    made = links(
        zenoh_listen=f"tls/127.0.0.1:{free_port()}",
        zenoh_tls=make_ends(tmp_path / "ends") / "worker-a",
        zenoh_drones="drone-1,drone-2",
        udp_listen="[::1]:0",
        tunnel_keys=keys,
    )
    assert isinstance(made.transport, SeveralTransports)
    assert len(made.lines()) == 2
    made.transport.open()
    assert made.transport.is_open
    assert made.tunnel.is_open
    made.transport.close()
    assert not made.tunnel.is_open


@pytest.mark.parametrize(
    ("listen", "warns"),
    [
        ("tcp/0.0.0.0:7447", True),
        ("tcp/127.0.0.1:7447,tcp/192.0.2.7:7447", True),
        ("tcp/127.0.0.1:7447,tcp/[::1]:7447,tcp/localhost:7447", False),
        ("", False),
    ],
)
def test_a_tunnel_beside_plain_zenoh_is_told(keys, listen, warns):
    """Its keys guard nothing when anybody may use a drone's name next to it."""
    made = links(zenoh_listen=listen, udp_listen="127.0.0.1:0", tunnel_keys=keys)
    assert any("plain Zenoh" in warning for warning in made.warnings) == warns
    assert not any("plain Zenoh" in warning for warning in links().warnings)


def test_files_that_cannot_be_used_are_told_before_anything_opens(tmp_path):
    """Certificates and keys are read at the start, and their errors name the file."""
    with pytest.raises(TlsFilesError, match="ca.pem"):
        links(zenoh_listen="tls/127.0.0.1:1", zenoh_tls=tmp_path, zenoh_drones="d1")
    with pytest.raises(KeyFileError, match=r"--keys .*none: No such file.*--tunnel-keys makes"):
        links(udp_listen="127.0.0.1:0", tunnel_keys=tmp_path / "none")
