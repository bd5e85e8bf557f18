"""What goes over the wire besides pictures: typed, bounded, versioned by the envelope.

Every message is a msgspec struct in MessagePack array form. Types and ranges are checked while
decoding; that numbers are finite and quaternions of unit length, when they become a ``Pose``.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal, TypeAlias, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from rgbd_wire.camera import DistortionModel
from rgbd_wire.depth import DepthTable
from rgbd_wire.envelope import Kind, seal
from rgbd_wire.errors import DecodeError, GeometryError, Reject
from rgbd_wire.geometry import Array, Pose

Name: TypeAlias = Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9_-]{0,31}\Z")]
"""A drone's or worker's name; also one chunk of a Zenoh key."""
Counter: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Nanoseconds: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Reason: TypeAlias = Annotated[str, Meta(max_length=120)]
PoseNumbers: TypeAlias = tuple[float, float, float, float, float, float, float]
"""tx, ty, tz [m], qw, qx, qy, qz."""
MAX_POSE_NUMBER = 1e6
"""No pose lies further out [m]: what both ends compute with it stays finite."""
COVARIANCE_NUMBERS = 21
MAX_COVARIANCE_NUMBER = 1e12
Pixels: TypeAlias = Annotated[int, Meta(ge=0, le=4096)]
Pixel: TypeAlias = Annotated[float, Meta(ge=-1e5, le=1e5)]
Score: TypeAlias = Annotated[float, Meta(ge=0, le=1)]


class _Message(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Base of all messages: immutable, compact, strict."""


class Intrinsics(_Message, frozen=True):
    """A pinhole camera on the wire; see ``rgbd_wire.camera.CameraIntrinsics``."""

    width: Annotated[int, Meta(ge=1, le=4096)]
    height: Annotated[int, Meta(ge=1, le=4096)]
    fx: float
    fy: float
    cx: float
    cy: float
    model: DistortionModel
    coefficients: tuple[float, float, float, float, float]


class FrameHeader(_Message, frozen=True):
    """Everything about a frame but its pictures."""

    drone: Name
    boot_id: Counter
    """Random per start of the drone's client; a restart is another one."""
    sequence: Counter
    t_capture_ns: Nanoseconds
    """Middle of the exposure, drone's clock."""
    t1_ns: Nanoseconds
    """First byte handed to the link, drone's clock."""
    budget_ns: Nanoseconds
    """For how long after its arrival the worker's answer is still of use: what was left of age_max
    when the frame left, less the way there and back. A duration, on nobody's clock."""
    color: Intrinsics
    depth: Intrinsics | None
    """None: depth is aligned to the colour picture, or there is none."""
    color_from_depth: PoseNumbers | None
    depth_scale_m: float
    depth_lattice_m: float
    world_from_camera: PoseNumbers | None
    """Colour camera at ``t_capture_ns``; None: the drone does not know."""
    depth_table: DepthTable
    color_bytes: Annotated[int, Meta(ge=1, le=2**23)]
    depth_bytes: Annotated[int, Meta(ge=0, le=2**23)]
    """0: a frame without depth."""
    depth_step: Literal[1, 2, 4]
    """The depth picture holds every so-manieth row and column."""
    depth_region: tuple[Pixels, Pixels, Pixels, Pixels] | None
    """x0, y0, x1, y1 in pixels of the depth picture: sent at full resolution, as a picture of its
    own."""
    region_bytes: Annotated[int, Meta(ge=0, le=2**23)]
    """Of that picture."""


class Ack(_Message, frozen=True):
    """A worker has received a frame whole: it frees a slot of the drone's window."""

    drone: Name
    boot_id: Counter
    sequence: Counter
    worker: Name
    worker_boot_id: Counter


class Outcome(StrEnum):
    """What became of a frame on the worker."""

    TARGET = "target"
    NOTHING_FOUND = "nothing_found"
    NOT_A_TARGET = "not_a_target"
    """Boxes, but none that nest as the target's geometry says."""
    REFUSED = "refused"
    """A target, but no pose that one could stand for; the reason says why."""
    SUPERSEDED = "superseded"
    """A newer frame of the same drone came before this one's turn."""
    BAD_FRAME = "bad_frame"
    OVERLOADED = "overloaded"
    """More drones than this worker serves, or more frames than this one may send."""
    DROPPED = "dropped"
    """Its answer could not have come within the frame's budget; nobody looked at the picture."""
    DRAINING = "draining"
    FAILED = "failed"
    """A fault of the worker's own; its log has the details."""

    @property
    def looked_at(self) -> bool:
        """The detector saw the frame: the answer says something of the world."""
        return self in _LOOKED_AT


_LOOKED_AT = frozenset(
    {Outcome.TARGET, Outcome.NOTHING_FOUND, Outcome.NOT_A_TARGET, Outcome.REFUSED}
)


class LevelBox(_Message, frozen=True):
    """One detected level of the target, pixels of the colour picture."""

    level: Annotated[str, Meta(max_length=16)]
    x0: Pixel
    y0: Pixel
    x1: Pixel
    y1: Pixel
    score: Score


class TargetPose(_Message, frozen=True):
    """Where the target is, how sure that is, and how it was found."""

    camera_from_target: PoseNumbers
    world_from_target: PoseNumbers | None
    """With the drone's own ``world_from_camera`` of the exposure; None: it gave none."""
    covariance: Annotated[
        tuple[float, ...], Meta(min_length=COVARIANCE_NUMBERS, max_length=COVARIANCE_NUMBERS)
    ]
    """Upper triangle by rows of the 6x6: translation, then rotation vector, both in the camera
    frame, of a perturbation from the left [m^2, m rad, rad^2]."""
    method: Annotated[str, Meta(max_length=16)]
    ambiguous: bool
    """Both folds fit; ``alternative`` is the other one."""
    alternative: PoseNumbers | None
    """``camera_from_target`` of the other fold of the two conic poses."""
    score: Score
    boxes: Annotated[tuple[LevelBox, ...], Meta(max_length=8)]


class Result(_Message, frozen=True):
    """A worker's answer to a frame; echoes the drone's stamps and adds its own two."""

    drone: Name
    boot_id: Counter
    sequence: Counter
    t_capture_ns: Nanoseconds
    """Echo, drone's clock."""
    t1_ns: Nanoseconds
    """Echo, drone's clock."""
    t2_ns: Nanoseconds
    """Last byte at the socket, before any queue, worker's clock."""
    t3_ns: Nanoseconds
    """Just before sending, worker's clock."""
    worker: Name
    worker_boot_id: Counter
    outcome: Outcome
    reason: Reason
    """Why there is no target; empty when there is one."""
    target: TargetPose | None
    stages_ns: Annotated[
        dict[Annotated[str, Meta(max_length=16)], Nanoseconds], Meta(max_length=16)
    ]
    """Time each stage took on the worker, in the order in which they ran."""
    model: Annotated[str, Meta(max_length=64)]
    """SHA-256 of the detector's weights."""
    draining: bool
    """The worker is about to stop: go to another one."""


class Status(_Message, frozen=True):
    """How a worker is doing, for drones that choose."""

    worker: Name
    worker_boot_id: Counter
    sequence: Counter
    """Goes up with each status of one start."""
    waiting: Counter
    """Frames that wait for the detector."""
    drones: Counter
    """Drones that have a slot."""
    max_drones: Counter
    service_p50_ns: Nanoseconds
    """Median of t3 - t2 of late, over frames that were looked at; 0: none yet."""
    service_p95_ns: Nanoseconds
    model: Annotated[str, Meta(max_length=64)]
    draining: bool


_HEADER_DECODER = msgspec.msgpack.Decoder(FrameHeader)
_ENCODER = msgspec.msgpack.Encoder()
_T = TypeVar("_T")


def encode_header(header: FrameHeader) -> bytes:
    """MessagePack of a frame header."""
    return _ENCODER.encode(header)


def decode_header(data: memoryview) -> FrameHeader:
    """Frame header of its MessagePack.

    Raises:
        DecodeError: BAD_HEADER.
    """
    return _decode(_HEADER_DECODER, data)


def seal_result(result: Result) -> bytes:
    """A whole RESULT message."""
    return seal(Kind.RESULT, _ENCODER.encode(result))


def seal_ack(ack: Ack) -> bytes:
    """A whole ACK message."""
    return seal(Kind.ACK, _ENCODER.encode(ack))


def seal_status(status: Status) -> bytes:
    """A whole STATUS message."""
    return seal(Kind.STATUS, _ENCODER.encode(status))


_ACK_DECODER = msgspec.msgpack.Decoder(Ack)
_STATUS_DECODER = msgspec.msgpack.Decoder(Status)
_RESULT_DECODER = msgspec.msgpack.Decoder(Result)


def decode_ack(body: memoryview) -> Ack:
    """The ack in the body of an envelope.

    Raises:
        DecodeError: BAD_HEADER.
    """
    return _decode(_ACK_DECODER, body)


def decode_status(body: memoryview) -> Status:
    """The status in the body of an envelope.

    Raises:
        DecodeError: BAD_HEADER.
    """
    return _decode(_STATUS_DECODER, body)


def decode_result(body: memoryview) -> Result:
    """The result in the body of an envelope, with every pose finite and of unit quaternion.

    Raises:
        DecodeError: BAD_HEADER or BAD_POSE.
    """
    result = _decode(_RESULT_DECODER, body)
    if (result.outcome is Outcome.TARGET) != (result.target is not None):
        raise DecodeError(Reject.BAD_HEADER, f"outcome {result.outcome.value} and its target")
    if (t := result.target) is not None:
        for numbers in (t.camera_from_target, t.world_from_target, t.alternative):
            if numbers is not None:
                pose_of(numbers)
        if not all(abs(n) <= MAX_COVARIANCE_NUMBER for n in t.covariance):
            raise DecodeError(Reject.BAD_POSE, f"covariance not within {MAX_COVARIANCE_NUMBER:g}")
        covariance = unpack_covariance(t.covariance)
        if np.linalg.eigvalsh(covariance)[0] < -1e-9 * max(1e-12, float(np.trace(covariance))):
            raise DecodeError(Reject.BAD_POSE, "the covariance is not positive semi-definite")
    return result


def pose_numbers(pose: Pose) -> PoseNumbers:
    """A pose as it goes over the wire."""
    tx, ty, tz = pose.translation.tolist()
    qw, qx, qy, qz = pose.q_wxyz.tolist()
    return tx, ty, tz, qw, qx, qy, qz


def pose_of(numbers: PoseNumbers) -> Pose:
    """The pose of its seven numbers.

    Raises:
        DecodeError: BAD_POSE, not finite, past ``MAX_POSE_NUMBER`` or not a unit quaternion.
    """
    if not all(abs(n) <= MAX_POSE_NUMBER for n in numbers):  # false for NaN
        raise DecodeError(Reject.BAD_POSE, f"{numbers} is not within {MAX_POSE_NUMBER:g}")
    try:
        return Pose(np.array(numbers[:3]), np.array(numbers[3:]))
    except GeometryError as error:
        raise DecodeError(Reject.BAD_POSE, str(error)) from None


_UPPER = np.triu_indices(6)


def pack_covariance(covariance: Array) -> tuple[float, ...]:
    """Upper triangle by rows (21) of a symmetric (6, 6)."""
    return tuple(covariance[_UPPER].tolist())


def unpack_covariance(numbers: tuple[float, ...]) -> Array:
    """Symmetric (6, 6) of its upper triangle by rows (21)."""
    upper = np.zeros((6, 6))
    upper[_UPPER] = numbers
    return np.asarray(upper + np.triu(upper, 1).T)


def _decode(decoder: msgspec.msgpack.Decoder[_T], data: memoryview) -> _T:
    try:
        return decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise DecodeError(Reject.BAD_HEADER, str(error)) from None
