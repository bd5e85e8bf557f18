"""The way down: what comes from the network is a result or a counted reason, and never raises."""

from __future__ import annotations

import math
import struct
import zlib
from collections import Counter

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_client.airframe import Airframe
from drone_client.gate import GateSettings, SentFrame, Verdict
from drone_client.reception import Receiver, Reception
from drone_client.target import Update
from rgbd_wire.envelope import MAX_BODY_BYTES, PREFIX_BYTES, VERSION, Kind, seal
from rgbd_wire.errors import Reject
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import (
    Ack,
    Outcome,
    Result,
    pack_covariance,
    seal_ack,
    seal_result,
)
from tests.unit.drone_client.builders import (
    MS,
    SMALL_COVARIANCE,
    WORKER_BOOT_ID,
    pose,
    rotation_of,
    target_of,
)

DRONE, BOOT_ID, WORKER = "drone-1", 77, "w1"
T_CAPTURE_NS, T1_NS = 1_000 * MS, 1_010 * MS
T4_NS = T1_NS + 80 * MS
CAMERA_FROM_TARGET = pose((0.2, -0.1, 2.5), (0.3, 1.2, -0.4))
ACK = Ack(DRONE, BOOT_ID, 7, WORKER, WORKER_BOOT_ID)
RESULT = Result(
    drone=DRONE,
    boot_id=BOOT_ID,
    sequence=7,
    t_capture_ns=T_CAPTURE_NS,
    t1_ns=T1_NS,
    t2_ns=5,
    t3_ns=5 + 30 * MS,
    worker=WORKER,
    worker_boot_id=WORKER_BOOT_ID,
    outcome=Outcome.TARGET,
    reason="",
    target=target_of(CAMERA_FROM_TARGET),
    stages_ns={"detect": 20 * MS},
    model="0" * 64,
    draining=False,
)


def result(**changes) -> bytes:
    """The good result with some fields changed, sealed."""
    return seal_result(msgspec.structs.replace(RESULT, **changes))


def target(**changes) -> bytes:
    """The good result with some fields of its target changed, sealed."""
    return result(target=msgspec.structs.replace(RESULT.target, **changes))


class Rig:
    """A receiver that has sent frame 7, and what it reported."""

    def __init__(self, knows_pose: bool = True) -> None:
        self.heard: list[tuple[int, str]] = []
        self.results: list[Reception] = []
        self.receiver = Receiver(
            DRONE,
            BOOT_ID,
            GateSettings(250 * MS, 400 * MS),
            Airframe(),
            on_heard=lambda sequence, worker, t_ns: self.heard.append((sequence, worker)),
            on_result=self.results.append,
        )
        if knows_pose:
            self.receiver.add_pose(T_CAPTURE_NS, pose((1, 2, 3), (0, 0, 0.7)))
        self.receiver.sending(SentFrame(7, T_CAPTURE_NS, T1_NS, WORKER))

    def acknowledged(self) -> Rig:
        self.receiver.on_message(seal_ack(ACK), T1_NS + 20 * MS)
        self.heard.clear()
        return self

    def receive(self, message: bytes, t4_ns: int = T4_NS) -> Reception | None:
        """What became of a message; None: it was counted and no more."""
        before = len(self.results)
        self.receiver.on_message(message, t4_ns)
        return self.results[-1] if len(self.results) > before else None


def test_an_ack_frees_the_slot_of_its_frame():
    """Told with its sequence and worker."""
    rig = Rig()
    rig.receiver.on_message(seal_ack(ACK), T1_NS + 1)
    assert rig.heard == [(7, WORKER)]


def test_an_acknowledged_result_is_accepted_and_frees_its_slot():
    """The gate's times are exact, and the target becomes known."""
    rig = Rig().acknowledged()
    assert rig.receiver.estimate is None
    got = rig.receive(result())
    assert got.judgement.verdict is Verdict.ACCEPTED
    assert got.judgement.network_delay_ns == 50 * MS
    assert got.judgement.age_ns == 90 * MS
    assert got.update is Update.FIRST
    assert rig.heard == [(7, WORKER)]
    assert rig.receiver.estimate.t_capture_ns == T_CAPTURE_NS


def test_the_target_is_composed_at_the_place_of_the_exposure_and_not_of_the_arrival():
    """By 4x4 matrices: body at capture time, camera on the body, target in the camera."""
    rig = Rig(knows_pose=False).acknowledged()
    before, after = pose((1, 2, 3), (0, 0, 0.5)), pose((1.4, 2, 3), (0, 0, 0.9))
    rig.receiver.add_pose(T_CAPTURE_NS - 40 * MS, before)
    rig.receiver.add_pose(T_CAPTURE_NS + 40 * MS, after)
    rig.receiver.add_pose(T4_NS - 1, pose((9, 9, 9)))
    got = rig.receive(result())
    halfway = pose((1.2, 2, 3), (0, 0, 0.7))
    expected = halfway.matrix @ Airframe().body_from_camera.matrix @ CAMERA_FROM_TARGET.matrix
    np.testing.assert_allclose(got.world_from_target.matrix, expected, atol=1e-9)
    np.testing.assert_allclose(rig.receiver.estimate.world_from_target.matrix, expected, atol=1e-9)


def test_a_result_from_before_a_jump_is_refused_and_counted():
    """The drone knows where it was, but in a world that is no more; and nothing is known now."""
    rig = Rig().acknowledged()
    rig.receive(result())
    rig.receiver.sending(SentFrame(8, T_CAPTURE_NS + 10 * MS, T1_NS, WORKER))
    rig.receiver.begin_epoch(T_CAPTURE_NS + 20 * MS)
    rig.receiver.add_pose(T_CAPTURE_NS + 20 * MS, pose((9, 9, 9)))
    assert rig.receiver.estimate is None
    assert rig.receiver.word.estimate is None
    assert rig.receiver.lost.t_capture_ns == T_CAPTURE_NS
    rig.receiver.on_message(seal_ack(msgspec.structs.replace(ACK, sequence=8)), T4_NS)
    got = rig.receive(result(sequence=8, t_capture_ns=T_CAPTURE_NS + 10 * MS))
    assert got.judgement.verdict is Verdict.ACCEPTED
    assert (got.update, got.measurement) == (Update.BEFORE_JUMP, None)
    assert rig.receiver.estimate is None
    assert rig.receiver.lost is not None


def test_the_first_measurement_after_a_jump_is_the_new_estimate():
    """In the new world, and nothing is lost any more."""
    rig = Rig().acknowledged()
    rig.receive(result())
    rig.receiver.begin_epoch(T_CAPTURE_NS + 20 * MS)
    rig.receiver.begin_epoch(T_CAPTURE_NS + 30 * MS)
    assert rig.receiver.lost is not None
    rig.receiver.add_pose(T_CAPTURE_NS + 30 * MS, pose((9, 9, 9)))
    rig.receiver.sending(SentFrame(8, T_CAPTURE_NS + 30 * MS, T1_NS + 30 * MS, WORKER))
    rig.receiver.on_message(seal_ack(msgspec.structs.replace(ACK, sequence=8)), T4_NS)
    changes = {"sequence": 8, "t_capture_ns": T_CAPTURE_NS + 30 * MS, "t1_ns": T1_NS + 30 * MS}
    got = rig.receive(result(**changes), T4_NS + 30 * MS)
    assert got.update is Update.FIRST
    assert rig.receiver.estimate.epoch == 2
    expected = pose((9, 9, 9)) @ Airframe().body_from_camera @ CAMERA_FROM_TARGET
    np.testing.assert_allclose(got.world_from_target.matrix, expected.matrix, atol=1e-9)
    assert rig.receiver.lost is None


def test_a_jump_before_the_target_was_seen_loses_nothing():
    """There is nothing to stand still for."""
    rig = Rig()
    rig.receiver.begin_epoch(T_CAPTURE_NS)
    assert rig.receiver.lost is None
    assert rig.receiver.pose_at(T_CAPTURE_NS) is None


def test_a_result_whose_exposure_place_is_unknown_is_not_used():
    """Odometry was lost at that moment: NO_POSE, and no target from it."""
    rig = Rig(knows_pose=False).acknowledged()
    rig.receiver.add_pose(T_CAPTURE_NS + 21 * MS, Pose.identity())
    got = rig.receive(result())
    assert got.judgement.accepted
    assert got.update is Update.NO_POSE
    assert got.world_from_target is None
    assert rig.receiver.estimate is None


def test_an_ambiguous_target_is_told_and_not_used():
    """Two folds fit: its place is in the ledger, the estimate does not take it."""
    rig = Rig().acknowledged()
    got = rig.receive(target(ambiguous=True))
    assert got.update is Update.AMBIGUOUS
    assert got.world_from_target is not None
    assert rig.receiver.estimate is None


def test_an_accepted_result_without_a_target_changes_no_estimate():
    """Nothing found is an answer like any other."""
    rig = Rig().acknowledged()
    got = rig.receive(result(outcome=Outcome.NOTHING_FOUND, reason="no box", target=None))
    assert got.judgement.accepted
    assert got.update is None
    assert rig.receiver.estimate is None


@pytest.mark.parametrize("outcome", [Outcome.SUPERSEDED, Outcome.DRAINING, Outcome.BAD_FRAME])
def test_an_answer_that_nobody_looked_at_the_picture_settles_it_and_is_no_knowledge(outcome):
    """Its slot is free, its verdict is told; an older result may still be accepted after it."""
    rig = Rig().acknowledged()
    rig.receiver.sending(SentFrame(6, T_CAPTURE_NS - 1, T1_NS, WORKER))
    rig.receiver.on_message(seal_ack(msgspec.structs.replace(ACK, sequence=6)), T1_NS)
    got = rig.receive(result(outcome=outcome, reason="newer frame", target=None))
    assert got.judgement.verdict is Verdict.NOT_LOOKED_AT
    assert rig.heard[-1] == (7, WORKER)
    older = rig.receive(result(sequence=6, t_capture_ns=T_CAPTURE_NS - 1))
    assert older.judgement.accepted


@pytest.mark.parametrize("covariance", [np.full((6, 6), 1e12), np.eye(6) * 1e12, np.eye(6) * 200])
def test_a_target_that_says_it_knows_nothing_is_not_used(covariance):
    """The largest covariance that the wire lets through, of rank one too; and nothing raises."""
    rig = Rig().acknowledged()
    blind = target(covariance=pack_covariance(covariance))
    assert rig.receive(blind).update is Update.TOO_UNSURE
    assert rig.receiver.estimate is None


def test_what_the_gate_refuses_never_reaches_the_target():
    """Too late by one nanosecond: judged, told, not used; its frame is settled."""
    rig = Rig().acknowledged()
    got = rig.receive(result(), T1_NS + 30 * MS + 250 * MS + 1)
    assert got.judgement.verdict is Verdict.NETWORK_DELAY
    assert got.update is None
    assert rig.receiver.estimate is None
    assert rig.heard == [(7, WORKER)]


def test_a_duplicate_is_refused_and_the_first_one_stands():
    """The same bytes twice: one update."""
    rig = Rig().acknowledged()
    rig.receive(result())
    estimate = rig.receiver.estimate
    got = rig.receive(result())
    assert got.judgement.verdict is Verdict.DUPLICATE
    assert got.update is None
    assert rig.receiver.estimate is estimate


@pytest.mark.parametrize(
    ("changes", "verdict", "frees"),
    [
        ({"sequence": 8}, Verdict.NEVER_SENT, False),
        ({"t1_ns": T1_NS + 1}, Verdict.ECHO_MISMATCH, False),
        ({"t_capture_ns": 0}, Verdict.ECHO_MISMATCH, False),
        ({"worker": "w2"}, Verdict.WRONG_WORKER, False),
        ({"worker_boot_id": 43}, Verdict.WRONG_WORKER, False),
        ({"t3_ns": 0}, Verdict.IMPOSSIBLE_TIME, True),
        ({"t3_ns": 2**62}, Verdict.IMPOSSIBLE_TIME, True),
    ],
)
def test_a_result_that_may_be_made_up_frees_no_slot_and_locks_nothing_out(changes, verdict, frees):
    """What does not prove that the worker has the frame leaves the window and the frame alone."""
    rig = Rig().acknowledged()
    got = rig.receive(result(**changes))
    assert got.judgement.verdict is verdict
    assert got.update is None
    assert bool(rig.heard) is frees
    then = rig.receive(result()).judgement.verdict
    assert then is (Verdict.DUPLICATE if frees else Verdict.ACCEPTED)


def test_a_result_before_its_ack_is_refused_but_proves_that_the_frame_arrived():
    """Its slot is free; the answer that comes after the ack counts."""
    rig = Rig()
    assert rig.receive(result()).judgement.verdict is Verdict.NOT_ACKNOWLEDGED
    assert rig.heard == [(7, WORKER)]
    rig.acknowledged()
    assert rig.receive(result()).judgement.verdict is Verdict.ACCEPTED


@pytest.mark.parametrize(
    "message",
    [
        seal_ack(msgspec.structs.replace(ACK, drone="drone-2")),
        seal_ack(msgspec.structs.replace(ACK, boot_id=78)),
        result(drone="drone-2"),
        result(boot_id=78),
    ],
)
def test_messages_for_another_drone_or_another_start_of_it_are_counted(message):
    """Valid, but not for us: no slot, no verdict."""
    rig = Rig().acknowledged()
    assert rig.receive(message) is None
    assert rig.receiver.foreign == 1
    assert rig.heard == []
    assert rig.receiver.rejects == {}


@pytest.mark.parametrize(
    "ack",
    [
        msgspec.structs.replace(ACK, sequence=8),
        msgspec.structs.replace(ACK, worker="w2"),
    ],
)
def test_an_ack_of_what_was_not_sent_to_that_worker_frees_nothing(ack):
    """A frame never sent, or sent to somebody else."""
    rig = Rig()
    rig.receiver.on_message(seal_ack(ack), T1_NS)
    assert rig.heard == []


def resealed(message: bytes, **head) -> bytes:
    """A message with another head, and the checksum that fits it."""
    magic, version, kind, reserved, length = struct.unpack_from("<4sBBHI", message)
    fields = {"magic": magic, "version": version, "kind": kind, "reserved": reserved}
    fields |= {"length": length} | head
    packed = struct.pack("<4sBBHI", *fields.values())
    body = message[PREFIX_BYTES:]
    return packed + struct.pack("<I", zlib.crc32(body, zlib.crc32(packed))) + body


GOOD = result()
NAN_POSE = (math.nan,) * 7


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (b"", Reject.TRUNCATED),
        (GOOD[:15], Reject.TRUNCATED),
        (GOOD[:-1], Reject.TRUNCATED),
        (GOOD + b"\0", Reject.WRONG_SIZE),
        (b"AER?" + GOOD[4:], Reject.WRONG_MAGIC),
        (resealed(GOOD, version=VERSION + 1), Reject.WRONG_VERSION),
        (resealed(GOOD, kind=Kind.FRAME), Reject.WRONG_KIND),
        (resealed(GOOD, kind=99), Reject.WRONG_KIND),
        (resealed(GOOD, reserved=1), Reject.BAD_HEADER),
        (resealed(GOOD, kind=Kind.ACK), Reject.OVERSIZED),
        (resealed(seal_ack(ACK), kind=Kind.RESULT), Reject.BAD_HEADER),
        (seal(Kind.RESULT, bytes(MAX_BODY_BYTES[Kind.RESULT] + 1)), Reject.OVERSIZED),
        (GOOD[:-1] + bytes([GOOD[-1] ^ 1]), Reject.CHECKSUM),
        (seal(Kind.RESULT, b"\xc1"), Reject.BAD_HEADER),
        (seal(Kind.RESULT, b"\x91" * 5000), Reject.BAD_HEADER),
        (seal(Kind.ACK, msgspec.msgpack.encode(["D!", 1, 1, "w1", 1])), Reject.BAD_HEADER),
        (seal(Kind.ACK, msgspec.msgpack.encode(["d", -1, 1, "w1", 1])), Reject.BAD_HEADER),
        (result(target=None), Reject.BAD_HEADER),
        (result(outcome=Outcome.REFUSED), Reject.BAD_HEADER),
        (target(camera_from_target=NAN_POSE), Reject.BAD_POSE),
        (target(alternative=NAN_POSE), Reject.BAD_POSE),
        (target(camera_from_target=(0.0, 0.0, 2.0, 2.0, 0.0, 0.0, 0.0)), Reject.BAD_POSE),
        (target(camera_from_target=(1e7, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0)), Reject.BAD_POSE),
        (target(covariance=(math.nan,) * 21), Reject.BAD_POSE),
        (target(covariance=pack_covariance(-SMALL_COVARIANCE)), Reject.BAD_POSE),
        (target(score=math.nan), Reject.BAD_HEADER),
    ],
)
def test_each_bad_message_is_counted_under_its_reason(message, reason):
    """Nothing raises, nothing is heard, and the true result is still accepted afterwards."""
    rig = Rig().acknowledged()
    assert rig.receive(message) is None
    assert rig.receiver.rejects == Counter({reason: 1})
    assert rig.heard == []
    assert rig.receive(GOOD).judgement.accepted


@given(st.sampled_from([GOOD, seal_ack(ACK)]), st.data())
def test_a_flipped_bit_anywhere_is_one_counted_reject(message, data):
    """The checksum covers the head and the body."""
    at = data.draw(st.integers(0, len(message) - 1))
    bit = data.draw(st.integers(0, 7))
    flipped = bytearray(message)
    flipped[at] ^= 1 << bit
    rig = Rig()
    rig.receiver.on_message(bytes(flipped), T4_NS)
    assert rig.receiver.rejects.total() == 1
    assert (rig.heard, rig.results) == ([], [])


@given(st.binary(max_size=200), st.sampled_from([Kind.RESULT, Kind.ACK]), st.booleans())
def test_random_bytes_are_one_counted_reject_with_or_without_a_valid_envelope(body, kind, sealed):
    """No bytes raise."""
    rig = Rig()
    rig.receiver.on_message(seal(kind, body) if sealed else body, T4_NS)
    assert rig.receiver.rejects.total() == 1


numbers = st.floats(width=64) | st.floats(-2, 2)


@settings(max_examples=60)
@given(
    st.tuples(*[numbers] * 7),
    st.lists(numbers, min_size=21, max_size=21),
    st.tuples(*[st.integers(0, 2**63 - 1)] * 3),
)
def test_any_numbers_in_a_well_formed_result_are_judged_or_counted(seven, covariance, times):
    """Poses, covariances and times that no worker would send: a verdict or a reject."""
    rig = Rig().acknowledged()
    t2_ns, t3_ns, t4_ns = times
    message = target(camera_from_target=seven, covariance=tuple(covariance))
    for worked in (result(t2_ns=t2_ns, t3_ns=t3_ns), message):
        rig.receiver.on_message(worked, t4_ns)
    assert rig.receiver.rejects.total() + len(rig.results) == 2


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(-4, 1), st.floats(0, 1e5))
def test_any_sequence_of_accepted_targets_leaves_a_usable_estimate(seed, magnitude, far):
    """Twelve targets anywhere, as sure or unsure as they like: the estimate stays finite."""
    rng = np.random.default_rng(seed)
    rig = Rig()
    for i in range(12):
        t_ns = T_CAPTURE_NS + i * 30 * MS
        rig.receiver.sending(SentFrame(100 + i, t_ns, t_ns, WORKER))
        rig.receiver.add_pose(t_ns, pose(rng.normal(size=3)))
        rig.receiver.on_message(seal_ack(msgspec.structs.replace(ACK, sequence=100 + i)), t_ns)
        a = rng.normal(size=(6, 6)) * 10**magnitude
        seen = target_of(pose(rng.normal(size=3) * far, rng.normal(size=3) * 0.5), a @ a.T)
        rig.receive(
            result(sequence=100 + i, t_capture_ns=t_ns, t1_ns=t_ns, target=seen), t_ns + 60 * MS
        )
    assert len(rig.results) == 12
    assert all(r.judgement.accepted for r in rig.results)
    if (estimate := rig.receiver.estimate) is not None:
        assert np.isfinite(estimate.world_from_target.matrix).all()
        assert np.linalg.eigvalsh(estimate.covariance)[0] > 0


def test_poses_are_asked_at_any_time():
    """The drone's own place, interpolated, for whoever needs it."""
    rig = Rig(knows_pose=False)
    assert rig.receiver.pose_at(0) is None
    rig.receiver.add_pose(0, pose((0, 0, 0)))
    rig.receiver.add_pose(100 * MS, pose((1, 0, 0), (0, 0, 1)))
    got = rig.receiver.pose_at(25 * MS)
    np.testing.assert_allclose(got.translation, (0.25, 0, 0), atol=1e-12)
    np.testing.assert_allclose(rotation_of(got).as_rotvec(), (0, 0, 0.25), atol=1e-9)


def test_the_last_word_says_whether_the_edge_looked_again_and_saw_nothing():
    """An accepted answer without a target denies what was seen before it, and nothing after."""
    rig = Rig().acknowledged()
    assert not rig.receiver.word.denies
    rig.receive(result())
    assert not rig.receiver.word.denies
    later = T_CAPTURE_NS + MS
    rig.receiver.sending(SentFrame(8, later, T1_NS, WORKER))
    rig.receiver.on_message(seal_ack(msgspec.structs.replace(ACK, sequence=8)), T1_NS)
    empty = {"outcome": Outcome.NOTHING_FOUND, "reason": "no box", "target": None}
    rig.receive(result(sequence=8, t_capture_ns=later, **empty))
    word = rig.receiver.word
    assert word.denies
    assert word.t_denied_ns == later
    assert word.estimate is rig.receiver.estimate


def test_an_answer_that_was_refused_denies_nothing():
    """Nobody looked, or it came too late."""
    rig = Rig().acknowledged()
    rig.receive(result(outcome=Outcome.SUPERSEDED, reason="newer frame", target=None))
    assert rig.receiver.word.t_denied_ns is None
