"""The summary of a run: counted from the ledger's own lines."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.summary import read_lines, spread, summarise
from drone_client.truth import TruthEntry
from tests.unit.drone_client.builders import pose

TRUE = pose((0.0, 0.0, 2.0))


def answered(sequence, verdict="accepted", outcome="target", dx_mm=0.0, **more):
    """A ledger line of an answered frame, as the client writes it."""
    line = {
        "sequence": sequence,
        "fate": "answered",
        "worker": "w1",
        "bytes": 1000 + sequence,
        "encoding": {"rung": "full", "reason": "fits"},
        "d1_ms": 12.0,
        "d2_ms": 8.0,
        "one_way_bound_ms": 5.0,
        "network_delay_ms": 20.0 + sequence,
        "age_ms": 60.0 + sequence,
        "service_ms": 30.0,
        "stages_ms": {"decode": 2.0, "detect": 25.0},
        "verdict": verdict,
        "outcome": outcome,
        "reason": None if outcome == "target" else "no box",
        "update": "fused" if verdict == "accepted" and outcome == "target" else None,
    }
    if outcome == "target":
        line |= {"method": "fused", "camera_from_target": [dx_mm / 1e3, 0, 2.0, 1, 0, 0, 0]}
    return line | more


def unanswered(sequence, fate, **more):
    return {
        "sequence": sequence,
        "fate": fate,
        "worker": None,
        "bytes": None,
        "encoding": None,
    } | more


FRAMES = [
    answered(0),
    answered(1, dx_mm=3.0),
    answered(2, verdict="network_delay"),
    answered(3, outcome="nothing_found"),
    answered(4, verdict="impossible_time", network_delay_ms=None, service_ms=3.6e6),
    answered(5, outcome="superseded"),
    unanswered(6, "superseded_on_board"),
    unanswered(7, "no_reply", bytes=500, worker="w1"),
]
EVENTS = [
    {"event": "worker", "before": None, "now": "w1"},
    {"event": "suspect", "worker": "w1", "why": "no replies"},
    {"event": "worker", "before": "w1", "now": "w2"},
    {"event": "copy", "sequence": 7, "worker": "w2", "why": "hand_over"},
]
TICKS = [
    {"known": "no_target"},
    {"known": "target", "freshness": "fresh", "status": "active", "h_m": 0.5},
    {"known": "target", "freshness": "hold", "status": "stale", "h_m": -0.25},
    {"known": "target", "freshness": "hold", "status": "abort", "h_m": None},
]


def test_counts_every_frame_once_under_each_heading():
    """Fates of all, verdicts and outcomes of the answered, updates of the accepted targets."""
    s = summarise(FRAMES, TICKS, EVENTS, ())
    assert s["frames"] == 8
    assert s["fates"] == {"answered": 6, "superseded_on_board": 1, "no_reply": 1}
    assert s["verdicts"] == {"accepted": 4, "network_delay": 1, "impossible_time": 1}
    assert s["outcomes"] == {"target": 4, "nothing_found": 1, "superseded": 1}
    assert s["reasons"] == {"no box": 2}
    assert s["updates"] == {"fused": 2}
    assert s["methods"] == {"fused": 2}
    assert s["workers"] == {"w1": 6}
    assert (s["accepted"], s["accepted_poses"]) == (4, 2)
    assert s["frame_bytes"]["max"] == 1005
    assert "truth" not in s


def test_tells_of_the_link():
    """Hand-overs, suspicions, second copies, encodings, and the two ways apart."""
    s = summarise(FRAMES, TICKS, EVENTS, ())
    assert s["hand_overs"] == 1  # the first choice is none
    assert s["suspicions"] == {"no replies": 1}
    assert s["copies"] == {"hand_over": 1}
    assert s["encodings"] == {"full": 6}
    assert s["encoding_reasons"] == {"fits": 6}
    assert (s["d1_ms"]["p50"], s["d2_ms"]["p50"]) == (12.0, 8.0)
    assert s["one_way_bound_ms"]["max"] == 5.0


def test_times_are_of_what_was_accepted_and_of_clocks_that_can_be_believed():
    """Delays of refused results would hide how fresh the accepted ones are."""
    s = summarise(FRAMES, TICKS, EVENTS, ())
    assert s["network_delay_ms"]["max"] == 25
    assert s["age_ms"]["max"] == 65
    assert s["service_ms"]["max"] == 30
    assert s["stages_ms"]["detect"]["p50"] == 25


def test_counts_ticks_and_finds_the_smallest_h():
    """Where the filter was asked."""
    s = summarise(FRAMES, TICKS, EVENTS, ())
    assert s["ticks"] == 4
    assert s["known"] == {"target": 3, "no_target": 1}
    assert s["freshness"] == {"hold": 2, "fresh": 1}
    assert s["statuses"] == {"active": 1, "stale": 1, "abort": 1}
    assert s["h_min_m"] == -0.25


def test_against_truth_only_frames_that_somebody_looked_at_count():
    """Found of those in full view, ghosts of those without it, errors of what was seen."""
    truth = [TruthEntry(TRUE, v) for v in (1.0, 0.95, 0.0, 0.9, 0.5, 1.0, 1.0, 1.0)]
    t = summarise(FRAMES, TICKS, EVENTS, truth)["truth"]
    assert t["frames_fully_visible"] == 3  # 0, 1, 3; nobody looked at 5, 6 and 7
    assert t["found_of_these"] == 2
    assert (t["frames_without_target"], t["ghosts_in_these"]) == (1, 1)
    assert t["position_error_mm"]["max"] == pytest.approx(3.0)
    assert t["normal_error_deg"]["max"] == pytest.approx(0.0, abs=1e-4)


def test_an_empty_run_has_a_summary_that_is_json():
    """A run that was interrupted before its first frame."""
    s = summarise([], [], [], ())
    assert s["frames"] == 0
    assert s["network_delay_ms"] is None
    assert s["h_min_m"] is None
    json.dumps(s, allow_nan=False)


def test_a_workers_made_up_reasons_cannot_fill_the_summary():
    """At most 32 of them are told, the most frequent first."""
    frames = [answered(i, outcome="refused", reason=f"reason {i % 50}") for i in range(120)]
    reasons = summarise(frames, [], [], ())["reasons"]
    assert len(reasons) == 32
    assert set(reasons.values()) == {3, 2}
    assert list(reasons.values())[0] == 3


@given(st.lists(st.none() | st.floats(-1e6, 1e6), max_size=30))
def test_spread_is_numpys_percentiles_of_what_is_there(values):
    """None where nothing is."""
    got = spread(values)
    numbers = [v for v in values if v is not None]
    if not numbers:
        assert got is None
        return
    for name, q in (("p50", 50), ("p95", 95), ("p99", 99), ("max", 100)):
        assert got[name] == pytest.approx(np.percentile(numbers, q), abs=1e-4)


def test_a_line_that_a_full_disk_cut_off_is_left_out(tmp_path):
    """The whole ones count."""
    path = tmp_path / "ledger.jsonl"
    path.write_text('{"a": 1}\n{"a": 2}\n{"a": 3')
    assert read_lines(path) == [{"a": 1}, {"a": 2}]
