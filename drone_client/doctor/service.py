"""The service: workers that live, how long the way there and back takes, and what they run."""

from __future__ import annotations

import secrets
import statistics
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from drone_client.doctor.finding import Check, Finding, judged, ok, unchecked
from drone_client.doctor.path import PathFacts, judge_path
from drone_client.errors import LinkError, SourceError
from drone_client.link import Link
from drone_client.link.diagnosis import diagnose
from drone_client.prober import Prober
from drone_client.settings import ClientSettings
from drone_client.snap import get
from rgbd_wire.clock import Clock
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.errors import DecodeError
from rgbd_wire.messages import Status, decode_status
from rgbd_wire.probe import decode_probe, seal_probe
from rgbd_wire.tls_files import tls_files
from target_pose.target import Target

AREA = "service"
PROBED_S = 2.5
"""So long the workers are probed; a status comes once a second."""
MANY_LOST = 0.1
GEOMETRY = ("board_side_m", "board_shade", "discs", "level_m", "points")
"""What of a target decides where it is."""


@dataclass(frozen=True, slots=True)
class WorkerFacts:
    """One worker."""

    name: str
    sent: int = 0
    round_trips_ms: tuple[float, ...] = ()
    status: Status | None = None


@dataclass(frozen=True, slots=True)
class ServiceFacts:
    """What answered at an address."""

    workers: tuple[WorkerFacts, ...] = ()
    why: str = ""
    """Where there is none: how far a knock at the door came."""
    bad_messages: int = 0
    """Of another version, or none of ours."""
    http: dict[str, str] = field(default_factory=dict)
    """By path: what it said, or why it did not."""
    target: Mapping[str, Any] | None = None
    """What the worker behind the HTTP address looks for; None: it was not asked, or did not say."""
    paths: tuple[PathFacts, ...] = ()
    """Of the UDP tunnel's endpoints."""
    link_warnings: tuple[str, ...] = ()
    """What the link itself warns of."""


class _Listener:
    """Takes what comes over the link: echoes and statuses."""

    def __init__(self) -> None:
        self.trips_ms: dict[str, list[float]] = {}
        self.statuses: dict[str, Status] = {}
        self.bad = 0
        self._prober = Prober(secrets.randbits(63))
        self._lock = threading.Lock()

    def take(self, message: bytes, t4_ns: int) -> None:
        """On the link's thread."""
        try:
            kind, body = unseal(message, Kind.RESULT, Kind.ACK, Kind.PROBE, Kind.STATUS)
            with self._lock:
                if kind is Kind.STATUS:
                    status = decode_status(body)
                    self.statuses[status.worker] = status
                elif kind is Kind.PROBE:
                    probe = decode_probe(body)
                    if (worker := self._prober.echo(probe, t4_ns)) is not None:
                        self.trips_ms.setdefault(worker, []).append((t4_ns - probe.t1_ns) / 1e6)
        except DecodeError:
            self.bad += 1

    def probe(self, link: Link, now_ns: int) -> list[str]:
        """Send what is due; the workers that were probed."""
        with self._lock:
            due = self._prober.due(now_ns, link.workers())
        for worker, probe in due:
            link.send_urgent(worker, seal_probe(probe))
        return [worker for worker, _ in due]


def collect_service(
    link: Link, settings: ClientSettings, clock: Clock, wait_s: float
) -> ServiceFacts:
    """Wait for workers and probe them; sends no frame."""
    listener = _Listener()
    link.start(listener.take, lambda: None)
    give_up = time.monotonic() + wait_s
    while not link.workers() and time.monotonic() < give_up:
        time.sleep(0.02)
    if not link.workers():
        why = "is edge-service running there with EDGE_UDP_LISTEN, and does it have our key?"
        if not settings.uses_tunnel:
            tls = None if settings.tls is None else tls_files(settings.tls)
            why = "; ".join(diagnose(endpoint, tls) for endpoint in settings.endpoints[:2])
        return ServiceFacts(why=why, bad_messages=listener.bad)
    sent: Counter[str] = Counter()
    end = time.monotonic() + PROBED_S
    while time.monotonic() < end:
        sent.update(listener.probe(link, clock.now_ns()))
        time.sleep(0.005)
    time.sleep(min(0.3, settings.tau_max_ms / 1e3))
    found = tuple(
        WorkerFacts(
            name,
            sent[name],
            tuple(listener.trips_ms.get(name, ())),
            listener.statuses.get(name),
        )
        for name in link.workers()
    )
    return ServiceFacts(found, bad_messages=listener.bad)


def collect_http(url: str, timeout_s: float = 3.0) -> dict[str, str]:
    """What the service's HTTP says of itself."""
    said = {}
    for path in ("/livez", "/readyz"):
        try:
            answer = get(url, path, timeout_s)
            said[path] = "ok" if answer.get("alive", answer.get("ready")) else str(answer)[:200]
        except (LinkError, SourceError) as error:
            said[path] = " ".join(str(error).split())
    return said


def collect_target(url: str, timeout_s: float = 3.0) -> Mapping[str, Any] | None:
    """What the service's HTTP says that it looks for; None: it does not say."""
    try:
        target = get(url, "/v1/model", timeout_s).get("target")
    except (LinkError, SourceError):  # /readyz tells why
        return None
    return target if isinstance(target, dict) else None


def judge_service(
    facts: ServiceFacts, settings: ClientSettings, own: Target | None = None
) -> Sequence[Check]:
    """All checks of the service.

    Args:
        facts: what answered.
        settings: the client's.
        own: the target that the drone's own eyes look for; None: it has none.
    """
    around = [
        *_link(facts),
        *(judge_path(path) for path in facts.paths),
        *_http(facts),
        *_target(facts.target, own),
    ]
    if not facts.workers:
        none = judged(AREA, "workers", Finding.FAULT, f"none at {settings.connect}", facts.why)
        return [none, *around]
    names = ", ".join(w.name for w in facts.workers)
    one = len(facts.workers) == 1
    checks = [
        judged(
            AREA,
            "workers",
            Finding.WARNING if one else Finding.OK,
            names,
            "one alone: when it fails the drone has none; start a second (docs/deploy.md)",
        )
    ]
    for worker in facts.workers:
        checks += [_way(worker, settings.tau_max_ms), _status(worker)]
    models = {w.status.model for w in facts.workers if w.status is not None}
    if len(models) > 1:
        checks.append(
            judged(
                AREA,
                "models",
                Finding.WARNING,
                f"workers run {len(models)} different models",
                "run one: a hand-over changes what is seen",
            )
        )
    if facts.bad_messages:
        checks.append(
            judged(
                AREA,
                "protocol",
                Finding.FAULT,
                f"{facts.bad_messages} messages could not be read",
                "client and service are of different versions: update both",
            )
        )
    return [*checks, *around]


def _way(worker: WorkerFacts, tau_max_ms: float) -> Check:
    name = f"way to {worker.name}"
    trips = worker.round_trips_ms
    if not trips:
        return judged(
            AREA,
            name,
            Finding.FAULT,
            f"none of {worker.sent} probes came back",
            "the worker is listed but does not answer: restart it, or look at the link",
        )
    median, worst = statistics.median(trips), max(trips)
    lost = 1 - len(trips) / max(worker.sent, len(trips))
    found = f"round trip {median:.1f} ms, worst {worst:.1f} ms, {lost:.0%} of {worker.sent} lost"
    if median > tau_max_ms:
        return judged(
            AREA, name, Finding.FAULT, found, f"over tau_max ({tau_max_ms:g} ms): no result counts"
        )
    bad = worst > tau_max_ms / 2 or lost > MANY_LOST
    return judged(
        AREA,
        name,
        Finding.WARNING if bad else Finding.OK,
        found,
        f"little is left of tau_max ({tau_max_ms:g} ms) for pictures: move nearer, use the UDP "
        "tunnel where packets are lost, or raise --tau-max-ms and the stand-off",
    )


def _status(worker: WorkerFacts) -> Check:
    name, status = f"worker {worker.name}", worker.status
    if status is None:
        return unchecked(AREA, name, f"no status within {PROBED_S:g} s")
    if status.draining:
        return judged(AREA, name, Finding.WARNING, "is shutting down", "wait for its successor")
    full = status.drones >= status.max_drones
    p95 = f", p95 {status.service_p95_ns / 1e6:.0f} ms a frame" if status.service_p95_ns else ""
    return judged(
        AREA,
        name,
        Finding.WARNING if full else Finding.OK,
        f"{status.drones} of {status.max_drones} drones{p95}, model {status.model[:12]}",
        "full: it turns new drones away; start another worker",
    )


def _http(facts: ServiceFacts) -> list[Check]:
    return [
        ok(AREA, path, said)
        if said == "ok"
        else judged(AREA, path, Finding.FAULT, said, "see the service's log")
        for path, said in facts.http.items()
    ]


def _link(facts: ServiceFacts) -> list[Check]:
    if not facts.link_warnings:
        return []
    return [
        judged(
            AREA,
            "link",
            Finding.WARNING,
            "; ".join(facts.link_warnings),
            "it matters on a radio; on a wire that loses nothing it does not",
        )
    ]


def _target(said: Mapping[str, Any] | None, own: Target | None) -> list[Check]:
    """Whether both ends look for one thing: the sizes, too, for they are the distances."""
    if said is None:
        return []
    name = str(said.get("name"))[:80]
    if own is None:
        return [ok(AREA, "target", f"the service looks for {name}")]
    mine = msgspec.json.decode(msgspec.json.encode(own))  # as HTTP would say it
    other = [key for key, value in mine.items() if key in GEOMETRY and said.get(key) != value]
    if name == own.name and not other:
        return [ok(AREA, "target", f"both look for {name}")]
    found = f"the service looks for {name}, the drone's own eyes for {own.name}"
    if name == own.name:
        found = f"{name} at both ends, but they differ in {', '.join(other)}"
    return [
        judged(
            AREA,
            "target",
            Finding.FAULT,
            found,
            "give both the same file (EDGE_TARGET, --onboard-target): of another size it is at "
            "another distance",
        )
    ]
