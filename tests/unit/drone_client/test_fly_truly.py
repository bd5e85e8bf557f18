"""The truth of a simulated flight, beside what the client believes of it."""

from __future__ import annotations

import math
from typing import Any

import pytest

from drone_client.fly.truly import print_truth, truth_rows, unsafe

TOUCHED: dict[str, Any] = {
    "touched": True,
    "offset_m": 0.0042,
    "closing_mps": 0.051,
    "peak_force_n": 1.29,
    "press_force_n": 0.44,
    "pressed_s": 3.02,
    "outside_m": 0.0,
    "collisions": [],
    "drift_m": 0.0245,
    "slipped_s": 0.0,
    "error": None,
    "safe": True,
}
UNTOUCHED = TOUCHED | {
    "touched": False,
    "offset_m": None,
    "closing_mps": None,
    "peak_force_n": 0.0,
    "press_force_n": None,
    "pressed_s": 0.0,
    "drift_m": math.nan,
}


def test_a_touch_is_told_in_numbers():
    """Where, how fast, how hard, how long, and what else."""
    assert truth_rows(TOUCHED) == {
        "touch": "4 mm from the centre of the print, closing at 51 mm/s",
        "force": "at most 1.3 N, median 0.4 N, pressed 3.0 s",
        "else touched": "nothing",
        "beside the mouth": "never",
        "drift": "24 mm at the end",
    }


def test_a_flight_without_a_touch_tells_no_numbers_of_one():
    """Nor a drift that is not known."""
    rows = truth_rows(UNTOUCHED)
    assert (rows["touch"], rows["drift"]) == ("none", "unknown")
    assert rows["force"] == "at most 0.0 N, pressed 0.0 s"


@pytest.mark.parametrize(
    ("what", "says"),
    [
        (
            {"collisions": ["drone/propeller_1 on wall"]},
            "not safe, whatever the client believes: drone/propeller_1 on wall",
        ),
        (
            {"outside_m": 0.004},
            "not safe, whatever the client believes: pushed 4.0 mm beside the mouth",
        ),
    ],
)
def test_what_none_may_do_is_a_sentence(what: dict[str, Any], says: str):
    """Also where the client believes in success."""
    assert unsafe({"phase": "done", "simulated": TOUCHED | what | {"safe": False}}) == says


def test_of_a_real_flight_nobody_knows(capsys):
    """No table, and nothing that could be unsafe."""
    assert unsafe({"phase": "done"}) is None
    print_truth({"phase": "done"})
    assert capsys.readouterr().out == ""


def test_a_world_that_stood_still_or_slipped_is_told():
    """The numbers are of a flight that was none, or slower than its clock."""
    rows = truth_rows(TOUCHED | {"slipped_s": 1.25, "error": "the physics diverged"})
    assert rows["slipped"].startswith("1.2 s")
    assert rows["ERROR"] == "the physics diverged"


def test_the_table_is_printed(capsys):
    """With its title."""
    print_truth({"simulated": TOUCHED})
    out = capsys.readouterr().out
    assert "truth" in out
    assert "4 mm from the centre" in out
