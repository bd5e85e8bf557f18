"""``load-test``: many drones at once, to size a cluster.

Each drone is what a real one is to the service: its own link, ack clock and gate. Only
the pictures are compressed once, before the clock starts, so that the client's CPU is not what is
measured, and nobody probes the way back: a frame's budget is all of age_max, where a real drone
takes its way back off it, so that a worker on a slow path drops sooner than here.
"""

from __future__ import annotations

import json
import secrets
import sys
import threading
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table

from drone_client.ack_clock import AckClock
from drone_client.airframe import Airframe
from drone_client.errors import ClientError
from drone_client.gate import SentFrame
from drone_client.link.choose import open_link
from drone_client.link.waiting import wait_for_worker
from drone_client.reception import Receiver, Reception
from drone_client.roster import Roster
from drone_client.settings import NS_PER_MS, ClientSettings, about, load_settings
from drone_client.source.replay import open_recording
from drone_client.summary import spread
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.clock import Clock, MonotonicClock
from rgbd_wire.errors import WireError
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import CompressedFrame, Encoding, FrameStamp, compress, pack
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Outcome

MAX_PICTURES = 32
"""Of a recording; they repeat."""


@dataclass(slots=True)
class LoadTally:
    """What one drone saw; written by its threads under its lock."""

    due: int = 0
    """Frames that the rate called for."""
    sent: int = 0
    skipped: int = 0
    """Not sent because the window was full: back-pressure at work."""
    timeouts: int = 0
    verdicts: Counter[str] = field(default_factory=Counter)
    outcomes: Counter[str] = field(default_factory=Counter)
    workers: Counter[str] = field(default_factory=Counter)
    round_trip_ms: list[float] = field(default_factory=list)
    network_ms: list[float] = field(default_factory=list)
    service_ms: list[float] = field(default_factory=list)


class LoadDrone:
    """One simulated drone: sends at a rate as far as its window allows."""

    def __init__(
        self, name: str, settings: ClientSettings, pictures: list[CompressedFrame], clock: Clock
    ) -> None:
        self.name = name
        self.tally = LoadTally()
        self.lock = threading.Lock()
        self._settings = settings
        self._pictures = pictures
        self._clock = clock
        self._boot_id = secrets.randbits(63)
        self._acks = AckClock(settings.window, round(settings.ack_timeout_ms * NS_PER_MS))
        self._roster = Roster(name)
        self._asked: dict[int, str] = {}
        self.link = open_link(settings, clock, name)
        self._receiver = Receiver(
            name,
            self._boot_id,
            settings.gate,
            Airframe(),
            on_heard=self._on_heard,
            on_result=self._on_result,
        )
        self.link.start(self._receiver.on_message, lambda: None)

    def run(self, rate_hz: float, phase: float, until_ns: int, stop: threading.Event) -> None:
        """Send until a time on the clock; ``phase`` in [0, 1) spreads the drones over a period."""
        period_ns = round(1e9 / rate_hz)
        due_ns = self._clock.now_ns() + round(phase * period_ns)
        number = 0
        while (now_ns := self._clock.now_ns()) < until_ns:
            if stop.wait(max(0, due_ns - now_ns) / 1e9):
                return
            self._send_one(number)
            number += 1
            due_ns += period_ns

    def _send_one(self, sequence: int) -> None:
        t_capture_ns = self._clock.now_ns()
        with self.lock:
            self.tally.due += 1
            self._roster.see(self.link.workers())
            for late in self._acks.expire(t_capture_ns):
                self.tally.timeouts += 1
                self._roster.missed(self._asked.pop(late))
            worker = self._roster.choose(t_capture_ns)
            if worker is None or not self._acks.has_room():
                self.tally.skipped += 1
                return
            self._acks.send(sequence, t_capture_ns)
            self._asked[sequence] = worker
            self.tally.sent += 1
        picture = self._pictures[sequence % len(self._pictures)]
        stamped = replace(picture, frame=replace(picture.frame, t_capture_ns=t_capture_ns))
        t1_ns = self._clock.now_ns()
        budget_ns = self._settings.gate.age_max_ns  # whole: nobody here probes the way back
        message = pack(stamped, FrameStamp(self.name, self._boot_id, sequence, t1_ns, budget_ns))
        self._receiver.sending(SentFrame(sequence, t_capture_ns, t1_ns, worker))
        self.link.send(worker, message, budget_ns)

    def _on_heard(self, sequence: int, worker: str, t_ns: int) -> None:
        with self.lock:
            self._roster.replied(worker, t_ns)
            if self._acks.release(sequence):
                del self._asked[sequence]

    def _on_result(self, r: Reception) -> None:
        result, judgement = r.result, r.judgement
        with self.lock:
            tally = self.tally
            tally.verdicts[judgement.verdict.value] += 1
            if not judgement.verdict.settles_frame:
                return
            tally.outcomes[result.outcome.value] += 1
            tally.workers[result.worker] += 1
            if judgement.network_delay_ns is not None:
                tally.round_trip_ms.append((r.t4_ns - result.t1_ns) / NS_PER_MS)
                tally.network_ms.append(judgement.network_delay_ns / NS_PER_MS)
                tally.service_ms.append((result.t3_ns - result.t2_ns) / NS_PER_MS)


def summarise_load(tallies: list[LoadTally], seconds: float) -> dict[str, Any]:
    """The result table's numbers."""

    def total(name: str) -> int:
        return sum(getattr(t, name) for t in tallies)

    def counts(name: str) -> dict[str, int]:
        return dict(sum((getattr(t, name) for t in tallies), Counter()).most_common())

    def times(name: str) -> dict[str, float] | None:
        return spread([v for t in tallies for v in getattr(t, name)])

    verdicts = counts("verdicts")
    looked_at = [sum(n for o, n in t.outcomes.items() if Outcome(o).looked_at) for t in tallies]
    return {
        "drones": len(tallies),
        "seconds": round(seconds, 3),
        "frames_due": total("due"),
        "frames_sent": total("sent"),
        "skipped_window_full": total("skipped"),
        "ack_timeouts": total("timeouts"),
        "verdicts": verdicts,
        "outcomes": counts("outcomes"),
        "workers": counts("workers"),
        "processed_per_s": round(sum(looked_at) / seconds, 2),
        "processed_per_s_and_drone": spread([n / seconds for n in looked_at]),
        "round_trip_ms": times("round_trip_ms"),
        "network_delay_ms": times("network_ms"),
        "service_ms": times("service_ms"),
    }


def load_test(
    drones: Annotated[int, typer.Option(min=1, max=64, help="how many drones")] = 4,
    rate: Annotated[
        float,
        typer.Option(
            min=0.1, max=240, help="frames a second of each; a worker takes EDGE_MAX_RATE_HZ (60)"
        ),
    ] = 15.0,
    duration: Annotated[float, typer.Option(min=0.5, max=3600, help="seconds")] = 10.0,
    connect: Annotated[str | None, typer.Option(help=about("connect"))] = None,
    recording: Annotated[
        Path | None,
        typer.Option(help="folder whose pictures are sent; without it a noise picture"),
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(help="its camera JSON; without it RECORDING/camera.json")
    ] = None,
    tau_max_ms: Annotated[float | None, typer.Option(help=about("tau_max_ms"))] = None,
    window: Annotated[int | None, typer.Option(help=about("window"))] = None,
    key_file: Annotated[
        Path | None,
        typer.Option(help="file with the keys of load-0, load-1, ... for udp/ endpoints"),
    ] = None,
    tls: Annotated[
        Path | None,
        typer.Option(
            help="for tls/ endpoints: folder with one folder of ca.pem, cert.pem and key.pem for "
            "each of load-0, load-1, ..., as scripts/certificates makes them; or load-0's own, "
            "for one drone"
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the result as JSON")] = False,
) -> None:
    """Load a service with many drones and say what each of them got.

    Example: load-test --drones 8 --rate 15 --duration 20 --connect tcp/192.0.2.7:7447
    """
    settings = load_settings(
        connect=connect, tau_max_ms=tau_max_ms, window=window, key_file=key_file, tls=tls
    )
    pictures = _pictures(recording, camera, settings.jpeg_quality)
    clock = MonotonicClock()
    fleet: list[LoadDrone] = []
    stop = threading.Event()
    try:
        for i in range(drones):
            name = f"load-{i}"
            own = settings.model_copy(update={"tls": _certificates_of(name, settings.tls, drones)})
            fleet.append(LoadDrone(name, own, pictures, clock))
        for drone in fleet:
            wait_for_worker(drone.link, settings)
        start_ns = clock.now_ns()
        until_ns = start_ns + round(duration * 1e9)
        threads = [
            threading.Thread(target=d.run, args=(rate, i / drones, until_ns, stop), daemon=True)
            for i, d in enumerate(fleet)
        ]
        for thread in threads:
            thread.start()
        with Live(console=Console(stderr=True), refresh_per_second=4, transient=True) as live:
            while any(t.is_alive() for t in threads):
                elapsed_s = (clock.now_ns() - start_ns) / 1e9
                live.update(_live_line(fleet, elapsed_s, duration))
                stop.wait(0.25)
        stop.wait(settings.age_max_ms / 1e3)  # the last frames' answers
        seconds = (clock.now_ns() - start_ns) / 1e9
    finally:
        stop.set()
        for drone in fleet:
            drone.link.close()
    summary = summarise_load([d.tally for d in fleet], seconds)
    if as_json:
        print(json.dumps(summary, indent=2))
    else:
        _print(summary)


def main() -> None:
    """Run the command; a user's mistake ends in one line and exit code 2."""
    app = typer.Typer(
        pretty_exceptions_enable=False,
        add_completion=False,
        rich_markup_mode=None,  # as drone-client: no flag is cut on a narrow terminal
    )
    app.command(no_args_is_help=False)(load_test)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the one line is ours
    try:
        app()
    except (ClientError, WireError) as error:
        line = " ".join(str(error).split())
        Console(stderr=True).print(f"load-test: {line}", style="red", markup=False, soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def _certificates_of(name: str, tls: Path | None, drones: int) -> Path | None:
    """The folder of one drone's certificate: a certificate has one name.

    Raises:
        ClientError: there are several drones, and this one has no folder.
    """
    if tls is None or (tls / name).is_dir():
        return tls and tls / name
    if drones == 1:
        return tls
    raise ClientError(
        f"--tls {tls}: there is no folder {tls / name}, and {drones} drones need one each; "
        f"scripts/certificates {tls} --drones load-0,...,load-{drones - 1} makes them"
    )


def _pictures(
    recording: Path | None, camera: Path | None, jpeg_quality: int
) -> list[CompressedFrame]:
    if recording is None:
        return [compress(_noise_frame(), Encoding(jpeg_quality))]
    source = open_recording(recording, camera)
    return [
        compress(
            RgbdFrame(
                capture.color_rgb,
                capture.depth_units,
                source.camera,
                0,
                source.world_from_camera(capture.t_source_ns),
            ),
            Encoding(jpeg_quality),
        )
        for capture in source.some_captures(MAX_PICTURES)
    ]


def _noise_frame() -> RgbdFrame:
    """640x480 with the weight of a real picture: smooth shapes under sensor noise, no target."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[0:480, 0:640]
    shade = 120 + 60 * np.sin(u / 90) * np.cos(v / 70)
    color = shade[..., None] + rng.normal(0, 6, (480, 640, 3))
    depth_m = 2.0 + 0.8 * np.sin(u / 200) + rng.normal(0, 0.004, (480, 640))
    lattice_m = 385.0 * 0.095 * 32  # a D455's: fx x baseline x 32 sub-pixels
    depth_units = np.rint(lattice_m / np.rint(lattice_m / depth_m) / 0.001)
    intrinsics = CameraIntrinsics(640, 480, 385.0, 385.0, 319.5, 239.5)
    return RgbdFrame(
        np.clip(color, 0, 255).astype(np.uint8),
        depth_units.astype(np.uint16),
        RgbdCamera(intrinsics, intrinsics, 0.001, Pose.identity(), lattice_m),
        0,
        None,
    )


def _live_line(fleet: list[LoadDrone], elapsed_s: float, duration_s: float) -> str:
    sent = answered = accepted = 0
    recent: list[float] = []
    for drone in fleet:
        with drone.lock:
            sent += drone.tally.sent
            answered += drone.tally.outcomes.total()
            accepted += drone.tally.verdicts["accepted"]
            recent += drone.tally.round_trip_ms[-20:]
    middle = f"{np.median(recent):.1f} ms" if recent else "-"
    return (
        f"{elapsed_s:5.1f} of {duration_s:g} s   {len(fleet)} drones   {sent} sent   "
        f"{answered} answered   {accepted} accepted   round trip {middle}"
    )


def _print(summary: dict[str, Any]) -> None:
    table = Table("", "p50", "p95", "p99", "max", title="load test")
    for name in ("round_trip_ms", "network_delay_ms", "service_ms", "processed_per_s_and_drone"):
        s = summary[name]
        values = ["-"] * 4 if s is None else [f"{s[k]:.2f}" for k in ("p50", "p95", "p99", "max")]
        table.add_row(name, *values)
    console = Console()
    console.print(table)
    for name in (
        "drones",
        "seconds",
        "frames_due",
        "frames_sent",
        "skipped_window_full",
        "ack_timeouts",
        "processed_per_s",
        "verdicts",
        "outcomes",
        "workers",
    ):
        value = summary[name]
        if isinstance(value, dict):
            value = ", ".join(f"{n} {key}" for key, n in value.items()) or "none"
        console.print(f"{name:22}{value}", highlight=False)


if __name__ == "__main__":
    main()
