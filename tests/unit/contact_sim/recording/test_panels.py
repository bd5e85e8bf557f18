"""What a film shows beside the chase camera: pixels where they have to be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from contact_sim.recording.curves import LEFT_PX, RIGHT_PX, Curves
from contact_sim.recording.panels import BAR_PX, KNOWN, eye_panel, write_mission
from contact_sim.recording.reel import Instant, Reel, load_reel
from drone_client.viewing.outlines import board_outlines
from drone_client.viewing.overlay import project
from tests.unit.contact_sim.flights import RIG
from tests.unit.contact_sim.recording.flown import MS, REFUSED_FROM_NS, START_NS, fly

WIDTH, HEIGHT = 600, 450


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Reel:
    return load_reel(fly(tmp_path_factory.mktemp("flight")))[0]


def corner(reel: Reel, instant: Instant) -> tuple[int, int]:
    """Row and column of a corner of the board in the panel, by the rig's own projection."""
    assert instant.answer is not None
    assert instant.answer.camera_from_target is not None
    square = board_outlines(reel.facts)[0].points
    pixels = project(square, instant.answer.camera_from_target, RIG.color)
    assert pixels is not None
    x, y = (pixels[0] + 0.5) * (WIDTH / RIG.color.width, HEIGHT / RIG.color.height) - 0.5
    return round(y), round(x)


@pytest.mark.parametrize(("at_ns", "bright", "dark"), [(300 * MS, 1, 0), (REFUSED_FROM_NS, 0, 1)])
def test_the_outline_lies_on_the_board_in_the_colour_of_the_verdict(
    reel: Reel, at_ns: int, bright: int, dark: int
):
    """Green where the answer was accepted, red where it came too late; the rest is the picture."""
    instant = reel.at(START_NS + at_ns)
    panel = eye_panel(instant, reel.facts, WIDTH, HEIGHT)
    row, column = corner(reel, instant)
    pixel = panel[row, column].astype(int)
    assert pixel[bright] > pixel[dark] + 80
    np.testing.assert_allclose(panel[30, 30], 128, atol=4)


def test_what_was_known_is_a_thin_square(reel: Reel):
    """Where no answer lies over it."""
    instant = reel.at(START_NS + 300 * MS)._replace(answer=None)
    panel = eye_panel(instant, reel.facts, WIDTH, HEIGHT)
    near = np.abs(panel.astype(int) - KNOWN).max(axis=2) < 60
    assert 50 < near[: HEIGHT - BAR_PX].sum() < 2000


def test_without_a_picture_the_panel_says_so(reel: Reel, tmp_path: Path):
    """Dark, with words; also where the file has gone."""
    instant = reel.at(START_NS)
    assert instant.picture is not None
    none = eye_panel(instant._replace(picture=None, answer=None, known=None), reel.facts, 600, 450)
    assert none.mean() < 40
    assert none.max() > 120


def test_the_phase_is_written_in_its_colour(reel: Reel):
    """Amber for the approach."""
    scene = np.full((450, 680, 3), 100, dtype=np.uint8)
    write_mission(scene, reel.at(START_NS + 500 * MS), START_NS, "news")
    amber = (scene[:40, :200, 0].astype(int) - scene[:40, :200, 2]) > 120
    assert amber.sum() > 100
    np.testing.assert_array_equal(scene[200], np.full((680, 3), 100))


def test_the_cursor_moves_with_time_and_the_future_is_dark(reel: Reel):
    """White at the moment's own column, dim to its right."""
    curves = Curves(reel, 1280, 270)
    span = 1280 - LEFT_PX - RIGHT_PX
    for share in (0.25, 0.75):
        t_ns = reel.start_ns + round(share * (reel.end_ns - reel.start_ns))
        strip = curves.at(reel.at(t_ns))
        column = LEFT_PX + round(share * span)
        assert strip[40:240, column].mean() > 230
        full = curves.at(reel.at(reel.end_ns))
        right = slice(column + 5, column + 100)
        assert strip[30:, right].mean() < 0.75 * full[30:, right].mean()
        np.testing.assert_array_equal(strip[30:, : column - 2], full[30:, : column - 2])


def test_a_delay_over_the_limit_is_drawn_over_the_line(reel: Reel):
    """Red dots above tau_max, green ones below."""
    strip = Curves(reel, 1280, 270).at(reel.at(reel.end_ns)).astype(int)
    plot = strip[100:180, LEFT_PX + 4 : 1280 - RIGHT_PX - 4]
    red = np.argwhere((plot[..., 0] - plot[..., 1] > 90) & (plot[..., 0] > 200))
    green = np.argwhere((plot[..., 1] - plot[..., 0] > 90) & (plot[..., 1] > 180))
    assert len(red) > 4
    assert len(green) > 4
    assert red[:, 0].max() < green[:, 0].min()
    assert red[:, 1].min() > green[:, 1].max()
