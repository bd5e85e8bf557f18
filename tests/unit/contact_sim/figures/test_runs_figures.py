"""The figures of the two runs: what their captions say is so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.figures import barrier, cbf_boundary, commands, contact_force, pose_errors
from contact_sim.figures.run import Push, Run
from drone_client.cbf import Funnel
from drone_client.mission import Phase


@given(st.floats(0.0, 2.0), st.floats(0.5, 6.0), st.floats(0.0, 6.3))
def test_the_edge_is_where_h_is_zero(rho, a, turn):
    """In every direction from the axis."""
    funnel = Funnel(a=a)
    x = float(cbf_boundary.edge_m(funnel, np.array([rho]))[0])
    assert funnel.h((x, rho * np.cos(turn), rho * np.sin(turn))) == pytest.approx(0.0, abs=1e-9)


def test_the_way_in_ends_as_the_retreat_begins(run):
    """Its last place is at the board."""
    tip = cbf_boundary.way_in(run)
    assert len(tip) < len(run.tip)
    assert abs(tip[-1, 0]) < 0.02


def test_after_it_has_entered_it_stays_inside_until_the_touch(run):
    """And just before, it was outside."""
    entered = barrier.entered_s(run)
    inside = (run.t_s >= entered) & (run.t_s <= run.touch_s)
    assert (run.h[inside] >= 0.0).all()
    assert run.h[run.t_s < entered][-1] < 0.0


def test_the_least_h_is_one_of_the_approach_or_later(run):
    """It is there, and nothing later is less."""
    h_m, at_s = barrier.least(run)
    assert at_s >= run.began(Phase.APPROACH)
    assert h_m == run.h[run.t_s >= run.began(Phase.APPROACH)].min()


def test_it_lines_up_before_it_closes_in(run):
    """The paper's order of the errors."""
    across_s, along_s = pose_errors.settled_s(run)
    assert across_s < along_s
    before = run.t_s <= run.began(Phase.RETREAT)
    later = before & (run.t_s > across_s)
    assert (np.hypot(run.tip[later, 1], run.tip[later, 2]) <= 0.05).all()


def moved(run: Run, tip: np.ndarray) -> Run:
    """The same flight with its tip elsewhere."""
    places = [(float(x), float(y), float(z)) for x, y, z in tip]
    rows = tuple(
        replace(row, tip_target=place) for row, place in zip(run.flown.rows, places, strict=True)
    )
    return replace(run, flown=replace(run.flown, rows=rows))


def test_the_order_of_the_errors_is_each_runs_own(run):
    """The one before the other, after it, or never."""
    along, across = run.tip * (1.0, 0.0, 0.0), run.tip * (0.0, 1.0, 1.0)
    beside = moved(run, run.tip + (0.0, 0.06, 0.0))
    assert pose_errors.settled_s(beside) == (None, pose_errors.settled_s(run)[1])
    across_s, along_s = pose_errors.settled_s(run)
    assert pose_errors._of(run) == (
        f"a run lines up before it closes in ({across_s:.1f} s against {along_s:.1f} s)"
    )
    assert pose_errors._of(beside) == (f"a run does not line up (never against {along_s:.1f} s)")
    assert "lines up and does not close in" in pose_errors._of(moved(run, run.tip + (0.06, 0, 0)))
    assert "does not line up before it closes in" in pose_errors._of(moved(run, across))
    assert "lines up before it closes in (0.0 s" in pose_errors._of(moved(run, along))
    assert "neither lines up nor closes in" in pose_errors._of(moved(run, run.tip + 0.06))


def untouched(run: Run) -> Run:
    """The same flight as if nothing had met anything."""
    outcome = replace(
        run.flown.outcome, touched=False, offset_m=None, touch_target_m=None, touched_ns=None,
        closing_mps=None, press_force_n=None,
    )  # fmt: skip
    pushes = tuple(push._replace(force_n=0.0, arm_m=0.0) for push in run.pushes)
    return replace(run, flown=replace(run.flown, outcome=outcome), pushes=pushes)


def test_where_a_run_starts_and_touches_is_its_own(run):
    """On either side of the boundary, in the mouth, beside it, or not at all."""
    assert cbf_boundary._of(run) == (
        f"a run, seed 3, starts outside, at h = {run.h[0]:.2f} m, and touches "
        f"{1e3 * run.flown.outcome.offset_m:.1f} mm from the axis, in the mouth"
    )
    assert "starts inside" in cbf_boundary._of(moved(run, run.tip * (1.0, 0.1, 0.1)))
    far = replace(run.flown, outcome=replace(run.flown.outcome, offset_m=0.03))
    assert cbf_boundary._of(replace(run, flown=far)).endswith(
        "30.0 mm from the axis, beside the mouth"
    )
    assert cbf_boundary._of(untouched(run)).endswith("m, and does not touch the board")


def test_where_the_filter_is_not_certain_is_said(bench, run):
    """The least of what it was certain of; the true h is more all along."""
    before_m, after_m = barrier.least_certain(run)
    later = run.tick_t_s >= run.began(Phase.APPROACH)
    assert min(before_m, after_m) == np.nanmin(run.h_certain[later])
    assert after_m < 0.0 < barrier.least(run)[0]
    caption = barrier.draw(bench)[1]
    assert f"{1e3 * after_m:.0f} mm after contact in a run" in caption
    assert "docs/cbf.md, section 3" in caption


def test_a_tip_that_comes_off_again_is_said(bench, run):
    """It bounces soon after the touch: nothing presses in a break, something does before it."""
    breaks = contact_force.breaks(run)
    after_s = np.array([p.t_s for p in run.pushes]) - run.touch_s
    forces = np.array([p.force_n for p in run.pushes])
    said = contact_force._of_breaks(run)
    assert breaks
    before_s = 0.0
    for start_s, end_s in breaks:
        assert (forces[(after_s >= start_s) & (after_s <= end_s)] == 0.0).all()
        assert forces[(after_s >= before_s) & (after_s < start_s)].max() > 0.3
        assert f"from {start_s:.1f} to {end_s:.1f} s" in said
        before_s = end_s


def test_how_a_tip_stays_on_the_board_is_each_runs_own(run):
    """It comes off and on again, off for good, not at all; or it never touches."""
    t_s = np.arange(run.touch_s, run.contact_end_s, 0.004)

    def pressed(*off: tuple[float, float]) -> Run:
        forces = [0.0 if any(a <= t - t_s[0] < b for a, b in off) else 1.0 for t in t_s]
        pushes = [Push(float(t), force, 0.0) for t, force in zip(t_s, forces, strict=True)]
        return replace(run, pushes=tuple(pushes))

    of = contact_force._of_breaks
    assert of(pressed()) == "a run never until the retreat"
    assert of(pressed((0.5, 1.0))) == "a run from 0.5 to 1.0 s, and then no more until the retreat"
    assert (
        of(pressed((0.5, 1.0), (1.5, 9.0)))
        == "a run from 0.5 to 1.0 s and from 1.5 s to the retreat"
    )
    gone = replace(run, pushes=pressed((0.5, 1.0)).pushes[:150])  # it leaves for good, and far
    assert of(gone) == "a run from 0.5 s to the retreat"
    assert of(untouched(run)) == "a run does not touch"


def test_a_run_that_is_at_the_board_twice_is_said(run):
    """With the attempt that touched, which need not be the last."""
    ticks = tuple(
        replace(t, decision=replace(t.decision, mission=replace(t.decision.mission, attempts=2)))
        for t in run.flown.ticks
    )
    twice = replace(run, label="run 1", flown=replace(run.flown, attempts=2, ticks=ticks))
    again = replace(twice, flown=replace(twice.flown, attempts=3))
    assert run.touch_attempt == 1
    assert (twice.touch_attempt, untouched(twice).touch_attempt) == (2, None)
    assert cbf_boundary._again((run, run)) == ""
    assert cbf_boundary._again((again, run)) == "Run 1 makes 3 attempts, and touches at attempt 2. "
    assert "2 attempts, and touches at none" in cbf_boundary._again((untouched(twice), run))


def test_what_a_run_does_with_the_barrier_is_its_own(run):
    """In to stay until the touch, in from the start, never; with no approach, nothing of one."""
    entered = barrier.entered_s(run)
    assert f"starts outside, at h = {run.h[0]:.2f} m, and stays inside" in barrier._of(run)
    assert f"stays inside from {entered:.1f} s to the touch; from its approach" in barrier._of(run)
    assert "inside from" not in barrier._of(moved(run, run.tip * (1.0, 0.0, 0.0)))
    assert "does not stay in the safe set" in barrier._of(moved(run, run.tip + (0.0, 1.5, 0.0)))
    ticks = tuple(t for t in run.flown.ticks if t.t_ns / 1e9 < run.began(Phase.APPROACH))
    waits = barrier._of(untouched(replace(run, flown=replace(run.flown, ticks=ticks))))
    assert waits.endswith("s to the end")


@pytest.mark.parametrize("module", [cbf_boundary, barrier, pose_errors, commands])
def test_each_is_drawn_with_units_on_every_axis(module, bench):
    """A label that names no unit cannot be read."""
    figure, caption = module.draw(bench)
    assert caption.endswith("Flown with a localiser's measured errors instead of pictures.")
    assert "nan" not in caption
    labels = [
        label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label
    ]
    assert labels
    assert all("[" in label for label in labels)
