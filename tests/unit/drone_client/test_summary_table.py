"""The table of a run: what it covers is said, and what is not known is not a zero."""

import pytest

from drone_client.summary_table import summary_rows


def summary(**fields):
    """Of a run of 20 frames in which little happened."""
    spread = {"p50": 50.0, "p95": 80.0, "p99": 85.0, "max": 90.0}
    some = {
        "drone": "d1",
        "frames": 20,
        "fates": {"answered": 20},
        "verdicts": {"accepted": 20},
        "outcomes": {"target": 20},
        "workers": {"w1": 20},
        "updates": {},
        "encodings": {},
        "network_delay_ms": spread,
        "tau_max_ms": 250.0,
        "age_ms": spread,
        "age_max_ms": 300.0,
        "service_ms": None,
        "ticks": 0,
        "known": {},
        "statuses": {},
        "freshness": {},
        "rejected_messages": {},
        "hand_overs": 0,
        "d1_ms": None,
        "link": {"kind": "zenoh"},
        "interrupted": False,
        "foreign_messages": 0,
        "same_name_workers": [],
        "lost_ledger_lines": 0,
        "unwritten": [],
    }
    return some | fields


def state(**fields):
    """What the tunnel says of a way."""
    return {"goodput_mbps": 0.0, "loss": 0.0, "parity": 0.1, "round_trip_ms": 0.0} | fields


def test_the_age_is_said_to_be_that_of_accepted_results():
    """A result that the gate refused was older than this maximum."""
    rows = summary_rows(summary())
    assert rows["age [ms]"].endswith("max 90.0  of accepted (age_max 300)")
    assert rows["d1 + d2 [ms]"].endswith("max 90.0  of accepted (tau_max 250)")
    assert "service [ms]" in rows
    assert not {k for k in rows if k.isupper()}


@pytest.mark.parametrize(
    ("known", "says"),
    [
        (None, "unknown"),
        (state(), "goodput unknown, round trip unknown, loss 0.0%, parity 10%"),
        (state(goodput_mbps=12.34), "12.3 Mbit/s, round trip unknown, loss 0.0%, parity 10%"),
        (
            state(goodput_mbps=3.0, round_trip_ms=20.0, loss=0.015),
            "3.0 Mbit/s, round trip 20.0 ms, loss 1.5%, parity 10%",
        ),
    ],
)
def test_what_the_tunnel_does_not_know_is_not_a_zero(known, says):
    """Neither a rate nor a round trip is ever 0 once it was measured."""
    rows = summary_rows(summary(link={"kind": "udp", "workers": {"w1": known}}))
    assert rows["tunnel to w1"] == says


@pytest.mark.parametrize(
    ("late", "link", "says"),
    [
        (1, {"kind": "zenoh"}, None),
        (15, {"kind": "zenoh"}, "the way to the worker and back, and the time on board, leave"),
        (15, {"workers": {"w1": state()}}, "the way to the worker and back, and the time on board"),
        (
            15,
            {"workers": {"w1": state(round_trip_ms=600.0), "w2": None}},
            "600 ms, and the time on board, leave nothing of age_max 300 ms for 15 of 20 frames",
        ),
    ],
)
def test_a_round_trip_that_leaves_no_time_is_told_with_what_to_do(late, link, says):
    """When many frames were not sent for it; the round trip where the link knows it."""
    fates = {"answered": 20 - late, "too_old_on_board": late}
    told = summary_rows(summary(fates=fates, link=link)).get("ROUND TRIP")
    if says is None:
        assert told is None
    else:
        assert told.startswith(says)
        assert "--age-max-ms" in told


@pytest.mark.parametrize(
    ("fields", "row", "says"),
    [
        ({"foreign_messages": 3}, "SAME NAME", "3 answers were for another client called 'd1'"),
        ({"same_name_workers": ["w1", "w2"]}, "SAME NAME", "is called 'w1', 'w2'"),
        ({"interrupted": True}, "INTERRUPTED", "not played to its end"),
        ({"updates": {"no_pose": 2}}, "NO POSE", "2 targets were not used"),
        ({"lost_ledger_lines": 4}, "LOST LINES", "4 (is the disk full?)"),
        ({"unwritten": ["run/summary.json: No space"]}, "UNWRITTEN", "No space"),
    ],
)
def test_what_a_person_has_to_know_has_a_row_in_capitals(fields, row, says):
    """One for each, and only when it happened."""
    rows = summary_rows(summary(**fields))
    assert says in rows[row]
    assert [k for k in rows if k.isupper()] == [row]
