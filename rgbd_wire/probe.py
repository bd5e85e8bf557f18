"""Probes: 64 bytes there and back, for round trip, clock offset and signs of life.

::

    envelope of kind PROBE, then little-endian
    offset  bytes
    16      8      boot_id of the drone's client
    24      8      sequence
    32      8      t1 [ns, drone's clock]
    40      8      t2 [ns, worker's clock], 0 on the way up
    48      8      t3 [ns, worker's clock], 0 on the way up
    56      8      boot_id of the worker, 0 on the way up

What they tell is for people and for the choice of a worker, never for the gate.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from rgbd_wire.envelope import MAX_BODY_BYTES, PREFIX_BYTES, Kind, seal
from rgbd_wire.errors import DecodeError, Reject

_BODY = struct.Struct("<6Q")
assert _BODY.size == MAX_BODY_BYTES[Kind.PROBE]
PROBE_BYTES = PREFIX_BYTES + _BODY.size
_MAX = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Probe:
    """A probe on its way up, or its echo."""

    boot_id: int
    sequence: int
    t1_ns: int
    """Drone's clock."""
    t2_ns: int = 0
    """Worker's clock."""
    t3_ns: int = 0
    """Worker's clock."""
    worker_boot_id: int = 0


def seal_probe(probe: Probe) -> bytes:
    """A whole PROBE message of ``PROBE_BYTES``."""
    return seal(
        Kind.PROBE,
        _BODY.pack(
            probe.boot_id,
            probe.sequence,
            probe.t1_ns,
            probe.t2_ns,
            probe.t3_ns,
            probe.worker_boot_id,
        ),
    )


def decode_probe(body: memoryview) -> Probe:
    """The probe in the body of an envelope.

    Raises:
        DecodeError: WRONG_SIZE, or BAD_HEADER for a number past 63 bits.
    """
    if len(body) != _BODY.size:
        raise DecodeError(Reject.WRONG_SIZE, f"{len(body)} bytes, a probe has {_BODY.size}")
    numbers = _BODY.unpack(body)
    if max(numbers) > _MAX:
        raise DecodeError(Reject.BAD_HEADER, "a number of the probe has more than 63 bits")
    return Probe(*numbers)
