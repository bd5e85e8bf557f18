"""Write the test vectors beside this file: whole messages, and a JSON that says what is in them.

``python tests/data/wire/make.py`` rewrites them; that is called for only when the protocol's
version changes. The pictures are formulas, so that an implementer needs no other file.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.depth import DepthPlan
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import BEST, Encoding, FrameStamp, compress, pack, unpack
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import (
    Ack,
    LevelBox,
    Outcome,
    Result,
    Status,
    TargetPose,
    pack_covariance,
    pose_numbers,
    seal_ack,
    seal_result,
    seal_status,
)
from rgbd_wire.probe import Probe, seal_probe

HERE = Path(__file__).parent
WIDTH, HEIGHT = 64, 48
BOOT_ID = 0x1234_5678_9ABC_DEF0
WORKER_BOOT_ID = 42

COLOR = CameraIntrinsics(
    WIDTH, HEIGHT, 60.0, 60.5, 31.5, 23.5, "brown_conrady", (0.1, -0.05, 0.001, -0.002, 0.0)
)
DEPTH = CameraIntrinsics(WIDTH, HEIGHT, 57.0, 57.0, 32.25, 24.75)
STEREO = RgbdCamera(
    COLOR,
    DEPTH,
    depth_scale_m=0.001,
    color_from_depth=Pose(np.array([-0.059, 0.0, 0.0004]), np.array([1.0, 0.0, 0.0, 0.0])),
    depth_lattice_m=57.0 * 0.095 * 32,
)
ALIGNED = RgbdCamera(COLOR, COLOR, depth_scale_m=0.0002, color_from_depth=Pose.identity())
# The camera looks east (x of the world); the target faces it and stands upright.
WORLD_FROM_CAMERA = Pose(np.array([1.5, -2.25, 0.75]), np.array([0.5, -0.5, 0.5, -0.5]))
CAMERA_FROM_TARGET = Pose(np.array([0.125, -0.25, 2.5]), np.array([0.5, 0.5, 0.5, -0.5]))

REGION_PX = (20, 12, 44, 31)
REGION = DepthPlan(2, REGION_PX)

FORMULAS = {
    "color_rgb": "R = 4 u, G = 5 v, B = 128 at column u, row v; JPEG is lossy: within 16",
    "frame_stereo.depth_units": (
        "round half to even of (depth_lattice_m / depth_scale_m) / (50 + 2 u + v); "
        "0 where u < 6 or v < 2"
    ),
    "frame_region.depth_units": (
        "as frame_stereo's where 20 <= u < 44 and 12 <= v < 31, or where u and v are even; else 0"
    ),
    "frame_aligned.depth_units": "5000 + 300 u + 7 v v; 0 where u < 6 or v < 2",
}


def color_picture() -> NDArray[np.uint8]:
    """The colour picture of every frame, (48, 64, 3)."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return np.dstack([4 * u, 5 * v, np.full_like(u, 128)]).astype(np.uint8)


def depth_picture(camera: RgbdCamera) -> NDArray[np.uint16]:
    """The depth picture (48, 64) of a frame: on the lattice, or off it for a camera without one."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    if camera.depth_lattice_m > 0:
        depth = np.rint(camera.depth_lattice_m / camera.depth_scale_m / (50 + 2 * u + v))
    else:
        depth = 5000 + 300 * u + 7 * v * v
    units: NDArray[np.uint16] = depth.astype(np.uint16)
    units[(u < 6) | (v < 2)] = 0
    return units


def frames() -> dict[str, tuple[RgbdFrame, FrameStamp]]:
    """Each frame by the name of its file."""
    stereo = RgbdFrame(
        color_picture(), depth_picture(STEREO), STEREO, 1_000_000_000, WORLD_FROM_CAMERA
    )
    aligned = RgbdFrame(color_picture(), depth_picture(ALIGNED), ALIGNED, 1_033_333_333, None)
    no_depth = RgbdFrame(color_picture(), None, ALIGNED, 1_066_666_666, None)
    return {
        "frame_stereo": (stereo, _stamp(7, 1_004_000_000)),
        "frame_aligned": (aligned, _stamp(8, 1_037_333_333)),
        "frame_color_only": (no_depth, _stamp(9, 1_070_666_666)),
        "frame_region": (stereo, _stamp(10, 1_100_000_000)),
    }


def encoding(name: str) -> Encoding:
    """How a frame is compressed."""
    return Encoding(depth=REGION) if name == "frame_region" else BEST


def arriving_depth(name: str) -> NDArray[np.uint16] | None:
    """The depth picture that a frame decodes to: what its plan leaves out is 0."""
    units = frames()[name][0].depth_units
    if name != "frame_region" or units is None:
        return units
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    x0, y0, x1, y1 = REGION_PX
    inside = (x0 <= u) & (u < x1) & (y0 <= v) & (v < y1)
    return np.where(inside | ((u % 2 == 0) & (v % 2 == 0)), units, 0).astype(np.uint16)


Small = Ack | Result | Probe | Status


def messages() -> dict[str, Small]:
    """Each message but the frames, by the name of its file."""
    ack = Ack("drone-1", BOOT_ID, 7, "worker-a", WORKER_BOOT_ID)
    target = TargetPose(
        camera_from_target=pose_numbers(CAMERA_FROM_TARGET),
        world_from_target=pose_numbers(WORLD_FROM_CAMERA @ CAMERA_FROM_TARGET),
        covariance=pack_covariance(np.diag([4e-6, 4e-6, 2.5e-5, 1e-4, 1e-4, 4e-2])),
        method="fused",
        ambiguous=True,
        alternative=(0.125, -0.25, 2.5, 0.7, 0.1, 0.7, -0.1),
        score=0.875,
        boxes=(
            LevelBox("T_good", 24.5, 10.0, 43.5, 29.0, 0.75),
            LevelBox("T_better", 27.0, 12.5, 41.0, 26.5, 0.875),
        ),
    )
    found = Result(
        drone="drone-1",
        boot_id=BOOT_ID,
        sequence=7,
        t_capture_ns=1_000_000_000,
        t1_ns=1_004_000_000,
        t2_ns=900_000_000_000,
        t3_ns=900_031_000_000,
        worker="worker-a",
        worker_boot_id=WORKER_BOOT_ID,
        outcome=Outcome.TARGET,
        reason="",
        target=target,
        stages_ns={"decode": 2_000_000, "detect": 25_000_000, "localise": 3_000_000},
        model="e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
        draining=False,
    )
    refused = msgspec.structs.replace(
        found,
        sequence=8,
        outcome=Outcome.REFUSED,
        reason="near-grazing view, 78 deg",
        target=None,
        draining=True,
    )
    up = Probe(BOOT_ID, 12, 1_050_000_000)
    back = dataclasses.replace(
        up, t2_ns=900_040_000_000, t3_ns=900_040_150_000, worker_boot_id=WORKER_BOOT_ID
    )
    status = Status(
        worker="worker-a",
        worker_boot_id=WORKER_BOOT_ID,
        sequence=31,
        waiting=1,
        drones=2,
        max_drones=8,
        service_p50_ns=29_000_000,
        service_p95_ns=41_000_000,
        model=found.model,
        draining=True,
    )
    return {
        "ack": ack,
        "probe_up": up,
        "probe_back": back,
        "result_target": found,
        "result_refused": refused,
        "status": status,
    }


def sealed(message: Small) -> bytes:
    """The whole message."""
    match message:
        case Ack():
            return seal_ack(message)
        case Result():
            return seal_result(message)
        case Probe():
            return seal_probe(message)
        case Status():
            return seal_status(message)


def named(value: Any) -> Any:
    """A message as nested dicts by field name, for people to read."""
    if isinstance(value, Probe):
        return dataclasses.asdict(value)
    if isinstance(value, msgspec.Struct):
        return {f: named(getattr(value, f)) for f in value.__struct_fields__}
    if isinstance(value, tuple):
        return [named(v) for v in value]
    return value


def describe(data: bytes, fields: dict[str, Any]) -> dict[str, Any]:
    """What the JSON says of one message."""
    kind, body = unseal(data, *Kind)
    return {"kind": kind.name, "body_bytes": len(body), "fields": fields}


def _stamp(sequence: int, t1_ns: int) -> FrameStamp:
    return FrameStamp("drone-1", BOOT_ID, sequence, t1_ns, budget_ns=250_000_000)


def main() -> None:
    """Write every vector and their description."""
    described: dict[str, Any] = {"formulas": FORMULAS, "messages": {}}
    for name, (frame, stamp) in frames().items():
        data = pack(compress(frame, encoding(name)), stamp)
        (HERE / f"{name}.bin").write_bytes(data)
        entry = describe(data, named(unpack(data).header))
        units = arriving_depth(name)
        if units is not None:
            little_endian = units.astype("<u2").tobytes()
            entry["depth_u16le_sha256"] = hashlib.sha256(little_endian).hexdigest()
        described["messages"][f"{name}.bin"] = entry
    for name, message in messages().items():
        data = sealed(message)
        (HERE / f"{name}.bin").write_bytes(data)
        described["messages"][f"{name}.bin"] = describe(data, named(message))
    (HERE / "vectors.json").write_text(json.dumps(described, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
