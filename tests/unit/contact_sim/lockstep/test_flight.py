"""Whole flights in lockstep: the client's own parts around a simulated worker and world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contact_sim.lockstep.flight import LockstepFlight, LockstepSettings
from drone_client.mission import Phase, Reason
from link_emulator.profiles import PROFILES
from tests.unit.contact_sim.flights import lockstep_flight


@pytest.fixture(scope="module")
def plain():
    return lockstep_flight().fly()


def test_it_touches_the_middle_and_comes_back(plain) -> None:
    """Through gate, filters and mission; every answer that came in time was accepted."""
    assert (plain.phase, plain.reason, plain.attempts) == (Phase.DONE, Reason.BACK, 1)
    assert plain.outcome.offset_m < 0.02
    assert plain.outcome.closing_mps < 0.06
    assert plain.outcome.safe
    assert plain.verdicts["accepted"] > 100
    assert set(plain.verdicts) <= {"accepted", "too_old", "network_delay"}
    assert plain.counts["target"] > 0.8 * plain.counts["sent"]
    assert [t.after for t in plain.transitions][-3:] == [Phase.CONTACT, Phase.RETREAT, Phase.DONE]
    delays = [t.network_delay_ns for t in plain.ticks if t.network_delay_ns is not None]
    assert 4e6 < np.median(delays) < 40e6  # wifi's 2 ms each way, jitter, and 60 kB at 40 Mbit/s


def test_the_same_seed_is_the_same_flight_to_the_last_bit(plain) -> None:
    """And another one is another."""
    again = lockstep_flight().fly()
    assert again.rows == plain.rows
    assert again.outcome == plain.outcome
    assert again.verdicts == plain.verdicts
    assert lockstep_flight(seed=1).fly().rows[:200] != plain.rows[:200]


def test_a_worker_that_dies_in_the_approach_ends_in_a_retreat() -> None:
    """What is known grows old: hold, brake, back; nothing is touched."""
    killed = []

    def before(f: LockstepFlight) -> None:
        near = f.tip_distance_m is not None and f.tip_distance_m < 0.3
        if f.phase is Phase.APPROACH and near and not killed:
            killed.append(f.simulation.t_ns)
            f.worker.kill(f.simulation.t_ns)

    quick = LockstepSettings(longest_s=25.0)
    flown = lockstep_flight(settings=quick).fly(before)
    assert killed
    phases = [t.after for t in flown.transitions]
    assert Phase.BRAKE in phases or Phase.HOLD in phases
    assert flown.outcome.end_m > 0.8
    assert not flown.outcome.touched
    after = [t for t in flown.ticks if t.t_ns > killed[0] + 700_000_000]
    towards_mps = [float(t.decision.command.velocity_world[0]) for t in after]  # the board is at +x
    assert max(towards_mps) < 0.02
    assert min(towards_mps) < -0.05  # it backs off


def test_a_worker_whose_clock_is_set_changes_nothing(plain) -> None:
    """d1 + d2 takes differences on each clock: not one verdict is another."""

    def before(f: LockstepFlight) -> None:
        f.worker.clock_step_ns = 3_600_000_000_000 if f.simulation.t_ns > 5e9 else 0

    flown = lockstep_flight().fly(before)
    assert flown.verdicts == plain.verdicts
    assert flown.rows == plain.rows


def test_a_frozen_camera_is_noticed(plain) -> None:
    """Not one of its pictures is sent."""

    def before(f: LockstepFlight) -> None:
        f.frozen = f.simulation.t_ns > 8e9

    flown = lockstep_flight(settings=LockstepSettings(longest_s=20.0)).fly(before)
    assert flown.counts["frozen"] > 100
    assert not flown.outcome.touched
    assert flown.outcome.safe


def test_a_link_that_is_too_slow_is_gated() -> None:
    """A tau_max of 5 ms: every result is refused, and the drone never leaves its place."""
    settings = LockstepSettings(longest_s=6.0)
    gate = replace(settings.parts.gate, tau_max_ns=5_000_000)
    settings = replace(settings, parts=replace(settings.parts, gate=gate))
    flown = lockstep_flight(settings=settings, link=PROFILES["bad"]).fly()
    assert set(flown.verdicts) == {"network_delay"}
    assert flown.outcome.nearest_m > 0.9
    ungated = lockstep_flight(settings=replace(settings, gates=False), link=PROFILES["bad"]).fly()
    assert set(ungated.verdicts) == {"accepted"}
