"""Airframe files: what they may say, and one line for what they may not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drone_client.airframe import FLU_FROM_RDF, MAX_AIRFRAME_BYTES, Airframe, load_airframe
from drone_client.cbf import FilterSettings
from drone_client.cbf.keep_out import MAX_KEEP_OUTS, Stance, gaps_m
from drone_client.errors import AirframeError

EXAMPLE = Path(__file__).parents[3] / "examples" / "airframe.toml"


def test_reads_both_poses(tmp_path):
    """Translation and quaternion of the camera and the tip."""
    path = tmp_path / "drone.toml"
    path.write_text(
        "[body_from_camera]\ntranslation_m = [0.1, 0, 0.02]\nq_wxyz = [0, 1, 0, 0]\n"
        "[body_from_tip]\ntranslation_m = [0.7, 0.0, -0.1]\n"
    )
    airframe = load_airframe(path)
    np.testing.assert_allclose(airframe.body_from_camera.translation, (0.1, 0, 0.02))
    np.testing.assert_allclose(airframe.body_from_camera.q_wxyz, (0, 1, 0, 0))
    np.testing.assert_allclose(airframe.body_from_tip.translation, (0.7, 0, -0.1))
    np.testing.assert_allclose(airframe.body_from_tip.q_wxyz, (1, 0, 0, 0))


def test_what_is_left_out_keeps_its_default(tmp_path):
    """An empty file is the default drone."""
    path = tmp_path / "drone.toml"
    path.write_text("")
    airframe, default = load_airframe(path), Airframe()
    np.testing.assert_array_equal(airframe.body_from_camera.matrix, default.body_from_camera.matrix)
    np.testing.assert_array_equal(airframe.body_from_tip.matrix, default.body_from_tip.matrix)


def test_what_is_left_out_is_named(tmp_path):
    """For whoever flies another drone by the default's numbers."""
    path = tmp_path / "drone.toml"
    path.write_text("[body_from_tip]\ntranslation_m = [0.7, 0, 0]")
    assert load_airframe(path).assumed == ("body_from_camera", "part")
    assert load_airframe(EXAMPLE).assumed == Airframe().assumed == ()


SIDE = "normal = [0, 1, 0]\noffset_m = -2"


@pytest.mark.parametrize(
    ("plane", "names"),
    [
        (f"name = 'side'\n{SIDE}", ["wall", "side"]),
        (f"name = 'wall'\n{SIDE}", ["target's wall", "wall"]),
        ("name = 'far'\noffset_m = -3", ["wall", "far"]),
        ("name = 'floor'\nframe = 'world'\nnormal = [1, 0, 0]", ["wall", "floor"]),
        ("name = 'own'\noffset_m = -0.1\nclearance_m = 0.2", ["own"]),
    ],
)
def test_the_wall_of_the_target_is_kept_clear_of_whatever_else_is(tmp_path, plane, names):
    """A side wall in the file does not take it away; a plane that faces as it does is it."""
    path = tmp_path / "drone.toml"
    path.write_text(f"[[keep_out]]\n{plane}")
    found = load_airframe(path).keep_outs
    assert [k.name for k in found] == names
    if len(names) > 1:
        (default,) = Airframe().keep_outs
        assert replace(found[0], name=default.name) == default


def test_the_default_camera_looks_ahead_and_down():
    """Level, the optical axis is the body's x, the picture's right its -y, down its -z."""
    down = Rotation.from_euler("y", 10.0, degrees=True).as_matrix()
    turn = down.T @ Airframe().body_from_camera.rotation
    np.testing.assert_allclose(turn @ (0, 0, 1), (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(turn @ (1, 0, 0), (0, -1, 0), atol=1e-12)
    np.testing.assert_allclose(turn @ (0, 1, 0), (0, 0, -1), atol=1e-12)
    np.testing.assert_allclose(turn, FLU_FROM_RDF, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"[body_from_camera", "Expected"),
        (b"\xff\xfe", "decode"),
        (b"[wings]\nn = 2", "unknown 'wings'; known: body_from_camera"),
        (b'"two\\nlines" = 1', r"unknown 'two\nlines'"),
        (b"body_from_tip = 3", r"[body_from_tip] lacks translation_m"),
        (b"[body_from_tip]\nq_wxyz = [1, 0, 0, 0]", "lacks translation_m"),
        (b"[body_from_tip]\ntranslation_m = [0, 0]", "(3,)"),
        (b"[body_from_tip]\ntranslation_m = [0, 0, nan]", "finite"),
        (b"[body_from_tip]\ntranslation_m = 'far'", "could not convert"),
        (b"[body_from_tip]\ntranslation_m = 1979-05-27", "body_from_tip"),
        (b"[body_from_tip]\ntranslation_m = [550, 0, 0]", "over 5 m"),
        (b"[body_from_tip]\ntranslation_m = [0, 0, 0]\nq_wxyz = [2, 0, 0, 0]", "unit length"),
        (b"[body_from_tip]\ntranslation_m = [0, 0, 0]\nroll = 1", "unknown 'roll'"),
        (b"part = 3", "part must be a list of tables"),
        (b"[[part]]\nname = 'a'\nradius_m = 1", "part 'a': center_body_m = None"),
        (b"[[keep_out]]\nname = 'wall'\nclearance_m = 7", "clearance_m = 7.0 is not in"),
        (b"[[keep_out]]\nname = 'wall'\nparts = ['wing']", "known: body, front left"),
        (b"#" * (MAX_AIRFRAME_BYTES + 1), "over 65536 bytes"),
        (b"x = " + b"[" * 5000, ""),
    ],
)
def test_a_wrong_file_gives_one_line_with_its_name_and_what_is_wrong(tmp_path, text, says):
    """Each mistake is told with the file and the field."""
    path = tmp_path / "drone.toml"
    path.write_bytes(text)
    with pytest.raises(AirframeError) as caught:
        load_airframe(path)
    line = str(caught.value)
    assert line.startswith(f"airframe file {path}: ")
    assert says in line
    assert "\n" not in line


def test_the_example_is_the_default_drone():
    """So that it can be copied and changed."""
    written, default = load_airframe(EXAMPLE), Airframe()
    np.testing.assert_allclose(
        written.body_from_camera.matrix, default.body_from_camera.matrix, atol=1e-12
    )
    np.testing.assert_array_equal(written.body_from_tip.matrix, default.body_from_tip.matrix)
    assert written.keep_outs == default.keep_outs


def test_the_arm_reaches_the_wall_before_the_propellers_do():
    """Pressed to the full depth, with the largest ball that the funnel admits there."""
    drone = Airframe()
    pressed = -FilterSettings().depth_max_m / 2
    tip, arm = (pressed, 0.0, 0.0), (-0.55, 0.0, 0.0)
    turned = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
    stance = Stance(tip, arm, (0.0, 0.0, 1.0), turned)
    (wall,) = drone.keep_outs
    assert len(wall.parts) == 5
    assert min(gaps_m(wall, stance, 0.014)) > 0


def test_floor_and_ceiling_are_planes_of_the_world():
    """Their free sides face each other."""
    drone = Airframe()
    assert drone.floor(0.2).normal == (0.0, 0.0, 1.0)
    assert drone.ceiling(2.5).normal == (0.0, 0.0, -1.0)
    assert drone.ceiling(2.5).offset_m == -2.5
    assert drone.floor(0.2).parts == drone.keep_outs[0].parts


def test_more_planes_than_the_safety_filter_takes_are_told_on_the_ground():
    """And not by an approach that is aborted: floor and ceiling count."""
    (wall,) = Airframe().keep_outs
    drone = replace(Airframe(), keep_outs=(wall,) * (MAX_KEEP_OUTS - 1))
    assert len(drone.planes(0.0, None)) == MAX_KEEP_OUTS
    with pytest.raises(ValueError, match=r"7 planes with wall, .* takes 6: leave out"):
        drone.planes(0.0, 3.0)


def test_a_missing_file_is_told(tmp_path):
    """With its path."""
    with pytest.raises(AirframeError, match=r"nowhere\.toml: No such file"):
        load_airframe(tmp_path / "nowhere.toml")
