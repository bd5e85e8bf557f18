"""The compliant arm: its closed form against SciPy's integration, and what a board does to it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from drone_client.mission.arm import AT_REST, Arm, Base, Deflection

ARM = Arm()
arms = st.builds(
    Arm,
    mass_kg=st.floats(0.02, 1),
    damping_nspm=st.floats(0.5, 60),
    stiffness_npm=st.floats(50, 2e3),
)


def integrated(arm: Arm, start: Deflection, base_mps2: float, t_s: float) -> np.ndarray:
    """The same equation of motion, by an integrator that knows no closed form."""

    def motion(_, state):
        d, v = state
        return v, base_mps2 - (arm.damping_nspm * v + arm.stiffness_npm * d) / arm.mass_kg

    return solve_ivp(motion, (0, t_s), start, rtol=1e-10, atol=1e-13, method="DOP853").y[:, -1]


@given(arms, st.floats(-0.04, 0.04), st.floats(-1, 1), st.floats(-5, 5), st.floats(0, 0.3))
def test_the_free_arm_is_what_an_integrator_says(arm, d, v, base, t_s) -> None:
    """Swinging, creeping and in between; any start, any acceleration of its root."""
    found = arm.free(Deflection(d, v), base, t_s)
    np.testing.assert_allclose(found, integrated(arm, Deflection(d, v), base, t_s), atol=1e-7)


@pytest.mark.parametrize("ratio", [0.5, 0.999999, 1.0, 1.000001, 3.0])
def test_around_critical_damping_nothing_breaks(ratio) -> None:
    """Where both roots meet, the two forms of the solution meet as well."""
    damping = 2 * ratio * math.sqrt(ARM.stiffness_npm * ARM.mass_kg)
    arm = Arm(damping_nspm=damping)
    found = arm.free(Deflection(0.02, -0.1), 1.0, 0.07)
    np.testing.assert_allclose(found, integrated(arm, Deflection(0.02, -0.1), 1.0, 0.07), atol=1e-9)


@given(arms, st.floats(0.0, 0.1), st.floats(0.0, 0.1))
def test_two_steps_are_one(arm, first_s, second_s) -> None:
    """The closed form is exact, so the length of a tick does not matter."""
    start = Deflection(0.03, 0.2)
    once = arm.free(start, 0.5, first_s + second_s)
    np.testing.assert_allclose(
        arm.free(arm.free(start, 0.5, first_s), 0.5, second_s), once, atol=1e-9
    )


@given(arms, st.floats(0.01, 0.3))
def test_a_swing_has_settled_when_it_should(arm, share) -> None:
    """Let go at rest, less than the share is left from then on."""
    settle_s = arm.settle_s(share)
    assume(settle_s < 20)
    left = [abs(arm.free(Deflection(0.01, 0.0), 0.0, settle_s * k).d_m) for k in (1, 1.1, 1.5, 3)]
    assert max(left) <= share * 0.01 + 1e-12


def test_at_rest_the_force_is_the_springs() -> None:
    """300 N/m pressed by 25 mm push 7.5 N; a board does not pull; the travel is the end."""
    assert ARM.static_force_n(0.025) == pytest.approx(7.5)
    assert ARM.static_depth_m(7.5) == pytest.approx(0.025)
    assert (ARM.static_force_n(-0.01), ARM.static_depth_m(-3)) == (0.0, 0.0)
    assert ARM.static_force_n(1.0) == pytest.approx(300 * ARM.travel_m)
    assert ARM.static_depth_m(1e6) == ARM.travel_m
    assert ARM.force_n(Deflection(0.025, 0.0)) == pytest.approx(7.5)
    assert ARM.force_n(Deflection(0.01, 0.1), 2.0) == pytest.approx(0.3 + 1.2 + 3.0)
    assert ARM.force_n(Deflection(-0.01, -0.1)) == 0.0


def test_an_accelerated_root_bends_the_arm_by_its_own_mass() -> None:
    """Held long enough, the deflection is M a / K."""
    found = ARM.free(AT_REST, 2.0, 5.0)
    assert found.d_m == pytest.approx(ARM.mass_kg * 2.0 / ARM.stiffness_npm)
    assert found.rate_mps == pytest.approx(0.0, abs=1e-12)


def test_a_board_stops_the_tip_and_lets_it_go() -> None:
    """Pressed, the tip is in the plane; pulled away at once it follows as the spring can."""
    state = AT_REST
    for depth_m in np.linspace(-0.02, 0.02, 81):
        state = ARM.touched(state, Base(float(depth_m), 0.1, 0.0), 0.005)
        assert state.d_m == pytest.approx(max(depth_m, 0.0), abs=1e-12)
    gone = ARM.touched(state, Base(-0.05, -1.0, 0.0), 0.005)
    assert gone == ARM.free(state, 0.0, 0.005)
    assert 0.0 < gone.d_m < 0.02


@pytest.mark.parametrize("name", list(Arm.__dataclass_fields__))
@pytest.mark.parametrize("value", [-1.0, 0.0, 1e9, math.nan])
def test_every_number_is_bounded(name, value) -> None:
    """The message names it and its range."""
    with pytest.raises(ValueError, match=rf"^Arm\.{name} = .* is not in \["):
        Arm(**{name: value})
