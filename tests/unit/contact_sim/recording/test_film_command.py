"""``python -m contact_sim film``: what cannot be filmed is told in a sentence."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from contact_sim.errors import RenderError, SimulatorError
from contact_sim.recording import command
from contact_sim.recording.film import film
from contact_sim.scene import build_scene
from tests.unit.contact_sim.recording.flown import fly
from tests.unit.drone_client.view_builders import write_run

app = typer.Typer(rich_markup_mode=None)
app.command()(command.film)


def told(*arguments: object) -> str:
    """The sentence that a mistake ends in."""
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    assert isinstance(done.exception, SimulatorError), done.output
    return str(done.exception)


def test_a_mistake_is_told(tmp_path: Path):
    """No such run, one of no simulator, one without its world, a name of no film, a file there."""
    out = tmp_path / "a.webm"
    assert "holds no run" in told(tmp_path / "none", out)
    assert "nothing was written of how it truly was" in told(write_run(tmp_path / "real"), out)
    run = fly(tmp_path / "run", 0.3)
    (run / "world.json").unlink()
    assert "is no simulated flight, or was cut off" in told(run, out)
    assert "a film is called .mp4 or .webm" in told(run, tmp_path / "a.avi")
    assert "there is no folder" in told(run, tmp_path / "b" / "a.webm")
    out.write_bytes(b"precious")
    assert "is there already: another name, or --overwrite" in told(run, out)
    assert out.read_bytes() == b"precious"


def test_without_opengl_nothing_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The machine is at fault, not the run."""

    def none() -> str:
        raise RenderError("no OpenGL that draws without a screen: install libegl1")

    monkeypatch.setattr(command, "choose_gl", none)
    assert "install libegl1" in told(tmp_path / "none", tmp_path / "a.webm")


def test_the_help_has_an_example():
    """And says where the drone's own pictures come from."""
    done = CliRunner().invoke(app, ["--help"])
    assert "python -m contact_sim film runs/a a.webm" in done.stdout
    assert "--video" in done.stdout


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A short flight, said to be of a world that is built quickly."""
    run = fly(tmp_path / "run", 0.3)
    (run / "world.json").write_text(json.dumps({"world": "tunnel", "seed": 1, "board": "clean"}))
    return run


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_an_interrupt_leaves_nothing_and_says_so(run: Path, monkeypatch: pytest.MonkeyPatch):
    """Exit code 130, one line."""
    monkeypatch.setattr("contact_sim.recording.film.draw_film", interrupted)
    out = run.parent / "a.mp4"
    done = CliRunner().invoke(app, [str(run), str(out)])
    assert done.exit_code == command.EXIT_INTERRUPTED
    assert done.stderr.strip() == f"{out} was given up: nothing of it is left"


def test_after_a_flight_an_interrupt_says_how_to_make_the_film_later(
    run: Path, monkeypatch: pytest.MonkeyPatch
):
    """It is a sentence for the summary: the flight was flown all the same."""
    monkeypatch.setattr("contact_sim.recording.film.draw_film", interrupted)
    out = run.parent / "a.mp4"
    with pytest.raises(SimulatorError, match="was given up") as told:
        film(run, build_scene("tunnel", 1), out, lambda share: None)
    assert f"python -m contact_sim film {run} {out}" in str(told.value)
