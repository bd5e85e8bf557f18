"""The test vectors that other implementations are checked against say what we say."""

from __future__ import annotations

import hashlib
import json

import msgspec
import numpy as np
import pytest

from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.frame_codec import CompressedFrame, decompress, pack, unpack
from rgbd_wire.messages import decode_ack, decode_result, decode_status
from rgbd_wire.probe import decode_probe
from tests.data.wire import make

DESCRIBED = json.loads((make.HERE / "vectors.json").read_text(encoding="utf-8"))["messages"]
FRAMES, MESSAGES = make.frames(), make.messages()
DECODERS = {
    Kind.ACK: decode_ack,
    Kind.RESULT: decode_result,
    Kind.PROBE: decode_probe,
    Kind.STATUS: decode_status,
}


def bytes_of(name):
    return (make.HERE / f"{name}.bin").read_bytes()


def test_every_file_is_described():
    """The JSON lists the files that are there, and no other."""
    files = {path.name for path in make.HERE.glob("*.bin")}
    assert files == set(DESCRIBED) == {f"{n}.bin" for n in [*FRAMES, *MESSAGES]}


@pytest.mark.parametrize("name", FRAMES)
def test_frames_are_packed_to_the_same_bytes(name):
    """Around the same compressed pictures, envelope and header come out byte for byte.

    The pictures themselves may be coded otherwise by another release of their codecs.
    """
    frame, stamp = FRAMES[name]
    data = bytes_of(name)
    packed = unpack(data)
    same = CompressedFrame(frame, bytes(packed.color), packed.depth)
    assert pack(same, stamp) == data


@pytest.mark.parametrize("name", FRAMES)
def test_frames_decode_to_their_formulas(name):
    """Depth to the bit, colour as close as JPEG is, camera and pose as described."""
    expected, _ = FRAMES[name]
    expected_units = make.arriving_depth(name)
    got = decompress(unpack(bytes_of(name)))
    np.testing.assert_allclose(got.color_rgb.astype(int), expected.color_rgb, atol=16)
    if expected_units is None:
        assert got.depth_units is None
    else:
        np.testing.assert_array_equal(got.depth_units, expected_units)
        digest = hashlib.sha256(got.depth_units.astype("<u2").tobytes()).hexdigest()
        assert digest == DESCRIBED[f"{name}.bin"]["depth_u16le_sha256"]


@pytest.mark.parametrize("name", FRAMES)
def test_frames_are_described(name):
    """The JSON holds every header field under its name, in order."""
    described, data = DESCRIBED[f"{name}.bin"], bytes_of(name)
    fields = make.named(unpack(data).header)
    assert described["kind"] == "FRAME"
    assert described["fields"] == fields
    assert list(described["fields"]) == list(fields)
    assert described["body_bytes"] == len(data) - 16


@pytest.mark.parametrize("name", MESSAGES)
def test_messages_are_sealed_to_the_same_bytes(name):
    """All but the frames: the same bytes both ways, and as described."""
    message, data = MESSAGES[name], bytes_of(name)
    kind, body = unseal(data, *DECODERS)
    assert kind.name == name.split("_")[0].upper() == DESCRIBED[f"{name}.bin"]["kind"]
    assert DECODERS[kind](body) == message
    assert make.sealed(message) == data
    assert DESCRIBED[f"{name}.bin"]["fields"] == json.loads(
        msgspec.json.encode(make.named(message))
    )


def test_both_tables_are_there():
    """Among the vectors are rank codes, plain depth, no depth, and a region of interest."""
    headers = [DESCRIBED[f"{name}.bin"]["fields"] for name in FRAMES]
    assert {h["depth_table"] for h in headers} == {"lattice", "identity"}
    assert [h["depth_bytes"] == 0 for h in headers].count(True) == 1
    assert [h["depth_region"] is not None for h in headers].count(True) == 1
