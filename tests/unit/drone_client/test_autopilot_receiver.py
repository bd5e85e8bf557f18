"""Hostile bytes: bounded, counted, never an exception."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot.receiver import BUFFER_MAX, BYTES_PER_WINDOW, Receiver

NOW = 5_000_000_000


def receiver(**options: int) -> Receiver:
    return Receiver(mav.MAV_AUTOPILOT_PX4, 191, **options)


def packed(
    message: mav.MAVLink_message, system: int = 1, component: int = 1, *, v1: bool = False
) -> bytes:
    return message.pack(mav.MAVLink(None, system, component), force_mavlink1=v1)


def heartbeat(autopilot: int = mav.MAV_AUTOPILOT_PX4) -> mav.MAVLink_message:
    return mav.MAVLink_heartbeat_message(2, autopilot, 1, 6 << 16, 4, 3)


def timesync() -> mav.MAVLink_message:
    return mav.MAVLink_timesync_message(123, 456)


def kinds(r: Receiver, data: bytes) -> list[str]:
    return [m.get_type() for m in r.messages(data, NOW)]


def test_the_first_autopilot_is_chosen_and_no_other_is_heard() -> None:
    """A message before its heartbeat, a ground station and another drone are refused by name."""
    r = receiver()
    assert kinds(r, packed(timesync())) == []
    gcs = heartbeat(mav.MAV_AUTOPILOT_INVALID)
    assert kinds(r, packed(gcs)) == []
    assert kinds(r, packed(heartbeat(), system=3)) == ["HEARTBEAT"]
    assert r.system == 3
    assert kinds(r, packed(heartbeat(), system=4)) == []
    assert kinds(r, packed(timesync(), system=3, component=100)) == []
    assert kinds(r, packed(timesync(), system=3, component=191)) == []
    assert kinds(r, packed(timesync(), system=3)) == ["TIMESYNC"]
    assert r.refused == {
        "not_chosen_yet": 1,
        "other_autopilot": 1,
        "other_system": 1,
        "other_component": 1,
        "own_echo": 1,
    }


def test_an_autopilot_of_another_kind_is_not_spoken_with() -> None:
    """Its modes have other numbers: an ArduPilot is never taken for a PX4."""
    r = receiver()
    assert kinds(r, packed(heartbeat(mav.MAV_AUTOPILOT_ARDUPILOTMEGA))) == []
    assert r.system is None


def test_mavlink1_and_signed_messages_are_taken_and_counted() -> None:
    """An autopilot begins in MAVLink 1; a signature is skipped, for nothing is shared to check."""
    r = receiver()
    assert kinds(r, packed(heartbeat(), v1=True)) == ["HEARTBEAT"]
    signer = mav.MAVLink(None, 1, 1)
    signer.signing.secret_key = bytes(32)
    signer.signing.sign_outgoing = True
    assert kinds(r, timesync().pack(signer)) == ["TIMESYNC"]
    assert (r.mavlink1, r.signed) == (1, 1)


def test_a_message_behind_garbage_is_found() -> None:
    """On a wire, noise costs what it covers and no more."""
    r = receiver()
    noise = random.Random(1).randbytes(200).replace(b"\xfd", b"").replace(b"\xfe", b"")
    assert kinds(r, noise + packed(heartbeat()) + noise + packed(timesync())) == [
        "HEARTBEAT",
        "TIMESYNC",
    ]
    assert r.refused["garbage"] > 0


def test_a_bit_error_is_refused(rng) -> None:
    """Each single flipped bit of a message is found by its checksum, or is another's message."""
    data = packed(heartbeat())
    for bit in range(8 * len(data)):
        wrong = bytearray(data)
        wrong[bit // 8] ^= 1 << bit % 8
        r = receiver()
        taken = kinds(r, bytes(wrong))
        # The two flags that MAVLink lets a receiver ignore are under the checksum as well
        assert taken == []


@given(st.lists(st.binary(max_size=400), max_size=20), st.randoms(use_true_random=False))
def test_anything_is_survived(chunks: list[bytes], chance: random.Random) -> None:
    """Random bytes with true messages cut into them: no exception, and the buffer stays small."""
    r = receiver()
    for chunk in chunks:
        kinds(r, chunk)
        whole = packed(heartbeat())
        kinds(r, whole[: chance.randrange(len(whole) + 1)])
        r.start_datagram()
    assert kinds(r, packed(heartbeat())) == ["HEARTBEAT"]
    assert len(r._parser.buf) <= BUFFER_MAX + 400


def test_a_datagram_that_is_cut_off_does_not_eat_the_next() -> None:
    """Each datagram begins anew."""
    r = receiver()
    r.start_datagram()
    assert kinds(r, packed(heartbeat())[:-3]) == []
    r.start_datagram()
    assert kinds(r, packed(heartbeat())) == ["HEARTBEAT"]
    assert r.refused["cut_off"] == 1


def test_a_busy_wire_that_is_never_empty_costs_no_memory() -> None:
    """Always a message and a half: pymavlink alone would keep all of it."""
    r = receiver()
    stream = packed(heartbeat()) * 20_000
    half = 31
    for i in range(0, len(stream) - half, half):
        r._window_bytes = 0
        list(r.messages(stream[i : i + half], NOW))
    assert len(r._parser.buf) < 2 * BUFFER_MAX
    assert r.accepted["HEARTBEAT"] > 19_000


def test_a_flood_is_cut_and_passes() -> None:
    """So many bytes in a tenth of a second are looked at; then all is as before."""
    r = receiver()
    flood = bytes(BYTES_PER_WINDOW)
    assert kinds(r, flood) == []
    assert r.over_budget(NOW)
    assert kinds(r, packed(heartbeat())) == []
    assert r.refused["flood"] == 1
    later = NOW + 100_000_001
    assert not r.over_budget(later)
    assert [m.get_type() for m in r.messages(packed(heartbeat()), later)] == ["HEARTBEAT"]


def test_the_environment_does_not_switch_the_checksum_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pymavlink has such a switch; a safety link has not."""
    monkeypatch.setattr(mav, "MAVLINK_IGNORE_CRC", "1")
    r = receiver()
    wrong = bytearray(packed(heartbeat()))
    wrong[-1] ^= 0xFF
    assert kinds(r, bytes(wrong)) == []
