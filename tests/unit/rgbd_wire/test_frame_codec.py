"""A frame's way to bytes and back, and every way in which the bytes can be wrong."""

from __future__ import annotations

import struct

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.depth import NO_DEPTH, DepthPlan, DepthTable, lattice_values
from rgbd_wire.envelope import Kind, seal, unseal
from rgbd_wire.errors import DecodeError, GeometryError, Reject
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import (
    MAX_HEADER_BYTES,
    Encoding,
    FrameStamp,
    compress,
    decompress,
    pack,
    unpack,
)
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Ack, decode_header, encode_header, seal_ack

COLOR = CameraIntrinsics(64, 48, 60.0, 61.0, 31.5, 23.5)
DEPTH = CameraIntrinsics(
    56, 40, 57.0, 57.0, 28.0, 20.0, "brown_conrady", (0.1, 0.2, 0.01, 0.02, 0.3)
)
LATTICE_M = 57.0 * 0.095 * 32
RIG = Pose(np.array([-0.059, 0.0, 0.001]), np.array([1.0, 0.0, 0.0, 0.0]))
STEREO = RgbdCamera(COLOR, DEPTH, 0.001, RIG, LATTICE_M)
ALIGNED = RgbdCamera(COLOR, COLOR, 0.0002, Pose.identity())
WORLD_FROM_CAMERA = Pose(np.array([1.0, -2.0, 3.0]), np.array([0.5, -0.5, 0.5, -0.5]))
STAMP = FrameStamp("drone-1", boot_id=2**62 + 1, sequence=7, t1_ns=1_004, budget_ns=250_000_000)
NAN, INF = float("nan"), float("inf")


def color_picture():
    v, u = np.mgrid[:48, :64]
    return np.dstack([3 * u, 4 * v, u + v]).astype(np.uint8)


def frame_of(camera, *, depth=True, pose=WORLD_FROM_CAMERA):
    lens = camera.depth
    v, u = np.mgrid[: lens.height, : lens.width]
    units = 500 + 20 * u + v
    if camera.depth_lattice_m > 0:
        units = lattice_values(camera.depth_lattice_m, camera.depth_scale_m)[units % 600]
    picture = units.astype(np.uint16) if depth else None
    return RgbdFrame(color_picture(), picture, camera, 1_000, pose)


@pytest.fixture(scope="module")
def message():
    """A whole FRAME message with everything in it."""
    return pack(compress(frame_of(STEREO)), STAMP)


def take_apart(message):
    """Header, colour and depth of a FRAME message, by the table in docs/protocol.md."""
    _, body = unseal(message, Kind.FRAME)
    (length,) = struct.unpack_from("<I", body)
    header = decode_header(body[4 : 4 + length])
    color_end = 4 + length + header.color_bytes
    return header, bytes(body[4 + length : color_end]), bytes(body[color_end:])


def with_header(message, **changes):
    """The same message with other values in its header and a checksum that fits."""
    header, color, depth = take_apart(message)
    head = encode_header(msgspec.structs.replace(header, **changes))
    return seal(Kind.FRAME, struct.pack("<I", len(head)), head, color, depth)


def lens(**changes):
    return {"color": msgspec.structs.replace(WIRE_LENS, **changes)}


def refusal(data):
    with pytest.raises(DecodeError) as caught:
        decompress(unpack(data))
    assert "\n" not in str(caught.value)
    return caught.value.reason


def assert_same_camera(a, b):
    assert (a.color, a.depth) == (b.color, b.depth)
    assert (a.depth_scale_m, a.depth_lattice_m) == (b.depth_scale_m, b.depth_lattice_m)
    np.testing.assert_array_equal(a.color_from_depth.matrix, b.color_from_depth.matrix)


WIRE_LENS = take_apart(pack(compress(frame_of(STEREO)), STAMP))[0].color


@given(
    st.sampled_from([STEREO, ALIGNED]),
    st.booleans(),
    st.sampled_from([None, WORLD_FROM_CAMERA]),
    st.integers(0, 2**63 - 1),
    st.integers(0, 2**63 - 1),
)
def test_round_trip(camera, depth, pose, sequence, t_ns):
    """Everything comes back exactly, but the colour, which comes back close."""
    sent = frame_of(camera, depth=depth, pose=pose)
    stamp = FrameStamp("drone-1", sequence, sequence, t_ns, t_ns)
    packed = unpack(pack(compress(sent), stamp))
    header = packed.header
    assert (header.drone, header.boot_id, header.sequence) == ("drone-1", sequence, sequence)
    assert (header.t1_ns, header.budget_ns, header.t_capture_ns) == (t_ns, t_ns, 1_000)
    got = decompress(packed)
    assert_same_camera(got.camera, camera)
    assert got.t_capture_ns == sent.t_capture_ns
    assert (got.world_from_camera is None) == (pose is None)
    if pose is not None:
        np.testing.assert_array_equal(got.world_from_camera.matrix, pose.matrix)
    assert np.abs(got.color_rgb.astype(int) - sent.color_rgb).mean() < 6
    if depth:
        np.testing.assert_array_equal(got.depth_units, sent.depth_units)
    else:
        assert got.depth_units is None


def test_tables():
    """A sensor's lattice goes out as ranks, any other depth as it is, no depth as nothing."""
    assert compress(frame_of(STEREO)).depth.table is DepthTable.LATTICE
    assert compress(frame_of(ALIGNED)).depth.table is DepthTable.IDENTITY
    assert compress(frame_of(ALIGNED, depth=False)).depth is NO_DEPTH


def test_aligned_cameras_are_sent_once():
    """Depth on the colour pixels needs no intrinsics of its own."""
    header = unpack(pack(compress(frame_of(ALIGNED)), STAMP)).header
    assert (header.depth, header.color_from_depth) == (None, None)


def test_size_and_quality():
    """``size_bytes`` is both pictures; a lower JPEG quality makes the colour smaller."""
    fine, coarse = (
        compress(frame_of(STEREO), Encoding(95)),
        compress(frame_of(STEREO), Encoding(30)),
    )
    assert fine.size_bytes == len(fine.color) + fine.depth.size_bytes
    assert len(coarse.color) < len(fine.color)
    assert coarse.depth == fine.depth


def test_pictures_are_not_copied(message):
    """``unpack`` gives views into the received bytes."""
    packed = unpack(message)
    assert packed.color.obj is message
    assert packed.depth.coarse.obj is message


def test_a_view_of_a_larger_buffer_unpacks(message):
    """A transport may hand over a slice of its own buffer."""
    buffer = bytearray(b"head" + message + b"tail")
    packed = unpack(memoryview(buffer)[4:-4])
    assert packed.header == unpack(message).header
    np.testing.assert_array_equal(
        decompress(packed).depth_units, decompress(unpack(message)).depth_units
    )


def test_cut_off_at_every_length(message):
    """A message that was cut off is refused as truncated, wherever the cut."""
    for length in range(len(message)):
        with pytest.raises(DecodeError) as caught:
            unpack(message[:length])
        assert caught.value.reason is Reject.TRUNCATED


def test_cut_off_under_a_new_checksum():
    """A sender that lost bytes before it sealed them is found out by the lengths."""
    _, body = unseal(pack(compress(frame_of(STEREO, depth=False)), STAMP), Kind.FRAME)
    for length in range(len(body)):
        reason = refusal(seal(Kind.FRAME, bytes(body[:length])))
        assert reason in {Reject.TRUNCATED, Reject.WRONG_SIZE}


def test_one_flipped_bit_anywhere(message):
    """Every single flipped bit of a frame is found."""
    for bit in range(8 * len(message)):
        flipped = bytearray(message)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(DecodeError):
            unpack(bytes(flipped))


@pytest.mark.parametrize("others", [b"", b"\0", bytes(3)])
def test_a_body_too_short_for_a_header_length(others):
    """Four bytes of length come first."""
    assert refusal(seal(Kind.FRAME, others)) is Reject.TRUNCATED


@pytest.mark.parametrize(
    ("length", "reason"),
    [
        (0, Reject.BAD_HEADER),
        (1, Reject.BAD_HEADER),
        (-1, Reject.BAD_HEADER),
        (+1, Reject.BAD_HEADER),
        (MAX_HEADER_BYTES + 1, Reject.OVERSIZED),
        (2**31, Reject.OVERSIZED),
        (2**32 - 1, Reject.OVERSIZED),
    ],
)
def test_a_header_length_that_lies(message, length, reason):
    """Shorter, longer, absurd: never a half-read header."""
    _, body = unseal(message, Kind.FRAME)
    (true,) = struct.unpack_from("<I", body)
    lie = true + length if abs(length) == 1 and length != 1 else length
    assert refusal(seal(Kind.FRAME, struct.pack("<I", lie), bytes(body[4:]))) is reason


def test_a_header_that_reaches_past_the_body(message):
    """A length within its bound but past the end of the message."""
    header, _, _ = take_apart(message)
    head = encode_header(header)
    short = seal(Kind.FRAME, struct.pack("<I", len(head) + 1), head)
    assert refusal(short) is Reject.TRUNCATED


def test_a_padded_header(message):
    """Bytes between the header and the colour are nobody's."""
    header, color, depth = take_apart(message)
    head = encode_header(header) + b"\xc0"
    padded = seal(Kind.FRAME, struct.pack("<I", len(head)), head, color, depth)
    assert refusal(padded) is Reject.BAD_HEADER


@pytest.fixture(scope="module")
def region_message():
    """A FRAME message whose depth has a region."""
    plan = DepthPlan(2, (8, 4, 32, 20))
    return pack(compress(frame_of(STEREO), Encoding(depth=plan)), STAMP)


def test_a_region_goes_over_the_wire(region_message):
    """Full resolution in the region, half outside, and the header says so."""
    packed = unpack(region_message)
    assert packed.header.depth_step == 2
    assert packed.header.depth_region == (8, 4, 32, 20)
    sent, got = frame_of(STEREO).depth_units, decompress(packed).depth_units
    np.testing.assert_array_equal(got[4:20, 8:32], sent[4:20, 8:32])
    np.testing.assert_array_equal(got[::2, ::2], sent[::2, ::2])
    assert not got[1::2, 33::2].any()


@pytest.mark.parametrize(
    "changes",
    [
        {"depth_step": 1},
        {"depth_step": 3},
        {"depth_region": None},
        {"depth_region": (8, 4, 8, 20)},
        {"depth_region": (8, 4, 57, 20)},
        {"depth_region": (8, 4, 32, 41)},
        {"depth_region": (-8, 4, 32, 20)},
        {"depth_region": (8, 4, 32)},
        {"region_bytes": -1},
    ],
    ids=str,
)
def test_regions_that_cannot_be(region_message, changes):
    """Empty, outside, at full resolution or without its picture: found before decoding."""
    header, color, depth = take_apart(region_message)
    head = encode_header(msgspec.structs.replace(header, **changes))
    spoiled = seal(Kind.FRAME, struct.pack("<I", len(head)), head, color, depth)
    with pytest.raises(DecodeError) as caught:
        unpack(spoiled)
    assert caught.value.reason in (Reject.BAD_HEADER, Reject.WRONG_SIZE)


def test_a_region_without_depth(message):
    """A frame without a depth picture has no step and no region either."""
    bare = pack(compress(frame_of(STEREO, depth=False)), STAMP)
    assert refusal(with_header(bare, depth_step=2)) is Reject.BAD_HEADER
    assert refusal(with_header(message, region_bytes=1)) is Reject.WRONG_SIZE


@pytest.mark.parametrize("field", ["color_bytes", "depth_bytes"])
@pytest.mark.parametrize("by", [-1, 1, 1000])
def test_sizes_that_do_not_add_up(message, field, by):
    """Header, colour and depth fill the body, to the byte."""
    header, _, _ = take_apart(message)
    lie = with_header(message, **{field: getattr(header, field) + by})
    assert refusal(lie) is Reject.WRONG_SIZE


@pytest.mark.parametrize("by", [-1, 1, 100])
def test_sizes_that_add_up_but_cut_at_the_wrong_place(message, by):
    """A border between colour and depth in the wrong place spoils the colour."""
    header, _, _ = take_apart(message)
    lie = with_header(
        message, color_bytes=header.color_bytes + by, depth_bytes=header.depth_bytes - by
    )
    unpack(lie)
    assert refusal(lie) is Reject.BAD_COLOR


@pytest.mark.parametrize(
    "changes",
    [
        {"color_bytes": 0},
        {"color_bytes": 2**23 + 1},
        {"color_bytes": -1},
        {"depth_bytes": -1},
        {"depth_bytes": 2**63 - 1},
        {"t_capture_ns": -1},
        {"t1_ns": 2**63},
        {"budget_ns": 1.5},
        {"drone": "drone/1"},
        {"depth": None},
        {"color_from_depth": None},
        {"depth_table": "ranks"},
        {"depth_scale_m": 0.0},
        {"depth_scale_m": NAN},
        {"depth_scale_m": 1.0},
        {"depth_lattice_m": -1.0},
        {"depth_lattice_m": INF},
        {"color_from_depth": (1000.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)},
    ],
    ids=str,
)
def test_headers_out_of_bounds(message, changes):
    """Counts, times, names and the depth's own numbers."""
    assert refusal(with_header(message, **changes)) is Reject.BAD_HEADER


@pytest.mark.parametrize(
    "changes",
    [
        *[{"fx": f} for f in (0.0, -60.0, NAN, INF, 1e9, 1e-9)],
        *[{"fy": f} for f in (0.0, -60.0, NAN)],
        *[{"cx": c} for c in (NAN, INF, 1e9, -1e9)],
        {"cy": NAN},
        *[{"width": w} for w in (0, -1, 4097, 20_000, 2**31, 64.0)],
        {"width": 4096, "height": 4096},
        {"model": "fisheye"},
        {"coefficients": (0.0, 0.0, 0.0, 0.0)},
        {"coefficients": (0.0, 0.0, 0.0, 0.0, NAN)},
        {"coefficients": (0.0, 0.0, 0.0, 0.0, 1e9)},
    ],
    ids=str,
)
def test_cameras_that_cannot_be(message, changes):
    """Focal lengths, centres, sizes and lens models, in either camera."""
    spoiled = lens(**changes)["color"]
    assert refusal(with_header(message, color=spoiled)) is Reject.BAD_HEADER
    assert refusal(with_header(message, depth=spoiled)) is Reject.BAD_HEADER


@pytest.mark.parametrize("field", ["world_from_camera", "color_from_depth"])
@pytest.mark.parametrize(
    "numbers",
    [
        7 * (NAN,),
        (NAN, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, INF, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0),
        7 * (0.0,),
        (1e300, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
    ],
)
def test_poses_that_cannot_be(message, field, numbers):
    """Not finite, no rotation, or further than anything is."""
    assert refusal(with_header(message, **{field: numbers})) is Reject.BAD_POSE


@pytest.mark.parametrize("size", [{"width": 63}, {"width": 128, "height": 96}, {"height": 47}])
def test_a_size_that_is_not_the_pictures(message, size):
    """The announced size and the picture's own must agree, for colour and for depth."""
    header, _, _ = take_apart(message)
    assert refusal(with_header(message, **lens(**size))) is Reject.BAD_COLOR
    other = msgspec.structs.replace(header.depth, **size)
    assert refusal(with_header(message, depth=other)) is Reject.BAD_DEPTH


def test_ranks_of_another_lattice(message):
    """Ranks past the end of the announced lattice are refused; without one, all are."""
    assert refusal(with_header(message, depth_lattice_m=0.3)) is Reject.BAD_DEPTH
    assert refusal(with_header(message, depth_lattice_m=0.0)) is Reject.BAD_DEPTH


def test_pictures_swapped(message):
    """Depth in the place of colour is no colour."""
    header, color, depth = take_apart(message)
    head = encode_header(
        msgspec.structs.replace(header, color_bytes=len(depth), depth_bytes=len(color))
    )
    swapped = seal(Kind.FRAME, struct.pack("<I", len(head)), head, depth, color)
    assert refusal(swapped) is Reject.BAD_COLOR


def test_another_kind_of_message():
    """A frame's receiver takes frames alone."""
    ack = seal_ack(Ack("drone-1", 1, 2, "worker-a", 3))
    assert refusal(ack) is Reject.WRONG_KIND


def test_no_depth_at_all_is_depth_of_zeros_apart():
    """A frame with nothing but holes has a depth picture; a frame without a sensor has none."""
    holes = frame_of(STEREO)
    holes.depth_units[:] = 0
    assert not decompress(unpack(pack(compress(holes), STAMP))).depth_units.any()


def test_frames_whose_pictures_do_not_fit_their_camera():
    """Wrong sizes and types are found before anything is sent."""
    color, depth = color_picture(), np.zeros((40, 56), np.uint16)
    for bad_color in (color[:47], color[..., :2], color.astype(float)):
        with pytest.raises(GeometryError, match="colour"):
            RgbdFrame(bad_color, depth, STEREO, 0, None)
    for bad_depth in (depth[:, :55], depth.T, depth.astype(np.int32)):
        with pytest.raises(GeometryError, match="depth"):
            RgbdFrame(color, bad_depth, STEREO, 0, None)
