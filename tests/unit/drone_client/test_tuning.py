"""Numbers from a tuning file: each at its place and in its bounds, or one line why not."""

from __future__ import annotations

import tomllib
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

from drone_client.errors import TuningError
from drone_client.flight_settings import FlightSettings, flight_settings
from drone_client.settings import ClientSettings
from drone_client.tuning import NOT_FROM_A_FILE, load_tuning

PARTS = flight_settings(ClientSettings())
SHIPPED = Path(__file__).parents[3] / "examples" / "tuning.toml"


def tuned(tmp_path: Path, text: str) -> FlightSettings:
    path = tmp_path / "tuning.toml"
    path.write_text(text)
    return load_tuning(path, PARTS)


def test_what_is_written_is_taken_and_the_rest_stays(tmp_path: Path):
    """Nested tables reach nested settings; a whole number may stand for a broken one."""
    parts = tuned(
        tmp_path,
        "[mission]\ndwell_s = 3\nattempts = 2\n"
        "[filter]\nv_max_mps = 0.3\n[filter.funnel]\nr_c_m = 0.03\n"
        "[odometry.jump]\nposition_m = 0.07\n[odometry.lidar]\nwindow = 7",
    )
    new = parts.control
    assert (new.mission.dwell_s, new.mission.attempts) == (3.0, 2)
    assert (new.filter.v_max_mps, new.filter.funnel.r_c_m) == (0.3, 0.03)
    assert new.filter.funnel.a == PARTS.control.filter.funnel.a
    assert new.guidance == PARTS.control.guidance
    assert (parts.odometry.jump.position_m, parts.odometry.lidar.window) == (0.07, 7)
    assert parts.odometry.vio_jump == PARTS.odometry.vio_jump
    assert parts.odometry.budget == PARTS.odometry.budget
    assert (parts.gate, parts.uplink) == (PARTS.gate, PARTS.uplink)
    assert tuned(tmp_path, "") == PARTS
    both = "[mission]\nstandoff_m = 0.8\n[filter]\nstandoff_m = 0.8\nlag_s = 0.35"
    assert tuned(tmp_path, both).control.filter.standoff_m == 0.8


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[mission]\ndwel_s = 3", "unknown 'mission.dwel_s'; known: "),
        ("[mission]\ndwell_s = 1000", "dwell_s = 1000.0 is not in"),
        ("[mission]\ndwell_s = '3'", "mission.dwell_s = '3' must be a number"),
        ("[mission]\nattempts = 2.5", "mission.attempts = 2.5 must be a whole number"),
        ("[mission]\ndwell_s = true", "must be a number"),
        ("[mission]\ndwell_s = 1" + "0" * 400, "must be a number"),
        ("[mission]\ndwell_s = 1" + "0" * 5000, "Exceeds the limit"),
        ("[mission]\ndwell_s = nan", "dwell_s = nan is not in"),
        ("[guidance]\nk_x = 1.0\nk_lateral = 0.5", "k_x = 1.0 must not exceed"),
        ("mission = 3", "mission must be a table [mission]"),
        ("[filter]\nvariant = 'paper'", "unknown 'filter.variant'"),
        ("[filter]\nallow_unsafe_variant = true", "unknown 'filter.allow_unsafe_variant'"),
        ("[mission]\nneeds_vehicle = false", "unknown 'mission.needs_vehicle'"),
        ("[odometr]", "unknown 'odometr'; known: filter, guidance, mission, odometry"),
        ("odometry = 3", "odometry must be a table [odometry]"),
        ("[odometry]\njump = 3", "odometry.jump must be a table [odometry.jump]"),
        ("[odometry.jumps]", "unknown 'odometry.jumps'; known: budget, jump, lidar, vio_jump"),
        ("[odometry.jump]\nposition_m = 3", "JumpSettings.position_m = 3.0 is not in"),
        ("[odometry.lidar]\nwindow = 4", "window = 4 is not odd"),
        ("[odometry.budget]\nsigma_m = 0", "OdometryBudget.sigma_m = 0.0 is not in"),
        ("[odometry.budget]\ndrift_mps = 0.02", "exceeds filter.drift_mps = 0.01: "),
        ("[filter]\ndrift_mps = 0.005", "exceeds filter.drift_mps = 0.005: "),
        ("[mission]\nstandoff_m = 0.8", "and filter.standoff_m = 1: "),
        ("[filter]\nstandoff_m = 0.8", "mission.standoff_m = 1 and filter.standoff_m = 0.8: "),
        ("[guidance]\nlag_s = 0.35", "guidance.lag_s = 0.35 exceeds filter.lag_s = 0.3: "),
        ("[mission", "Expected"),
        ("x" * 70_000, "over 65536 bytes"),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, text: str, why: str):
    """With the file, the field, and what it may be."""
    with pytest.raises(TuningError, match="tuning file .*tuning.toml: ") as caught:
        tuned(tmp_path, text)
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_one_line(tmp_path: Path):
    """The path and the system's reason."""
    with pytest.raises(TuningError, match="nowhere.toml: No such file"):
        load_tuning(tmp_path / "nowhere.toml", PARTS)


def test_the_example_holds_every_number_at_its_default():
    """So that it can be copied and changed; nothing that can be tuned is missing in it."""
    assert load_tuning(SHIPPED, PARTS) == PARTS
    written = tomllib.loads(SHIPPED.read_text())

    def every(settings: object, table: dict, where: str = "") -> None:
        assert is_dataclass(settings)
        for field in fields(settings):
            name = f"{where}{field.name}"
            value = getattr(settings, field.name)
            if name in NOT_FROM_A_FILE or not field.init:
                continue
            if is_dataclass(value):
                every(value, table[field.name], f"{name}.")
            elif isinstance(value, int | float):
                assert field.name in table, name

    every(PARTS.control, written)
    every(PARTS.odometry, written["odometry"], "odometry.")


def test_more_drift_is_taken_where_the_error_ball_covers_it(tmp_path: Path):
    """Both numbers together, in the file that names both."""
    parts = tuned(tmp_path, "[odometry.budget]\ndrift_mps = 0.03\n[filter]\ndrift_mps = 0.04")
    assert parts.odometry.budget.drift_mps == 0.03
