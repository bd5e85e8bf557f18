"""A frame and its bytes: header, colour, depth.

The work comes in two halves on both sides, so that each runs where it belongs. Sending:
``compress`` is costly and knows no time; ``pack`` stamps t1 and copies. Receiving: ``unpack`` is
cheap and checks everything but the pictures, ``decompress`` decodes them.

Body of a FRAME envelope: u32 length of the header, header, colour, depth, the depth's region
(docs/protocol.md).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.color import DEFAULT_JPEG_QUALITY, decode_color, encode_color
from rgbd_wire.depth import ALL_OF_IT, NO_DEPTH, CodedDepth, DepthPlan, decode_depth, encode_depth
from rgbd_wire.envelope import Kind, seal, unseal
from rgbd_wire.errors import DecodeError, GeometryError, Reject
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import (
    FrameHeader,
    Intrinsics,
    decode_header,
    encode_header,
    pose_numbers,
    pose_of,
)

_HEADER_LENGTH = struct.Struct("<I")
MAX_HEADER_BYTES = 2048


@dataclass(frozen=True, slots=True)
class Encoding:
    """How a frame is compressed."""

    jpeg_quality: int = DEFAULT_JPEG_QUALITY
    depth: DepthPlan = ALL_OF_IT


BEST = Encoding()


@dataclass(frozen=True, slots=True, eq=False)
class CompressedFrame:
    """A frame's pictures, compressed."""

    frame: RgbdFrame
    color: bytes
    depth: CodedDepth

    @property
    def size_bytes(self) -> int:
        """Bytes of all pictures."""
        return len(self.color) + self.depth.size_bytes


@dataclass(frozen=True, slots=True)
class FrameStamp:
    """Who sends a frame, and when."""

    drone: str
    boot_id: int
    sequence: int
    t1_ns: int
    """First byte handed to the link, drone's clock."""
    budget_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class PackedFrame:
    """A received frame, header checked, pictures still compressed."""

    header: FrameHeader
    camera: RgbdCamera
    world_from_camera: Pose | None
    color: memoryview
    depth: CodedDepth


def compress(frame: RgbdFrame, encoding: Encoding = BEST) -> CompressedFrame:
    """Compress both pictures of a frame; what is sent of the depth, without loss."""
    color = encode_color(frame.color_rgb, encoding.jpeg_quality)
    depth, camera = NO_DEPTH, frame.camera
    if frame.depth_units is not None:
        depth = encode_depth(
            frame.depth_units, camera.depth_lattice_m, camera.depth_scale_m, encoding.depth
        )
    return CompressedFrame(frame, color, depth)


def pack(compressed: CompressedFrame, stamp: FrameStamp) -> bytes:
    """A whole FRAME message."""
    frame, camera, depth = compressed.frame, compressed.frame.camera, compressed.depth
    aligned = camera.aligned
    header = FrameHeader(
        drone=stamp.drone,
        boot_id=stamp.boot_id,
        sequence=stamp.sequence,
        t_capture_ns=frame.t_capture_ns,
        t1_ns=stamp.t1_ns,
        budget_ns=stamp.budget_ns,
        color=_to_wire(camera.color),
        depth=None if aligned else _to_wire(camera.depth),
        color_from_depth=None if aligned else pose_numbers(camera.color_from_depth),
        depth_scale_m=camera.depth_scale_m,
        depth_lattice_m=camera.depth_lattice_m,
        world_from_camera=(
            None if frame.world_from_camera is None else pose_numbers(frame.world_from_camera)
        ),
        depth_table=depth.table,
        color_bytes=len(compressed.color),
        depth_bytes=len(depth.coarse),
        depth_step=depth.step,
        depth_region=depth.region,
        region_bytes=len(depth.fine),
    )
    head = encode_header(header)
    parts = (_HEADER_LENGTH.pack(len(head)), head, compressed.color, depth.coarse, depth.fine)
    return seal(Kind.FRAME, *parts)


def unpack(data: bytes | memoryview) -> PackedFrame:
    """Check a FRAME message and take it apart, without copying or decoding the pictures.

    Raises:
        DecodeError: with the reason; nothing larger than the header has been allocated.
    """
    _, body = unseal(data, Kind.FRAME)
    if len(body) < _HEADER_LENGTH.size:
        raise DecodeError(Reject.TRUNCATED, "no room for the header's length")
    (head_bytes,) = _HEADER_LENGTH.unpack_from(body)
    if head_bytes > MAX_HEADER_BYTES:
        raise DecodeError(Reject.OVERSIZED, f"header of {head_bytes}, at most {MAX_HEADER_BYTES}")
    head_end = _HEADER_LENGTH.size + head_bytes
    if head_end > len(body):
        raise DecodeError(Reject.TRUNCATED, f"header of {head_bytes} in {len(body)} bytes")
    header = decode_header(body[_HEADER_LENGTH.size : head_end])
    color_end = head_end + header.color_bytes
    depth_end = color_end + header.depth_bytes
    if depth_end + header.region_bytes != len(body):
        raise DecodeError(
            Reject.WRONG_SIZE,
            f"header {head_bytes} + colour {header.color_bytes} + depth {header.depth_bytes} + "
            f"region {header.region_bytes} in {len(body)} bytes",
        )
    _check_region(header)
    pose = header.world_from_camera
    return PackedFrame(
        header=header,
        camera=_camera(header),
        world_from_camera=None if pose is None else pose_of(pose),
        color=body[head_end:color_end],
        depth=CodedDepth(
            header.depth_table,
            header.depth_step,
            body[color_end:depth_end],
            header.depth_region,
            body[depth_end:],
        ),
    )


def decompress(packed: PackedFrame) -> RgbdFrame:
    """Decode both pictures.

    Raises:
        DecodeError: BAD_COLOR or BAD_DEPTH.
    """
    header, camera = packed.header, packed.camera
    color_rgb = decode_color(packed.color, camera.color.width, camera.color.height)
    depth_units = None
    if header.depth_bytes:
        depth_units = decode_depth(
            packed.depth,
            camera.depth.width,
            camera.depth.height,
            camera.depth_lattice_m,
            camera.depth_scale_m,
        )
    return RgbdFrame(color_rgb, depth_units, camera, header.t_capture_ns, packed.world_from_camera)


def _check_region(header: FrameHeader) -> None:
    """Refuse a region without a picture, a picture without a region, and either without depth."""
    region = header.depth_region
    if (region is None) != (header.region_bytes == 0):
        raise DecodeError(Reject.BAD_HEADER, f"region {region} of {header.region_bytes} bytes")
    if not header.depth_bytes and (header.depth_step, region) != (1, None):
        raise DecodeError(Reject.BAD_HEADER, "a step or region without a depth picture")
    if region is None:
        return
    lens = header.color if header.depth is None else header.depth
    x0, y0, x1, y1 = region
    if header.depth_step == 1 or not (x0 < x1 <= lens.width and y0 < y1 <= lens.height):
        raise DecodeError(
            Reject.BAD_HEADER,
            f"region {region} of {lens.width}x{lens.height} at step {header.depth_step}",
        )


def _to_wire(camera: CameraIntrinsics) -> Intrinsics:
    return Intrinsics(
        camera.width,
        camera.height,
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        camera.model,
        camera.coefficients,
    )


def _from_wire(i: Intrinsics) -> CameraIntrinsics:
    return CameraIntrinsics(i.width, i.height, i.fx, i.fy, i.cx, i.cy, i.model, i.coefficients)


def _camera(header: FrameHeader) -> RgbdCamera:
    if (header.depth is None) != (header.color_from_depth is None):
        raise DecodeError(Reject.BAD_HEADER, "depth intrinsics and color_from_depth go together")
    try:
        color = _from_wire(header.color)
        depth = color if header.depth is None else _from_wire(header.depth)
        numbers = header.color_from_depth
        color_from_depth = Pose.identity() if numbers is None else pose_of(numbers)
        return RgbdCamera(
            color, depth, header.depth_scale_m, color_from_depth, header.depth_lattice_m
        )
    except GeometryError as error:
        raise DecodeError(Reject.BAD_HEADER, str(error)) from None
