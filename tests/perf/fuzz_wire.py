"""Throw mutated messages at the receiving side; anything but an answer or a DecodeError is a bug.

``scripts/fuzz messages --count 1000000`` starts from the test vectors. Most mutants get a correct
checksum, so that they reach the layers behind it. A short run is part of the test suite.
"""

from __future__ import annotations

import random
import struct
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec

from edge_service.first_look import look
from rgbd_wire.envelope import Kind, seal, unseal
from rgbd_wire.errors import DecodeError
from rgbd_wire.frame_codec import decompress, unpack
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import decode_ack, decode_result, decode_status, pose_of
from rgbd_wire.probe import decode_probe

VECTORS = Path(__file__).parents[1] / "data" / "wire"
HEADER_LENGTH = struct.Struct("<I")

BLOCK = 2_000

NASTY: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    1,
    127,
    2**31,
    2**63 - 1,
    2**63,
    2**64 - 1,
    -(2**63),
    0.0,
    -0.0,
    1e-320,
    1e160,
    -1.7e308,
    float("nan"),
    float("inf"),
    -float("inf"),
    "",
    "drone-1",
    "Drone 1\n",
    "lattice",
    "target",
    "x" * 300,
    b"",
    b"\xff" * 9,
    [],
    {},
    [0.0] * 7,
    [1.0] * 21,
    {"decode": 1, "": -1},
    msgspec.msgpack.Ext(5, b"abc"),
)


class MessageBlock:
    """Messages that are all made from one seed."""

    def __init__(self, seed: str) -> None:
        self.outcomes: Counter[str] = Counter()
        self.thrown = 0
        self._rng = random.Random(seed)
        self._sources = seeds()

    def throw(self) -> int:
        """One message."""
        self.outcomes[receive(mutant(self._rng.choice(self._sources), self._rng))] += 1
        self.thrown += 1
        return 1

    def close(self) -> None:
        """Nothing is held."""


def seeds() -> list[bytes]:
    """The test vectors, whole messages."""
    return [path.read_bytes() for path in sorted(VECTORS.glob("*.bin"))]


def receive(data: bytes) -> str:
    """Do all that a receiver does with a message from the network; say what became of it.

    Raises:
        AssertionError: something was accepted that the rest of the program could stumble over.
    """
    try:
        kind, body = unseal(data, *Kind)
        if kind is Kind.FRAME:
            look(data)  # what the service does before it lets a frame in
            frame = decompress(unpack(data))
            if frame.world_from_camera is not None:
                _check_usable(frame.world_from_camera)
            _check_usable(frame.camera.color_from_depth)
        elif kind is Kind.RESULT:
            target = decode_result(body).target
            if target is not None:
                _check_usable(pose_of(target.camera_from_target))
        elif kind is Kind.ACK:
            decode_ack(body)
        elif kind is Kind.PROBE:
            decode_probe(body)
        else:
            decode_status(body)
    except DecodeError as error:
        if "\n" in str(error) or len(str(error)) > 20_000:
            raise AssertionError(f"an error of several lines or screens: {error!r}") from error
        return error.reason.value
    return f"{kind.name.lower()} accepted"


def mutant(source: bytes, rng: random.Random) -> bytes:
    """One mutant of a message."""
    kind, view = unseal(source, *Kind)
    body = bytes(view)
    way = rng.random()
    if way < 0.1:
        return _edited(source, rng)
    if way < 0.5:
        return seal(kind, _edited(body, rng))
    if way < 0.55:
        return seal(rng.choice(list(Kind)), body)
    if kind is Kind.PROBE:
        return seal(kind, _edited(body, rng, keep_length=True))
    if kind is not Kind.FRAME:
        return seal(kind, _replaced(body, rng))
    (length,) = HEADER_LENGTH.unpack_from(body)
    head, pictures = body[4 : 4 + length], body[4 + length :]
    if way < 0.7:
        pictures = _edited(pictures, rng, keep_length=True)
    else:
        head = _replaced(head, rng)
    return seal(kind, HEADER_LENGTH.pack(len(head)), head, pictures)


def _edited(data: bytes, rng: random.Random, *, keep_length: bool = False) -> bytes:
    """One to four bytes flipped, set, doubled, cut out or cut off; more often near the start."""
    edited = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        if not edited:
            break
        at = rng.randrange(len(edited) if rng.random() < 0.5 else min(len(edited), 300))
        way = rng.randrange(2 if keep_length else 5)
        if way == 0:
            edited[at] ^= 1 << rng.randrange(8)
        elif way == 1:
            edited[at] = rng.choice((0, 1, 0x7F, 0x80, 0xC1, 0xFF, rng.randrange(256)))
        elif way == 2:
            edited[at:at] = edited[at : at + rng.randint(1, 16)]
        elif way == 3:
            del edited[at : at + rng.randint(1, 16)]
        else:
            del edited[at:]
    return bytes(edited)


def _replaced(packed: bytes, rng: random.Random) -> bytes:
    """The same MessagePack with one value, somewhere in the tree, replaced, added or left out."""
    tree = msgspec.msgpack.decode(packed)
    node = tree
    while True:
        at = rng.randrange(len(node)) if isinstance(node, list) else rng.choice(list(node))
        inner = node[at]
        if not isinstance(inner, list | dict) or not inner or rng.random() < 0.3:
            break
        node = inner
    way = rng.random()
    if way < 0.85:
        node[at] = rng.choice(NASTY)
    elif way < 0.93:
        del node[at]
    elif isinstance(node, list):
        node.insert(at, rng.choice(NASTY))
    return msgspec.msgpack.encode(tree)


def _check_usable(pose: Pose) -> None:
    """What the two ends do with a pose must not overflow."""
    there_and_back = pose @ pose.inverse()
    if abs(there_and_back.translation).max() > 1e-6 * (1 + abs(pose.translation).max()):
        raise AssertionError(f"a pose that cannot be undone: {pose}")
