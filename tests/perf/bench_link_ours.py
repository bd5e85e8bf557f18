"""Our two links in the bench: the drone's real uplink, and the worker's real transport.

The frame is a real one that a real codec compresses, of noise, so that it weighs what it should.
Captured, encoded and queued on board: its age counts from the capture, encoding included.
"""

from __future__ import annotations

import secrets
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from drone_client.airframe import Airframe
from drone_client.encoding_choice import EncodingChoice
from drone_client.gate import GateSettings, SentFrame
from drone_client.ledger import Ledger
from drone_client.link import Link
from drone_client.link.udp import UdpLink
from drone_client.link.zenoh import ZenohLink
from drone_client.rate_control import RateSettings
from drone_client.reception import Receiver
from drone_client.settings import ClientSettings
from drone_client.uplink import Uplink, UplinkSettings
from edge_service.transport import Transport
from edge_service.transport.udp import UdpTransport
from edge_service.transport.zenoh import ZenohAddress, ZenohTransport
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import CompressedFrame, Encoding, FrameStamp, compress, pack, unpack
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Ack, Outcome, Result, seal_ack, seal_result
from rgbd_wire.probe import Probe, decode_probe, seal_probe
from rgbd_wire.tls_files import tls_files
from rgbd_wire.tunnel.keys import KeyFile, load_key
from tests.perf.bench_link_ends import CONNECT_S, DRONE, WORKER, Job, Sink, captures

BOOT_ID = 42
JPEG_QUALITY = 80
COLOR_PX, DEPTH_PX = (160, 120), (320, 240)
SIZE_ERROR = 0.005
BUDGET_NS = 250_000_000
_KIND_OFFSET = 5


def noise_frame(size_bytes: int) -> RgbdFrame:
    """A frame whose whole message weighs so much, to half a percent."""
    rng = np.random.default_rng(0)
    color, depth = (CameraIntrinsics(w, h, w, w, w / 2, h / 2) for w, h in (COLOR_PX, DEPTH_PX))
    camera = RgbdCamera(color, depth, 0.001, Pose.identity())
    color_rgb = rng.integers(0, 256, (*COLOR_PX[::-1], 3)).astype(np.uint8)
    noise = rng.integers(1, 1 << 16, DEPTH_PX[0] * DEPTH_PX[1]).astype(np.uint16)

    def frame(pixels: int) -> RgbdFrame:
        depth_units = np.where(np.arange(noise.size) < pixels, noise, 0).astype(np.uint16)
        return RgbdFrame(color_rgb, depth_units.reshape(DEPTH_PX[::-1]), camera, 0, None)

    def weight(pixels: int) -> int:
        return len(packed(compress(frame(pixels), Encoding(JPEG_QUALITY)), 0))

    low, high = 0, noise.size
    if not weight(low) < size_bytes < weight(high):
        raise ValueError(f"{size_bytes} bytes: from {weight(low)} to {weight(high)} can be had")
    while True:
        middle = (low + high) // 2
        got = weight(middle)
        if abs(got - size_bytes) <= SIZE_ERROR * size_bytes:
            return frame(middle)
        low, high = (middle, high) if got < size_bytes else (low, middle)


def packed(compressed: CompressedFrame, sequence: int) -> bytes:
    """The whole message of a frame."""
    stamp = FrameStamp(DRONE, BOOT_ID, sequence, time.monotonic_ns(), BUDGET_NS)
    return pack(compressed, stamp)


def open_drone_link(job: Job) -> Link:
    """The drone's link of the job's contender."""
    folder, place, clock = Path(job.folder), f"{job.host}:{job.port}", MonotonicClock()
    if job.contender == "our-tunnel":
        key = load_key(folder / "drones.keys", DRONE)
        return UdpLink(DRONE, (f"udp/{place}",), key, clock)
    if job.contender == "our-zenoh-tls":
        return ZenohLink(DRONE, (f"tls/{place}",), clock, tls_files(folder / DRONE))
    return ZenohLink(DRONE, (f"tcp/{place}",), clock)


def open_transport(job: Job) -> Transport:
    """The worker's transport of the job's contender."""
    folder, place = Path(job.folder), f"{job.host}:{job.port}"
    if job.contender == "our-tunnel":
        return UdpTransport(WORKER, f"udp/{place}", KeyFile(folder / "drones.keys"))
    address = ZenohAddress(listen=(f"tcp/{place}",))
    if job.contender == "our-zenoh-tls":
        files = tls_files(folder / WORKER)
        address = ZenohAddress((f"tls/{place}",), tls=files, drones=(DRONE,))
    return ZenohTransport(WORKER, address)


def await_worker(link: Link, came: threading.Event) -> None:
    """Until the link knows the worker."""
    deadline = time.monotonic() + CONNECT_S
    while WORKER not in link.workers():
        if not came.wait(max(0.0, deadline - time.monotonic())):
            raise TimeoutError("the worker was not found")
        came.clear()


class _Uplink:
    """The drone's uplink and what it needs around it, as a flight puts them together."""

    def __init__(self, job: Job, link: Link, folder: Path) -> None:
        s = ClientSettings()
        clock, boot_id = MonotonicClock(), secrets.randbits(62)
        self.receiver = Receiver(
            DRONE,
            boot_id,
            GateSettings(round(s.tau_max_ms * 1e6), round(s.age_max_ms * 1e6)),
            Airframe(),
            on_heard=lambda sequence, worker, t_ns: self.uplink.heard(sequence, worker, t_ns),
            on_result=lambda reception: self.uplink.answered(reception),
            on_echo=lambda probe, t4_ns: self.uplink.echo(probe, t4_ns),
            on_status=lambda status: self.uplink.take_status(status),
        )
        # No rate control: the bench is about a frame of a given weight
        rate = RateSettings(round(s.tau_max_ms * 1e6 / 3), enabled=False, best_quality=JPEG_QUALITY)
        settings = UplinkSettings(
            DRONE,
            boot_id,
            job.window,
            round(s.ack_timeout_ms * 1e6),
            round(s.age_max_ms * 1e6),
        )
        self.ledger = Ledger(folder)
        choice = EncodingChoice(rate, lambda: None)
        self.sent: list[int] = []
        self.uplink = Uplink(settings, link, clock, self, self.ledger, choice)

    def sending(self, frame: SentFrame) -> None:
        """A frame is about to leave."""
        self.sent.append(frame.sequence)
        self.receiver.sending(frame)


def send(job: Job) -> list[int]:
    """Submit every frame at its time to the drone's uplink; the numbers of those that left."""
    frame = noise_frame(job.size_bytes)
    link = open_drone_link(job)
    came = threading.Event()
    with tempfile.TemporaryDirectory() as folder:
        drone = _Uplink(job, link, Path(folder))

        def on_workers() -> None:
            came.set()
            drone.uplink.wake()

        link.start(drone.receiver.on_message, on_workers)
        await_worker(link, came)
        drone.uplink.start()
        for _, t_capture_ns in captures(job):
            drone.uplink.submit(replace(frame, t_capture_ns=t_capture_ns), "")
        time.sleep(0.5)
        drone.uplink.stop()
        link.close()
        drone.ledger.close()
    return drone.sent


def ask(job: Job) -> list[float]:
    """Round trips [ms] from ``send`` to the worker's ack, one frame at a time."""
    compressed = compress(noise_frame(job.size_bytes), Encoding(JPEG_QUALITY))
    link = open_drone_link(job)
    came, acked = threading.Event(), threading.Event()

    def on_message(message: bytes, t4_ns: int) -> None:
        if message[_KIND_OFFSET] == Kind.ACK:
            acked.set()

    link.start(on_message, came.set)
    await_worker(link, came)
    times = []
    for number, _ in captures(job):
        message = packed(compressed, number)
        acked.clear()
        start_ns = time.monotonic_ns()
        link.send(WORKER, message, BUDGET_NS)
        if acked.wait(1.0):
            times.append((time.monotonic_ns() - start_ns) / 1e6)
    link.close()
    return times


def receive(job: Job, sink: Sink, stop: threading.Event, ready: Callable[[], None]) -> None:
    """Acknowledge and answer every frame at once, and echo probes."""
    transport = open_transport(job)
    transport.open()
    transport.start(lambda drone, data, t2_ns: _on_message(transport, sink, drone, data, t2_ns))
    transport.announce()
    ready()
    stop.wait()


def _on_message(
    transport: Transport, sink: Sink, drone: str, data: bytes | memoryview, t2_ns: int
) -> None:
    if data[_KIND_OFFSET] == Kind.PROBE:
        _, body = unseal(data, Kind.PROBE)
        probe = decode_probe(body)
        echo = Probe(
            probe.boot_id,
            probe.sequence,
            probe.t1_ns,
            t2_ns=t2_ns,
            t3_ns=time.monotonic_ns(),
            worker_boot_id=BOOT_ID,
        )
        transport.send(drone, seal_probe(echo))
        return
    header = unpack(data).header
    sink.take(header.sequence, header.t_capture_ns)
    ack = Ack(header.drone, header.boot_id, header.sequence, WORKER, BOOT_ID)
    transport.send(drone, seal_ack(ack))
    result = Result(
        drone=header.drone,
        boot_id=header.boot_id,
        sequence=header.sequence,
        t_capture_ns=header.t_capture_ns,
        t1_ns=header.t1_ns,
        t2_ns=t2_ns,
        t3_ns=time.monotonic_ns(),
        worker=WORKER,
        worker_boot_id=BOOT_ID,
        outcome=Outcome.NOTHING_FOUND,
        reason="the bench looks at no picture",
        target=None,
        stages_ns={},
        model="",
        draining=False,
    )
    transport.send(drone, seal_result(result))
