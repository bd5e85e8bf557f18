"""How it truly was, in the run's folder."""

from __future__ import annotations

import json
from collections import deque
from pathlib import Path

import numpy as np

from contact_sim.contacts import TIP
from contact_sim.recording.truth import PERIOD_NS, TruthWriter
from drone_client.line_writer import LineWriter
from drone_client.viewing.moments import truly
from tests.unit.contact_sim.flights import BOARD, simulation


def written(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "truth.jsonl").read_text().splitlines()]


def test_the_truth_is_the_simulations(tmp_path: Path):
    """Thirty times a second, at the drone's time; the client's reader takes each line."""
    sim, writer, offset_ns = simulation(), TruthWriter(tmp_path), 10**12
    writer.begin()
    flown = {}
    for _ in range(250):
        sim.step(2)
        flown[sim.t_ns + offset_ns] = sim.truth.world_from_body.translation
        writer.look(sim, sim.t_ns + offset_ns)
    writer.close()
    lines = written(tmp_path)
    stamps = [line["t_ns"] for line in lines]
    assert len(lines) == 1_000_000_000 // (PERIOD_NS + 3_000_000) + 1
    assert all(line["t_simulated_ns"] + offset_ns == line["t_ns"] for line in lines)
    for t_ns, line in zip(stamps, lines, strict=True):
        moment = truly(line)
        np.testing.assert_allclose(moment.world_from_body.translation, flown[t_ns], atol=1e-12)
        np.testing.assert_allclose(moment.world_from_target.matrix, BOARD.matrix, atol=1e-9)
        assert len(line["qpos"]) == sim.model.nq
    assert writer.problem() is None


def test_a_touch_between_two_lines_is_not_missed(tmp_path: Path):
    """The force of a line is the worst since the line before."""
    sim, writer = simulation(start=(2.4, 0.0, 1.5)), TruthWriter(tmp_path)
    writer.begin()
    sim.set_velocity((0.3, 0.0, 0.0), 0.0)
    for _ in range(300):
        sim.step(2)
        writer.look(sim, sim.t_ns)
    writer.look(sim, sim.t_ns + PERIOD_NS)
    writer.close()
    lines, worst_n = written(tmp_path), sim.contacts.worst_force_n[TIP]
    assert worst_n > 1.0
    assert max(line["tip_force_n"] for line in lines) == round(worst_n, 4)
    assert any("drone/tip on board" in line["touches"] for line in lines)


def test_nothing_is_written_before_a_run_begins(tmp_path: Path):
    """A world that waits for its flight leaves no file."""
    sim, writer = simulation(), TruthWriter(tmp_path)
    sim.step(2)
    writer.look(sim, sim.t_ns)
    writer.close()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_takes_nothing_ends_no_flight(tmp_path: Path):
    """It is a sentence for the summary."""
    sim, writer = simulation(), TruthWriter(tmp_path / "nowhere")
    writer.begin()
    sim.step(2)
    writer.look(sim, sim.t_ns)
    writer.close()
    assert writer.problem() is not None
    assert "truth.jsonl: No such file or directory" in (writer.problem() or "")


def test_the_world_is_written_as_the_flight_begins(tmp_path: Path):
    """A flight that is killed can be filmed, too."""
    sim, writer = simulation(), TruthWriter(tmp_path)
    writer.begin()
    sim.step(2)
    for i in range(3):
        writer.look(sim, sim.t_ns + i * PERIOD_NS)
    writer.close()
    found = json.loads((tmp_path / "world.json").read_text())
    assert found == {"world": sim.scene.name, "seed": sim.scene.seed, "board": None}


def test_a_disk_that_takes_nothing_leaves_no_empty_file(tmp_path: Path, monkeypatch):
    """It would look like a record."""

    def full(self: LineWriter, batch: deque[object]) -> None:
        self.lost += len(batch)

    monkeypatch.setattr(LineWriter, "_write", full)
    sim, writer = simulation(), TruthWriter(tmp_path)
    writer.begin()
    sim.step(2)
    writer.look(sim, sim.t_ns)
    # while the flight is under way, for its summary
    assert "2 lines were not written" in (writer.problem() or "")
    writer.close()
    assert "2 lines were not written" in (writer.problem() or "")
    assert list(tmp_path.iterdir()) == []
