"""What is wrong is named, what is right is called good, and what was not seen is not guessed."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from drone_client.calibration.report import Calibration, as_json
from drone_client.calibration.sighting import Miss
from drone_client.calibration.verdicts import Finding, judge
from rgbd_wire.geometry import Pose
from target_pose.target import load_target
from tests.unit.drone_client.rigs import CAMERA, sightings, wrong

TARGET = load_target()


def verdicts(judgement):
    return {v.name: v for v in judgement.verdicts}


def off(judgement):
    return {v.name for v in judgement.verdicts if v.finding is Finding.OFF}


@pytest.mark.parametrize("seed", range(5))
def test_a_good_rig_is_good_in_everything(seed):
    """After a good recording nothing is left unknown."""
    judgement = judge(sightings(80, seed=seed), CAMERA, TARGET)
    assert {v.finding for v in judgement.verdicts} == {Finding.GOOD}
    assert judgement.finding is Finding.GOOD
    assert all(v.do == "" for v in judgement.verdicts)


def test_a_scale_names_its_three_candidates():
    """Depth unit, print and focal length look alike; each with the number it would have."""
    judgement = judge(sightings(80, 0.02), CAMERA, TARGET)
    assert off(judgement) == {"agreement", "scale"}
    scale = verdicts(judgement)["scale"]
    assert scale.value == pytest.approx(2.0, abs=0.3)
    assert re.search(r"depth_scale_m = 0\.000(98|97[89])", scale.do)
    assert re.search(r"a print of 30[56]\.\d mm \(is 300 mm", scale.do)
    assert re.search(r"focal length of 39[23]\.\d px \(is 385\)", scale.do)


@pytest.mark.parametrize(
    ("axis", "name"), [(0, "shift right"), (1, "shift down"), (2, "shift forward")]
)
@pytest.mark.parametrize("shift_m", [0.02, -0.02])
def test_a_shift_of_20_mm_is_named_with_the_translation_to_set(axis, name, shift_m):
    """And with that translation set, everything is good."""
    shift = np.zeros(3)
    shift[axis] = shift_m
    camera = wrong(CAMERA, 0.0, shift)
    seen = sightings(80)
    judgement = judge(seen, camera, TARGET)
    assert name in off(judgement)
    assert off(judgement) <= {"agreement", name}
    verdict = verdicts(judgement)[name]
    assert verdict.value == pytest.approx(1000 * shift_m, abs=3)
    assert verdict.do.startswith("color_from_depth.translation_m = [")
    translation = np.array(json.loads(verdict.do.split("=")[1]))
    np.testing.assert_allclose(translation, CAMERA.color_from_depth.translation, atol=4e-3)
    mended = replace(camera, color_from_depth=Pose(translation, camera.color_from_depth.q_wxyz))
    assert judge(seen, mended, TARGET).finding is Finding.GOOD


@pytest.mark.parametrize(
    ("axis", "name"), [(0, "turn about right"), (1, "turn about down"), (2, "turn about forward")]
)
def test_a_turn_is_named_with_the_quaternion_to_set(axis, name):
    """Three degrees about one axis."""
    turn = np.zeros(3)
    turn[axis] = math.radians(3)
    camera = wrong(CAMERA, 0.0, (0, 0, 0), turn)
    judgement = judge(sightings(80), camera, TARGET)
    assert name in off(judgement)
    verdict = verdicts(judgement)[name]
    assert verdict.value == pytest.approx(3, abs=0.4)
    q = np.array(json.loads(verdict.do.split("=")[1]))
    np.testing.assert_allclose(q, CAMERA.color_from_depth.q_wxyz, atol=5e-3)


@pytest.mark.parametrize(
    ("ratio", "words"),
    [(5.0, "0.0002 (1/5000 m: TUM"), (0.1, "0.01 (1 cm)"), (1000.0, ""), (3.28, "0.0003048")],
)
def test_a_wrong_unit_is_said_and_not_taken_out(ratio, words):
    """With the unit that would fit, where one is in use."""
    seen = [replace(s, ratio=ratio, plane=None) for s in sightings(20)]
    judgement = judge(seen, CAMERA, TARGET)
    (verdict,) = judgement.verdicts
    assert verdict.name == "depth unit"
    assert verdict.finding is Finding.OFF
    assert f"{0.001 / ratio:.3g} would fit" in verdict.do
    assert words in verdict.do
    assert judgement.errors is None


def test_one_range_tells_that_something_is_off_and_not_what():
    """A factor and a shift are both named, and how to tell them apart."""
    seen = sightings(60, 0.02, ranges=(2.2, 2.25), tilt_deg=20, aim=0.0)
    judgement = judge(seen, CAMERA, TARGET)
    assert off(judgement) == {"agreement"}
    agreement = verdicts(judgement)["agreement"]
    assert re.search(r"shift of 4[345] mm", agreement.do)
    assert re.search(r"depth_scale_m = 0\.000(98|97[89])", agreement.do)
    assert "record again from 0.7 m to 3 m" in agreement.do


def test_a_shift_within_the_allowance_is_not_called_off():
    """Two millimetres are within what the localiser and the filter allow for."""
    judgement = judge(sightings(80), wrong(CAMERA, 0.0, (0.002, 0.0, 0.002)), TARGET)
    assert judgement.finding is Finding.GOOD


@pytest.mark.parametrize("count", [0, 1, 4])
def test_too_few_frames_are_not_judged(count):
    """How many there were and how to record."""
    judgement = judge(sightings(count), CAMERA, TARGET)
    assert judgement.finding is Finding.UNKNOWN
    (verdict,) = judgement.verdicts
    assert f"in {count} frames" in verdict.says
    assert "hold the camera still" in verdict.do


def test_a_frontal_flight_leaves_the_turns_unknown():
    """And says how to fly for them."""
    judgement = judge(sightings(60, tilt_deg=1), CAMERA, TARGET)
    unknown = [v for v in judgement.verdicts if v.finding is Finding.UNKNOWN]
    assert {"turn about right", "turn about down"} <= {v.name for v in unknown}
    assert all(v.do for v in unknown)


def test_json_holds_everything_and_is_json():
    """Finite numbers, counted misses, the estimate with its frame."""
    seen = tuple(sightings(20, 0.02))
    judgement = judge(seen, CAMERA, TARGET)
    outcome = Calibration("rec", TARGET.name, seen, (Miss("a", "x"), Miss("b", "x")), judgement)
    body = json.loads(json.dumps(as_json(outcome), allow_nan=False))
    assert body["finding"] == "off"
    assert (body["frames"], body["sightings"], body["misses"]) == (22, 20, {"x": 2})
    assert body["rig_errors"]["frame"] == "camera"
    assert len(body["rig_errors"]["estimate"]) == len(body["rig_errors"]["names"]) == 7
    assert body["range_m"][0] < body["range_m"][1]
