"""What the ledger says of a reception and of a tick: plain JSON, every number finite."""

from __future__ import annotations

import json
import math

import msgspec
import numpy as np

from drone_client.airframe import Airframe
from drone_client.autopilot import VelocityCommand
from drone_client.cbf import Freshness, SafeCommand, Status
from drone_client.clock_offset import OffsetEstimate
from drone_client.control import ControlSettings, Decision, Known, OnMission, decide
from drone_client.gate import Judgement, Verdict
from drone_client.mission import MissionSettings, begin
from drone_client.reception import Reception
from drone_client.records import decision_record, one_way_record, reception_record
from drone_client.target import TargetEstimate, TargetMeasurement, Update
from rgbd_wire.messages import Outcome, Result
from tests.unit.drone_client.builders import MS, pose, target_of

SEEN = pose((0.1, 0.2, 2.0), (0, 1, 0))
WORLD = pose((5, 6, 7), (0, 0, 1))
MEASURED = TargetMeasurement(WORLD, np.eye(6), 100 * MS, 2.5)
RESULT = Result(
    drone="d",
    boot_id=1,
    sequence=3,
    t_capture_ns=100 * MS,
    t1_ns=110 * MS,
    t2_ns=5 * MS,
    t3_ns=35 * MS,
    worker="w1",
    worker_boot_id=42,
    outcome=Outcome.TARGET,
    reason="",
    target=target_of(SEEN, np.diag([1e-6, 4e-6, 9e-6, 1e-6, 1e-6, 1e-4])),
    stages_ns={"decode": 2 * MS, "detect": 25 * MS},
    model="0" * 64,
    draining=False,
)


def test_an_accepted_target_is_told_with_every_stamp_time_and_sigma():
    """Milliseconds are fractions of the stamps, sigmas the roots of the covariance."""
    judged = Judgement(Verdict.ACCEPTED, 50 * MS, 90 * MS)
    record = reception_record(Reception(RESULT, 190 * MS, judged, Update.FUSED, MEASURED))
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert (record["t2_ns"], record["t3_ns"], record["t4_ns"]) == (5 * MS, 35 * MS, 190 * MS)
    assert (record["network_delay_ms"], record["age_ms"], record["service_ms"]) == (50, 90, 30)
    assert record["stages_ms"] == {"decode": 2, "detect": 25}
    assert (record["verdict"], record["outcome"], record["update"]) == (
        "accepted",
        "target",
        "fused",
    )
    assert record["reason"] is None
    assert record["sigma_mm"] == [1, 2, 3]
    np.testing.assert_allclose(record["sigma_deg"][2], math.degrees(0.01), atol=1e-4)
    np.testing.assert_allclose(record["camera_from_target"][:3], SEEN.translation)
    np.testing.assert_allclose(record["world_from_target"], [*WORLD.translation, *WORLD.q_wxyz])
    assert record["boxes"] == {"T_good": [1, 2, 9, 10, 0.9]}


def test_a_refused_result_without_a_target_has_its_reason_and_no_pose():
    """Times that mean nothing are null."""
    nothing = msgspec.structs.replace(
        RESULT, outcome=Outcome.NOTHING_FOUND, reason="no box", target=None
    )
    judged = Judgement(Verdict.IMPOSSIBLE_TIME, age_ns=90 * MS)
    record = reception_record(Reception(nothing, 190 * MS, judged, None, None))
    assert record["reason"] == "no box"
    assert record["network_delay_ms"] is None
    assert record["update"] is None
    assert "camera_from_target" not in record


def test_a_target_whose_place_in_the_world_is_unknown_has_none():
    """NO_POSE: the measurement itself is told."""
    judged = Judgement(Verdict.ACCEPTED, 1, 2)
    record = reception_record(Reception(RESULT, 3, judged, Update.NO_POSE, None))
    assert record["world_from_target"] is None
    assert record["camera_from_target"] is not None


def test_a_decision_is_told_with_the_filters_own_numbers():
    """h, the error ball, phase, status and the command."""
    estimate = TargetEstimate(pose((3, 0, 1), (0, 0, math.pi)), 1e-6 * np.eye(6), 0, 2.0)
    d = decide(120 * MS, estimate, pose((1, 0, 1)), Airframe(), ControlSettings())
    record = decision_record(d)
    json.dumps(record, allow_nan=False)
    assert record["known"] == "target"
    assert record["target_age_ms"] == 120
    np.testing.assert_allclose(record["command_mps"], d.command.velocity_world, atol=1e-6)
    np.testing.assert_allclose(record["tip_target_m"], (1.45, 0, 0), atol=1e-6)
    assert record["h_m"] == round(d.safe.h, 6)
    assert record["h_robust_m"] == round(d.safe.h_robust, 6)
    assert record["delta_m"] == round(d.safe.delta_m, 6)
    assert (record["freshness"], record["status"]) == (
        d.safe.freshness.value,
        d.safe.status.value,
    )


def test_a_decision_without_knowledge_says_that_alone():
    """No filter was asked."""
    record = decision_record(decide(5, None, None, Airframe(), ControlSettings()))
    assert record == {
        "known": "no_target",
        "target_age_ms": None,
        "command_mps": [0, 0, 0],
        "yaw_rate_radps": 0,
    }


def test_a_mission_is_told_with_its_phase_and_every_transition_with_its_sentence():
    """The phase and why it began on every tick; the sentence in the tick of the transition."""
    settings = ControlSettings(mission=MissionSettings(needs_vehicle=False))
    state, records = begin(0), []
    for tick in range(20):
        d = decide(20 * tick * MS, None, pose(), Airframe(), settings, OnMission(state))
        state = d.mission
        records.append(decision_record(d))
        json.dumps(records[-1], allow_nan=False)
    assert (records[0]["phase"], records[0]["reason"]) == ("hold", "waiting")
    assert (records[-1]["phase"], records[-1]["reason"]) == ("search", "vehicle_ready")
    told = [r["transition"] for r in records if "transition" in r]
    assert told == [{"before": "hold", "sentence": "no vehicle to wait for"}]


def test_what_is_no_number_is_null():
    """An aborted filter has NaN for h."""
    safe = SafeCommand(
        (0.0, 0.0, 0.0), 0.0, math.nan, math.nan, Status.ABORT, Freshness.FRESH, math.nan
    )
    record = decision_record(
        Decision(VelocityCommand(np.zeros(3), 0.0, 0), Known.TARGET, 1, safe, (1.0, 0.0, 0.0))
    )
    assert (record["h_m"], record["h_robust_m"], record["delta_m"]) == (None, None, None)


def test_the_two_ways_apart_come_with_their_bound_or_not_at_all():
    """By hand: the worker's clock is 1 s ahead, 12 ms there, 8 ms back, known to 3 ms."""
    t1_ns, t2_ns, t3_ns, t4_ns = 110 * MS, 1_122 * MS, 1_152 * MS, 160 * MS
    result = msgspec.structs.replace(RESULT, t1_ns=t1_ns, t2_ns=t2_ns, t3_ns=t3_ns)
    estimate = OffsetEstimate(t4_ns, 1_000 * MS, 3 * MS, None, None, 6 * MS, 7 * MS)
    record = one_way_record(result, t4_ns, estimate)
    assert (record["d1_ms"], record["d2_ms"]) == (12.0, 8.0)
    assert 3.0 <= record["one_way_bound_ms"] < 3.1
    assert set(one_way_record(result, t4_ns, None).values()) == {None}
