"""Every overlay renders, is valid, is admitted under "restricted" and fits the service."""

from __future__ import annotations

import copy
import os
import re
from typing import Any

import kubernetes_validate
import pytest

from deploy.certificates import TUNNEL_KEYS
from edge_service.settings import NAME_PATTERN, PREFIX, EdgeSettings, load_settings
from tests.deploy.manifests import OVERLAYS, of_kind, only, rendered
from tests.deploy.pod_security import violations

SECURE = {"cpu-secure"}
"""Overlays with certificates and the UDP tunnel."""
OLDEST = "1.30"
"""The first release with the sleep action switched on (docs/deploy.md)."""
HTTP_STOP_S = 2
"""Longest that the HTTP side waits for open requests at a stop (edge_service/http/server.py)."""


@pytest.fixture(params=OVERLAYS)
def overlay(request: pytest.FixtureRequest) -> str:
    """The name of an overlay."""
    return str(request.param)


@pytest.fixture
def objects(overlay) -> list[dict[str, Any]]:
    """The overlay's objects."""
    return rendered(overlay)


@pytest.fixture
def is_secure(overlay) -> bool:
    """Whether the overlay is meant for a network that is not to be trusted."""
    return overlay in SECURE


@pytest.fixture
def pod(objects) -> dict[str, Any]:
    """The spec of the Deployment's pods."""
    return copy.deepcopy(only(objects, "Deployment")["spec"]["template"]["spec"])


@pytest.fixture
def settings(objects, monkeypatch) -> EdgeSettings:
    """What the service makes of the ConfigMap and of a pod's name."""
    for name in [n for n in os.environ if n.startswith(PREFIX)]:
        monkeypatch.delenv(name)
    for name, value in only(objects, "ConfigMap")["data"].items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("EDGE_NAME", longest_pod_name(only(objects, "Deployment")))
    return load_settings()


def longest_pod_name(deployment: dict[str, Any]) -> str:
    """Name, the template's hash of up to 10 characters, and 5 random ones."""
    return f"{deployment['metadata']['name']}-{'f' * 10}-{'x' * 5}"


def seconds_to_stop(pod: dict[str, Any], settings: EdgeSettings) -> float:
    """Longest time that an orderly stop takes."""
    (container,) = pod["containers"]
    return container["lifecycle"]["preStop"]["sleep"]["seconds"] + settings.drain_s + HTTP_STOP_S


def test_there_are_overlays():
    """The tests below have something to look at."""
    assert {"cpu"} | SECURE <= set(OVERLAYS)


@pytest.mark.parametrize("version", [OLDEST, kubernetes_validate.latest_version()])
def test_every_object_is_valid(objects, version):
    """Each object passes the strict schema of the oldest and of the newest Kubernetes."""
    for o in objects:
        checked_against = kubernetes_validate.validate(o, version, strict=True)
        assert version.startswith(checked_against)


def test_strict_validation_sees_a_wrong_field(objects):
    """The check above can fail: a misspelt field is refused."""
    deployment = copy.deepcopy(only(objects, "Deployment"))
    deployment["spec"]["template"]["spec"]["enableServiceLink"] = False
    with pytest.raises(kubernetes_validate.ValidationError, match="enableServiceLink"):
        kubernetes_validate.validate(deployment, OLDEST, strict=True)


def test_what_is_expected_is_there(objects, is_secure):
    """A Deployment with its budget, namespace and settings, and a Service for each way in."""
    kinds = sorted(o["kind"] for o in objects)
    ways_in = {("TCP", 7447), ("TCP", 8080)} | ({("UDP", 7448)} if is_secure else set())
    services = ["Service"] * len(ways_in)
    assert kinds == ["ConfigMap", "Deployment", "Namespace", "PodDisruptionBudget", *services]
    ports = {
        (p["protocol"], p["port"]) for s in of_kind(objects, "Service") for p in s["spec"]["ports"]
    }
    assert ports == ways_in


def test_everything_lies_in_one_restricted_namespace(objects):
    """All objects are in the namespace whose labels enforce the level "restricted"."""
    namespace = only(objects, "Namespace")["metadata"]
    for mode in ("enforce", "audit", "warn"):
        assert namespace["labels"][f"pod-security.kubernetes.io/{mode}"] == "restricted"
    others = [o["metadata"] for o in objects if o["kind"] != "Namespace"]
    assert {o["namespace"] for o in others} == {namespace["name"]}


def test_the_pod_is_admitted(pod):
    """Nothing in the pod violates the level "restricted"."""
    assert violations(pod) == []


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("hostNetwork",), True),
        (("securityContext", "runAsNonRoot"), False),
        (("securityContext", "runAsUser"), 0),
        (("securityContext", "seccompProfile", "type"), "Unconfined"),
        (("containers", 0, "securityContext", "allowPrivilegeEscalation"), True),
        (("containers", 0, "securityContext", "privileged"), True),
        (("containers", 0, "securityContext", "capabilities", "drop"), ["NET_RAW"]),
        (("containers", 0, "securityContext", "capabilities", "add"), ["SYS_ADMIN"]),
        (("containers", 0, "ports", 0, "hostPort"), 7447),
        (("volumes", 0), {"name": "tmp", "hostPath": {"path": "/"}}),
    ],
)
def test_a_weaker_pod_is_not_admitted(pod, path, value):
    """The checker sees each single thing that would weaken this pod."""
    place = pod
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    assert len(violations(pod)) == 1


def test_the_pod_writes_nothing_and_holds_no_key_of_the_clusters(pod):
    """No token, uid 10001, a read-only root, and a bounded /tmp as the one place to write."""
    (container,) = pod["containers"]
    assert pod["automountServiceAccountToken"] is False
    assert pod["securityContext"]["runAsUser"] == 10001
    assert container["securityContext"]["readOnlyRootFilesystem"] is True
    writable = {
        m["name"]: m["mountPath"] for m in container["volumeMounts"] if not m.get("readOnly")
    }
    assert writable == {"tmp": "/tmp"}
    volumes = {v["name"]: v for v in pod["volumes"]}
    assert "sizeLimit" in volumes["tmp"]["emptyDir"]


def test_the_keys_are_secrets_that_the_worker_alone_can_read(objects, pod, settings, is_secure):
    """They come from outside the files, by the group, to where the settings look for them."""
    assert not of_kind(objects, "Secret")
    (container,) = pod["containers"]
    volumes = {v["name"]: v["secret"] for v in pod["volumes"] if "secret" in v}
    mounts = {m["name"]: m for m in container["volumeMounts"] if m["name"] in volumes}
    secrets = {v["secretName"]: mounts[name]["mountPath"] for name, v in volumes.items()}
    if not is_secure:
        assert (secrets, settings.zenoh_tls, settings.udp_listen) == ({}, None, "")
        return
    assert secrets == {
        "edge-worker-tls": str(settings.zenoh_tls),
        "edge-worker-tunnel-keys": str(settings.tunnel_keys.parent),
    }
    assert settings.tunnel_keys.name == TUNNEL_KEYS
    assert {v["defaultMode"] for v in volumes.values()} == {0o440}
    assert pod["securityContext"]["fsGroup"] == pod["securityContext"]["runAsGroup"]
    assert not any("subPath" in m for m in mounts.values())  # or a new key would not arrive


def test_with_certificates_the_drones_are_named(settings, is_secure):
    """Zenoh has no wildcard for them."""
    assert bool(settings.drone_names) is is_secure


def test_memory_is_limited_and_cpu_is_not(pod, settings):
    """The CPU has a request that matches the threads, and no limit; memory has both."""
    (container,) = pod["containers"]
    resources = container["resources"]
    assert set(resources["requests"]) == {"cpu", "memory"}
    assert set(resources["limits"]) == {"memory"}
    assert float(resources["requests"]["cpu"]) == settings.threads


def test_the_settings_are_accepted(objects, settings):
    """The service takes every variable; a pod's longest name is a worker's name."""
    assert re.match(NAME_PATTERN, settings.name)
    links = [s["metadata"]["name"] for s in of_kind(objects, "Service")]
    assert links  # their variables would be among the settings, but for:
    assert only(objects, "Deployment")["spec"]["template"]["spec"]["enableServiceLinks"] is False


def test_a_change_of_settings_rolls_the_pods(objects, pod):
    """The pods name their settings with the content's hash."""
    (container,) = pod["containers"]
    (source,) = container["envFrom"]
    name = source["configMapRef"]["name"]
    assert name == only(objects, "ConfigMap")["metadata"]["name"]
    assert re.fullmatch(r"edge-worker-[a-z0-9]{10}", name)


def test_the_worker_is_called_as_its_pod(pod):
    """The worker's name comes from the pod's: one per worker, the same in all logs."""
    (variable,) = pod["containers"][0]["env"]
    field = variable["valueFrom"]["fieldRef"]["fieldPath"]
    assert (variable["name"], field) == ("EDGE_NAME", "metadata.name")


def test_the_ports_are_those_of_the_settings(pod, settings, is_secure):
    """The container declares the ports on which the settings make the service listen."""
    ports = {p["name"]: (p["protocol"], p["containerPort"]) for p in pod["containers"][0]["ports"]}
    assert ports["http"] == ("TCP", settings.http_address[1])
    protocol = "tls" if is_secure else "tcp"
    assert settings.listen_endpoints == (f"{protocol}/0.0.0.0:{ports['zenoh'][1]}",)
    assert ports["tunnel"] == ("UDP", 7448)
    assert settings.udp_listen == ("0.0.0.0:7448" if is_secure else "")


def test_each_probe_asks_for_its_own_thing(pod):
    """Start and readiness ask whether frames are taken, liveness whether the loop goes round."""
    (container,) = pod["containers"]
    ports = {p["name"] for p in container["ports"]}
    paths = {}
    for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
        paths[probe] = container[probe]["httpGet"]["path"]
        assert container[probe]["httpGet"]["port"] in ports
    assert paths == {
        "startupProbe": "/readyz",
        "readinessProbe": "/readyz",
        "livenessProbe": "/livez",
    }


def test_a_stop_has_the_time_that_it_needs(pod, settings):
    """The kill comes after the pause, the longest drain and the end of the HTTP side."""
    assert pod["terminationGracePeriodSeconds"] >= seconds_to_stop(pod, settings) + 5


def test_each_service_leads_to_the_pods(objects, pod):
    """Selectors match the pods' labels, and target ports exist with the same protocol."""
    labels = only(objects, "Deployment")["spec"]["template"]["metadata"]["labels"]
    ports = {p["name"]: p["protocol"] for p in pod["containers"][0]["ports"]}
    for service in of_kind(objects, "Service"):
        assert service["spec"]["selector"].items() <= labels.items()
        for port in service["spec"]["ports"]:
            assert ports[port["targetPort"]] == port["protocol"]


def test_only_frames_are_reachable_from_outside(objects, is_secure):
    """What opens the cluster does so without a second hop; HTTP stays inside."""
    services = {s["metadata"]["name"]: s["spec"] for s in of_kind(objects, "Service")}
    opened = {n for n, spec in services.items() if spec["type"] in ("LoadBalancer", "NodePort")}
    assert opened == ({"edge-zenoh", "edge-udp"} if is_secure else {"edge-zenoh"})
    for name in opened:
        assert services[name]["externalTrafficPolicy"] == "Local"
        assert services[name].get("sessionAffinity", "None") == "None"


def test_the_budget_and_the_spread_look_at_the_pods(objects, pod):
    """The disruption budget and the spread over nodes select the pods they are meant for."""
    labels = only(objects, "Deployment")["spec"]["template"]["metadata"]["labels"]
    budget = only(objects, "PodDisruptionBudget")["spec"]["selector"]["matchLabels"]
    (spread,) = pod["topologySpreadConstraints"]
    for selector in (budget, spread["labelSelector"]["matchLabels"]):
        assert selector
        assert selector.items() <= labels.items()


def test_the_image_is_of_one_version(pod):
    """The image has a tag other than latest, or a digest."""
    image = pod["containers"][0]["image"].rpartition("/")[2]
    name, _, version = image.partition("@" if "@" in image else ":")
    assert name == "aerial-contact"
    assert version not in ("", "latest")
