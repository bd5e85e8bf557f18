"""A flight in lockstep as the moments that a film is made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from contact_sim.chance import stream
from contact_sim.figures.bench import LINK
from contact_sim.figures.film import SEED, WORLD, Recorder, nearest
from contact_sim.figures.run import Run, fly
from contact_sim.lockstep.eyes import ModelEyes
from contact_sim.lockstep.flight import LockstepSettings
from contact_sim.recording.reel import Reel
from contact_sim.scene import build_scene
from contact_sim.sensing import d455
from drone_client.airframe import Airframe
from drone_client.settings import load_settings
from drone_client.viewing.facts import facts_of


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Reel, Run, Path]:
    """Two seconds."""
    folder = tmp_path_factory.mktemp("pictures")
    recorder = Recorder(ModelEyes(d455().color, stream(SEED, "eyes")), folder)
    settings = LockstepSettings(longest_s=2.0)
    run = fly(
        "film", build_scene(WORLD, SEED), SEED, LINK, recorder, settings, recorder.before_tick
    )
    facts = facts_of(load_settings(), Airframe(), run.funnel, d455())
    return Reel(facts, recorder.all(run)), run, folder


def test_every_moment_has_its_picture_its_answer_and_its_truth(flown):
    """In one clock: what was found is of the picture that it lies over."""
    reel, run, folder = flown
    instant = reel.at(round(1.8e9))
    assert instant.picture is not None
    assert instant.picture.path.parent == folder
    assert instant.answer is not None
    assert instant.answer.t_capture_ns == instant.picture.t_ns
    assert instant.answer.accepted
    assert instant.tick is not None
    assert instant.tick.line["phase"] == "align"
    assert len(reel.ticks) == len(run.flown.ticks)
    assert [said.sentence.split(":")[0] for said in reel.sayings] == [
        "hold -> search",
        "search -> align",
    ]
    assert instant.known is not None
    seen = instant.answer.camera_from_target
    assert seen is not None
    assert np.linalg.norm(instant.known.translation - seen.translation) < 0.03
    row = min(run.flown.rows, key=lambda r: abs(r.t_ns - instant.truth.t_ns))
    np.testing.assert_allclose(row.body_world, instant.truth.world_from_body.translation, atol=0.01)


def test_the_picture_that_is_shown_is_the_nearest():
    """Also before the first and after the last."""
    times = [0, 40, 80]
    assert [nearest(times, t) for t in (-100, 19, 21, 900)] == [0, 0, 1, 2]
