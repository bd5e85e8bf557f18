"""The list of figures, and the page that shows them."""

from __future__ import annotations

import importlib

import pytest

from contact_sim.errors import FigureError
from contact_sim.figures.catalogue import CATALOGUE, chosen
from contact_sim.figures.page import page, write_page
from contact_sim.figures.style import new_figure, save


def test_every_figure_has_a_name_of_its_own_and_a_module_that_draws():
    """Its file is called like it."""
    assert len({entry.name for entry in CATALOGUE}) == len(CATALOGUE)
    for entry in CATALOGUE:
        module = importlib.import_module(f"contact_sim.figures.{entry.module}")
        assert callable(module.draw)
        assert module.__doc__


def test_names_choose_in_the_order_of_the_page():
    """None is all; an unknown one is said, with those that there are."""
    assert chosen([]) == CATALOGUE
    assert [e.name for e in chosen(["gate", "barrier"])] == ["barrier", "gate"]
    with pytest.raises(FigureError, match=r"'nose'.*cbf-boundary"):
        chosen(["nose"])


COMMANDS = {"gate": "scripts/figures gate", "barrier": "scripts/figures barrier --service"}


def test_the_page_shows_what_is_there_with_the_captions_inside(tmp_path):
    """The paper's first, each with its own command; links lead from the page to the files."""
    figures = tmp_path / "docs" / "figures"
    for name in ("gate", "barrier"):
        save(new_figure(1.0), figures / f"{name}.png", f"What {name} shows.", COMMANDS[name])
    path = tmp_path / "docs" / "figures.md"
    write_page(path, figures)
    text = path.read_text()
    assert text.index("What barrier shows.") < text.index("What gate shows.")
    assert "](figures/gate.png)" in text
    assert f"`{COMMANDS['barrier']}`" in text
    assert f"`scripts/figures --service --out {figures} --page {path}`" in text
    assert "commands.png" not in text


def test_a_page_of_nothing_is_said(tmp_path):
    """With what to do first."""
    with pytest.raises(FigureError, match="scripts/figures"):
        page(tmp_path, tmp_path)
