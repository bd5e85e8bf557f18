"""Who may do what on a worker's Zenoh session, by the common name of the certificate.

Everything that is not allowed here is denied. Zenoh 1.10 compares common names exactly, without
wildcards: every drone is named.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rgbd_wire.streams import FRAME, PROBE, RESULT, worker_key, worker_status_key

Rule = dict[str, Any]


def access_control(drones: Iterable[str], workers: Iterable[str] = ()) -> dict[str, Any]:
    """Zenoh's ``access_control`` for a session that is a router.

    Args:
        drones: common names; each may send its own frames and probes and read its own answers.
        workers: common names of workers that join this router; each may answer any drone, under
            its own name.
    """
    roles = [("drone", name, _of_drone(name)) for name in drones]
    roles += [("worker", name, _of_worker(name)) for name in workers]
    rules: list[Rule] = []
    subjects, policies = [], []
    for role, name, of_role in roles:
        subject = f"{role} {name}"
        subjects.append({"id": subject, "cert_common_names": [name]})
        ids = []
        for number, (flow, messages, keys) in enumerate(of_role):
            ids.append(f"{subject} {number}")
            rules.append(
                {
                    "id": ids[-1],
                    "permission": "allow",
                    "flows": [flow],
                    "messages": messages,
                    "key_exprs": keys,
                }
            )
        policies.append({"subjects": [subject], "rules": ids})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


_Allowed = tuple[str, list[str], list[str]]
"""Flow as the router sees it, messages, keys."""


def _of_drone(name: str) -> list[_Allowed]:
    up = [FRAME.key(name, "*"), PROBE.key(name, "*")]
    down = [RESULT.key(name, "*"), worker_status_key("*")]
    workers_take = [FRAME.key("*", "*"), PROBE.key("*", "*")]
    return [
        ("ingress", ["put"], up),
        ("egress", ["declare_subscriber"], workers_take),
        ("egress", ["put"], down),
        ("ingress", ["declare_subscriber"], down),
        ("egress", ["liveliness_token"], [worker_key("*")]),
        ("ingress", ["declare_liveliness_subscriber", "liveliness_query"], [worker_key("*")]),
    ]


def _of_worker(name: str) -> list[_Allowed]:
    up = [FRAME.key("*", name), PROBE.key("*", name)]
    down = [RESULT.key("*", name), worker_status_key(name)]
    drones_take = [RESULT.key("*", "*"), worker_status_key("*")]
    return [
        ("egress", ["put"], up),
        ("ingress", ["declare_subscriber"], up),
        ("ingress", ["put"], down),
        ("egress", ["declare_subscriber"], drones_take),
        ("ingress", ["liveliness_token"], [worker_key(name)]),
        ("egress", ["declare_liveliness_subscriber", "liveliness_query"], [worker_key("*")]),
    ]
