"""The command line: one figure that fails does not keep the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from contact_sim.errors import FigureError, SimulatorError
from contact_sim.figures import command
from contact_sim.figures.bench import FigureBench
from contact_sim.figures.catalogue import chosen
from contact_sim.figures.run import Run
from contact_sim.figures.style import caption_of, command_of


@pytest.fixture
def app(monkeypatch, run: Run) -> typer.Typer:
    """The command, with runs that are flown already."""
    monkeypatch.setattr(FigureBench, "run_1", run)
    monkeypatch.setattr(FigureBench, "run_2", run)
    app = typer.Typer(rich_markup_mode=None)
    app.command()(command.figures)
    return app


def test_a_figure_that_cannot_be_drawn_says_why_and_the_others_go_on(app, tmp_path, monkeypatch):
    """Exit code 3, and a page of what is there."""

    def fails(bench: FigureBench) -> None:
        raise FigureError("a flight could not be flown")

    monkeypatch.setattr(FigureBench, "many", property(fails))
    out, page = tmp_path / "figures", tmp_path / "figures.md"
    done = CliRunner().invoke(
        app,
        ["contact-map", "barrier", "--out", str(out), "--page", str(page), "--json"],
    )
    assert done.exit_code == command.EXIT_INCOMPLETE
    result = json.loads(done.stdout)
    assert list(result["drawn"]) == ["barrier"]
    assert result["failed"]["contact-map"] == "a flight could not be flown"
    assert caption_of(out / "barrier.png") in page.read_text()
    assert not (out / "contact-map.png").exists()


def test_all_is_well_is_zero_and_names_the_files(app, tmp_path):
    """One line each."""
    done = CliRunner().invoke(app, ["commands", "pose-errors", "--out", str(tmp_path)])
    assert done.exit_code == 0
    assert done.stdout.split() == [str(tmp_path / f"{n}.png") for n in ("pose-errors", "commands")]


def test_a_folder_that_takes_nothing_is_told_before_anything_is_flown(app, monkeypatch):
    """Not after minutes of flights."""
    monkeypatch.setattr(command, "FigureBench", None)
    for options in (["--out", "/proc/x"], ["--page", "/proc/x/figures.md"]):
        done = CliRunner().invoke(app, ["barrier", *options])
        assert isinstance(done.exception, FigureError)
        assert "cannot write /proc/x/" in str(done.exception)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--table", "none.csv"), "cannot read none.csv: No such file or directory"),
        (("--service", "--connect", "tls/127.0.0.1:1"), "tls/127.0.0.1:1"),
    ],
)
def test_a_table_or_a_service_that_is_not_there_is_told_before_anything_is_drawn(
    app, tmp_path, monkeypatch, options, says
):
    """Not after the figures that need neither."""
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["barrier", "contact-map", "--out", "figures", *options])
    assert isinstance(done.exception, SimulatorError)
    assert says in str(done.exception)
    assert list((tmp_path / "figures").iterdir()) == []


def test_a_figure_says_what_draws_it_again(app, tmp_path, monkeypatch):
    """With the options that it depends on, and no others; nothing goes into docs by itself."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(FigureBench, "service", None)
    done = CliRunner().invoke(app, ["barrier", "--service", "--flights", "7", "--quick"])
    assert done.exit_code == 0, done.output
    path = tmp_path / "runs" / "figures" / "barrier.png"
    assert done.stdout.split() == [str(path.relative_to(tmp_path))]
    assert command_of(path) == "scripts/figures barrier --service --quick"
    assert "Flown with pictures through a real service" in caption_of(path)


@pytest.mark.parametrize(
    ("name", "asked", "says"),
    [
        ("gate", (True, Path("t.csv"), 7, False), "scripts/figures gate"),
        ("contact-map", (True, None, 7, False), "scripts/figures contact-map --flights 7"),
        ("contact-map", (True, None, command.FLIGHTS, False), "scripts/figures contact-map"),
        (
            "contact-force",
            (True, Path("t.csv"), 7, True),
            "scripts/figures contact-force --service --table t.csv --quick",
        ),
    ],
)
def test_the_command_has_what_the_figure_depends_on(name, asked, says):
    """Two of them look at many flights, six at runs 1 and 2."""
    (entry,) = chosen([name])
    assert command.Asked(*asked).command(entry) == says


def test_an_unknown_figure_is_a_mistake_of_the_user(app):
    """Before anything is flown."""
    done = CliRunner().invoke(app, ["nose"])
    assert isinstance(done.exception, FigureError)
