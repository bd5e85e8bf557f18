"""The funnel: its gradient, its bounds, and its robust form, a lower bound over the error ball."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_client.cbf import CuspFunnel, Funnel, paper_funnel

coordinates = st.floats(-3, 3)
points = st.tuples(coordinates, coordinates, coordinates)
near_axis = st.tuples(coordinates, st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
deltas = st.floats(0, 0.2)
funnels = st.builds(Funnel, st.floats(0.5, 6), st.floats(0.001, 0.05), st.floats(0, 0.1))


def differences(h, p, step: float) -> np.ndarray:
    """Central differences of ``h`` at ``p``."""
    p, out = np.array(p), []
    for axis in np.eye(3):
        ahead, behind = tuple(p + step * axis), tuple(p - step * axis)
        out.append((h(ahead) - h(behind)) / (2 * step))
    return np.array(out)


@settings(max_examples=500)
@given(funnels, points | near_axis, deltas)
def test_the_gradient_is_that_of_h(funnel, p, delta) -> None:
    """Central differences agree, off the axis and on it, with an error ball and without."""
    numeric = differences(lambda q: funnel.h(q, delta), p, step=funnel.e_m * 1e-3)
    # The third derivative of h is of order a / e^2.5 at most, and it is what differences leave.
    tolerance = 1e-6 * funnel.a / math.sqrt(funnel.e_m) + 1e-6
    np.testing.assert_allclose(funnel.gradient(p, delta), numeric, rtol=0, atol=tolerance)


@given(funnels, points | near_axis, deltas)
def test_the_derivative_by_delta_is_that_of_h(funnel, p, delta) -> None:
    """Central differences in the radius of the error ball agree."""
    step = 1e-3 * (funnel.e_m + delta)
    ahead, behind = funnel.h(p, delta + step), funnel.h(p, delta - step)
    numeric = (ahead - behind) / (2 * step)
    assert funnel.dh_ddelta(p, delta) == pytest.approx(numeric, rel=1e-5)


def test_the_gradient_is_defined_on_the_axis() -> None:
    """On the axis it points straight out, exactly."""
    assert Funnel().gradient((0.1, 0.0, 0.0)) == (1.0, 0.0, 0.0)
    assert Funnel().gradient((0.1, 0.0, 0.0), 0.01) == (1.0, 0.0, 0.0)


@given(funnels, points | near_axis)
def test_the_lateral_gradient_is_bounded(funnel, p) -> None:
    """It is at most (sqrt(2) / 2) 3^(-3/4) a / sqrt(e), about 0.3102 a / sqrt(e)."""
    _, gy, gz = funnel.gradient(p)
    bound = math.sqrt(2) / 2 * 3**-0.75 * funnel.a / math.sqrt(funnel.e_m)
    assert math.hypot(gy, gz) <= bound * (1 + 1e-12)


def test_the_bound_of_the_lateral_gradient_is_reached() -> None:
    """At rho = sqrt(2) e, with the figure 0.3102."""
    funnel = Funnel()
    gradient = funnel.gradient((0.0, math.sqrt(2) * funnel.e_m, 0.0))
    assert -gradient[1] == pytest.approx(0.3102 * funnel.a / math.sqrt(funnel.e_m), rel=1e-4)


def test_the_formula_is_the_smooth_funnel_of_the_docs() -> None:
    """Without an error ball h = x - a ((rho^2+e^2)^(1/4) - (r_c^2+e^2)^(1/4))."""
    x, y, z, a, e, r_c = 0.3, 0.02, -0.03, 3.0, 0.003, 0.02
    expected = x - a * ((y * y + z * z + e * e) ** 0.25 - (r_c * r_c + e * e) ** 0.25)
    assert Funnel(a, e, r_c).h((x, y, z)) == pytest.approx(expected, abs=1e-15)


@given(st.floats(0.001, 3), st.floats(0, 0.05))
def test_without_rounding_it_is_the_robust_cusp(rho, delta) -> None:
    """As e goes to zero h goes to x - delta - a sqrt(rho + delta) + a sqrt(r_c)."""
    funnel = Funnel(3.0, 1e-4, 0.02)
    limit = 0.5 - delta - 3.0 * math.sqrt(rho + delta) + 3.0 * math.sqrt(0.02)
    assert funnel.h((0.5, 0.6 * rho, 0.8 * rho), delta) == pytest.approx(limit, abs=1e-3)


@given(st.floats(0, 0.5), st.floats(0, 2 * math.pi))
def test_the_mouth_is_where_contact_is_allowed(rho, angle) -> None:
    """In the plane of the board h >= 0 exactly within r_c of the centre."""
    funnel = Funnel()
    h = funnel.h((0.0, rho * math.cos(angle), rho * math.sin(angle)))
    assert (h >= 0) == (rho <= funnel.r_c_m) or abs(rho - funnel.r_c_m) < 1e-9


@settings(max_examples=500)
@given(funnels, points | near_axis, deltas, points, st.floats(0, 1))
def test_the_robust_form_bounds_h_over_the_whole_ball(funnel, p, delta, direction, depth) -> None:
    """Wherever in the ball the true tip is, its h is at least the robust one at the estimate."""
    length = math.hypot(*direction)
    unit = np.array(direction) / length if length > 1e-300 else np.zeros(3)
    true_tip = tuple(np.array(p) + depth * delta * unit)
    assert funnel.h(true_tip) >= funnel.h(p, delta) - 1e-12


@settings(max_examples=500)
@given(funnels, points | near_axis, deltas)
def test_the_robust_form_bounds_h_at_the_worst_point(funnel, p, delta) -> None:
    """Also at the points of the ball straight away from the axis and towards the board."""
    rho = math.hypot(p[1], p[2])
    outward = (0.0, p[1] / rho, p[2] / rho) if rho > 0 else (0.0, 1.0, 0.0)
    for direction in (outward, (-1.0, 0.0, 0.0)):
        true_tip = tuple(np.array(p) + delta * np.array(direction))
        assert funnel.h(true_tip) >= funnel.h(p, delta) - 1e-12


@given(funnels, points | near_axis, deltas, deltas)
def test_more_error_is_never_safer(funnel, p, delta, more) -> None:
    """The robust form falls at least as fast as the radius grows, and is h without one."""
    assert funnel.h(p, delta + more) <= funnel.h(p, delta) - more + 1e-12
    assert funnel.h(p, 0.0) == funnel.h(p)


@pytest.mark.parametrize(("x", "largest_mm"), [(0.0, 20.1), (-0.015, 18.7), (-0.025, 17.9)])
def test_how_uncertain_a_contact_may_be(x, largest_mm) -> None:
    """The figures of docs/cbf.md: on the axis, touching and pressing need so small a ball."""
    funnel = Funnel()
    assert funnel.h((x, 0.0, 0.0), (largest_mm - 0.1) * 1e-3) > 0
    assert funnel.h((x, 0.0, 0.0), (largest_mm + 0.1) * 1e-3) < 0


@pytest.mark.parametrize(
    "arguments", [(0.0, 0.003, 0.02), (3.0, 0.0, 0.02), (3.0, 0.003, -1.0), (math.nan, 0.003, 0.02)]
)
def test_a_funnel_that_cannot_be_is_refused(arguments) -> None:
    """A parameter out of bounds is named in one line."""
    with pytest.raises(ValueError, match=r"^Funnel\.\w+ = .* is not in \[.*\]$"):
        Funnel(*arguments)


away_from_the_axis = points.filter(lambda p: math.hypot(p[1], p[2]) > 0.05)


@given(away_from_the_axis)
def test_the_cusp_has_its_true_gradient(p) -> None:
    """With the exponent 3/2 the gradient is that of x - a sqrt(l)."""
    cusp = CuspFunnel()
    np.testing.assert_allclose(cusp.gradient(p), differences(cusp.h, p, 1e-6), atol=1e-6)


@given(away_from_the_axis.filter(lambda p: abs(math.hypot(p[1], p[2]) - 1.0) > 0.05))
def test_the_printed_gradient_is_not_the_gradient_of_h(p) -> None:
    """The paper's exponent 3/4 is off by the factor l^(3/4): too flat near the axis."""
    printed, l = paper_funnel(), math.hypot(p[1], p[2])
    numeric = differences(printed.h, p, 1e-6)
    lateral = np.hypot(*numeric[1:])
    assert np.hypot(*printed.gradient(p)[1:]) == pytest.approx(lateral * l**0.75, rel=1e-5)
    assert abs(np.hypot(*printed.gradient(p)[1:]) / lateral - 1) > 0.03


def test_the_cusp_has_no_gradient_on_the_axis() -> None:
    """There, as the paper says, only x counts."""
    for funnel in (CuspFunnel(), paper_funnel()):
        assert funnel.gradient((0.5, 0.0, 0.0)) == (1.0, 0.0, 0.0)
        assert funnel.dh_ddelta((0.5, 0.0, 0.0), 0.01) == 0.0


def test_the_cusp_is_too_narrow_for_any_real_estimate() -> None:
    """10 cm from the board the paper's set has a radius of 1.1 mm."""
    assert CuspFunnel().h((0.1, 0.00111, 0.0)) >= 0
    assert CuspFunnel().h((0.1, 0.00112, 0.0)) < 0
