"""Which world a run was flown in, from its files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from contact_sim.errors import FilmError, WorldError
from contact_sim.recording.world import WorldName, load_world

TOLD = {"world": "refinery", "seed": 7, "board": "glossy"}


def test_the_file_of_the_flight_tells_it(tmp_path: Path):
    """Whatever else is there."""
    (tmp_path / "world.json").write_text(json.dumps(TOLD))
    (tmp_path / "summary.json").write_text("{}")
    assert load_world(tmp_path) == WorldName("refinery", 7, "glossy")


def test_the_summary_of_an_earlier_day_tells_it_but_for_the_board(tmp_path: Path):
    """And a file of the flight that was cut off is none."""
    (tmp_path / "world.json").write_text(json.dumps(TOLD)[:9])
    (tmp_path / "summary.json").write_text(
        json.dumps({"simulated": {"world": "tunnel", "seed": 3}})
    )
    world = load_world(tmp_path)
    assert world == WorldName("tunnel", 3, None)
    assert world.build().seed == 3


@pytest.mark.parametrize("summary", [None, "", "[]", "{}", '{"simulated": null}'])
def test_a_flight_of_no_simulator_is_told(tmp_path: Path, summary: str | None):
    """With the files that would say it."""
    if summary is not None:
        (tmp_path / "summary.json").write_text(summary)
    with pytest.raises(FilmError, match=r"no simulated flight.*world\.json"):
        load_world(tmp_path)


def test_a_world_that_there_is_not_is_told(tmp_path: Path):
    """By name and by kind."""
    (tmp_path / "world.json").write_text(json.dumps(TOLD | {"seed": "7"}))
    with pytest.raises(FilmError, match="no world that there is"):
        load_world(tmp_path)
    with pytest.raises(WorldError, match="no world 'moon'"):
        WorldName("moon", 1, None).build()
