"""What the client's tests are built from: a small camera, frames, a worker that answers them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import unpack
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import (
    Ack,
    FrameHeader,
    LevelBox,
    Outcome,
    Result,
    TargetPose,
    pack_covariance,
    pose_numbers,
    seal_ack,
    seal_result,
)

MS = 1_000_000
SECOND = 1_000_000_000
WIDTH, HEIGHT = 16, 12
INTRINSICS = CameraIntrinsics(WIDTH, HEIGHT, 20.0, 20.0, 7.5, 5.5)
CAMERA = RgbdCamera(INTRINSICS, INTRINSICS, 0.001, Pose.identity())
WORKER_BOOT_ID = 42
SMALL_COVARIANCE = np.diag([1e-6, 1e-6, 4e-6, 1e-6, 1e-6, 1e-4])


def eventually(holds: Callable[[], bool], timeout_s: float = 10.0) -> bool:
    """Whether something becomes true within a generous time; looks every 2 ms."""
    give_up = time.monotonic() + timeout_s
    pause = threading.Event()
    while not holds():
        if time.monotonic() > give_up:
            return False
        pause.wait(0.002)
    return True


def pose(translation: Sequence[float] = (0, 0, 0), rotation_vector: Sequence[float] = (0, 0, 0)):
    """A pose from a translation [m] and a rotation vector [rad], by SciPy."""
    xyzw = Rotation.from_rotvec(rotation_vector).as_quat()
    return Pose(np.array(translation, dtype=float), xyzw[[3, 0, 1, 2]])


def rotation_of(p: Pose) -> Rotation:
    """SciPy's rotation of a pose."""
    return Rotation.from_quat(p.q_wxyz[[1, 2, 3, 0]])


def frame(t_capture_ns: int = 0, world_from_camera: Pose | None = None) -> RgbdFrame:
    """A tiny frame with a gradient and flat depth."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    color = np.dstack([15 * u, 20 * v, np.full_like(u, 90)]).astype(np.uint8)
    depth = np.full((HEIGHT, WIDTH), 2000, np.uint16)
    return RgbdFrame(color, depth, CAMERA, t_capture_ns, world_from_camera)


def target_of(
    camera_from_target: Pose, covariance=SMALL_COVARIANCE, ambiguous: bool = False
) -> TargetPose:
    """A target as a worker tells it."""
    return TargetPose(
        camera_from_target=pose_numbers(camera_from_target),
        world_from_target=None,
        covariance=pack_covariance(np.asarray(covariance)),
        method="fused",
        ambiguous=ambiguous,
        alternative=None,
        score=0.9,
        boxes=(LevelBox("T_good", 1.0, 2.0, 9.0, 10.0, 0.9),),
    )


def ack_of(header: FrameHeader, worker: str, boot_id: int = WORKER_BOOT_ID) -> Ack:
    """A worker's receive-ack of a frame."""
    return Ack(header.drone, header.boot_id, header.sequence, worker, boot_id)


def result_of(
    header: FrameHeader,
    worker: str,
    target: TargetPose | None,
    service_ns: int = 0,
    boot_id: int = WORKER_BOOT_ID,
) -> Result:
    """A worker's answer to a frame; its clock stands at 7 s when the frame comes in."""
    return Result(
        drone=header.drone,
        boot_id=header.boot_id,
        sequence=header.sequence,
        t_capture_ns=header.t_capture_ns,
        t1_ns=header.t1_ns,
        t2_ns=7 * SECOND,
        t3_ns=7 * SECOND + service_ns,
        worker=worker,
        worker_boot_id=boot_id,
        outcome=Outcome.NOTHING_FOUND if target is None else Outcome.TARGET,
        reason="no box" if target is None else "",
        target=target,
        stages_ns={"decode": 1000, "detect": 2000},
        model="0" * 64,
        draining=False,
    )


def answering(
    target: Callable[[FrameHeader], TargetPose | None] = lambda _: None,
) -> Callable[[str, bytes], list[bytes]]:
    """A worker for ``MemoryLink``: an ack and a result for each frame, at once."""

    def answer(worker: str, message: bytes) -> list[bytes]:
        header = unpack(message).header
        return [
            seal_ack(ack_of(header, worker)),
            seal_result(result_of(header, worker, target(header))),
        ]

    return answer


coordinates = st.floats(-10, 10)
vectors = st.tuples(coordinates, coordinates, coordinates)
rotation_vectors = st.tuples(*[st.floats(-1.8, 1.8)] * 3)  # length below pi
poses = st.builds(pose, vectors, rotation_vectors)
