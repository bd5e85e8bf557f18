"""The stereo pair: its lattice, its noise, its shadows, and where it sees nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.chance import stream
from contact_sim.errors import RenderError
from contact_sim.scene import Light
from contact_sim.sensing import BASELINE_M, d455
from contact_sim.sensing.depth import DepthSettings, measured, unseen_by_right_eye
from contact_sim.sensing.renderer import View
from rgbd_wire.geometry import Pose

RIG = d455()
H, W = RIG.depth.height, RIG.depth.width
INDOORS = Light(level=0.5, haze_per_m=0.0, haze_rgb=(0.2, 0.2, 0.2), dust=0.0, projector=1.0)
OUTDOORS = replace(INDOORS, projector=0.0)
EXACT = DepthSettings(scale_error=0.0, patchy=0.0)


def wall(depth_m, rough=40.0, seed=0):
    """A view of something with so much texture, at depths that broadcast to (h, w)."""
    level = 110 + rough * stream(seed, "wall").standard_normal((H, W))
    color = np.repeat(np.clip(level, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    depth = np.broadcast_to(np.asarray(depth_m, np.float32), (H, W)).copy()
    return View(color, depth, Pose.identity(), RIG.depth)


def seen(view, light=INDOORS, settings=EXACT, seed=1):
    """Measured depth (h, w) [m]; NaN: none."""
    units = measured(view, RIG, light, stream(seed, "depth"), settings)
    return np.where(units > 0, units * RIG.depth_scale_m, np.nan)


@given(st.floats(0.45, 12.0), st.integers(0, 1000))
def test_every_value_is_on_the_lattice_of_a_stereo_pair(depth_m, seed):
    """A / n for a whole n, rounded to units: what the rank code of the link relies on."""
    units = measured(wall(depth_m), RIG, INDOORS, stream(seed, "depth"))
    values = np.unique(units[units > 0]).astype(float)
    a = RIG.depth_lattice_m / RIG.depth_scale_m
    # the whole numbers whose value rounds to this one lie between these two
    assert (np.floor(a / (values - 0.5)) > a / (values + 0.5) - 1e-9).all()
    n = np.arange(1, 4000)
    assert set(values) <= set(np.rint(a / n))


@pytest.mark.parametrize("depth_m", [0.6, 1.0, 2.0, 4.0])
def test_noise_grows_with_the_square_of_depth(depth_m):
    """The deviation is z^2 / (f b) x sigma of disparity, as DESIGN has it: 2.5 mm at 1 m."""
    z = seen(wall(depth_m))
    sigma = np.nanstd(z)
    steps = 1 / 32 / np.sqrt(12)
    wanted = depth_m**2 / (RIG.depth.fx * BASELINE_M) * np.hypot(EXACT.sigma_px, steps)
    assert sigma == pytest.approx(wanted, rel=0.2)
    assert np.nanmean(z) == pytest.approx(depth_m, abs=3 * wanted / np.sqrt(1000) + 1e-3)


def test_a_worn_calibration_makes_all_depths_too_long():
    """By its share, everywhere."""
    worn = replace(EXACT, scale_error=0.01)
    assert np.nanmean(seen(wall(1.5), settings=worn)) == pytest.approx(1.515, abs=2e-3)


@pytest.mark.parametrize("depth_m", [0.1, 0.39, np.inf])
def test_too_near_and_the_sky_have_no_depth(depth_m):
    """There is none past the search of disparities, and none without end."""
    assert np.isnan(seen(wall(depth_m))).all()


def test_near_enough_has_depth_nearly_everywhere():
    """But for the strip at the left, which the right eye does not see."""
    z = seen(wall(1.0))
    strip = int(np.ceil(RIG.depth.fx * BASELINE_M)) + 1
    assert np.isnan(z[:, : strip - 2]).all()
    assert np.isfinite(z[:, strip:]).mean() > 0.99


def test_a_near_thing_casts_a_shadow_to_its_left():
    """As wide as the difference of disparities; nothing is lost to its right."""
    depth = np.full(W, 3.0)
    depth[200:260] = 1.0
    z = seen(wall(depth[None, :]))
    lost = np.isnan(z).mean(axis=0)
    wide = RIG.depth.fx * BASELINE_M * (1 / 1.0 - 1 / 3.0)
    shadow = slice(200 - round(wide) + 1, 199)
    assert (lost[shadow] > 0.95).all()
    assert (lost[200 - round(wide) - 12 : 200 - round(wide) - 2] < 0.1).all()
    assert (lost[262:290] < 0.1).all()


@given(st.integers(0, 10_000))
def test_shadows_are_those_of_a_search_through_all_columns(seed):
    """The running minimum says the same as looking at every pair of columns."""
    rng = np.random.default_rng(seed)
    disparity = rng.choice([2.0, 5.5, 9.25], size=(1, 40))
    landing = np.arange(40) - disparity[0]
    slow = [landing[u] < 0 or any(landing[u + 1 :] <= landing[u]) for u in range(40)]
    assert unseen_by_right_eye(disparity)[0].tolist() == slow


def test_without_texture_only_the_projector_helps():
    """A blank wall has depth indoors, and none in the sun that drowns the pattern."""
    blank = wall(1.2, rough=0.0)
    inside, outside = seen(blank), seen(blank, OUTDOORS)
    assert np.isfinite(inside[:, 30:]).mean() > 0.95
    assert np.isfinite(outside).mean() < 0.02
    assert np.isfinite(seen(wall(1.2), OUTDOORS)[:, 30:]).mean() > 0.95


def test_the_pattern_fades_with_distance():
    """A blank wall far away has no depth, even indoors."""
    assert np.isfinite(seen(wall(9.0, rough=0.0))).mean() < 0.05


def test_what_is_burnt_out_has_no_depth():
    """A patch far brighter than the rest is white to the eye, whatever the pattern."""
    view = wall(1.2, rough=10.0)
    view.color[80:160, 200:300] = 255
    view.color[view.color < 200] //= 2
    z = seen(view)
    assert np.isnan(z[90:150, 210:290]).mean() > 0.95
    assert np.isfinite(z[:60, 40:]).mean() > 0.9


def test_patches_are_lost_anyhow():
    """About their share, and in patches: a lost pixel's neighbour mostly is lost too."""
    lost = np.isnan(seen(wall(1.0), settings=replace(EXACT, patchy=0.08)))[:, 40:]
    assert lost.mean() == pytest.approx(0.08, abs=0.03)
    assert lost[:, 1:][lost[:, :-1]].mean() > 0.7


def test_a_measurement_is_made_of_its_arguments_alone():
    """The same stream, the same depth; the view stays as it was."""
    view = wall(1.5)
    before = view.depth_m.copy()
    np.testing.assert_array_equal(seen(view), seen(view))
    assert (seen(view, seed=2)[:, 40:] != seen(view)[:, 40:]).mean() > 0.3
    np.testing.assert_array_equal(view.depth_m, before)


def test_a_rig_without_a_lattice_is_refused():
    """Its depth comes from no stereo pair; the error says what to give."""
    with pytest.raises(RenderError, match="give fx x baseline x 32"):
        measured(wall(1.0), replace(RIG, depth_lattice_m=0.0), INDOORS, stream(0, "x"))
