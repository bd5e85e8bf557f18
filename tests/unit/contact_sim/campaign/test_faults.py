"""Faults: files of them, and when they strike."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.campaign.faults import (
    USUAL,
    Fault,
    Kind,
    Striker,
    fault_name,
    load_faults,
    strikes,
)
from contact_sim.errors import CampaignError
from contact_sim.lockstep.flight import LockstepSettings
from contact_sim.scene import build_scene
from drone_client.mission import Phase
from link_emulator.profiles import PROFILES
from tests.unit.contact_sim.flights import lockstep_flight

EXAMPLE = Path(__file__).parents[4] / "examples/faults.toml"


def flown(fault: Fault, seed: int = 0, longest_s: float = 20.0):
    striker = Striker(fault, seed)
    flight = lockstep_flight(seed, PROFILES["lan"], LockstepSettings(longest_s=longest_s))
    return striker, flight, flight.fly(striker)


def test_every_kind_is_flown_by_default() -> None:
    """A kind that is added is looked at."""
    assert {fault.kind for fault in USUAL} == set(Kind)
    assert len({fault_name(fault) for fault in USUAL}) == len(USUAL)
    assert fault_name(None) == "none"
    assert fault_name(Fault(Kind.BLACK_HOLE, for_s=1.0)) == "black_hole 1s"
    assert fault_name(Fault(Kind.GUST)) == "gust 1.5s"
    far = Fault(Kind.VIO_JUMPS, 0.1, 0.2, size=2.0)
    assert fault_name(far) == "vio_jumps of 2 at 0.1-0.2 m"


@given(st.lists(st.builds(Fault, st.just(Kind.GUST), st.floats(0, 1), st.floats(1, 2)), min_size=2))
def test_faults_of_one_kind_keep_their_names_apart(faults) -> None:
    """A table's row is known by the name: what strikes elsewhere is called otherwise."""
    different = {(f"{f.nearest_m:g}", f"{f.farthest_m:g}") for f in faults}
    assert len({fault_name(fault) for fault in faults}) == len(different)


def test_in_daylight_no_lamp_goes_out() -> None:
    """The refinery has none; anything else can strike there, too."""
    assert strikes(None, "refinery")
    assert [f.kind for f in USUAL if not strikes(f, "refinery")] == [Kind.LAMP_OUT]
    assert all(strikes(f, "tunnel") for f in USUAL)
    assert build_scene("refinery", 0).lamps == ()
    assert build_scene("tunnel", 0).lamps


@pytest.mark.parametrize("fault", USUAL, ids=fault_name)
def test_it_strikes_once_in_the_approach_and_does_no_harm(fault: Fault) -> None:
    """Below the distance that the seed drew; nothing but the tip touches anything."""
    striker, _, flight = flown(fault)
    assert striker.struck_m is not None
    assert 0.0 - 0.05 <= striker.struck_m <= fault.farthest_m
    before = [t for t in flight.ticks if t.t_ns < striker.struck_ns]
    assert before[-1].decision.mission.phase is Phase.APPROACH
    assert flight.outcome.safe, flight.outcome


def test_what_strikes_is_felt() -> None:
    """A killed worker answers nothing, a hanging one acknowledges, a gust blows, a jump jumps."""
    killed, _, flight = flown(Fault(Kind.WORKER_KILLED), longest_s=16.0)
    late = [t for t in flight.ticks if t.t_ns > killed.struck_ns + 200_000_000]
    assert min(t.decision.age_ns for t in late if t.decision.age_ns is not None) > 150_000_000
    _, hung, _ = flown(Fault(Kind.WORKER_HANGS), longest_s=16.0)
    assert hung.worker.counts["hung"] > 3
    _, jumped, _ = flown(Fault(Kind.VIO_JUMPS), longest_s=16.0)
    assert jumped._feed.counts()["odometry_jumps"] == 1
    _, out, flight = flown(Fault(Kind.VIO_OUT), longest_s=16.0)
    assert flight.reason.value == "odometry_silent"
    assert not out._feed.silent(0)


def test_what_is_over_is_over() -> None:
    """A black hole of a second, a slow link: afterwards the flight goes on to contact."""
    _, _, flight = flown(Fault(Kind.BLACK_HOLE, for_s=1.0), longest_s=60.0)
    assert flight.phase is Phase.DONE
    _, slow, flight = flown(Fault(Kind.LINK_SLOW, for_s=3.0, size=0.2), longest_s=60.0)
    assert flight.phase is Phase.DONE
    late = [r.judgement for r in slow.receptions if r.judgement.network_delay_ns > 400_000_000]
    assert len(late) > 5
    assert {j.verdict.value for j in late} == {"network_delay"}


def test_a_file_of_faults(tmp_path: Path) -> None:
    """Numbers that are left out keep their defaults."""
    path = tmp_path / "faults.toml"
    path.write_text('[[fault]]\nkind = "gust"\nfor_s = 2\nsize = 0.5\n[[fault]]\nkind="vio_out"\n')
    assert load_faults(path) == (Fault(Kind.GUST, for_s=2.0, size=0.5), Fault(Kind.VIO_OUT))
    assert math.isinf(load_faults(path)[1].seconds)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "holds [[fault]] tables"),
        ("fault = 3", "holds [[fault]] tables"),
        ("[[fault]]\nfor_s = 1", "lacks its kind"),
        ('[[fault]]\nkind = "flood"', "no fault 'flood'; there are: worker_killed"),
        ('[[fault]]\nkind = "gust"\nforce = 1', "unknown 'force'"),
        ('[[fault]]\nkind = "gust"\nfor_s = "long"', "for_s = long is no number"),
        ('[[fault]]\nkind = "gust"\nfor_s = true', "for_s = True is no number"),
        ('[[fault]]\nkind = "gust"\nfor_s = nan', "for_s = nan is no number"),
        ('[[fault]]\nkind = "gust"\nfor_s = -1', "for_s = -1 must be in"),
        ('[[fault]]\nkind = "gust"\nfor_s = inf', "for_s = inf must be in"),
        ('[[fault]]\nkind = "gust"\nsize = 9', "size = 9 must be in"),
        ('[[fault]]\nkind = "lamp_out"\nfor_s = 1', "lamp_out is never over"),
        ('[[fault]]\nkind = "vio_out"\nsize = 1', "vio_out takes no size"),
        ('[[fault]]\nkind = "gust"\n[[fault]]\nkind = "gust"', "twice the same: gust 1.5s"),
        ("fault = []", "at least one"),
        ('[[fault]]\nkind = "gust"\nnearest_m = 2\nfarthest_m = 1', "does not hold"),
        ("[[fault", "Expected"),
    ],
)
def test_a_file_that_says_nonsense_is_refused_in_one_line(tmp_path: Path, text, says) -> None:
    """With the path, the field, and what it may be."""
    path = tmp_path / "faults.toml"
    path.write_text(text)
    with pytest.raises(CampaignError, match=r"faults.toml: ") as refused:
        load_faults(path)
    assert says in str(refused.value)


def test_a_file_that_is_not_there() -> None:
    """Named."""
    with pytest.raises(CampaignError, match="nowhere.toml: No such file"):
        load_faults(Path("nowhere.toml"))


def test_the_example_is_one() -> None:
    """What docs/simulator.md names can be flown."""
    kinds = [fault.kind for fault in load_faults(EXAMPLE)]
    assert kinds == [Kind.BLACK_HOLE, Kind.LINK_SLOW, Kind.GUST]


def test_a_number_of_400_digits_is_refused_in_a_line(tmp_path: Path) -> None:
    """TOML has integers of any length."""
    path = tmp_path / "f.toml"
    path.write_text(f'[[fault]]\nkind = "gust"\nsize = {"9" * 400}\n')
    with pytest.raises(CampaignError, match="f.toml: "):
        load_faults(path)
