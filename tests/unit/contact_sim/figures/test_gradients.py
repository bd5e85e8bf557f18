"""The slopes are those of h, but the printed one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contact_sim.figures.gradients import STARTS, _settings, difference, kept, missed, slope
from contact_sim.figures.run import Run
from contact_sim.scene import WORLDS
from drone_client.cbf import Variant
from drone_client.mission import Phase, Reason

RHO = np.geomspace(2e-3, 0.9, 40)


@pytest.mark.parametrize("variant", [Variant.CUSP, Variant.SMOOTH])
def test_the_true_slopes_are_those_of_differences(variant):
    """To a millionth."""
    barrier = _settings(variant).barrier
    np.testing.assert_allclose(slope(barrier, RHO), difference(barrier, RHO), rtol=1e-6)


def test_the_printed_one_is_too_flat_by_the_power_of_three_quarters():
    """Of the distance from the axis: docs/cbf.md, section 1."""
    printed, true = (_settings(v).barrier for v in (Variant.PAPER, Variant.CUSP))
    np.testing.assert_allclose(slope(printed, RHO) / slope(true, RHO), RHO**0.75, rtol=1e-12)
    assert not np.allclose(slope(printed, RHO), difference(printed, RHO), rtol=0.05)


def test_both_worlds_are_flown():
    """No start twice."""
    assert {world for world, _ in STARTS} == set(WORLDS)
    assert len(set(STARTS)) == len(STARTS)


def short(run: Run, phase: Phase, nearest_m: float) -> Run:
    """A flight that did not touch."""
    outcome = replace(run.flown.outcome, touched=False, nearest_m=nearest_m)
    return replace(run, flown=replace(run.flown, phase=phase, outcome=outcome))


def test_what_became_of_flights_that_did_not_touch_is_said_of_them_alone(run):
    """Given up by the mission, or cut off by the figure."""
    given_up, cut_off = short(run, Phase.ABORT, 0.16), short(run, Phase.RETREAT, 0.25)
    assert missed([run]) == ""
    assert missed([run, given_up]) == ": 1 comes no nearer than 16 cm; the mission gives up 1"
    cut = "1 is still at it after 70 s, where they are cut off"
    assert missed([cut_off]) == f": 1 comes no nearer than 25 cm; {cut}"
    assert missed([run, given_up, given_up, cut_off]) == (
        f": 3 come no nearer than 16 to 25 cm; the mission gives up 2, and {cut}"
    )
    assert missed([short(run, Phase.DONE, 0.02)]).endswith("; 1 went back as if from contact")


def test_contact_is_kept_by_what_dwelt_on_the_board(run):
    """Not by what never touched, and also by what has no time left to come back."""
    flown = run.flown
    early = tuple(t for t in flown.transitions if t.reason is not Reason.DWELT)
    assert kept([run, short(run, Phase.DONE, 0.1)]) == 1
    assert kept([replace(run, flown=replace(flown, phase=Phase.RETREAT))]) == 1
    assert kept([replace(run, flown=replace(flown, transitions=early))]) == 0
