"""What the service adds: round trip minus the sum of its stages, beside raw TCP, in one run.

    scripts/bench overhead [--frames 200] [--rate 10] [--recording FOLDER]

A real service process on loopback answers frames of the recording, one at a time. For each frame,
right after it, the same bytes go to a bare TCP echo process, which answers with as many bytes as
the result had. ``overhead`` is the service's round trip minus its own stages (decode, detect,
nest, localise): link, checks, queue, hand-overs. Its ratio to the raw TCP round trip is what can
be compared between machines.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing as mp
import queue
import socket
import struct
import tempfile
import time
from pathlib import Path

import numpy as np

from drone_client.airframe import Airframe
from drone_client.gate import GateSettings, SentFrame
from drone_client.link.zenoh import ZenohLink
from drone_client.reception import Receiver, Reception
from drone_client.source.replay import ReplaySource
from rgbd_wire.camera import load_camera
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import FrameStamp, compress, pack
from rgbd_wire.messages import seal_result
from tests.service_process import service_process

RECORDING = Path(__file__).parents[2] / "examples/recordings/rendered-approach"
STAGES = ("decode", "detect", "nest", "localise")
WARM_UP = 10
_SIZES = struct.Struct("<II")


def _echo(listener: socket.socket) -> None:
    connection, _ = listener.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with connection, connection.makefile("rb") as incoming:
        while len(head := incoming.read(_SIZES.size)) == _SIZES.size:
            size, reply = _SIZES.unpack(head)
            incoming.read(size)
            connection.sendall(bytes(reply))


class RawTcp:
    """A bare echo process and a connection to it."""

    def __init__(self) -> None:
        listener = socket.create_server(("127.0.0.1", 0))
        self._process = mp.get_context("fork").Process(target=_echo, args=(listener,), daemon=True)
        self._process.start()
        self._socket = socket.create_connection(listener.getsockname())
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        listener.close()

    def round_trip_ns(self, message: bytes, reply_bytes: int) -> int:
        """Time from the first byte out to the last byte of the reply in."""
        start_ns = time.monotonic_ns()
        self._socket.sendall(_SIZES.pack(len(message), reply_bytes) + message)
        missing = reply_bytes
        while missing:
            missing -= len(self._socket.recv(missing))
        return time.monotonic_ns() - start_ns


def measure(endpoint: str, recording: Path, frames: int, rate_hz: float) -> dict[str, np.ndarray]:
    """Milliseconds per frame of each part, after a warm-up."""
    clock = MonotonicClock()
    answers: queue.SimpleQueue[Reception] = queue.SimpleQueue()
    second_ns = 10**9
    receiver = Receiver(
        "bench",
        1,
        GateSettings(10 * second_ns, 10 * second_ns),
        Airframe(),
        lambda *_: None,
        answers.put,
    )
    link, raw = ZenohLink("bench", (endpoint,), clock), RawTcp()
    link.start(receiver.on_message, lambda: None)
    while not link.workers():
        time.sleep(0.02)
    (worker,) = link.workers()
    source = ReplaySource(recording, load_camera(recording / "camera.json"))
    captures = list(source.captures())
    rows: dict[str, list[float]] = {k: [] for k in ("round trip", *STAGES, "overhead", "raw tcp")}
    sizes = []
    for sequence in range(frames + WARM_UP):
        capture = captures[sequence % len(captures)]
        frame = RgbdFrame(
            capture.color_rgb, capture.depth_units, source.camera, clock.now_ns(), None
        )
        compressed = compress(frame)
        t1_ns = clock.now_ns()
        message = pack(compressed, FrameStamp("bench", 1, sequence, t1_ns, second_ns))
        receiver.sending(SentFrame(sequence, frame.t_capture_ns, t1_ns, worker))
        link.send(worker, message, 10**9)
        reception = answers.get(timeout=10)
        result = reception.result
        raw_ns = raw.round_trip_ns(message, len(seal_result(result)))
        if sequence >= WARM_UP:
            round_trip_ns = reception.t4_ns - t1_ns
            stages_ns = [result.stages_ns.get(stage, 0) for stage in STAGES]
            values = [round_trip_ns, *stages_ns, round_trip_ns - sum(stages_ns), raw_ns]
            for name, value in zip(rows, values, strict=True):
                rows[name].append(value / 1e6)
            sizes.append(len(message))
        time.sleep(1 / rate_hz)
    link.close()
    return {name: np.array(values) for name, values in rows.items()} | {
        "bytes": np.array(sizes, dtype=np.float64)
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--rate", type=float, default=10.0, help="frames a second")
    parser.add_argument("--recording", type=Path, default=RECORDING)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, service_process(Path(folder)) as service:
        rows = measure(service.endpoint, options.recording, options.frames, options.rate)
    spreads = {
        name: dict(
            zip(("p05", "p50", "p95", "p99"), np.percentile(v, [5, 50, 95, 99]), strict=True)
        )
        for name, v in rows.items()
    }
    ratio = spreads["overhead"]["p50"] / spreads["raw tcp"]["p50"]
    if options.json:
        print(json.dumps({"ms": spreads, "overhead_over_raw_tcp_p50": ratio}, indent=2))
        return
    print(f"{options.frames} frames of {spreads['bytes']['p50'] / 1e3:.0f} kB over loopback [ms]")
    print(f"{'':12}{'p05':>9}{'p50':>9}{'p95':>9}{'p99':>9}")
    for name, spread in spreads.items():
        if name != "bytes":
            print(f"{name:12}" + "".join(f"{v:9.3f}" for v in spread.values()))
    print(f"overhead / raw tcp, p50: {ratio:.2f}")


if __name__ == "__main__":
    main()
