"""What a run tells of the drone's own eyes: bridges from ticks, counts from looks."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.onboard_summary import Bridge, bridges, summarise_onboard
from drone_client.summary import summarise
from drone_client.summary_table import summary_rows
from drone_client.truth import TruthEntry
from tests.unit.drone_client.builders import MS, pose
from tests.unit.drone_client.test_summary_table import summary as plain_summary

PERIOD_NS = 20 * MS


def tick(i: int, source: str | None, freshness: str = "fresh") -> dict:
    line = {"t_ns": i * PERIOD_NS, "known": "no_target" if source is None else "target"}
    if source is not None:
        line |= {"target_source": source, "freshness": freshness, "status": "active"}
    return line


def ticks(letters: str) -> list[dict]:
    """e: edge, o: own eyes, s: own eyes but stale, -: no target."""
    kinds = {
        "e": ("edge", "fresh"),
        "o": ("onboard", "fresh"),
        "s": ("onboard", "hold"),
        "-": (None, "fresh"),
    }
    return [tick(i, *kinds[letter]) for i, letter in enumerate(letters)]


def looked(sequence: int, verdict: str = "accepted", dx_mm: float = 0.0, **more) -> dict:
    line = {"sequence": sequence, "verdict": verdict, "look_ms": 9.0}
    if verdict == "accepted":
        line["camera_from_target"] = [dx_mm / 1e3, 0, 2, 1, 0, 0, 0]
    return line | more


def test_a_bridge_is_a_stretch_of_fresh_ticks_on_own_eyes():
    """It ends where the edge leads, where the pose is stale, and with the run."""
    assert bridges(ticks("--eeooosseeoe-oo")) == [
        Bridge(4 * PERIOD_NS, 6 * PERIOD_NS),
        Bridge(11 * PERIOD_NS, 11 * PERIOD_NS),
        Bridge(14 * PERIOD_NS, 15 * PERIOD_NS),
    ]
    assert bridges([]) == []


@given(st.text("eos-", max_size=60))
def test_bridges_are_what_splitting_the_letters_gives(letters):
    """By string methods."""
    runs = [
        r for r in letters.replace("e", " ").replace("s", " ").replace("-", " ").split(" ") if r
    ]
    got = bridges(ticks(letters))
    assert [(b.end_ns - b.start_ns) // PERIOD_NS + 1 for b in got] == [len(r) for r in runs]


def test_the_summary_counts_looks_ticks_and_bridges():
    """Reasons with the localiser's own word, shares of all ticks, the longest bridge."""
    looks = [
        looked(0),
        looked(1, dx_mm=4.0),
        looked(2, "refused", detail="grazing"),
        looked(3, "expired", look_ms=None),
    ]
    truth = [TruthEntry(pose((0, 0, 2)), 1.0)] * 4
    s = summarise_onboard(looks, ticks("eeoooosse-"), truth)
    assert s["frames"] == 4
    assert s["accepted"] == 2
    assert s["verdicts"] == {"accepted": 2, "refused: grazing": 1, "expired": 1}
    assert s["ticks_by_source"] == {"edge": 3, "onboard": 6}
    assert s["share_of_ticks"] == 0.4
    assert (s["bridges"], s["longest_bridge_ms"]) == (1, 60.0)
    assert s["look_ms"]["max"] == 9.0
    assert s["truth"]["position_error_mm"]["max"] == pytest.approx(4.0)


def test_without_own_eyes_the_summary_says_none_and_the_table_nothing():
    """It stands in every summary, so that a program need not guess."""
    s = summarise([], [], [], ())
    assert s["onboard"] is None
    assert "own eyes" not in summary_rows(plain_summary(onboard=None))


def test_an_empty_run_with_own_eyes_is_json():
    """No look, no tick."""
    s = summarise([], [], [], (), [])
    assert s["onboard"]["frames"] == 0
    assert s["onboard"]["look_ms"] is None
    json.dumps(s, allow_nan=False)


def test_the_table_tells_of_looks_and_of_the_longest_bridge():
    """Two rows; the second only where there was a bridge."""
    own = summarise_onboard([looked(0), looked(1, "off_prediction")], ticks("eooo"), ())
    rows = summary_rows(plain_summary(onboard=own))
    expected = "2 frames without a fresh result: 1 accepted, 1 off_prediction"
    assert rows["own eyes"] == expected
    assert rows["bridges"].startswith("1, longest 0.04 s; 75.0% of all ticks flown on own eyes")
    assert "TAKEN BACK" not in rows
    lost = summary_rows(plain_summary(onboard=own | {"taken_back": 2}))
    assert lost["TAKEN BACK"].startswith("2 times the edge disagreed")
    none = summarise_onboard([], ticks("ee"), ())
    assert "bridges" not in summary_rows(plain_summary(onboard=none))
