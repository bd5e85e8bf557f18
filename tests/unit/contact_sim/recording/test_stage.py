"""The stage of a film: the world with the drone that was flown."""

from __future__ import annotations

from dataclasses import replace

import pytest

from contact_sim.recording.stage import PROPELLER_RGBA, Stage
from contact_sim.scene import SEEN_GROUP
from drone_client.cbf import Funnel
from drone_client.settings import load_settings
from drone_client.viewing.facts import Propeller, facts_of
from tests.unit.contact_sim.flights import AIRFRAME, RIG, plain_scene


def test_the_propellers_are_those_that_were_flown():
    """A smaller drone of another airframe is drawn as small as it is."""
    facts = facts_of(load_settings(), AIRFRAME, Funnel(), RIG)
    small = tuple(
        Propeller((0.15 * x, 0.15 * y, 0.03), 0.09) for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1))
    )
    with Stage(plain_scene(), replace(facts, propellers=small), 64, 48) as stage:
        for i, propeller in enumerate(small):
            geom = stage.model.geom(f"drone/propeller_{i}")
            assert geom.pos == pytest.approx(propeller.center_body)
            assert geom.size[0] == pytest.approx(propeller.radius_m)
            assert geom.rgba == pytest.approx(PROPELLER_RGBA)
            assert geom.group[0] == SEEN_GROUP
