"""Wind: its spread and its eddies are what the settings say, and how it pushes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import welch

from contact_sim.chance import stream
from contact_sim.errors import VehicleError
from contact_sim.vehicle.wind import MAX_WIND_MPS, Wind, WindSettings

DT_S = 0.02
MEAN = (3.0, 4.0, 0.0)


def blown(settings: WindSettings, steps: int, seed: int = 0) -> np.ndarray:
    wind = Wind(settings, stream(seed, "wind"))
    return np.array([wind.step(DT_S) for _ in range(steps)])


def test_gusts_have_the_mean_and_the_spread_of_the_settings():
    """Over an hour: mean, spread along and across, and half of it upright."""
    settings = WindSettings(mean_world=MEAN, gust_share=0.2)
    winds = blown(settings, 180_000)
    along = winds @ [0.6, 0.8, 0.0]
    across = winds @ [-0.8, 0.6, 0.0]
    assert along.mean() == pytest.approx(5.0, abs=0.05)
    assert along.std() == pytest.approx(1.0, rel=0.05)
    assert across.std() == pytest.approx(1.0, rel=0.05)
    assert winds[:, 2].std() == pytest.approx(0.5, rel=0.05)


def test_gusts_have_drydens_spectra():
    """Power over frequency is that of MIL-F-8785C, along and across."""
    settings = WindSettings(mean_world=(5.0, 0.0, 0.0), gust_share=0.2, length_m=10.0)
    winds = blown(settings, 400_000, seed=3)
    for axis, shape in (
        (0, lambda w: 2.0 / (1.0 + w**2)),
        (1, lambda w: (1.0 + 3.0 * w**2) / (1.0 + w**2) ** 2),
    ):
        f_hz, power = welch(winds[:, axis], fs=1.0 / DT_S, nperseg=8192)
        band = (f_hz > 0.02) & (f_hz < 2.0)
        scaled = 2.0 * math.pi * f_hz[band] * 10.0 / 5.0
        # one-sided in Hz: sigma^2 2 L/V times the shape
        expected = 1.0**2 * 2.0 * 10.0 / 5.0 * shape(scaled)
        ratio = power[band] / expected
        assert 0.9 < np.median(ratio) < 1.1
        assert np.quantile(ratio, 0.05) > 0.6
        assert np.quantile(ratio, 0.95) < 1.5


def test_no_wind_is_still():
    """Without a mean there are no gusts either."""
    assert not blown(WindSettings(), 100).any()


def test_a_gust_comes_goes_and_is_over():
    """It is strongest in its middle and nothing is left after it."""
    wind = Wind(WindSettings(), stream(0, "wind"))
    wind.gust((0.0, 6.0, 0.0), 2.0)
    speeds = np.array([wind.step(DT_S)[1] for _ in range(150)])
    assert speeds.max() == pytest.approx(6.0, abs=0.01)
    assert np.argmax(speeds) == pytest.approx(49, abs=1)
    assert not speeds[100:].any()


def test_five_metres_a_second_take_a_tilt_of_five_degrees():
    """The drag of a quadrotor of this weight; it grows faster than the wind."""
    wind = Wind(WindSettings(), stream(0, "wind"))
    still = (0.0, 0.0, 0.0)
    force = wind.drag((5.0, 0.0, 0.0), still)
    assert math.degrees(math.atan(force[0] / (3.3 * 9.81))) == pytest.approx(5.3, abs=0.3)
    assert wind.drag((10.0, 0.0, 0.0), still)[0] > 2.5 * force[0]
    assert wind.drag((5.0, 0.0, 0.0), (5.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert wind.drag(still, (0.0, 2.0, 0.0))[1] < 0.0


def test_bad_winds_are_refused():
    """A storm, or a gust of no time, says what there may be."""
    with pytest.raises(ValueError, match="mean_world"):
        WindSettings(mean_world=(30.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="gust_share"):
        WindSettings(gust_share=float("nan"))
    wind = Wind(WindSettings(), stream(0, "wind"))
    for velocity, seconds in (((50.0, 0.0, 0.0), 1.0), ((1.0, 0.0, 0.0), 0.0)):
        with pytest.raises(VehicleError, match="a gust has at most"):
            wind.gust(velocity, seconds)


def test_the_strongest_gust_blows_from_anywhere():
    """20 m/s scaled to any direction may have a last digit more, which refuses no flight."""
    wind, longest = Wind(WindSettings(), stream(0, "wind")), 0.0
    for x, y, z in stream(0, "directions").standard_normal((500, 3)).tolist():
        scale = MAX_WIND_MPS / math.hypot(x, y, z)
        velocity = scale * x, scale * y, scale * z
        longest = max(longest, math.hypot(*velocity))
        wind.gust(velocity, 1.0)
    assert longest > MAX_WIND_MPS
