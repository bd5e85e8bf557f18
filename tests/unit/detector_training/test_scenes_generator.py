"""Whole scenes: the same for a seed, labelled truly, and showing what the labels say."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from detector_training.scenes import Library, generate
from detector_training.scenes.labels import label_boxes
from detector_training.scenes.placement import facing
from detector_training.scenes.recipe import PLANS, Recipe
from rgbd_wire.camera import CameraIntrinsics
from target_pose.target import Level, load_target

TARGET = load_target()
PROCEDURAL = Library((), ())
CAMERA = CameraIntrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)


@pytest.fixture(scope="module")
def scenes():
    """Two dozen scenes without any photograph."""
    return [generate((7, index), PROCEDURAL, TARGET) for index in range(24)]


def decoded(scene):
    """Grey levels (480, 640) of a scene's JPEG."""
    data = np.frombuffer(scene.jpeg, dtype=np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE).astype(float)


def pixels_of_ring(scene, radius_m):
    """Grey levels at 72 points of a circle on the board that fall in the picture."""
    grey, camera, pose = decoded(scene), scene.camera, scene.camera_from_target
    values = []
    for angle in np.linspace(0, 2 * math.pi, 72, endpoint=False):
        p = pose @ np.array([0.0, radius_m * math.cos(angle), radius_m * math.sin(angle)])
        u = round(camera.fx * p[0] / p[2] + camera.cx)
        v = round(camera.fy * p[1] / p[2] + camera.cy)
        if 0 <= u < 640 and 0 <= v < 480:
            values.append(grey[v, u])
    return np.array(values)


def test_a_seed_always_gives_the_same_bytes(scenes):
    """Rendering again gives the same JPEG and the same labels; another seed does not."""
    again = generate((7, 3), PROCEDURAL, TARGET)
    assert again.jpeg == scenes[3].jpeg
    assert again.label("x") == scenes[3].label("x")
    assert generate((8, 3), PROCEDURAL, TARGET).jpeg != scenes[3].jpeg


def test_about_a_quarter_are_negatives_and_have_no_boxes(scenes):
    """A negative has no box, no pose and no distance; a scene has all three levels."""
    negatives = [s for s in scenes if not s.boxes]
    assert 1 <= len(negatives) <= 12
    for scene in scenes:
        label = scene.label("images/a.jpg")
        if scene.boxes:
            assert label["kind"] == "scene"
            assert [b["level"] for b in label["boxes"]] == ["T_good", "T_better", "T_best"]
            assert label["distance_m"] > 0
        else:
            assert label["kind"] == "negative"
            assert label["boxes"] == []
            assert label["distance_m"] is None
            assert scene.camera_from_target is None


def test_pictures_are_640x480_jpegs(scenes):
    """Every picture decodes to the size that its label states."""
    for scene in scenes[:10]:
        assert decoded(scene).shape == (scene.height, scene.width) == (480, 640)


def test_the_disc_is_darker_than_the_board_where_the_label_says(scenes):
    """On unhidden targets over 30 px the black ring is darker than both white rings around it."""
    checked = 0
    for scene in scenes:
        if not scene.boxes or scene.boxes[0].visible < 0.95:
            continue
        x0, _, x1, _ = scene.boxes[1].xyxy
        if x1 - x0 < 30:
            continue
        black, inner, outer = (np.median(pixels_of_ring(scene, r)) for r in (0.11, 0.05, 0.175))
        assert black < inner
        assert black < outer
        checked += 1
    assert checked >= 3


def test_labels_bound_the_shapes_of_the_true_pose(scenes):
    """Boxes equal those of densely sampled shapes, projected from the scene's own pose."""
    for scene in (s for s in scenes if s.boxes):
        if "distortion" in scene.conditions:
            continue
        for box in scene.boxes:
            size = TARGET.level_m[box.level]
            if box.level is Level.GOOD:
                yz = [(sy * size / 2, sz * size / 2) for sy in (-1, 1) for sz in (-1, 1)]
            else:
                angle = np.linspace(0, 2 * math.pi, 3600)
                yz = size / 2 * np.column_stack([np.cos(angle), np.sin(angle)])
            p = scene.camera_from_target @ np.column_stack([np.zeros(len(yz)), np.array(yz)])
            u = scene.camera.fx * p[:, 0] / p[:, 2] + scene.camera.cx
            v = scene.camera.fy * p[:, 1] / p[:, 2] + scene.camera.cy
            assert box.xyxy == pytest.approx((u.min(), v.min(), u.max(), v.max()), abs=0.01)


@pytest.mark.parametrize("recipe", list(Recipe))
def test_a_recipe_gives_what_it_is_named_after(recipe):
    """Pictures of a condition carry its name; those of the mix carry any, negatives no box."""
    scenes = [generate((11, index), PROCEDURAL, TARGET, recipe) for index in range(3)]
    for scene in scenes:
        if recipe is Recipe.HARD_NEGATIVES:
            assert not scene.boxes
            assert "lookalike" in scene.conditions
        elif recipe is not Recipe.MIXED:
            assert scene.recipe is recipe
            assert scene.label("x")["recipe"] == recipe.value
    if recipe in ("low_light", "flare", "distortion", "over_exposed", "orientation"):
        assert all(recipe.value in scene.conditions for scene in scenes)


def test_a_plan_of_ones_own_takes_the_place_of_the_recipes():
    """Camera, distance, tilt and light as it says; the name is the caller's."""
    plan = replace(
        PLANS[Recipe.NOMINAL],
        camera=CAMERA,
        distance_m=(1.2, 1.2),
        tilt_deg=(50.0, 65.0),
        whole=True,
        dark=1.0,
        dark_stops=(-3.0, -3.0),
    )
    for index in range(3):
        scene = generate((13, index), PROCEDURAL, TARGET, Recipe.NOMINAL, plan=plan)
        assert scene.recipe is Recipe.NOMINAL
        assert scene.camera == CAMERA
        assert {"low_light", "orientation"} <= set(scene.conditions)
        assert scene.camera_from_target.translation[2] == pytest.approx(1.2)
        assert scene.boxes[0].visible == 1.0


def test_a_plan_of_a_recipe_gives_that_recipes_pictures():
    """The mix aside, whose plan is drawn first: the bytes are the same."""
    for recipe in (Recipe.NOMINAL, Recipe.LOW_LIGHT):
        named = generate((14, 1), PROCEDURAL, TARGET, recipe)
        assert generate((14, 1), PROCEDURAL, TARGET, recipe, plan=PLANS[recipe]).jpeg == named.jpeg


def test_another_board_changes_nothing_but_the_print():
    """Same pose, same light, same labels: that is what makes markers comparable."""

    def grey(side_px, paint):
        return np.broadcast_to((paint.white + paint.black) / 2, (side_px, side_px, 3)).copy()

    ours = generate((12, 1), PROCEDURAL, TARGET, Recipe.NOMINAL)
    other = generate((12, 1), PROCEDURAL, TARGET, Recipe.NOMINAL, grey)
    assert other.label("x") == ours.label("x")
    assert other.jpeg != ours.jpeg


def test_visible_is_the_open_share_inside_the_picture():
    """A target half hidden is half visible, one half outside too, and both multiply."""
    nothing = np.zeros((480, 640), dtype=np.float32)
    right = nothing.copy()
    right[:, 320:] = 1
    middle = facing(np.array([0.0, 0.0, 1.5]), 0.0, 0.0, 0.0)
    for box in label_boxes(TARGET, CAMERA, middle, nothing):
        assert box.visible == pytest.approx(1.0)
    for box in label_boxes(TARGET, CAMERA, middle, right):
        assert box.visible == pytest.approx(0.5, abs=0.01)
    edge = facing(np.array([0.0, -240.0 / 600 * 1.5, 1.5]), 0.0, 0.0, 0.0)
    lower = nothing.copy()
    lower[:, 320:] = 1
    halves = label_boxes(TARGET, CAMERA, edge, nothing)
    quarters = label_boxes(TARGET, CAMERA, edge, lower)
    # the tilt of the line of sight makes the board lean a little
    assert halves[1].visible == pytest.approx(0.5, abs=0.04)
    assert quarters[1].visible == pytest.approx(halves[1].visible / 2, abs=0.01)


def test_a_target_that_cannot_be_seen_has_no_label():
    """Outside the picture, or wholly hidden, there is nothing to learn."""
    everything = np.ones((480, 640), dtype=np.float32)
    outside = facing(np.array([3.0, 0.0, 1.5]), 0.0, 0.0, 0.0)
    middle = facing(np.array([0.0, 0.0, 1.5]), 0.0, 0.0, 0.0)
    assert label_boxes(TARGET, CAMERA, outside, 0 * everything) == ()
    assert label_boxes(TARGET, CAMERA, middle, everything) == ()
