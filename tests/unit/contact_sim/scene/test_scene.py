"""Worlds as a whole: the same for a seed, and with room to fly to the board and touch it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contact_sim.errors import WorldError
from contact_sim.scene import BOARDS, WORLDS, build_scene
from target_pose.target import load_target
from tests.unit.contact_sim.scene.rays import Rays

SIDE_M = load_target().board_side_m
BODY_FROM_BOARD_M = 0.55
"""The drone's middle when its tip touches."""
ROOM_M = 0.42
"""Body and propellers reach no further."""
SEEDS = range(6)


class World(Rays):
    """A scene and what rays find in it."""

    def __init__(self, world, seed, board="clean"):
        self.scene = build_scene(world, seed, board)
        super().__init__(self.scene.spec)


@pytest.fixture(scope="module")
def worlds():
    """Every world of a few seeds, built once."""
    return {(name, seed): World(name, seed) for name in WORLDS for seed in SEEDS}


each = pytest.mark.parametrize(("name", "seed"), [(w, s) for w in WORLDS for s in SEEDS])


@pytest.mark.parametrize("name", WORLDS)
def test_a_seed_is_one_world(name):
    """Built twice, shapes, textures, light and places are the same to the bit."""
    first, again = World(name, 7), World(name, 7)
    for field in ("mesh_vert", "mesh_texcoord", "tex_data", "geom_pos", "geom_quat", "light_pos"):
        np.testing.assert_array_equal(getattr(first.model, field), getattr(again.model, field))
    assert first.scene.facts == again.scene.facts
    for place in ("world_from_target", "world_from_body"):
        one, two = getattr(first.scene, place), getattr(again.scene, place)
        np.testing.assert_array_equal(one.matrix, two.matrix)


@pytest.mark.parametrize("name", WORLDS)
def test_bare_of_its_textures_a_world_is_the_same(name):
    """Shapes, places and names of what is stepped are those of what is drawn."""
    scene = build_scene(name, 3)
    bare, drawn = scene.bare.compile(), scene.spec.compile()
    assert len(drawn.tex_data) > len(bare.tex_data)
    for field in ("mesh_vert", "geom_pos", "geom_quat", "geom_matid", "geom_contype", "light_pos"):
        np.testing.assert_array_equal(getattr(bare, field), getattr(drawn, field))


@pytest.mark.parametrize("name", WORLDS)
def test_the_print_changes_nothing_else(name):
    """Clean, scratched and glossy boards hang in the same place of the same world."""
    clean, *others = (build_scene(name, 3, board) for board in BOARDS)
    for other in others:
        assert other.facts["board"] != clean.facts["board"]
        assert other.facts == {**clean.facts, "board": other.facts["board"]}
        np.testing.assert_array_equal(
            other.world_from_target.matrix, clean.world_from_target.matrix
        )


def test_seeds_differ(worlds):
    """No two seeds have the same place of the board."""
    places = {tuple(w.scene.world_from_target.translation) for w in worlds.values()}
    assert len(places) == len(worlds)


@each
def test_the_start_looks_on_the_board_over_free_air(worlds, name, seed):
    """2 to 3.5 m before it, on its front side, at most 60 degrees off, and nothing in between."""
    world = worlds[name, seed]
    target, body = world.scene.world_from_target, world.scene.world_from_body
    way = target.translation - body.translation
    ahead = body.rotation[:, 0]
    assert 1.98 <= np.linalg.norm(way[:2]) <= 3.52
    assert (target.inverse() @ body.translation)[0] > 1.5
    off = math.atan2(ahead[0] * way[1] - ahead[1] * way[0], ahead[:2] @ way[:2])
    assert abs(math.degrees(off)) <= 60.5
    far, hit = world.ray(body.translation, way)
    assert hit in ("print", "board")
    assert far == pytest.approx(np.linalg.norm(way), abs=1e-3)


@each
def test_the_way_to_the_board_has_room_for_the_drone(worlds, name, seed):
    """Along the whole way, nothing comes as near as the propellers reach."""
    world = worlds[name, seed]
    target = world.scene.world_from_target
    end = target @ np.array([BODY_FROM_BOARD_M, 0.0, 0.0])
    before = target @ np.array([1.2, 0.0, 0.0])
    start = world.scene.world_from_body.translation
    way = [*np.linspace(start, before, 5), *np.linspace(before, end, 4)]
    directions = [
        (math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e))
        for a in np.linspace(-math.pi, math.pi, 16, endpoint=False)
        for e in (-0.9, -0.3, 0.0, 0.3, 0.9)
    ]
    nearest = min(world.ray(place, d)[0] for place in way for d in directions)
    assert nearest > ROOM_M


@each
def test_nothing_beside_the_board_stands_before_its_plane(worlds, name, seed):
    """A propeller that comes level with the board's edge meets no wall."""
    world = worlds[name, seed]
    target = world.scene.world_from_target
    for z in (-0.15, 0.0, 0.15):
        start = target @ np.array([0.01, 0.0, z])
        for side in (-1.0, 1.0):
            far, hit = world.ray(start, side * target.rotation[:, 1])
            assert far > 0.5, f"{hit} stands {far:.2f} m beside the middle of the board"


@each
def test_the_board_is_where_the_scene_says(worlds, name, seed):
    """Rays find its face on the plane x = 0, to a third of a millimetre, up to its edges."""
    world = worlds[name, seed]
    target = world.scene.world_from_target
    edge = 0.49 * SIDE_M
    for y, z in ((0, 0), (edge, edge), (-edge, edge), (edge, -edge), (-edge, -edge)):
        far, hit = world.ray(target @ np.array([0.3, y, z]), -target.rotation[:, 0])
        assert hit in ("print", "board")
        assert far == pytest.approx(0.3, abs=3e-4)
    outside = target @ np.array([0.3, 0.52 * SIDE_M, 0.0])
    assert world.ray(outside, -target.rotation[:, 0])[1] not in ("print", "board")


@each
def test_the_board_hangs_upright(worlds, name, seed):
    """Its z is up but for a lean of 5 degrees and a roll."""
    turn = worlds[name, seed].scene.world_from_target.rotation
    assert turn[2, 2] > math.cos(math.radians(7))
    assert abs(math.degrees(math.asin(turn[2, 0]))) < 5.5


@each
def test_floor_and_ceiling_hold_along_the_way(worlds, name, seed):
    """The floor is not above what is said, and what is said not far above it; the ceiling so."""
    world = worlds[name, seed]
    target, body = world.scene.world_from_target, world.scene.world_from_body
    end = target @ np.array([BODY_FROM_BOARD_M, 0.0, 0.0])
    for place in np.linspace(body.translation, end, 5):
        floor = place[2] - world.ray(place, (0, 0, -1))[0]
        assert world.scene.floor_m - 0.25 < floor < world.scene.floor_m + 0.02
        above = world.ray(place, (0, 0, 1))[0] + place[2]
        if world.scene.ceiling_m is not None:
            assert above > world.scene.ceiling_m
            assert world.scene.ceiling_m > place[2] + ROOM_M


@each
def test_lamps_are_lights_and_things_that_glow(worlds, name, seed):
    """What may go out has a light and a geom of its name; a refinery has the sun alone."""
    world = worlds[name, seed]
    for lamp in world.scene.lamps:
        assert world.model.light(lamp).active[0]
        assert world.model.geom(lamp).group[0] == 0
    seen = [lamp.name for lamp in world.scene.light.lamps]
    assert seen == list(world.scene.lamps)
    assert (name == "tunnel") == bool(seen) == (world.scene.light.sun is None)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("cave", 0), "no world 'cave'; there are: tunnel, refinery"),
        (("tunnel", 0, "wet"), "no board 'wet'; there are: clean, scratched, glossy"),
        (("tunnel", -1), "a seed is a whole number from 0"),
    ],
)
def test_what_there_is_not_is_refused_with_what_there_is(arguments, words):
    """The error names the value and the choices."""
    with pytest.raises(WorldError, match=words):
        build_scene(*arguments)
