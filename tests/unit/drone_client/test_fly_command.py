"""``drone-client fly``: what it asks for before anything moves, and how it refuses."""

from __future__ import annotations

import io
import signal
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from drone_client.autopilot.simulated import SimulatedAutopilot
from drone_client.cli import app
from drone_client.errors import ClientError
from drone_client.fly.cockpit import View
from drone_client.fly.command import _heeding_hang_up
from drone_client.fly.orders import Orders
from drone_client.fly.terminal import TerminalCockpit, flight_lines
from drone_client.mission import Order
from drone_client.run_files import LEDGER_NAME
from drone_client.tally import Tally
from rgbd_wire.clock import MonotonicClock
from target_pose.errors import TargetError
from tests.unit.drone_client.builders import pose

AIRFRAME = str(Path(__file__).parents[3] / "examples" / "airframe.toml")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "nobody to ask: run it in a terminal, or with --yes or --dry-run"),
        (("--yes", "--tau-max-ms", "900"), "exceeds --age-max-ms"),
        (("--yes", "--tuning", "nowhere.toml"), "tuning file nowhere.toml: No such file"),
        (("--yes", "--floor-m", "1e9"), "offset_m = 1000000000.0 is not in"),
        (("--yes", "--floor-m", "3", "--ceiling-m", "1"), "is not below --ceiling-m 1"),
        (("--yes", "--onboard-target", "typo"), "typo"),
        (("--yes", "--source", "webcam"), "webcam: no camera that is known"),
        (("--yes", "--autopilot", "tcp/here:1"), "'tcp/here:1' is no address; such as"),
    ],
)
def test_a_mistake_is_told_before_anything_is_opened(arguments: tuple[str, ...], says: str):
    """One line each, of the place where the bound is at home."""
    result = CliRunner().invoke(app, ["fly", "--airframe", AIRFRAME, *arguments])
    assert isinstance(result.exception, ClientError | TargetError)
    assert says in str(result.exception)


@pytest.mark.parametrize(
    "arguments",
    [
        ("fly", "--sim", "tunnel", "--wait-for-vehicle-s", "nan"),
        ("doctor", "--limit-s", "nan"),
        ("snap", "color.jpg", "--timeout-s", "nan"),
    ],
)
def test_a_time_that_is_no_number_is_refused(arguments: tuple[str, ...]):
    """Nobody waits for ever by mistake."""
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "Input should be" in result.stderr


def test_an_airframe_must_be_given_and_be_there():
    """Nobody flies by the default drone's transforms unawares."""
    result = CliRunner().invoke(app, ["fly", "--yes"])
    assert "--airframe is needed" in str(result.exception)
    result = CliRunner().invoke(app, ["fly", "--yes", "--airframe", "nowhere.toml"])
    assert "airframe file nowhere.toml: No such file" in str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--sim", "moon"), "no world 'moon'; there are: tunnel, refinery"),
        (("--sim", "tunnel", "--board", "torn"), "no board 'torn'; there are: clean"),
        (
            ("--sim", "tunnel", "--link", "string"),
            "no link 'string'; there are: lan, wifi, 5g, bad",
        ),
        (("--sim", "tunnel", "--link", "wifi", "--connect", "tcp/127.0.0.1:1"), "leave --connect"),
        (("--yes", "--airframe", AIRFRAME, "--link", "wifi"), "--link emulates a link for --sim"),
    ],
)
def test_a_simulated_flight_that_cannot_be_is_told_before_it_begins(
    arguments: tuple[str, ...], says: str
):
    """And nothing is left running: no thread, no process was begun."""
    result = CliRunner().invoke(app, ["fly", *arguments])
    assert isinstance(result.exception, ClientError)
    assert says in str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--seed", "3"), "--seed needs --sim"),
        (("--board", "clean"), "--board needs --sim"),
        (("--video", "x.mp4"), "--video shows a simulated world, with --sim"),
        (("--link", "wifi"), "--link emulates a link for --sim"),
        (("--sim", "tunnel", "--source", "realsense"), "--source names a part of a real drone"),
        (("--sim", "tunnel", "--camera", "c.json"), "--camera names a part of a real drone"),
        (("--sim", "tunnel", "--vio-topic", "/vio"), "--vio-topic names a part of a real drone"),
        (("--sim", "tunnel", "--lidar-topic", "/down"), "--lidar-topic names a part"),
        (("--sim", "tunnel", "--ahead-topic", "/ahead"), "--ahead-topic names a part"),
        (("--sim", "tunnel", "--autopilot", "udp/127.0.0.1:1"), "--autopilot goes with --hil"),
        (("--sim", "tunnel", "--airframe", "nowhere.toml"), "airframe file nowhere.toml: No such"),
        (("--sim", "tunnel", "--tuning", "nowhere.toml"), "tuning file nowhere.toml: No such"),
        (("--sim", "tunnel", "--tau-max-ms", "900"), "exceeds --age-max-ms"),
        (("--sim", "tunnel", "--tls", "certificates"), "--tls is for the service of --connect"),
        (("--sim", "tunnel", "--key-file", "k"), "--key-file is for the service of --connect"),
        (("--sim", "tunnel", "--onboard-target", "typo"), "no target 'typo'"),
        (("--sim", "tunnel", "--video", "x" * 300 + ".webm"), "File name too long"),
    ],
)
def test_what_does_not_go_together_is_told_before_a_world_is_built(
    arguments: tuple[str, ...], says: str, tmp_path: Path
):
    """Nothing that was given is silently ignored; each line names the option at fault."""
    out = tmp_path / "run"
    result = CliRunner().invoke(app, ["fly", *arguments, "--out", str(out)])
    assert isinstance(result.exception, ClientError | TargetError)
    assert says in str(result.exception)
    assert "building" not in result.stderr
    assert not out.exists()


@pytest.mark.parametrize("which", [("--sim", "tunnel"), ("--yes", "--airframe", AIRFRAME)])
def test_a_folder_that_is_refused_is_left_as_it_was(which: tuple[str, ...], tmp_path: Path):
    """An earlier run in it, a file in its place, a file above it: told at once."""
    run = tmp_path / "run"
    run.mkdir()
    (run / LEDGER_NAME).write_text("{}\n")
    (run / "edge-service.log").write_text("of the earlier run")
    for out, says in (
        (run, "holds an earlier run: give another --out, or --overwrite"),
        (run / LEDGER_NAME, "is a file"),
        (run / LEDGER_NAME / "below", "is a file"),
    ):
        result = CliRunner().invoke(app, ["fly", *which, "--out", str(out)])
        assert isinstance(result.exception, ClientError)
        assert says in str(result.exception)
        assert "building" not in result.stderr
    assert {p.name: p.read_text() for p in run.iterdir()} == {
        LEDGER_NAME: "{}\n",
        "edge-service.log": "of the earlier run",
    }


def view(accepted: int = 3) -> View:
    tally = Tally()
    tally.verdicts["accepted"] = accepted
    vehicle = SimulatedAutopilot(MonotonicClock(), pose((1, 2, 3)))
    return View(vehicle.state(), None, tally, ("w1",))


@pytest.mark.parametrize(
    ("typed", "flies"),
    [("yes\n", True), (" YES \n", True), ("y\n", False), ("\n", False), ("", False)],
)
def test_only_a_yes_is_one(typed: str, flies: bool, monkeypatch: pytest.MonkeyPatch):
    """The vehicle, the workers and what was seen stand above the question."""
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    shown = io.StringIO()
    cockpit = TerminalCockpit(Console(file=shown, width=100), ask=True)
    assert cockpit.may_fly(view()) is flies
    for word in (
        "POSCTL, armed, not ours, battery 100%",
        "w1",
        "3 of 3",
        "not seen yet",
        "Type yes",
    ):
        assert word in shown.getvalue()


def test_with_yes_nobody_is_asked():
    """The table is shown all the same."""
    shown = io.StringIO()
    assert TerminalCockpit(Console(file=shown, width=100), ask=False).may_fly(view())
    assert "POSCTL" in shown.getvalue()
    assert "Type yes" not in shown.getvalue()


def test_before_the_first_tick_there_is_a_line_to_show():
    """Whatever is not known yet is left out."""
    first, second = flight_lines(View(None, None, Tally(), ()))
    assert first.plain.strip() == "waiting"
    assert second.plain.strip() == "no vehicle"


@pytest.mark.parametrize("error", [BrokenPipeError, OSError])
def test_a_terminal_that_has_gone_ends_no_flight(error: type[OSError]):
    """Whatever the flight has to say then, nobody hears it, and nothing is raised."""

    class Gone(io.StringIO):
        def isatty(self) -> bool:
            return True

        def write(self, text: str) -> int:
            raise error("gone")

    cockpit = TerminalCockpit(Console(file=Gone(), force_terminal=True), ask=False)
    for _ in range(3):
        cockpit.show(view())
        cockpit.tell("the drone backs off")
    cockpit.close()


def test_a_terminal_that_is_closed_is_an_interrupt():
    """As long as the flight lasts; afterwards the signal is what it was."""
    before = signal.getsignal(signal.SIGHUP)
    with pytest.raises(KeyboardInterrupt), _heeding_hang_up():
        signal.raise_signal(signal.SIGHUP)
    assert signal.getsignal(signal.SIGHUP) is before


def test_under_nohup_a_closed_terminal_is_nothing():
    """Whoever started it so wants it to go on."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with _heeding_hang_up():
            signal.raise_signal(signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_an_abort_is_the_last_order():
    """Stand, go, stand again; after an abort nothing."""
    orders = Orders()
    assert orders.now is Order.HOLD
    orders.give(Order.GO)
    assert orders.now is Order.GO
    orders.give(Order.ABORT)
    orders.give(Order.GO)
    assert orders.now is Order.ABORT
