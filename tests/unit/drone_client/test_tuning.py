"""Numbers from a tuning file: each at its place and in its bounds, or one line why not."""

from __future__ import annotations

import tomllib
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

from drone_client.control import ControlSettings
from drone_client.errors import TuningError
from drone_client.tuning import NOT_FROM_A_FILE, load_tuning

SETTINGS = ControlSettings()
SHIPPED = Path(__file__).parents[3] / "examples" / "tuning.toml"


def tuned(tmp_path: Path, text: str) -> ControlSettings:
    path = tmp_path / "tuning.toml"
    path.write_text(text)
    return load_tuning(path, SETTINGS)


def test_what_is_written_is_taken_and_the_rest_stays(tmp_path: Path):
    """Nested tables reach nested settings; a whole number may stand for a broken one."""
    new = tuned(
        tmp_path,
        "[mission]\ndwell_s = 3\nattempts = 2\n"
        "[filter]\nv_max_mps = 0.3\n[filter.funnel]\nr_c_m = 0.03",
    )
    assert (new.mission.dwell_s, new.mission.attempts) == (3.0, 2)
    assert (new.filter.v_max_mps, new.filter.funnel.r_c_m) == (0.3, 0.03)
    assert new.filter.funnel.a == SETTINGS.filter.funnel.a
    assert new.guidance == SETTINGS.guidance
    assert tuned(tmp_path, "") == SETTINGS


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[mission]\ndwel_s = 3", "unknown 'mission.dwel_s'; known: "),
        ("[mission]\ndwell_s = 1000", "dwell_s = 1000.0 is not in"),
        ("[mission]\ndwell_s = '3'", "mission.dwell_s = '3' must be a number"),
        ("[mission]\nattempts = 2.5", "mission.attempts = 2.5 must be a whole number"),
        ("[mission]\ndwell_s = true", "must be a number"),
        ("[mission]\ndwell_s = nan", "dwell_s = nan is not in"),
        ("[guidance]\nk_x = 1.0\nk_lateral = 0.5", "k_x = 1.0 must not exceed"),
        ("mission = 3", "mission must be a table [mission]"),
        ("[filter]\nvariant = 'paper'", "unknown 'filter.variant'"),
        ("[filter]\nallow_unsafe_variant = true", "unknown 'filter.allow_unsafe_variant'"),
        ("[mission]\nneeds_vehicle = false", "unknown 'mission.needs_vehicle'"),
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
        load_tuning(tmp_path / "nowhere.toml", SETTINGS)


def test_the_example_holds_every_number_at_its_default():
    """So that it can be copied and changed; nothing that can be tuned is missing in it."""
    assert load_tuning(SHIPPED, SETTINGS) == SETTINGS
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

    every(SETTINGS, written)
