"""Acks, results and headers: what goes in comes out, and nothing else is taken for one."""

from __future__ import annotations

import math
import struct

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.errors import DecodeError, Reject
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import (
    COVARIANCE_NUMBERS,
    MAX_POSE_NUMBER,
    Ack,
    FrameHeader,
    Intrinsics,
    LevelBox,
    Outcome,
    Result,
    TargetPose,
    decode_ack,
    decode_header,
    decode_result,
    encode_header,
    pack_covariance,
    pose_numbers,
    pose_of,
    seal_ack,
    seal_result,
    unpack_covariance,
)

IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
COVARIANCE = pack_covariance(np.diag([1e-6, 1e-6, 1e-5, 1e-4, 1e-4, 1e-2]))
ACK = Ack("drone-1", 1, 2, "worker-a", 3)
TARGET = TargetPose(
    camera_from_target=(0.1, -0.2, 2.5, 0.5, -0.5, -0.5, -0.5),
    world_from_target=None,
    covariance=COVARIANCE,
    method="fused",
    ambiguous=False,
    alternative=None,
    score=0.9,
    boxes=(LevelBox("T_good", 1.0, 2.0, 3.0, 4.0, 0.5),),
)
RESULT = Result(
    drone="drone-1",
    boot_id=1,
    sequence=2,
    t_capture_ns=3,
    t1_ns=4,
    t2_ns=5,
    t3_ns=6,
    worker="worker-a",
    worker_boot_id=7,
    outcome=Outcome.TARGET,
    reason="",
    target=TARGET,
    stages_ns={"decode": 1, "detect": 2},
    model="0" * 64,
    draining=False,
)
LENS = Intrinsics(640, 480, 600.0, 600.0, 320.0, 240.0, "none", (0.0, 0.0, 0.0, 0.0, 0.0))
HEADER = FrameHeader(
    drone="drone-1",
    boot_id=1,
    sequence=2,
    t_capture_ns=3,
    t1_ns=4,
    budget_ns=5,
    color=LENS,
    depth=LENS,
    color_from_depth=IDENTITY,
    depth_scale_m=0.001,
    depth_lattice_m=1155.2,
    world_from_camera=IDENTITY,
    depth_table="lattice",
    color_bytes=20_000,
    depth_bytes=80_000,
    depth_step=2,
    depth_region=(100, 80, 300, 240),
    region_bytes=9_000,
)
DECODERS = {Ack: decode_ack, Result: decode_result, FrameHeader: decode_header}
MESSAGES = [ACK, RESULT, HEADER]

names = st.from_regex(r"[a-z0-9][a-z0-9_-]{0,31}", fullmatch=True)
counters = st.integers(0, 2**63 - 1)
unit_numbers = st.floats(0, 1)
pose_tuples = st.builds(
    lambda t, q: (*t, *(np.array(q) / np.linalg.norm(q)).tolist()),
    st.tuples(*[st.floats(-MAX_POSE_NUMBER, MAX_POSE_NUMBER)] * 3),
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 1e-3),
)
covariances = st.lists(st.floats(-1, 1), min_size=36, max_size=36).map(
    lambda a: pack_covariance(np.reshape(a, (6, 6)) @ np.reshape(a, (6, 6)).T)
)
pixels = st.floats(-1e5, 1e5)
boxes = st.builds(
    LevelBox, st.text(max_size=16), pixels, pixels, pixels, pixels, score=unit_numbers
)
targets = st.builds(
    TargetPose,
    camera_from_target=pose_tuples,
    world_from_target=st.none() | pose_tuples,
    covariance=covariances,
    method=st.text(max_size=16),
    ambiguous=st.booleans(),
    alternative=st.none() | pose_tuples,
    score=unit_numbers,
    boxes=st.lists(boxes, max_size=8).map(tuple),
)
results = st.builds(
    lambda target, outcome, **fields: Result(
        target=target, outcome=outcome if target is None else Outcome.TARGET, **fields
    ),
    target=st.none() | targets,
    outcome=st.sampled_from([o for o in Outcome if o is not Outcome.TARGET]),
    drone=names,
    boot_id=counters,
    sequence=counters,
    t_capture_ns=counters,
    t1_ns=counters,
    t2_ns=counters,
    t3_ns=counters,
    worker=names,
    worker_boot_id=counters,
    reason=st.text(max_size=120),
    stages_ns=st.dictionaries(st.text(max_size=16), counters, max_size=16),
    model=st.text(max_size=64),
    draining=st.booleans(),
)


def packed(message):
    return msgspec.msgpack.encode(message)


def fields_of(message):
    """The MessagePack array of a message, as lists that a test can spoil."""
    return msgspec.msgpack.decode(packed(message))


def refusal(decode, data):
    with pytest.raises(DecodeError) as caught:
        decode(memoryview(data))
    return caught.value.reason


def result_with(**target_fields):
    return msgspec.structs.replace(RESULT, target=msgspec.structs.replace(TARGET, **target_fields))


@given(st.builds(Ack, names, counters, counters, names, counters))
def test_ack_round_trip(ack):
    """Any ack within its bounds comes out as it went in."""
    kind, body = unseal(seal_ack(ack), Kind.ACK)
    assert kind is Kind.ACK
    assert decode_ack(body) == ack


@given(results)
def test_result_round_trip(result):
    """Any result within its bounds comes out as it went in, and fits into its envelope."""
    kind, body = unseal(seal_result(result), Kind.RESULT)
    assert kind is Kind.RESULT
    assert decode_result(body) == result


def test_header_round_trip():
    """A header comes out as it went in, with and without its optional parts."""
    for header in (
        HEADER,
        msgspec.structs.replace(HEADER, depth=None, color_from_depth=None, world_from_camera=None),
    ):
        assert decode_header(memoryview(encode_header(header))) == header


def test_the_largest_messages_fit_their_envelopes():
    """Bounds on fields and bounds on bodies agree."""
    name, count, text = "x" * 32, 2**63 - 1, "\U0001f681"
    ack = Ack(name, count, count, name, count)
    pose = (-1.234e5, 1.234e5, 1.234e5, 0.1, 0.7, 0.1, 0.7)
    target = TargetPose(
        camera_from_target=pose,
        world_from_target=pose,
        covariance=COVARIANCE,
        method=16 * text,
        ambiguous=True,
        alternative=pose,
        score=0.123,
        boxes=8 * (LevelBox(16 * text, 0.1, 0.2, 0.3, 0.4, 0.5),),
    )
    result = Result(
        name, count, count, count, count, count, count, name, count, Outcome.TARGET,
        120 * text, target, {f"{i:02}" + 14 * text: count for i in range(16)}, 64 * text, True,
    )  # fmt: skip
    assert decode_ack(unseal(seal_ack(ack), Kind.ACK)[1]) == ack
    assert decode_result(unseal(seal_result(result), Kind.RESULT)[1]) == result


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_cut_off_at_every_length(message):
    """No part of a message passes for the message."""
    data = packed(message)
    for length in range(len(data)):
        assert refusal(DECODERS[type(message)], data[:length]) is Reject.BAD_HEADER


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_a_field_more_or_less(message):
    """Another version's message, with another number of fields, is not half understood."""
    decode, fields = DECODERS[type(message)], fields_of(message)
    assert refusal(decode, packed([*fields, None])) is Reject.BAD_HEADER
    assert refusal(decode, packed(fields[:-1])) is Reject.BAD_HEADER
    assert refusal(decode, packed(message) + b"\0") is Reject.BAD_HEADER


def test_a_field_more_or_less_within_a_message():
    """Nor is a camera of fewer numbers filled up with what was meant to be usual."""
    fields = fields_of(HEADER)
    (place, lens) = next((i, f) for i, f in enumerate(fields) if f == fields_of(LENS))
    for spoiled in (lens[:-1], lens[:-2], [*lens, None]):
        changed = [*fields[:place], spoiled, *fields[place + 1 :]]
        assert refusal(decode_header, packed(changed)) is Reject.BAD_HEADER


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_no_message_is_another(message):
    """A body under the wrong kind is refused."""
    for other, decode in DECODERS.items():
        if other is not type(message):
            assert refusal(decode, packed(message)) is Reject.BAD_HEADER


@pytest.mark.parametrize("name", ["", "A", "-a", "a" * 33, "a b", "a/b", "a*", "ä", "a\n", "a\0"])
@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_names_that_are_no_key_chunk(message, name):
    """A name with a slash, a wildcard or a line break never gets as far as a key or a log."""
    spoiled = msgspec.structs.replace(message, drone=name)
    assert refusal(DECODERS[type(message)], packed(spoiled)) is Reject.BAD_HEADER


@pytest.mark.parametrize("value", [-1, 2**63, 2**64 - 1, 1.0, float("nan"), "1", None, True, []])
@pytest.mark.parametrize("field", ["boot_id", "sequence"])
@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_counters_are_63_bit_whole_numbers(message, field, value):
    """Too large, negative, fractional or no number at all."""
    spoiled = msgspec.structs.replace(message, **{field: value})
    assert refusal(DECODERS[type(message)], packed(spoiled)) is Reject.BAD_HEADER


@pytest.mark.parametrize(
    ("numbers", "why"),
    [
        (IDENTITY[:3] + (2.0, 0.0, 0.0, 0.0), "unit"),
        (IDENTITY[:3] + (0.0, 0.0, 0.0, 0.0), "unit"),
        (IDENTITY[:3] + (0.0, 0.0, 0.0, 1.01), "unit"),
        ((float("nan"), *IDENTITY[1:]), "within"),
        ((float("inf"), *IDENTITY[1:]), "within"),
        ((1e308, *IDENTITY[1:]), "within"),
        ((math.nextafter(MAX_POSE_NUMBER, math.inf), *IDENTITY[1:]), "within"),
        (IDENTITY[:6] + (float("nan"),), "within"),
        (IDENTITY[:3] + (1e200, 0.0, 0.0, 0.0), "within"),
        (7 * (float("nan"),), "within"),
    ],
)
@pytest.mark.parametrize("field", ["camera_from_target", "world_from_target", "alternative"])
def test_impossible_poses_in_a_result(field, numbers, why):
    """Not finite, absurdly far, or no rotation: refused as a pose, wherever it stands."""
    with pytest.raises(DecodeError, match=why) as caught:
        decode_result(memoryview(packed(result_with(**{field: numbers}))))
    assert caught.value.reason is Reject.BAD_POSE


@pytest.mark.parametrize("numbers", [IDENTITY[:6], (*IDENTITY, 0.0), ("0", *IDENTITY[1:]), None])
def test_a_pose_is_seven_numbers(numbers):
    """Another count or type is no pose."""
    data = packed(result_with(camera_from_target=numbers))
    assert refusal(decode_result, data) is Reject.BAD_HEADER


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1, 1, 1, 1, 1, -1e-3]),
        np.diag([-1e-3, 0, 0, 0, 0, 0]),
        np.eye(6) + 2 * (np.eye(6, k=1) + np.eye(6, k=-1)),
        np.full((6, 6), np.nan),
        np.diag([np.inf, 1, 1, 1, 1, 1]),
        np.full((6, 6), 1e308),
        np.diag([1e13, 1, 1, 1, 1, 1]),
    ],
)
def test_impossible_covariances(matrix):
    """Not finite, absurdly large, or with a negative variance in some direction."""
    data = packed(result_with(covariance=pack_covariance(matrix)))
    assert refusal(decode_result, data) is Reject.BAD_POSE


def test_a_covariance_with_a_blind_direction():
    """Zero variance, and rank one, are covariances."""
    v = np.array([1.0, -2.0, 3.0, 1e-3, 0.0, 1e3])
    for matrix in (np.zeros((6, 6)), np.outer(v, v)):
        decode_result(memoryview(packed(result_with(covariance=pack_covariance(matrix)))))


@pytest.mark.parametrize("count", [0, COVARIANCE_NUMBERS - 1, COVARIANCE_NUMBERS + 1, 36])
def test_a_covariance_has_21_numbers(count):
    """Another count is no upper triangle of a 6x6."""
    data = packed(result_with(covariance=count * (0.0,)))
    assert refusal(decode_result, data) is Reject.BAD_HEADER


@pytest.mark.parametrize("score", [-0.01, 1.01, float("nan"), float("inf"), "0.5", None])
def test_scores_lie_between_0_and_1(score):
    """A score that is none would pass or fail every threshold."""
    box = LevelBox("T_good", 1.0, 2.0, 3.0, 4.0, score)
    for spoiled in (result_with(score=score), result_with(boxes=(box,))):
        assert refusal(decode_result, packed(spoiled)) is Reject.BAD_HEADER


@pytest.mark.parametrize("edge", ["x0", "y0", "x1", "y1"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e6])
def test_boxes_lie_near_the_picture(edge, value):
    """An edge that is no pixel is refused."""
    box = msgspec.structs.replace(TARGET.boxes[0], **{edge: value})
    assert refusal(decode_result, packed(result_with(boxes=(box,)))) is Reject.BAD_HEADER


@pytest.mark.parametrize(
    "spoiled",
    [
        {"outcome": Outcome.TARGET, "target": None},
        {"outcome": Outcome.NOTHING_FOUND},
        {"outcome": "maybe"},
        {"reason": 121 * "x"},
        {"model": 65 * "x"},
        {"stages_ns": {str(i): 1 for i in range(17)}},
        {"stages_ns": {17 * "x": 1}},
        {"stages_ns": {"decode": -1}},
        {"draining": 1},
    ],
)
def test_results_out_of_bounds(spoiled):
    """An outcome that contradicts itself, and texts and tables that are too long."""
    data = packed(msgspec.structs.replace(RESULT, **spoiled))
    assert refusal(decode_result, data) is Reject.BAD_HEADER


def test_too_many_boxes_or_too_long_names():
    """Eight boxes, sixteen characters."""
    box = TARGET.boxes[0]
    for spoiled in (
        result_with(boxes=9 * (box,)),
        result_with(method=17 * "x"),
        result_with(boxes=(msgspec.structs.replace(box, level=17 * "x"),)),
    ):
        assert refusal(decode_result, packed(spoiled)) is Reject.BAD_HEADER


values = st.recursive(
    st.none()
    | st.booleans()
    | st.floats()
    | st.integers(-(2**63), 2**64 - 1)
    | st.text(max_size=8)
    | st.binary(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=16)
        | st.dictionaries(st.text(max_size=3) | st.integers(0, 9), inner, max_size=3)
    ),
    max_leaves=20,
)


@given(st.lists(values, max_size=16) | values)
def test_random_messagepack_is_refused(value):
    """Well-formed MessagePack that is no message of ours."""
    for decode in DECODERS.values():
        assert refusal(decode, packed(value)) is Reject.BAD_HEADER


@given(st.binary(max_size=64))
def test_garbage_is_refused(data):
    """Bytes that are not even MessagePack."""
    for decode in DECODERS.values():
        assert refusal(decode, data) is Reject.BAD_HEADER


@pytest.mark.parametrize(
    "data",
    [
        5000 * b"\x91" + b"\x00",  # arrays in arrays
        b"\x95" + 5000 * b"\x91" + b"\x00",
        5000 * b"\x81\xa1a" + b"\x00",  # maps in maps
        b"\xdd\xff\xff\xff\xff",  # an array of four thousand million
        b"\xdf\xff\xff\xff\xff",
        b"\x95\xdb\xff\xff\xff\xffdrone",  # a text of four gigabytes
        b"\x95\xa7\xff\xfe\xfd\xfc\xfb\xfa\xf9" + b"\x01\x02\xa1w\x03",  # not UTF-8
        b"\x95\xa7\xed\xa0\x80none" + b"\x01\x02\xa1w\x03",  # half a surrogate pair
        b"\x95\xa1d\x01\x02\xa1w\xca" + struct.pack(">f", 3.0),  # a float where a count belongs
        b"\x95\xa1d\xd3" + struct.pack(">q", -1) + b"\x02\xa1w\x03",
        b"\x95\xa1d\xcf" + struct.pack(">Q", 2**64 - 1) + b"\x02\xa1w\x03",
        b"\x95\xa1d\x01\x02\xa1w\xd6\xff\x00\x00\x00\x00",  # a timestamp
        b"\xc1",
    ],
)
def test_hostile_messagepack(data):
    """Endless nesting, lying lengths, broken text, the wrong kind of number."""
    for decode in DECODERS.values():
        assert refusal(decode, data) is Reject.BAD_HEADER


def test_other_widths_of_the_same_number_are_understood():
    """An implementer may write any MessagePack width: only the value counts."""
    wide = b"\xdc\x00\x05\xd9\x07drone-1\xcf" + struct.pack(">Q", 1)
    wide += b"\xd3" + struct.pack(">q", 2) + b"\xda\x00\x08worker-a\xce" + struct.pack(">I", 3)
    assert decode_ack(memoryview(wide)) == ACK


@given(pose_tuples)
def test_pose_numbers_round_trip(numbers):
    """Translation, then the quaternion ``wxyz``."""
    pose = pose_of(numbers)
    np.testing.assert_array_equal(pose.translation, numbers[:3])
    np.testing.assert_allclose(pose_numbers(pose), numbers, rtol=1e-12, atol=1e-12)


def test_pose_numbers_are_plain_floats():
    """The encoder never meets a numpy number."""
    assert {type(n) for n in pose_numbers(Pose.identity())} == {float}
    assert {type(n) for n in pack_covariance(np.eye(6))} == {float}


def test_covariance_order():
    """Row by row, from the diagonal to the right."""
    symmetric = np.arange(36).reshape(6, 6)
    symmetric = np.triu(symmetric) + np.triu(symmetric, 1).T
    numbers = pack_covariance(symmetric.astype(float))
    assert numbers == (
        0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 14, 15, 16, 17, 21, 22, 23, 28, 29, 35
    )  # fmt: skip
    np.testing.assert_array_equal(unpack_covariance(numbers), symmetric)
