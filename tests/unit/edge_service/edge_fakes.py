"""A small RGB-D scene with a known target, messages made of it, and a detector that knows it."""

from __future__ import annotations

import json
import threading
from dataclasses import replace

import numpy as np

from edge_service.mailbox import Mailbox
from edge_service.metrics import Metrics
from edge_service.pipeline import Pipeline
from edge_service.service import EdgeService
from edge_service.settings import EdgeSettings
from edge_service.state import ServiceState
from edge_service.transport.memory import MemoryTransport
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.clock import ManualClock
from rgbd_wire.envelope import Kind, seal, unseal
from rgbd_wire.errors import DecodeError
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import FrameStamp, compress, pack, unpack
from rgbd_wire.geometry import Pose
from target_pose.candidate import Box, Detections
from target_pose.localise import localise
from target_pose.nesting import group
from target_pose.target import Shade, load_target

SECOND_NS = 1_000_000_000
INTRINSICS = CameraIntrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)
CAMERA = RgbdCamera(INTRINSICS, INTRINSICS, 0.001, Pose.identity())
CAMERA_JSON = json.dumps(CAMERA.to_json())
TARGET = load_target()
CENTER = np.array([0.05, -0.03, 1.5])  # [m], of a board that faces the camera squarely
CAMERA_FROM_TARGET = Pose.from_rotation(
    np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]), CENTER
)
WORLD_FROM_CAMERA = Pose.from_rotation(  # level, looking along world x from 2 m above its origin
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 2.0])
)


def scene(supersample=4):
    """Colour and depth of the board in front of a grey wall, by its definition alone."""
    k, n = INTRINSICS, supersample
    u = (np.arange(k.width * n) + 0.5) / n - 0.5
    v = (np.arange(k.height * n) + 0.5) / n - 0.5
    x = (u[None, :] - k.cx) / k.fx * CENTER[2] - CENTER[0]
    y = (v[:, None] - k.cy) / k.fy * CENTER[2] - CENTER[1]
    tone = {Shade.BLACK: 30.0, Shade.WHITE: 215.0}
    half = TARGET.board_side_m / 2
    board = (abs(x) <= half) & (abs(y) <= half)
    fine = np.where(board, tone[TARGET.board_shade], 120.0)
    for disc in TARGET.discs:
        fine[np.hypot(x, y) <= disc.diameter_m / 2] = tone[disc.shade]
    grey = fine.reshape(k.height, n, k.width, n).mean(axis=(1, 3))
    color_rgb = np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, axis=2)
    on_board = board.reshape(k.height, n, k.width, n).mean(axis=(1, 3)) > 0.5
    depth_units = np.where(on_board, CENTER[2], CENTER[2] + 0.3) / CAMERA.depth_scale_m
    return color_rgb, np.round(depth_units).astype(np.uint16)


COLOR, DEPTH = scene()


def true_detections(score=0.9):
    """The boxes of the scene's target."""
    k = INTRINSICS
    u, v = k.cx + k.fx * CENTER[0] / CENTER[2], k.cy + k.fy * CENTER[1] / CENTER[2]
    boxes = {}
    for level, side_m in TARGET.level_m.items():
        r = 0.5 * side_m * k.fx / CENTER[2]
        boxes[level] = (Box(u - r, v - r, u + r, v + r, score),)
    return Detections(boxes)


class KnownDetector:
    """Answers what it was told to, and keeps the pictures that it was shown."""

    model_hash = "0" * 64

    def __init__(self, detections=None, error=None):
        self.detections = true_detections() if detections is None else detections
        self.error = error
        self.seen = []
        self.batches = []

    def detect(self, color_rgb):
        self.seen.append(color_rgb)
        if self.error is not None:
            raise self.error
        return self.detections

    def detect_batch(self, colors_rgb):
        self.batches.append(len(colors_rgb))
        return [self.detect(color_rgb) for color_rgb in colors_rgb]

    def describe(self):
        return {"name": "known", "model_hash": self.model_hash}


class HeldDetector(KnownDetector):
    """Waits in each inference until it is let go."""

    def __init__(self):
        super().__init__()
        self.entered = threading.Semaphore(0)
        self.go = threading.Semaphore(0)

    def detect(self, color_rgb):
        self.entered.release()
        assert self.go.acquire(timeout=20)
        return super().detect(color_rgb)


_COMPRESSED = compress(RgbdFrame(COLOR, DEPTH, CAMERA, 5, WORLD_FROM_CAMERA))
_COLOR_ONLY = compress(RgbdFrame(COLOR, None, CAMERA, 5, None))


def message(drone="d1", sequence=0, boot_id=7, t1_ns=11, budget_ns=SECOND_NS, bare=False):
    """One whole frame of the scene; ``bare``: without depth and pose."""
    stamp = FrameStamp(drone, boot_id, sequence, t1_ns, budget_ns)
    return pack(_COLOR_ONLY if bare else _COMPRESSED, stamp)


def tiny_frame(side_px):
    """A frame without depth, of another size than the scene's."""
    half = side_px / 2
    intrinsics = CameraIntrinsics(side_px, side_px, float(side_px), float(side_px), half, half)
    camera = replace(CAMERA, color=intrinsics)
    return RgbdFrame(np.zeros((side_px, side_px, 3), np.uint8), None, camera, 5, None)


def named_drone(data):
    """The drone that a frame names; d1 for anything else."""
    try:
        return unpack(data).header.drone
    except DecodeError:
        return "d1"


def with_broken_picture(data):
    """The message with its colour picture overwritten, and a right checksum."""
    _, body = unseal(data, Kind.FRAME)
    broken = bytearray(body)
    head_end = 4 + int.from_bytes(body[:4], "little")
    broken[head_end : head_end + 200] = bytes(200)
    return seal(Kind.FRAME, bytes(broken))


def pipeline(detector=None, clock=None, **options):
    """The real stages behind a detector that knows the answer."""
    detector = KnownDetector() if detector is None else detector
    clock = ManualClock(1000) if clock is None else clock
    return Pipeline(detector, TARGET, group, localise, clock, **options)


def settings(**fields):
    """Settings that do not depend on the machine."""
    return EdgeSettings(**{"name": "w1", "drain_s": 2.0, **fields})


class Bench:
    """A service on an in-memory link, with a clock that stands still."""

    def __init__(self, detector=None, **fields):
        self.settings = settings(**fields)
        self.clock = ManualClock(10 * SECOND_NS)
        self.transport = MemoryTransport()
        self.transport.open()
        mailbox = Mailbox(self.settings.max_drones, int(self.settings.drone_idle_s * 1e9))
        self.state = ServiceState(self.settings, Metrics(), mailbox, transport=self.transport)
        self.pipeline = replace(pipeline(detector), clock=self.clock)
        self.service = EdgeService(
            self.settings, self.pipeline, self.transport, self.state, self.clock
        )

    def deliver(self, data, drone=None):
        """Hand over a message that is complete now; ``drone``: other than the one it names."""
        self.transport.deliver(drone or named_drone(data), data, self.clock.now_ns())

    def count(self, name, **labels):
        """Value of a metric; 0 when it has none."""
        return self.state.metrics.registry.get_sample_value(name, labels) or 0

    def drain(self):
        """Stop without waiting for what may still be on its way."""
        return self.service.drain(lambda _: None)
