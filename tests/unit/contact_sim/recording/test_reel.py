"""What there was to see at each moment of a flight."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from contact_sim.errors import FilmError
from contact_sim.recording.reel import Reel, load_reel
from tests.unit.contact_sim.flights import AIRFRAME, BOARD
from tests.unit.contact_sim.recording.flown import DELAY_NS, MS, START_NS, fly
from tests.unit.drone_client.view_builders import write_lines, write_run


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Reel:
    return load_reel(fly(tmp_path_factory.mktemp("flight")))[0]


def test_the_newest_picture_has_its_own_answer(reel: Reel):
    """Also when that came only later: the lines lie over the picture that they were found in."""
    instant = reel.at(START_NS + 250 * MS)
    assert instant.picture is not None
    assert instant.answer is not None
    assert instant.picture.t_ns == instant.answer.t_capture_ns == START_NS + 200 * MS
    assert instant.answer.t_ns > instant.t_ns


def test_what_was_known_is_the_newest_answer_by_then(reel: Reel):
    """None before the first; then the board where the drone believed it to be, in that picture."""
    assert reel.at(START_NS + DELAY_NS - MS).known is None
    instant = reel.at(START_NS + 500 * MS)
    assert instant.known is not None
    assert instant.answer is not None
    assert instant.answer.camera_from_target is not None
    np.testing.assert_allclose(
        instant.known.matrix, instant.answer.camera_from_target.matrix, atol=1e-6
    )


def test_tick_and_truth_are_the_newest(reel: Reel):
    """Nothing from the future."""
    t_ns = START_NS + 333 * MS
    instant = reel.at(t_ns)
    assert instant.tick is not None
    assert t_ns - 20 * MS <= instant.tick.t_ns <= t_ns
    assert t_ns - 40 * MS <= instant.truth.t_ns <= t_ns


def test_between_two_looks_the_drone_moves_on(reel: Reel):
    """The film has no steps of a thirtieth of a second; the attitude stays one."""
    xs = [reel.snapshot(START_NS + 500 * MS + i * 5 * MS).qpos for i in range(20)]
    steps = np.diff([q[0] for q in xs])
    assert (steps > 0).all()
    assert steps.max() < 2.5 * steps.min()
    np.testing.assert_allclose([np.linalg.norm(q[3:7]) for q in xs], 1.0, atol=1e-12)


def test_a_snapshot_is_the_truth(reel: Reel):
    """At the moment of a line it is that line."""
    truth = reel.truths[7]
    np.testing.assert_allclose(
        reel.snapshot(truth.t_ns).qpos[:3], truth.world_from_body.translation, atol=1e-9
    )
    assert np.allclose((truth.world_from_target).matrix, BOARD.matrix)
    assert reel.facts.body_from_tip.translation[0] == AIRFRAME.body_from_tip.translation[0]


def test_the_film_has_the_length_of_the_flight(reel: Reel):
    """At its rate, from the mission's beginning to its end."""
    times = reel.times_ns(25.0)
    assert times[0] >= START_NS
    assert np.unique(np.diff(times)).tolist() == [40 * MS]
    assert 23 <= len(times) <= 26


def test_a_flight_without_a_simulator_cannot_be_filmed(tmp_path: Path):
    """There is no world to draw."""
    with pytest.raises(FilmError, match="nothing was written of how it truly was"):
        load_reel(write_run(tmp_path / "real"))
    with pytest.raises(FilmError, match=r"there is no flight\.json"):
        load_reel(write_run(tmp_path / "replay", known=False))


def test_a_truth_of_another_simulator_is_told(tmp_path: Path):
    """One without the coordinates that this one draws by."""
    run = fly(tmp_path, 0.2)
    lines = [json.loads(line) for line in (run / "truth.jsonl").read_text().splitlines()]
    for wrong in (None, [0.0] * 7, ["x"] * 8):
        write_lines(run / "truth.jsonl", [line | {"qpos": wrong} for line in lines])
        with pytest.raises(FilmError, match="not written as this simulator does"):
            load_reel(run)


def test_a_record_that_was_cut_off_is_filmed_as_far_as_it_goes(tmp_path: Path):
    """Half a line is left out and counted; what is missing is known."""
    run = fly(tmp_path)
    whole = (run / "truth.jsonl").read_bytes()
    (run / "truth.jsonl").write_bytes(whole[: len(whole) // 2] + b"\n")
    reel, unread = load_reel(run)
    assert unread == 1
    assert reel.end_ns == reel.truths[-1].t_ns
    assert 0.3 < reel.missing_s < 0.7
    assert reel.has_pictures
