"""What a flight truly came to: seen by a witness that does not ask the client."""

from __future__ import annotations

import json
import math

import pytest

from contact_sim.contacts import BOARD
from contact_sim.flight.outcome import Witness
from drone_client.mission import Phase
from tests.unit.contact_sim.flights import BOARD as WORLD_FROM_TARGET
from tests.unit.contact_sim.flights import BOARD_X_M, HEIGHT_M, REACH_M, Pilot, simulation

TURN_S = 0.004
ON_THE_FLOOR_M = 0.02
"""Height of a body whose lowest part is in the floor."""


def watched(sim, seconds: float, witness: Witness | None = None) -> Witness:
    witness = witness or Witness(WORLD_FROM_TARGET)
    for _ in range(round(seconds / TURN_S)):
        sim.step(2)
        witness.look(sim)
    return witness


def test_a_flight_without_a_touch_has_none() -> None:
    """It hovers, 3 m away: everything that needs a touch is not known."""
    sim = simulation()
    outcome = watched(sim, 0.5).outcome(sim, TURN_S)
    assert not outcome.touched
    assert (outcome.offset_m, outcome.closing_mps, outcome.press_force_n) == (None, None, None)
    assert (outcome.peak_force_n, outcome.outside_m, outcome.collisions) == (0.0, 0.0, ())
    assert outcome.nearest_m == pytest.approx(BOARD_X_M - REACH_M, abs=0.05)
    assert outcome.flown_s == 0.5


def test_a_push_beside_the_mouth_is_one() -> None:
    """Flown into the board 10 cm beside the centre: the place, the speed and the depth are told."""
    sim = simulation(start=(BOARD_X_M - REACH_M - 0.1, 0.1, HEIGHT_M))
    sim.set_velocity((0.08, 0.0, 0.0), 0.0)
    wider = Witness(WORLD_FROM_TARGET, mouth_m=0.2)
    witness = Witness(WORLD_FROM_TARGET)
    for _ in range(round(4.0 / TURN_S)):
        sim.step(2)
        witness.look(sim)
        wider.look(sim)
    outcome = witness.outcome(sim, TURN_S)
    assert outcome.touched
    assert outcome.offset_m == pytest.approx(0.1, abs=0.03)
    assert wider.outcome(sim, TURN_S).safe  # a funnel that is tuned so lets it touch there
    assert outcome.touch_target_m[0] == pytest.approx(-0.1, abs=0.03)  # the board's left is -y
    assert outcome.closing_mps == pytest.approx(0.08, abs=0.04)
    assert outcome.outside_m > 0.002
    assert outcome.peak_force_n >= outcome.press_force_n > 0.0
    assert 0.0 < outcome.pressed_s < 4.0
    assert outcome.collisions == ()
    json.dumps(outcome.as_json(), allow_nan=False)


def test_a_propeller_at_the_wall_is_a_collision() -> None:
    """Sideways into the board: what touched what is named."""
    sim = simulation(start=(BOARD_X_M - 0.55, 0.0, HEIGHT_M), turned_rad=math.pi / 2)
    sim.set_velocity((0.3, 0.0, 0.0), 0.0)
    outcome = watched(sim, 2.0).outcome(sim, TURN_S)
    assert any("propeller" in c and c.endswith(f"on {BOARD}") for c in outcome.collisions)


def test_the_clients_contact_is_the_witnesses_too() -> None:
    """Flown by the real mission and filter: in the mouth, gently, nothing else touched."""
    sim = simulation(start=(1.2, 0.1, HEIGHT_M), turned_rad=0.1)
    witness = Witness(WORLD_FROM_TARGET)
    step = sim.step

    def step_and_look(n: int = 1) -> None:
        for _ in range(n // 2):
            step(2)
            witness.look(sim)

    sim.step = step_and_look  # type: ignore[method-assign]
    pilot = Pilot(sim).fly(40.0)
    assert pilot.mission.phase is Phase.DONE
    outcome = witness.outcome(sim, TURN_S)
    assert outcome.touched
    assert outcome.offset_m < 0.02
    assert outcome.closing_mps < 0.06
    assert outcome.outside_m == 0.0
    assert outcome.collisions == ()
    assert outcome.end_m > 0.8
    assert len(witness.rows) == pytest.approx(outcome.flown_s / 0.02, rel=0.05)
    assert max(abs(row.yaw_error_rad) for row in witness.rows[-100:]) < 0.05


def test_the_ground_that_it_rises_from_is_no_collision_and_the_one_it_falls_on_is() -> None:
    """It is put down with its feet on the floor, rises, and is flown into the floor again."""
    sim, witness = simulation(start=(1.0, 0.0, ON_THE_FLOOR_M)), Witness(WORLD_FROM_TARGET)
    watched(sim, 0.02, witness)
    assert sim.truth.touches
    sim.set_velocity((0.0, 0.0, 0.5), 0.0)
    watched(sim, 2.0, witness)
    assert not sim.truth.touches
    assert witness.outcome(sim, TURN_S).collisions == ()
    sim.set_velocity((0.0, 0.0, -0.5), 0.0)
    watched(sim, 3.0, witness)
    assert any(c.endswith(" on floor") for c in witness.outcome(sim, TURN_S).collisions)


def test_a_touch_between_two_looks_is_seen() -> None:
    """Down to the floor and up again while nobody looks: nothing touches now, and it counts."""
    sim, witness = simulation(start=(1.0, 0.0, HEIGHT_M)), Witness(WORLD_FROM_TARGET)
    watched(sim, 0.5, witness)
    sim.set_velocity((0.0, 0.0, -0.5), 0.0)
    while not sim.contacts.touches:
        sim.step(1)
    (part, other) = sim.contacts.touches[0][:2]
    sim.set_velocity((0.0, 0.0, 0.5), 0.0)
    sim.step(500)
    assert not sim.truth.touches
    witness.look(sim)
    collisions = witness.outcome(sim, TURN_S).collisions
    assert f"{part} on {other}" in collisions
    assert other == "floor"
    watched(sim, 0.5, witness)
    assert witness.outcome(sim, TURN_S).collisions == collisions


def test_the_end_is_told_when_the_track_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    """And so is the fastest touch when no impact is kept any more."""
    monkeypatch.setattr("contact_sim.flight.outcome.MAX_TRACK", 3)
    monkeypatch.setattr("contact_sim.contacts.KEPT_IMPACTS", 0)
    sim = simulation(start=(BOARD_X_M - REACH_M - 0.1, 0.0, HEIGHT_M))
    sim.set_velocity((0.08, 0.0, 0.0), 0.0)
    witness = watched(sim, 4.0)
    outcome = witness.outcome(sim, TURN_S)
    assert (len(witness.rows), sim.contacts.impacts) == (3, [])
    assert outcome.end_m < 0.05 < witness.rows[-1].tip_target[0]
    assert outcome.closing_mps == pytest.approx(0.08, abs=0.04)


def test_the_body_on_the_board_is_no_touch_of_the_tip() -> None:
    """Sideways into the board with a propeller: nothing is said of where the tip touched."""
    sim = simulation(start=(BOARD_X_M - 0.55, 0.0, HEIGHT_M), turned_rad=math.pi / 2)
    sim.set_velocity((0.3, 0.0, 0.0), 0.0)
    outcome = watched(sim, 2.0).outcome(sim, TURN_S)
    assert not outcome.touched
    assert outcome.offset_m is None
