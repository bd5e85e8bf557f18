"""Settings of the service: read once, checked, and every mistake is one line that helps."""

from __future__ import annotations

import os

import pytest
from pydantic import ValidationError

from edge_service.batching import BatchLimits
from edge_service.errors import SettingsError
from edge_service.settings import EdgeSettings, default_name, load_settings
from rgbd_wire.messages import Ack, seal_ack


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch):
    for name in [n for n in os.environ if n.startswith("EDGE_")]:
        monkeypatch.delenv(name)


def test_flags_come_before_variables_and_variables_before_defaults(monkeypatch):
    """A flag wins, a variable without a flag counts, the rest is the default."""
    monkeypatch.setenv("EDGE_NAME", "from-env")
    monkeypatch.setenv("EDGE_MAX_DRONES", "3")
    settings = load_settings(name="from-flag", threads=None)
    assert (settings.name, settings.max_drones, settings.threads) == ("from-flag", 3, None)
    assert settings.listen_endpoints == ("tcp/0.0.0.0:7447",)


def test_an_empty_variable_is_none(monkeypatch):
    """A compose file passes on what is not set as an empty string."""
    monkeypatch.setenv("EDGE_WEIGHTS", "")
    assert load_settings().weights is None


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("EDGE_MAX_DRONE", "3", ["EDGE_MAX_DRONE ", "did you mean EDGE_MAX_DRONES?"]),
        ("EDGE_QWERTZ", "3", ["EDGE_QWERTZ", "edge-service settings lists all"]),
        ("EDGE_HTTP_PORT", "80", ["EDGE_HTTP_PORT", "did you mean EDGE_HTTP?"]),
        ("EDGE_MAX_DRONES", "0", ["EDGE_MAX_DRONES", "'0'", "greater than or equal to 1"]),
        ("EDGE_DRAIN_S", "soon", ["EDGE_DRAIN_S", "'soon'", "number"]),
        ("EDGE_DRAIN_S", "nan", ["EDGE_DRAIN_S", "'nan'"]),
        ("EDGE_NAME", "Worker 1", ["EDGE_NAME", "'Worker 1'"]),
        ("EDGE_NAME", "w1\n", ["EDGE_NAME"]),
        ("EDGE_HTTP", "8080", ["EDGE_HTTP", "'8080'", "HOST:PORT"]),
        ("EDGE_HTTP", "localhost:99999", ["EDGE_HTTP", "HOST:PORT"]),
        ("EDGE_ZENOH_LISTEN", "0.0.0.0:7447", ["EDGE_ZENOH_LISTEN", "tcp/0.0.0.0:7447"]),
        ("EDGE_ZENOH_LISTEN", ",", ["no way in"]),
        ("EDGE_PRECISION", "int4", ["EDGE_PRECISION", "'int4'", "bf16"]),
    ],
)
def test_a_wrong_variable_is_one_line_that_names_it(monkeypatch, name, value, words):
    """The line says which variable, what it got and what it takes."""
    monkeypatch.setenv(name, value)
    with pytest.raises(SettingsError) as error:
        load_settings()
    line = str(error.value)
    assert "\n" not in line.replace(r"\n", "")
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("EDGE_SERVICE_HOST", "10.96.0.7"),
        ("EDGE_SERVICE_PORT", "7447"),
        ("EDGE_SERVICE_PORT_HTTP", "8080"),
        ("EDGE_PORT", "tcp://10.96.0.7:7447"),
        ("EDGE_PORT_7447_TCP", "tcp://10.96.0.7:7447"),
        ("EDGE_PORT_7447_TCP_PROTO", "tcp"),
        ("EDGE_SERVICE_PORT_8080_TCP_ADDR", "10.96.0.7"),
    ],
)
def test_what_kubernetes_tells_of_services_is_no_mistake(monkeypatch, name, value):
    """A Service called edge puts its own EDGE_ variables into every pod beside it."""
    monkeypatch.setenv(name, value)
    load_settings()


def test_a_wrong_flag_is_named_as_the_flag():
    """Who typed --listen is not told of a variable."""
    with pytest.raises(SettingsError, match=r"^--listen: must be endpoints .*, not 'junk'$"):
        load_settings(zenoh_listen="junk")


KEYS = "/run/keys"


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("EDGE_UDP_LISTEN", "0.0.0.0:7448", ["EDGE_UDP_LISTEN", "EDGE_TUNNEL_KEYS"]),
        ("EDGE_UDP_LISTEN", "7448", ["EDGE_UDP_LISTEN", "HOST:PORT"]),
        ("EDGE_BATCH_MAX", "17", ["EDGE_BATCH_MAX", "less than or equal to 16"]),
        ("EDGE_BATCH_WAIT_MS", "-1", ["EDGE_BATCH_WAIT_MS"]),
        ("EDGE_MAX_RATE_HZ", "0", ["EDGE_MAX_RATE_HZ"]),
        ("EDGE_TUNNEL_KEY", KEYS, ["did you mean EDGE_TUNNEL_KEYS?"]),
    ],
)
def test_wrong_settings_of_the_links_are_told(monkeypatch, name, value, words):
    """The tunnel needs keys; bounds hold."""
    monkeypatch.setenv(name, value)
    with pytest.raises(SettingsError) as error:
        load_settings()
    for word in words:
        assert word in str(error.value)


def test_the_tunnel_alone_is_a_way_in(monkeypatch):
    """An empty EDGE_ZENOH_LISTEN beside the tunnel turns Zenoh off; without one it is not set."""
    monkeypatch.setenv("EDGE_ZENOH_LISTEN", "")
    assert load_settings().has_zenoh
    monkeypatch.setenv("EDGE_UDP_LISTEN", "0.0.0.0:7448")
    monkeypatch.setenv("EDGE_TUNNEL_KEYS", KEYS)
    settings = load_settings()
    assert (settings.has_zenoh, settings.udp_listen) == (False, "0.0.0.0:7448")
    assert load_settings(zenoh_listen="tcp/127.0.0.1:1").has_zenoh
    monkeypatch.delenv("EDGE_ZENOH_LISTEN")
    assert load_settings().has_zenoh


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ({"tunnel_keys": KEYS}, ["--keys", "EDGE_TUNNEL_KEYS", "--udp 0.0.0.0:7448"]),
        ({"zenoh_drones": "d1"}, ["--drones", "EDGE_ZENOH_DRONES", "--tls FOLDER"]),
        (
            {
                "zenoh_tls": "/run/tls",
                "zenoh_drones": "d1",
                "zenoh_listen": "",
                "udp_listen": "0.0.0.0:7448",
                "tunnel_keys": KEYS,
            },
            ["--tls", "no Zenoh", "--listen tls/0.0.0.0:7447"],
        ),
    ],
)
def test_keys_or_certificates_without_their_link_are_told(flags, words):
    """Whoever gives them believes that the link is there and closed to others."""
    with pytest.raises(SettingsError) as error:
        load_settings(**flags)
    for word in words:
        assert word in str(error.value)


def test_flags_of_the_links_are_named_as_flags():
    """Who typed --udp is not told of a variable."""
    with pytest.raises(SettingsError, match=r"^--udp: must be HOST:PORT"):
        load_settings(udp_listen="junk", tunnel_keys=KEYS)


def test_batches_and_names_are_passed_on_by_value():
    """What the worker and Zenoh are given."""
    settings = EdgeSettings(
        name="w1", batch_max=4, batch_wait_ms=2.5, zenoh_drones="d1, d2", zenoh_tls="/run/tls"
    )
    assert settings.batch_limits == BatchLimits(4, 2_500_000)
    assert settings.drone_names == ("d1", "d2")
    assert EdgeSettings(name="w1").batch_limits == BatchLimits(1, 0)


def test_settings_are_frozen_and_closed():
    """Nobody changes a setting later, or adds one."""
    settings = EdgeSettings(name="w1")
    with pytest.raises(ValidationError):
        settings.name = "w2"
    with pytest.raises(ValidationError):
        EdgeSettings(name="w1", colour="red")


@pytest.mark.parametrize("host", ["Edge-1.example", "_x", "ÄÖ", "A" * 80, "10.0.0.1"])
def test_the_default_name_is_always_one_that_the_wire_takes(monkeypatch, host):
    """Whatever the machine is called, its name becomes a chunk of a Zenoh key."""
    monkeypatch.setattr("socket.gethostname", lambda: host)
    name = default_name()
    EdgeSettings(name=name)
    seal_ack(Ack("d", 0, 0, name, 0))


def test_the_default_name_keeps_what_tells_pods_apart(monkeypatch):
    """Kubernetes tells the pods of a Deployment apart by the end of their names."""
    monkeypatch.setattr("socket.gethostname", lambda: "a-long-deployment-name-6d4b75cb6d-8x7kq")
    assert default_name().endswith("-8x7kq")


def test_joining_a_router_opens_no_port():
    """With a router to join there is nothing to listen on."""
    settings = EdgeSettings(name="w1", zenoh_connect="tcp/router:7447, tcp/other:7447")
    assert settings.listen_endpoints == ()
    assert settings.connect_endpoints == ("tcp/router:7447", "tcp/other:7447")


@pytest.mark.parametrize(
    ("text", "address"),
    [("127.0.0.1:0", ("127.0.0.1", 0)), ("[::1]:8080", ("::1", 8080)), ("host:1", ("host", 1))],
)
def test_http_address(text, address):
    """Host and port of either family."""
    assert EdgeSettings(name="w1", http=text).http_address == address


def test_every_setting_says_what_it_means():
    """The list of settings is the documentation: no field without a description."""
    assert all(field.description for field in EdgeSettings.model_fields.values())
