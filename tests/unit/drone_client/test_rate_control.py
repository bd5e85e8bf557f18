"""Rate control: what is predicted fits whenever anything fits; down at once, up with patience."""

from __future__ import annotations

import json

from hypothesis import given, settings
from hypothesis import strategies as st

from drone_client.goodput import Goodput
from drone_client.rate_control import LADDER, Choice, RateController, RateSettings, Reason

MS = 1_000_000
SECOND = 1_000_000_000
BOUND_NS = 83 * MS
COLOR, DEPTH = 25_000, 80_000
"""Bytes of the best rung."""
PERIOD_NS = 33 * MS


def controller(**changes) -> RateController:
    """A controller for tau_max 250 ms."""
    return RateController(RateSettings(BOUND_NS, **changes))


def weigh(control: RateController, choice: Choice, scale: float = 1.0) -> int:
    """What the rung's frame weighs, told to the controller; in bytes."""
    color = round(scale * COLOR * choice.rung.color_weight)
    depth = round(scale * DEPTH * choice.rung.depth_weight(choice.region_share))
    control.weighed(choice, color, depth)
    return color + depth


def fly(control: RateController, goodput: float, start_ns: int, frames: int) -> list[Choice]:
    """So many frames over a link of that goodput."""
    choices = []
    for n in range(frames):
        choices.append(control.choose(start_ns + n * PERIOD_NS, goodput))
        weigh(control, choices[-1])
    return choices


def lowest_bytes() -> float:
    """Of the leanest rung."""
    return COLOR * LADDER[-1].color_weight + DEPTH * LADDER[-1].depth_weight(0.0)


def test_the_ladder_only_gets_leaner():
    """Each rung weighs less than the one above it, whatever the region, and looks no better."""
    for share in (0.0, 0.1, 0.5, 1.0):
        weights = [COLOR * r.color_weight + DEPTH * r.depth_weight(share) for r in LADDER]
        if share < 0.9:  # at last the region is the picture
            assert weights == sorted(weights, reverse=True)
    assert [r.depth_step for r in LADDER] == sorted(r.depth_step for r in LADDER)


def test_before_the_first_ack_the_best_goes():
    """Nobody knows the link: the first frames tell."""
    choice = controller().choose(0, None)
    assert (choice.rung, choice.reason) == (LADDER[0], Reason.UNKNOWN_LINK)


@given(st.floats(1e4, 1e8), st.floats(0.3, 3.0))
def test_the_predicted_time_is_within_the_bound_whenever_any_rung_fits(goodput, scale):
    """And when none fits, the leanest goes, and says so."""
    control = controller()
    weigh(control, control.choose(0, None), scale)
    choice = control.choose(1, goodput)
    if choice.reason is Reason.TOO_SLOW:
        assert choice.rung is LADDER[-1]
        assert scale * lowest_bytes() / goodput > 0.99 * BOUND_NS / 1e9
    else:
        assert choice.predicted_ns <= BOUND_NS


@given(st.floats(1e5, 1e7), st.floats(0.05, 1.0))
def test_less_goodput_never_gives_a_fatter_rung(goodput, share):
    """A fall is answered at once, by the same rung or a leaner one."""
    control = controller()
    before = fly(control, goodput, 0, 60)[-1]
    after = control.choose(60 * PERIOD_NS, share * goodput)
    assert LADDER.index(after.rung) >= LADDER.index(before.rung)


@settings(max_examples=40)
@given(st.floats(1e5, 1e7))
def test_on_a_steady_link_the_rung_settles(goodput):
    """No oscillation: after the first second the rung changes upwards only, and not for long."""
    choices = fly(controller(), goodput, 0, 300)
    rungs = [LADDER.index(c.rung) for c in choices]
    assert rungs[100:] == sorted(rungs[100:], reverse=True)
    assert len(set(rungs[200:])) == 1


@settings(max_examples=40)
@given(st.floats(5e5, 5e6), st.integers(0, 10**6))
def test_a_goodput_that_wavers_does_not_make_the_rung_waver(goodput, seed):
    """Ten per cent up and down around a boundary: at most one step up in ten seconds."""
    control, rungs = controller(), []
    for n in range(300):
        wobble = 1.1 if (n + seed) % 2 else 0.9
        choice = control.choose(n * PERIOD_NS, wobble * goodput)
        weigh(control, choice)
        rungs.append(LADDER.index(choice.rung))
    ups = sum(b < a for a, b in zip(rungs[40:], rungs[41:], strict=False))
    assert ups <= 1


@settings(max_examples=40)
@given(st.lists(st.floats(5e5, 2e7), min_size=2, max_size=4), st.integers(0, 30 * MS))
def test_over_a_link_whose_rate_changes_the_bound_holds(rates, delay_ns):
    """With the goodput as it is measured: late for four frames after a fall at most, then within.

    Every rate here carries the leanest rung in time.
    """
    control, estimate, free_ns, now_ns = controller(), Goodput(), 0, 0
    for rate in rates:
        for n in range(60):
            choice = control.choose(now_ns, estimate.bytes_per_s)
            size = weigh(control, choice)
            t1_ns = max(now_ns, free_ns)
            free_ns = t1_ns + round(size / rate * 1e9)
            estimate.acked(size, t1_ns, free_ns + 2 * delay_ns, 2 * delay_ns)
            now_ns = t1_ns + PERIOD_NS
            if n >= 4:
                assert size / rate * 1e9 <= 1.01 * BOUND_NS
        assert choice.reason is not Reason.TOO_SLOW


def test_up_takes_a_second_of_room_to_spare():
    """A link that got better is believed after a second."""
    control = controller()
    fly(control, 5e5, 0, 30)
    start_ns = 30 * PERIOD_NS
    choices = fly(control, 1e8, start_ns, 60)
    first = next(n for n, c in enumerate(choices) if c.rung is LADDER[0])
    assert first * PERIOD_NS >= SECOND
    assert {c.reason for c in choices[:first]} == {Reason.WAITS}
    assert choices[-1].reason is Reason.FITS


@given(st.floats(0.0, 0.5), st.floats(0.0, 0.5), st.floats(2e5, 3e6))
def test_a_region_that_comes_up_is_in_the_prediction(before, after, goodput):
    """A target that is seen for the first time does not make the next frame late."""
    control = controller()
    weigh(control, control.choose(0, None, before))
    for n in range(60):
        weigh(control, control.choose(n * PERIOD_NS, goodput, before))
    choice = control.choose(60 * PERIOD_NS, goodput, after)
    weight = choice.rung.depth_weight(after)
    bytes_ = COLOR * choice.rung.color_weight + DEPTH * weight
    assert abs(choice.predicted_bytes - bytes_) <= 0.01 * bytes_ + 2
    if choice.reason is not Reason.TOO_SLOW:
        assert bytes_ / goodput <= 1.02 * BOUND_NS / 1e9


def test_a_quality_above_80_is_what_the_best_rung_has():
    """--jpeg-quality 95 means 95 where the link carries it, and the ladder's own below."""
    control = controller(best_quality=95)
    first = control.choose(0, None)
    assert first.jpeg_quality == 95
    weigh(control, first)
    assert control.choose(1, 1e4).jpeg_quality == LADDER[-1].jpeg_quality


def test_switched_off_it_is_always_the_best():
    """The quality asked for, whatever the link does."""
    control = controller(enabled=False, best_quality=90)
    choices = fly(control, 1e4, 0, 5)
    assert {(c.rung, c.jpeg_quality, c.reason) for c in choices} == {(LADDER[0], 90, Reason.FIXED)}


def test_no_rung_goes_above_the_quality_asked_for():
    """--jpeg-quality is the best there is."""
    control = controller(best_quality=50)
    qualities = {control.choose(0, None).jpeg_quality}
    weigh(control, control.choose(0, None))
    qualities |= {control.choose(n, 1e4 * 2**n).jpeg_quality for n in range(12)}
    assert max(qualities) == 50


def test_the_ledger_hears_what_was_chosen_and_why():
    """Plain JSON, with nulls where nothing is known."""
    control = controller()
    first = control.choose(0, None)
    weigh(control, first)
    later = control.choose(1, 1e6)
    for choice in (first, later):
        assert json.loads(json.dumps(choice.record())) == choice.record()
    assert first.record()["predicted_ms"] is None
    assert later.record()["goodput_mbps"] == 8.0
    assert later.record()["reason"] == "slow_link"
