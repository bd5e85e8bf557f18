"""The command line: one figure that fails does not keep the others."""

from __future__ import annotations

import json

import pytest
import typer
from typer.testing import CliRunner

from contact_sim.errors import FigureError
from contact_sim.figures import command
from contact_sim.figures.bench import FigureBench
from contact_sim.figures.run import Run
from contact_sim.figures.style import caption_of


@pytest.fixture
def app(monkeypatch, run: Run) -> typer.Typer:
    """The command, with runs that are flown already."""
    monkeypatch.setattr(FigureBench, "run_1", run)
    monkeypatch.setattr(FigureBench, "run_2", run)
    app = typer.Typer(rich_markup_mode=None)
    app.command()(command.figures)
    return app


def test_a_figure_that_cannot_be_drawn_says_why_and_the_others_go_on(app, tmp_path):
    """Exit code 3, and a page of what is there."""
    table = tmp_path / "none.csv"
    out, page = tmp_path / "figures", tmp_path / "figures.md"
    done = CliRunner().invoke(
        app,
        ["contact-map", "barrier", "--table", str(table), "--out", str(out), "--page", str(page)]
        + ["--json"],
    )
    assert done.exit_code == command.EXIT_INCOMPLETE
    result = json.loads(done.stdout)
    assert list(result["drawn"]) == ["barrier"]
    assert "none.csv" in result["failed"]["contact-map"]
    assert caption_of(out / "barrier.png") in page.read_text()
    assert not (out / "contact-map.png").exists()


def test_all_is_well_is_zero_and_names_the_files(app, tmp_path):
    """One line each."""
    done = CliRunner().invoke(app, ["commands", "pose-errors", "--out", str(tmp_path)])
    assert done.exit_code == 0
    assert done.stdout.split() == [str(tmp_path / f"{n}.png") for n in ("pose-errors", "commands")]


def test_an_unknown_figure_is_a_mistake_of_the_user(app):
    """Before anything is flown."""
    done = CliRunner().invoke(app, ["nose"])
    assert isinstance(done.exception, FigureError)
