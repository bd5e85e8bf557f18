"""The many flights, from a campaign's table."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contact_sim.campaign.row import NAMES, Flight, FlightRow, as_cells, flight_row
from contact_sim.errors import FigureError
from contact_sim.figures import contact_force, contact_map
from contact_sim.figures.bench import MODEL_WORDS, SERVICE_WORDS, FigureBench
from contact_sim.figures.run import Run


@pytest.fixture(scope="module")
def row(run: Run) -> FlightRow:
    flight = Flight("tunnel", 3, "clean", "wifi", "model", "none", "none")
    return flight_row(flight, run.flown, None, 1.0)


def table(folder: Path, rows: list[FlightRow]) -> Path:
    path = folder / "flights.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, NAMES)
        writer.writeheader()
        writer.writerows(as_cells(row) for row in rows)
    return path


def rows(row: FlightRow) -> list[FlightRow]:
    missed = replace(
        row, seed=5, touched=False, offset_m=None, touch_left_m=None, touch_up_m=None,
        closing_mps=None, peak_force_n=0.0,
    )  # fmt: skip
    beside = replace(row, world="refinery", touch_left_m=0.021, touch_up_m=0.0)
    faulty = replace(row, fault="gust 1.5s", touch_left_m=0.5)
    return [row, missed, beside, faulty, replace(row, ablation="no_gate", touch_left_m=0.5)]


def test_flights_with_faults_and_ablations_are_left_out(row, tmp_path):
    """And one that did not touch has no place, but is counted."""
    many = FigureBench(table=table(tmp_path, rows(row))).many
    assert [(r.world, r.seed) for r in many] == [("tunnel", 3), ("tunnel", 5), ("refinery", 3)]
    assert contact_map.touches(many).shape == (2, 2)


def test_the_map_says_how_many_touched_where(row, tmp_path, bench):
    """2.1 cm beside is not within 2 cm."""
    bench.__dict__["many"] = FigureBench(table=table(tmp_path, rows(row))).many
    figure, caption = contact_map.draw(bench)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "tunnel: 1 of 2 touch",
        "refinery: 1 of 1 touch",
    ]
    assert "in the tunnel 1 of 2 touched within 2 cm" in caption
    assert "in the refinery 0 of 1 touched within 2 cm" in caption
    assert caption.endswith("Flown with a localiser's measured errors instead of pictures.")
    figure, caption = contact_force.draw(bench)
    assert len(figure.axes) == 4
    assert "2 flights that touched, with a localiser's measured errors" in caption
    assert "flown with a localiser's measured errors" in caption


def test_flights_through_a_service_are_told_as_such(row):
    """The table knows who looked."""
    bench = FigureBench()
    bench.__dict__["many"] = [replace(row, eyes="service")]
    assert bench.many_eyes_words == SERVICE_WORDS
    bench.__dict__["many"].append(replace(row, eyes="model"))
    assert bench.many_eyes_words == f"{MODEL_WORDS}, some {SERVICE_WORDS}"


def test_the_smoothed_force_keeps_what_was_pushed():
    """Its sum is that of the steps."""
    force = np.zeros(50)
    force[20:25] = 2.0
    assert contact_force.smooth(force).sum() == pytest.approx(force.sum())
    assert contact_force.smooth(force).max() == pytest.approx(2.0)


def test_a_table_without_such_a_flight_is_said(row, tmp_path):
    """With what to do."""
    path = table(tmp_path, rows(row)[3:])
    with pytest.raises(FigureError, match="--plain"):
        _ = FigureBench(table=path).many


def test_nothing_drops_out_of_the_pictures_of_many(row, bench):
    """However far beside, and however fast."""
    wild = replace(row, seed=4, touch_left_m=-0.09, touch_up_m=0.01, closing_mps=0.2)
    bench.__dict__["many"] = [row, wild, replace(row, seed=5, closing_mps=-0.002)]
    figure, _ = contact_force.draw(bench)
    for axes in figure.axes[2:]:
        assert sum(bar.get_height() for bar in axes.patches) == 3
    (axes,) = contact_map.draw(bench)[0].axes
    assert axes.get_xlim()[0] < -90.0
    assert axes.get_ylim()[1] > 90.0


def test_a_seed_that_is_flown_twice_is_not_one_flight(row):
    """A table may hold it on several boards."""
    other = replace(row, seed=4, collisions="arm on wall; skid on rock", outside_m=0.001)
    caption = contact_map._caption([row, other], ["tunnel"])
    assert "Where the tip first touched, one flight a seed: in" in caption
    assert "1 pushed outside the mouth, 1 collided" in caption
    assert "one flight a seed" not in contact_map._caption(
        [row, replace(row, board="glossy")], ["tunnel"]
    )
