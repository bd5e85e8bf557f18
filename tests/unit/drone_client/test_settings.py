"""Settings: the environment, the flags above it, and a hint for what is misspelt."""

import os

import pytest
from pydantic import ValidationError

from drone_client.errors import ClientError
from drone_client.settings import ClientSettings, about, default_settings, known_name, load_settings
from rgbd_wire.streams import FRAME, RESULT


@pytest.fixture(autouse=True)
def no_settings(monkeypatch):
    """An environment without any DRONE_ variable."""
    for name in list(os.environ):
        if name.startswith("DRONE_"):
            monkeypatch.delenv(name)


def test_the_bounds_on_age_come_from_the_stream_table():
    """Nobody retypes them."""
    settings = load_settings()
    assert settings.tau_max_ms == FRAME.max_age_ms
    assert settings.age_max_ms == RESULT.max_age_ms


def test_a_flag_wins_over_the_environment_and_that_over_the_default(monkeypatch):
    """None stands for a flag that was not given."""
    monkeypatch.setenv("DRONE_WINDOW", "3")
    monkeypatch.setenv("DRONE_NAME", "from-env")
    settings = load_settings(window=4, name=None, jpeg_quality=None)
    assert (settings.window, settings.name, settings.jpeg_quality) == (4, "from-env", 80)


def test_the_default_settings_know_no_environment(monkeypatch):
    """They are what an empty one gives, each value checked as if it had been given."""
    usual = load_settings()
    monkeypatch.setenv("DRONE_TAU_MAX_MS", "40")
    monkeypatch.setenv("DRONE_NO_SUCH", "1")
    assert default_settings() == usual
    assert default_settings().gate == usual.gate


def test_an_empty_variable_is_none_at_all(monkeypatch):
    """As the link's own advice has it: leave DRONE_TLS empty."""
    for name in ("TLS", "KEY_FILE", "ROS_TOPIC", "CONNECT", "TAU_MAX_MS"):
        monkeypatch.setenv(f"DRONE_{name}", "")
    assert load_settings() == default_settings()
    assert "connect" not in load_settings().model_fields_set


def test_settings_are_frozen():
    """Read once, passed down by value."""
    with pytest.raises(ValidationError, match="frozen"):
        load_settings().window = 3


def test_endpoints_are_separated_by_commas():
    """Blanks and empty ones do not count."""
    settings = load_settings(connect=" tcp/a:1 ,tcp/b:2,, ")
    assert settings.endpoints == ("tcp/a:1", "tcp/b:2")


@pytest.mark.parametrize(
    ("variable", "hint"),
    [
        ("DRONE_TAUMAX_MS", "did you mean DRONE_TAU_MAX_MS?"),
        ("DRONE_CONECT", "did you mean DRONE_CONNECT?"),
        ("DRONE_ZZZZZZZZZZZZZZZZ", "known: DRONE_NAME, DRONE_CONNECT"),
    ],
)
def test_an_unknown_variable_is_told_with_the_one_that_was_meant(monkeypatch, variable, hint):
    """A setting that is silently ignored would be flown without."""
    monkeypatch.setenv(variable, "1")
    with pytest.raises(ClientError) as caught:
        load_settings()
    assert str(caught.value).startswith(f"unknown setting {variable}")
    assert hint in str(caught.value)


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        ({"tau_max_ms": -1.0}, "--tau-max-ms = -1.0: input should be greater than"),
        ({"tau_max_ms": float("nan")}, "--tau-max-ms = nan: input should be"),
        ({"tau_max_ms": 20_000.0}, "less than or equal to 10000"),
        ({"window": 0}, "--window = 0: input should be greater than or equal to 1"),
        ({"jpeg_quality": 101}, "--jpeg-quality = 101"),
        ({"onboard_max_s": 0.1}, "--onboard-max-s = 0.1: input should be greater than"),
        ({"onboard_max_s": 31.0}, "less than or equal to 30"),
        ({"onboard_growth_mm_s": 0.0}, "--onboard-growth-mm-s = 0.0"),
        ({"name": "Bad Name"}, "--name = 'Bad Name'"),
        ({"name": "two\nlines"}, r"'two\nlines'"),
    ],
)
def test_a_value_out_of_bounds_is_told_with_its_flag_bound_and_meaning(flags, says):
    """One line."""
    with pytest.raises(ClientError) as caught:
        load_settings(**flags)
    (field,) = flags
    assert says in str(caught.value)
    assert str(caught.value).endswith(f"({ClientSettings.model_fields[field].description})")
    assert "\n" not in str(caught.value)


def test_a_wrong_variable_is_told_by_its_own_name(monkeypatch):
    """Not by the flag that was never given."""
    monkeypatch.setenv("DRONE_WINDOW", "two")
    with pytest.raises(
        ClientError, match=r"^DRONE_WINDOW = 'two': input should be a valid integer"
    ):
        load_settings()


def test_tau_past_age_is_told_with_both_and_what_to_do():
    """The age of a result holds its time on the network."""
    with pytest.raises(
        ClientError, match=r"--tau-max-ms = 500 exceeds --age-max-ms = 300: .* raise --age-max-ms"
    ):
        load_settings(tau_max_ms=500.0, age_max_ms=300.0)
    assert load_settings(tau_max_ms=300.0, age_max_ms=300.0).tau_max_ms == 300.0


def test_each_setting_says_what_it_is_with_its_default():
    """Help texts come from the settings themselves."""
    for field in ClientSettings.model_fields:
        assert known_name(field) == f"DRONE_{field.upper()}"
        assert "None" not in about(field)
    assert about("window") == "frames in the network at most (default: 2)"
