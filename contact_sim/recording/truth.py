"""How the flight truly was, a line thirty times a second, as ``drone_client.viewing`` reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from contact_sim.scene import Scene
from contact_sim.simulation import Simulation
from drone_client.line_writer import LineWriter
from drone_client.run_files import TRUTH_NAME, WORLD_NAME
from drone_client.viewing.whole_file import remove_if_empty
from rgbd_wire.messages import pose_numbers

PERIOD_NS: Final = 33_000_000
ON_DISK_S: Final = 5.0
MAX_LINES: Final = 200_000
"""Two hours at that rate."""


class TruthWriter:
    """Looks at every turn of a simulation; nobody waits for it, nor for its disk."""

    def __init__(self, folder: Path) -> None:
        self._unopened: str | None = None
        self._path = folder / TRUTH_NAME
        self._world_path = folder / WORLD_NAME
        self._lines: LineWriter | None = None
        self._left = MAX_LINES
        self._due_ns = 0
        self._written_ns = 0
        """Simulated time of the last line."""

    def begin(self) -> None:
        """Open the file; nothing is written before. A disk that takes it not is a ``problem``."""
        try:
            self._lines = LineWriter({TRUTH_NAME: self._path, WORLD_NAME: self._world_path})
        except OSError as error:
            self._unopened = f"{self._path}: {error.strerror}"

    def look(self, simulation: Simulation, now_ns: int) -> None:
        """Take the moment.

        Args:
            simulation: between two steps.
            now_ns: drone's clock.
        """
        if self._lines is None:
            return
        if now_ns < self._due_ns or self._left <= 0:
            return
        self._left -= 1
        if self._due_ns == 0:
            self._lines.put(WORLD_NAME, _world(simulation.scene))
        self._due_ns = now_ns + PERIOD_NS
        self._lines.put(TRUTH_NAME, truth_line(simulation, now_ns, self._written_ns))
        self._written_ns = simulation.t_ns

    def problem(self) -> str | None:
        """Why not all of it so far was written; waits a moment for what is on its way."""
        lines = self._lines
        if lines is None:
            return self._unopened
        if not lines.on_disk(ON_DISK_S):
            return f"{self._path}: the disk takes too long"
        return f"{self._path}: {lines.lost} lines were not written" if lines.lost else None

    def close(self) -> None:
        """Write what is left."""
        if self._lines is not None:
            self._lines.close()
            if self._lines.lost:
                remove_if_empty(self._path)
                remove_if_empty(self._world_path)


def _world(scene: Scene) -> dict[str, Any]:
    """What builds the world again."""
    return {"world": scene.name, "seed": scene.seed, "board": scene.facts.get("board")}


def truth_line(simulation: Simulation, now_ns: int, since_ns: int = 0) -> dict[str, Any]:
    """A line of ``truth.jsonl``.

    Args:
        simulation: between two steps.
        now_ns: drone's clock.
        since_ns: simulated time of the line before: what touched after it is in this one, and the
            worst force of the tip.
    """
    truth, snapshot = simulation.truth, simulation.snapshot()
    return {
        "t_ns": now_ns,
        "t_simulated_ns": truth.t_ns,
        "world_from_body": list(pose_numbers(truth.world_from_body)),
        "world_from_target": list(pose_numbers(simulation.scene.world_from_target)),
        "velocity_mps": [round(v, 5) for v in truth.velocity_world.tolist()],
        "tip_force_n": round(simulation.contacts.worst_tip_force_since(since_ns), 4),
        "arm_m": round(truth.arm_m, 6),
        "drift_m": round(simulation.drift_m, 5),
        "touches": [f"{part} on {other}" for part, other in simulation.contacts.since(since_ns)],
        "lamps_out": sorted(snapshot.lamps_out),
        "qpos": snapshot.qpos.tolist(),
    }
