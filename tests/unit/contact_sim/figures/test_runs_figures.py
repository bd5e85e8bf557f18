"""The figures of the two runs: what their captions say is so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.figures import barrier, cbf_boundary, commands, contact_force, pose_errors
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


def test_where_the_filter_is_not_certain_is_said(bench, run):
    """The least of what it was certain of; the true h is more all along."""
    before_m, after_m = barrier.least_certain(run)
    later = run.tick_t_s >= run.began(Phase.APPROACH)
    assert min(before_m, after_m) == np.nanmin(run.h_certain[later])
    assert after_m < 0.0 < barrier.least(run)[0]
    caption = barrier.draw(bench)[1]
    assert f"{1e3 * after_m:.0f} mm in the retreat" in caption
    assert "docs/cbf.md, section 3" in caption


def test_a_tip_that_comes_off_again_is_said(bench, run):
    """It bounces soon after the touch: nothing presses in a break, something does before it."""
    breaks = contact_force.breaks(run)
    after_s = np.array([p.t_s for p in run.pushes]) - run.touch_s
    forces = np.array([p.force_n for p in run.pushes])
    said = contact_force._of_breaks((run, run))
    assert breaks
    before_s = 0.0
    for start_s, end_s in breaks:
        assert (forces[(after_s >= start_s) & (after_s <= end_s)] == 0.0).all()
        assert forces[(after_s >= before_s) & (after_s < start_s)].max() > 0.3
        assert f"from {start_s:.1f} to {end_s:.1f} s" in said
        before_s = end_s


def test_a_run_that_is_at_the_board_twice_is_said(run):
    """Both attempts are drawn, in one colour."""
    twice = replace(run, label="run 1", flown=replace(run.flown, attempts=2))
    assert cbf_boundary._again((run, run)) == ""
    assert "Run 1 backs off on its way in" in cbf_boundary._again((twice, run))


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
