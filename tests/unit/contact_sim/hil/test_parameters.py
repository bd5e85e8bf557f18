"""The parameters that a PX4 needs for the simulated drone say what the simulation is."""

from __future__ import annotations

from pathlib import Path

import pytest

from contact_sim.hil.motors import QUARTERS
from contact_sim.scene.drone import MASS_KG, rotor_places
from contact_sim.vehicle.rotors import DRAG_TORQUE_M, MAX_THRUST_N
from drone_client.autopilot.parameters import load_parameter_file, packaged_parameters
from tests.unit.contact_sim.flights import AIRFRAME

FILE = Path(__file__).parents[4] / "examples" / "px4" / "contact-sim.params"


@pytest.fixture(scope="module")
def values() -> dict[str, float]:
    return {name: p.value for name, p in load_parameter_file(FILE).items()}


def test_the_rotors_are_where_the_simulated_ones_are(values):
    """In PX4's order, FRD; those that turn counter-clockwise have a positive torque."""
    places = {(x > 0.0, y > 0.0): (x, y) for x, y, _ in rotor_places(AIRFRAME)}
    for i, quarter in enumerate(QUARTERS):
        x, y = places[quarter]
        assert values[f"CA_ROTOR{i}_PX"] == pytest.approx(x)
        assert values[f"CA_ROTOR{i}_PY"] == pytest.approx(-y)
        assert values[f"CA_ROTOR{i}_KM"] == pytest.approx(DRAG_TORQUE_M * (1 if i < 2 else -1))


def test_the_hover_is_where_the_simulated_one_is(values):
    """Weight over thrust, with the linear curve."""
    assert values["MPC_THR_HOVER"] == pytest.approx(MASS_KG * 9.81 / (4 * MAX_THRUST_N), abs=0.005)
    assert values["THR_MDL_FAC"] == 0.0


def test_nothing_contradicts_the_project_s_own_parameters(values):
    """Both files are loaded, in whatever order."""
    assert values.keys().isdisjoint(packaged_parameters())
