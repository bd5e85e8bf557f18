"""The colour camera: light, blur, haze, glare and grain against what they should be by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.chance import stream
from contact_sim.scene import Lamp, Light, Sun
from contact_sim.sensing import d455
from contact_sim.sensing.color import (
    ColorCamera,
    ColorSettings,
    Exposure,
    motion_kernel,
    swept_px,
)
from contact_sim.sensing.renderer import View
from rgbd_wire.geometry import Pose, rotation_from_vector

INTRINSICS = d455().color
HEIGHT, WIDTH = INTRINSICS.height, INTRINSICS.width
CLEAR = Light(level=1.0, haze_per_m=0.0, haze_rgb=(0.5, 0.5, 0.5), dust=0.0, projector=1.0)
PLAIN = ColorSettings(vignette=0.0)
LONGEST = Exposure(PLAIN.longest_exposure_s, 1.0)


def flat(level=128, depth_m=2.0):
    """A view of one colour at one depth."""
    color = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
    return View(color, np.full((HEIGHT, WIDTH), depth_m, np.float32), Pose.identity(), INTRINSICS)


def camera(settings=PLAIN):
    return ColorCamera(INTRINSICS, stream(0, "sensor"), settings)


def light_of(picture):
    """Mean light of a picture, as a share of white."""
    return float(np.square(picture / 255.0).mean())


@given(st.integers(40, 200), st.floats(0.3, 1.0), st.floats(1.0, 3.0))
def test_light_goes_as_exposure_and_gain(level, share, gain):
    """The picture's light is the scene's, times exposure, times gain, where nothing burns out."""
    scene = (level / 255) ** 2
    if scene * share * gain > 0.85:
        return
    exposure = Exposure(PLAIN.longest_exposure_s * share, gain)
    picture = CAMERA.expose(flat(level), CLEAR, exposure, stream(1, "x"))
    assert light_of(picture) == pytest.approx(scene * share * gain, rel=0.03)


CAMERA = camera()


@pytest.mark.parametrize("gain", [1.0, 4.0, 16.0])
def test_grain_is_that_of_electrons(gain):
    """The deviation of light is the root of the electrons that made it, plus the read noise."""
    level = 90
    light = replace(CLEAR, level=1 / gain)
    exposure = Exposure(PLAIN.longest_exposure_s, gain)
    picture = camera().expose(flat(level), light, exposure, stream(2, "x")) / 255.0
    root = level / 255
    shot = 0.5 * math.sqrt(gain / PLAIN.full_well)
    read = PLAIN.read_noise * gain / (2 * root)
    steps = 1 / 255 / math.sqrt(12)
    assert picture.std() == pytest.approx(math.hypot(shot, read, steps), rel=0.05)


def test_a_picture_is_made_of_its_arguments_alone():
    """The same stream gives the same picture, another one another grain."""
    view = flat()
    first, again, other = (
        CAMERA.expose(view, replace(CLEAR, dust=20.0), LONGEST, stream(seed, "pictures"))
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5
    assert (view.color == 128).all()


@given(st.integers(20, 250), st.floats(0.05, 20.0))
def test_the_exposure_comes_to_what_is_wanted_or_to_its_ends(level, brightness):
    """Mean light is as wanted, unless gain is at its most or the shutter at its shortest."""
    light = replace(CLEAR, level=brightness)
    exposure = CAMERA.metered(flat(level), light)
    share = exposure.exposure_s / PLAIN.longest_exposure_s
    mean = (level / 255) ** 2 * brightness * share * exposure.gain
    assert 1.0 <= exposure.gain <= PLAIN.max_gain
    assert 0 < share <= 1.0
    assert exposure.gain == 1.0 or share == 1.0
    if 1.0 < exposure.gain < PLAIN.max_gain or 1e-3 < share < 1.0:
        assert mean == pytest.approx(PLAIN.wanted_light, rel=1e-3)


def test_the_exposure_settles_as_a_first_order_lag():
    """After one time constant, 63 % of the way in stops; in many small steps or in one."""
    dark = replace(CLEAR, level=0.1)
    start = CAMERA.metered(flat(), CLEAR)
    end = CAMERA.metered(flat(), dark)

    def stops(exposure):
        return math.log(exposure.exposure_s * exposure.gain)

    once = CAMERA.metered(flat(), dark, start, PLAIN.settling_s)
    often = start
    for _ in range(10):
        often = CAMERA.metered(flat(), dark, often, PLAIN.settling_s / 10)
    wanted = stops(start) + (1 - math.exp(-1)) * (stops(end) - stops(start))
    assert stops(once) == pytest.approx(wanted, abs=1e-6)
    assert stops(often) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("depth_m", [1.0, 5.0, 30.0, np.inf])
def test_haze_takes_light_and_gives_its_own(depth_m):
    """By the law of Beer and Lambert, from the scene's light to the haze's."""
    light = replace(CLEAR, haze_per_m=0.1, haze_rgb=(0.7, 0.7, 0.7))
    picture = CAMERA.expose(flat(60, depth_m), light, LONGEST, stream(5, "x"))
    through = math.exp(-0.1 * min(depth_m, 200))
    wanted = through * (60 / 255) ** 2 + (1 - through) * 0.49
    red = np.square(picture[..., 0] / 255.0).mean()
    assert red == pytest.approx(wanted, rel=0.05)


def test_corners_are_darker():
    """By the square of the vignette at the corner, and not in the middle."""
    picture = camera(ColorSettings(vignette=0.3)).expose(flat(), CLEAR, LONGEST, stream(6, "x"))
    light = np.square(picture.mean(axis=2) / 255)
    corner, middle = light[:20, :20].mean(), light[230:250, 310:330].mean()
    assert corner / middle == pytest.approx(1 / 1.15**2, rel=0.04)


@given(st.floats(-20, 20), st.floats(-20, 20))
def test_smear_keeps_light_and_place(right, down):
    """The kernel sums to one, lies about its middle, and is as long as the way."""
    kernel = motion_kernel(right, down)
    half = kernel.shape[0] // 2
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    assert kernel.sum() == pytest.approx(1, abs=1e-5)
    assert (kernel * x).sum() == pytest.approx(0, abs=1e-4)
    assert (kernel * y).sum() == pytest.approx(0, abs=1e-4)
    shorter = min(1.0, 24.0 / max(math.hypot(right, down), 1e-9))
    spread = (kernel * (x * x + y * y)).sum()
    line = (right * right + down * down) * shorter**2 / 12
    # spreading each point over four pixels adds up to a quarter of a pixel's square an axis
    assert line - 1e-3 <= spread <= 1.1 * line + 0.55


def test_smear_widens_an_edge_along_the_way_alone():
    """An upright edge is smeared by moving across, not by moving along."""
    view = flat(200)
    view.color[:, : WIDTH // 2] = 20

    def width(swept):
        picture = CAMERA.expose(view, CLEAR, LONGEST, stream(7, "x"), swept)
        profile = np.square(picture.mean(axis=(0, 2)) / 255)
        low, high = profile[:50].mean(), profile[-50:].mean()
        share = (profile - low) / (high - low)
        return int(((share > 0.1) & (share < 0.9)).sum())

    still = width((0.0, 0.0))
    assert width((0.0, 12.0)) == still
    assert width((12.0, 0.0)) >= still + 7


@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(-0.01, 0.01))
def test_a_turn_sweeps_the_picture_the_other_way(pitch, yaw, forward):
    """For small turns by f times the angle; flying ahead leaves the middle where it is."""
    first = Pose.identity()
    turn = rotation_from_vector(np.array([pitch, yaw, 0.0]))
    right, down = swept_px(first, Pose.from_rotation(turn, np.zeros(3)), INTRINSICS, 2.0)
    assert right == pytest.approx(-INTRINSICS.fx * yaw, abs=0.02)
    assert down == pytest.approx(INTRINSICS.fy * pitch, abs=0.02)
    ahead = Pose(np.array([0.0, 0.0, forward]), first.q_wxyz)
    assert swept_px(first, ahead, INTRINSICS, 2.0) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("depth_m", "out", "seen"),
    [(3.0, frozenset(), True), (1.0, frozenset(), False), (3.0, frozenset({"lamp"}), False)],
)
def test_a_lamp_blinds_unless_something_stands_before_it_or_it_is_out(depth_m, out, seen):
    """Its glare is where it projects to, and a veil lies over the rest."""
    place = np.array([0.5, -0.3, 2.0])
    light = replace(CLEAR, lamps=(Lamp("lamp", place, 1.0),))
    view = flat(40, depth_m)
    with_lamp = CAMERA.expose(view, light, LONGEST, stream(8, "x"), lamps_out=out).astype(int)
    without = CAMERA.expose(view, CLEAR, LONGEST, stream(8, "x")).astype(int)
    more = (with_lamp - without).sum(axis=2)
    if not seen:
        assert (more == 0).all()
        return
    u = INTRINSICS.fx * place[0] / place[2] + INTRINSICS.cx
    v = INTRINSICS.fy * place[1] / place[2] + INTRINSICS.cy
    rows, columns = np.nonzero(more > 0.9 * more.max())
    assert abs(columns.mean() - u) < 4
    assert abs(rows.mean() - v) < 4
    assert more.min() >= 0
    assert more.mean() > 0


def test_the_sun_blinds_through_open_sky_alone():
    """Where something stands before it, however far away, it does not."""
    sun = Sun(np.array([0.0, 0.0, 1.0]), 2.0)
    light = replace(CLEAR, sun=sun)
    base = CAMERA.expose(flat(40), CLEAR, LONGEST, stream(9, "x")).mean()
    assert CAMERA.expose(flat(40, 100.0), light, LONGEST, stream(9, "x")).mean() == base
    assert CAMERA.expose(flat(40, np.inf), light, LONGEST, stream(9, "x")).mean() > base + 5


def test_dust_adds_light_in_few_places():
    """Grains are brighter than what is behind, and there are as many as are said."""
    dusty = replace(CLEAR, dust=60.0)
    picture = CAMERA.expose(flat(30), dusty, LONGEST, stream(10, "x")).astype(int)
    clear = CAMERA.expose(flat(30), replace(CLEAR, dust=1e-9), LONGEST, stream(10, "x"))
    brighter = picture.mean(axis=2) > clear.mean() + 8
    assert 0.0005 < brighter.mean() < 0.1


def test_dust_and_haze_are_not_seen_where_all_lamps_are_out():
    """What hangs in the air is lit by the lamps alone; with half of them, half as much."""
    lamps = tuple(Lamp(name, np.array([0.0, 0.0, -1.0]), 1.0) for name in ("a", "b"))
    light = replace(CLEAR, haze_per_m=0.5, dust=60.0, lamps=lamps)
    bare = replace(light, haze_per_m=0.0, dust=0.0)
    view = flat(0)

    def added(*out):
        return light_of(
            CAMERA.expose(view, light, LONGEST, stream(11, "x"), (0, 0), frozenset(out))
        )

    dark = light_of(CAMERA.expose(view, bare, LONGEST, stream(11, "x")))
    assert added("a", "b") == pytest.approx(dark, rel=0.02)
    assert added("a") - dark == pytest.approx(0.5 * (added() - dark), rel=0.05)
    assert added() > 10 * dark
