"""A flight as arrays: they are what was flown, in the frame of the target."""

from __future__ import annotations

import numpy as np
import pytest

from contact_sim.scene import build_scene
from drone_client.mission import Phase


def test_the_flight_is_whole(run):
    """From outside the safe set to contact and back, with every result and its verdict."""
    assert run.h[0] < 0.0
    phases = [phase for _, phase in run.phases]
    order = [Phase.ALIGN, Phase.APPROACH, Phase.CONTACT, Phase.RETREAT, Phase.DONE]
    assert [phase for phase in phases if phase in order] == order
    assert len(run.receptions) == sum(run.flown.verdicts.values())
    starts = [t_s for t_s, _ in run.phases]
    assert starts == sorted(starts)
    assert run.began(Phase.BRAKE) is None


def test_velocities_are_those_of_the_body_seen_from_the_target(run):
    """Against differences of the body's place, turned by the board's own pose."""
    target_from_world = build_scene("tunnel", 3).world_from_target.inverse().rotation
    places = np.array([row.body_world for row in run.flown.rows]) @ target_from_world.T
    slopes = np.gradient(places, run.t_s, axis=0)
    np.testing.assert_allclose(run.velocity_target[5:-5], slopes[5:-5], atol=0.03)


def test_commands_keep_their_limit_and_the_vehicle_follows(run):
    """A command is what is flown half a second later, about."""
    assert np.linalg.norm(run.command_target, axis=1).max() <= 0.4 + 1e-9
    later = np.interp(run.tick_t_s + 0.35, run.t_s, run.velocity_target[:, 0])
    away = (run.tick_t_s > 2.5) & (run.tick_t_s < 10.0)
    assert np.abs(later - run.command_target[:, 0])[away].mean() < 0.03


def test_what_is_certain_is_less_than_what_is_true(run):
    """The error ball is larger than the error, at every tick that the filter was asked at."""
    asked = ~np.isnan(run.h_certain)
    true = np.interp(run.tick_t_s[asked], run.t_s, run.h)
    assert asked.sum() > 500
    assert (run.h_certain[asked] < true + 0.01).all()


def test_the_force_is_written_down_near_the_board(run):
    """250 times a second, beginning without a touch, and as hard as the witness says."""
    t_s = np.array([push.t_s for push in run.pushes])
    assert np.median(np.diff(t_s)) == pytest.approx(0.004)
    assert run.pushes[0].force_n == 0.0
    assert run.touch_s is not None
    assert run.began(Phase.APPROACH) < run.touch_s < run.began(Phase.RETREAT)
    assert max(push.force_n for push in run.pushes) <= run.flown.outcome.peak_force_n + 1e-9
