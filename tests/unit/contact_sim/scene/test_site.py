"""Places of board and start: within their bounds for every chance."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.chance import stream
from contact_sim.scene.board import PLATE_M
from contact_sim.scene.site import SWEPT_M, draw_site, draw_wind


@given(st.integers(0, 10**9), st.floats(2.1, 3.5), st.floats(0.3, 1.5))
def test_board_and_start_keep_their_bounds(seed, farthest, aside):
    """The start is within the room that it is given, at least 2 m away, at a man's height."""
    site = draw_site(stream(seed, "site"), farthest, aside)
    way = site.site_from_body.translation - site.site_from_target.translation
    assert 2.0 - 1e-9 <= math.hypot(way[0], way[1]) <= farthest + 1e-9
    assert abs(way[1]) <= aside + 1e-9
    assert way[0] > 0
    assert 0.95 < site.site_from_body.translation[2] < 1.85


@given(st.integers(0, 10**9))
def test_the_wall_lies_behind_the_board_where_the_drone_sweeps(seed):
    """No point of the plane x = 0 within the drone's width stands before the board's plane."""
    site = draw_site(stream(seed, "site"), 3.0, 1.0)
    board = site.site_from_target
    for y in (-SWEPT_M, 0.0, SWEPT_M):
        wall = np.array([0.0, y, board.translation[2]])
        assert (board.inverse() @ wall)[0] < -PLATE_M / 2


@given(st.integers(0, 10**9))
def test_the_world_is_the_site_turned_and_carried(seed):
    """Distances are kept, and up stays up."""
    site = draw_site(stream(seed, "site"), 3.0, 1.0)
    apart = site.world_from_body.translation - site.world_from_target.translation
    in_site = site.site_from_body.translation - site.site_from_target.translation
    assert math.isclose(np.linalg.norm(apart), np.linalg.norm(in_site), rel_tol=1e-9)
    assert math.isclose(apart[2], in_site[2], abs_tol=1e-9)


@given(st.integers(0, 10**9), st.floats(0.0, 5.0), st.floats(0.0, 1.5), st.floats(-3.1, 3.1))
def test_the_wind_blows_along_the_wall(seed, fastest, aside, heading):
    """Level, no faster than it may be, and no further aside; the same for a seed."""
    along = np.array([math.cos(heading), math.sin(heading), 0.0])
    wind = draw_wind(seed, along, fastest, aside)
    assert wind == draw_wind(seed, along, fastest, aside)
    speed = math.hypot(*wind)
    assert wind[2] == 0.0
    assert speed <= fastest + 1e-12
    assert abs(along @ np.array(wind)) >= speed * math.cos(aside) - 1e-9
