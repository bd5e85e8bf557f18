"""The real detector and localiser find the board in the simulated worlds, where it truly is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contact_sim.chance import stream
from contact_sim.scene import BOARDS, WORLDS, Scene, Snapshot, build_scene
from contact_sim.sensing import d455
from contact_sim.sensing.color import ColorCamera
from contact_sim.sensing.depth import measured
from contact_sim.sensing.renderer import Renderer
from drone_client.airframe import FLU_FROM_RDF
from edge_service.parts import make_pipeline
from edge_service.settings import EdgeSettings
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose, rotation_from_vector
from rgbd_wire.messages import Outcome

RIG = d455()
SEEDS = range(5)
WITHIN_M = 0.02


@pytest.fixture(scope="module")
def pipeline():
    """The service's own stages with its default weights, on the CPU."""
    return make_pipeline(EdgeSettings(), MonotonicClock())


def level_camera(scene: Scene, away_m: float, aside_m: float) -> Pose:
    """``world_from_camera`` of a level camera so far from the board, which it looks at."""
    board = scene.world_from_target
    place = board @ np.array([away_m, aside_m, 0.0])
    way = board.translation - place
    heading = rotation_from_vector(np.array([0.0, 0.0, math.atan2(way[1], way[0])]))
    return Pose.from_rotation(heading @ FLU_FROM_RDF, place)


def frames(scene: Scene, places: list[Pose]) -> list[RgbdFrame]:
    """What the cameras give at each of the places."""
    model = scene.spec.compile()
    camera = ColorCamera(RIG.color, stream(scene.seed, "color sensor"))
    chance = stream(scene.seed, "pictures")
    taken = []
    with Renderer(model, RIG) as renderer:
        renderer.place(Snapshot(0, model.qpos0.copy()))
        for place in places:
            view = renderer.color(place)
            exposure = camera.metered(view, scene.light)
            color = camera.expose(view, scene.light, exposure, chance)
            depth = renderer.depth(place @ RIG.color_from_depth)
            units = measured(depth, RIG, scene.light, chance)
            taken.append(RgbdFrame(color, units, RIG, 0, place))
    return taken


def off(found: Pose, truth: Pose) -> tuple[float, float]:
    """How far the place is off [m], and the normal [rad]."""
    away = float(np.linalg.norm(found.translation - truth.translation))
    cosine = float(np.clip(found.rotation[:, 0] @ truth.rotation[:, 0], -1.0, 1.0))
    return away, math.acos(cosine)


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_board_is_found_where_it_is(pipeline, world, seed):
    """At 1.5 m from straight ahead within 2 cm and 3 degrees; from 0.7 m within 3 mm."""
    scene = build_scene(world, seed)
    far, near = frames(scene, [level_camera(scene, 1.5, 0.0), level_camera(scene, 0.7, 0.05)])
    for frame, within_m in ((far, WITHIN_M), (near, 0.003)):
        output = pipeline.locate(frame)
        assert output.outcome is Outcome.TARGET, output.reason
        away_m, tilt_rad = off(output.found.world_from_target, scene.world_from_target)
        assert away_m < within_m
        assert math.degrees(tilt_rad) < 3.0


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("board", BOARDS)
def test_a_worn_or_glossy_board_is_found_too(pipeline, world, board):
    """From 2 m and aside, whatever became of the print."""
    scene = build_scene(world, 1, board)
    (frame,) = frames(scene, [level_camera(scene, 2.0, 0.5)])
    output = pipeline.locate(frame)
    assert output.outcome is Outcome.TARGET, output.reason
    assert off(output.found.world_from_target, scene.world_from_target)[0] < WITHIN_M


@pytest.mark.parametrize("world", WORLDS)
def test_nothing_is_found_where_no_board_hangs(pipeline, world):
    """Dials, flanges, drums and lamps are no targets: all round, with the board behind."""
    scene = build_scene(world, 2)
    start = scene.world_from_body.translation
    away = level_camera(scene, 2.0, 0.0).rotation
    turns = [rotation_from_vector(np.array([0, 0, a])) for a in np.radians((90, 150, 210, 270))]
    places = [Pose.from_rotation(turn @ away, start) for turn in turns]
    board = scene.world_from_target.translation
    for frame in frames(scene, places):
        x, _, z = frame.world_from_camera.inverse() @ board
        assert z <= 0 or abs(x / z) > 0.5 * RIG.color.width / RIG.color.fx
        assert pipeline.locate(frame).outcome is not Outcome.TARGET
