"""What Kubernetes' Pod Security admission refuses under the level "restricted".

After the published Pod Security Standards: the controls of "baseline" and those that "restricted"
adds, for Linux pods.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

_VOLUMES = {
    "configMap",
    "csi",
    "downwardAPI",
    "emptyDir",
    "ephemeral",
    "persistentVolumeClaim",
    "projected",
    "secret",
}
_SELINUX_TYPES = {
    None,
    "",
    "container_t",
    "container_init_t",
    "container_kvm_t",
    "container_engine_t",
}
_SECCOMP = {"RuntimeDefault", "Localhost"}


def violations(pod: dict[str, Any]) -> list[str]:
    """Why a pod's spec is refused; empty: it is admitted."""
    containers = [
        container
        for key in ("initContainers", "containers", "ephemeralContainers")
        for container in pod.get(key, [])
    ]
    return [*_of_pod(pod), *(v for c in containers for v in _of_container(c, pod))]


def _of_pod(pod: dict[str, Any]) -> Iterator[str]:
    for key in ("hostNetwork", "hostPID", "hostIPC"):
        if pod.get(key):
            yield key
    for volume in pod.get("volumes", []):
        for kind in volume.keys() - {"name"} - _VOLUMES:
            yield f"volume {volume['name']} is of type {kind}"
    context = pod.get("securityContext", {})
    if context.get("sysctls"):
        yield "sysctls"
    yield from _of_context(context, "pod")


def _of_container(container: dict[str, Any], pod: dict[str, Any]) -> Iterator[str]:
    name = container["name"]
    own = container.get("securityContext", {})
    merged = {**pod.get("securityContext", {}), **own}
    capabilities = own.get("capabilities", {})
    added = set(capabilities.get("add", []))
    probes = [container.get(f"{kind}Probe", {}) for kind in ("liveness", "readiness", "startup")]
    refused = {
        "hostPort": any(port.get("hostPort") for port in container.get("ports", [])),
        "a probe of another host": any(p.get("httpGet", {}).get("host") for p in probes),
        "privileged": own.get("privileged", False),
        "procMount": own.get("procMount", "Default") != "Default",
        "allowPrivilegeEscalation": own.get("allowPrivilegeEscalation") is not False,
        "capabilities.drop": "ALL" not in capabilities.get("drop", []),
        "capabilities.add": bool(added - {"NET_BIND_SERVICE"}),
        "runAsNonRoot": merged.get("runAsNonRoot") is not True,
        "seccompProfile": merged.get("seccompProfile", {}).get("type") not in _SECCOMP,
    }
    yield from (f"{name}: {what}" for what, is_refused in refused.items() if is_refused)
    yield from _of_context(own, name)


def _of_context(context: dict[str, Any], where: str) -> Iterator[str]:
    if context.get("runAsUser") == 0:
        yield f"{where}: runAsUser"
    selinux = context.get("seLinuxOptions", {})
    if selinux.get("type") not in _SELINUX_TYPES or selinux.get("user") or selinux.get("role"):
        yield f"{where}: seLinuxOptions"
    if context.get("appArmorProfile", {}).get("type", "RuntimeDefault") == "Unconfined":
        yield f"{where}: appArmorProfile"
    if context.get("windowsOptions", {}).get("hostProcess"):
        yield f"{where}: hostProcess"
