"""What there was to see at each moment of a flight: picture, answer, control tick and truth."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from contact_sim.errors import FilmError
from contact_sim.scene import Snapshot
from drone_client.pose_buffer import PoseBuffer
from drone_client.viewing.facts import FlightFacts
from drone_client.viewing.moments import Line, Moment, Moved, Pictured, Said, Settled, Ticked, Truly
from drone_client.viewing.run_folder import RunFolder
from rgbd_wire.geometry import Pose

LEAD_NS = 500_000_000
"""So long before the mission begins the film begins."""
COORDINATES = 8
"""Of a drone: its place, its attitude, its arm."""
TAIL_NS = 1_000_000_000
"""And so long after the last control tick it ends."""


class Instant(NamedTuple):
    """One picture of a film."""

    t_ns: int
    """Drone's clock."""
    truth: Truly
    picture: Pictured | None
    """The newest that the camera had taken."""
    answer: Settled | None
    """What became of that one, also when it came later."""
    tick: Ticked | None
    known: Pose | None
    """``camera_from_target`` of that picture, by what the drone knew at the time: the newest answer
    that it had accepted, and its own odometry. None: nothing, or not where it was."""


class Reel:
    """A flight that is over."""

    def __init__(self, facts: FlightFacts, moments: Sequence[Moment]) -> None:
        """Sort what happened.

        Raises:
            FilmError: nobody wrote down how it truly was.
        """
        self.facts = facts
        self.truths = [m for m in moments if isinstance(m, Truly)]
        self.ticks = [m for m in moments if isinstance(m, Ticked)]
        self.answers = [m for m in moments if isinstance(m, Settled)]
        self.sayings = [m for m in moments if isinstance(m, Said)]
        self._pictures = [m for m in moments if isinstance(m, Pictured)]
        if len(self.truths) < 2:
            raise FilmError("there is no flight to film: nothing was written of how it truly was")
        if any("t_simulated_ns" not in m.line or not _is_place(m.line) for m in self.truths):
            raise FilmError("how it truly was is not written as this simulator does")
        self._poses = PoseBuffer(len(moments) + 1)
        for m in moments:
            if isinstance(m, Moved):
                self._poses.add(m.t_ns, m.world_from_body)
        self._known = [m for m in self.answers if m.accepted and m.world_from_target is not None]
        self._known_ns = [m.t_ns for m in self._known]
        self._by_capture = {m.t_capture_ns: m for m in self.answers}
        self._truth_ns, self._tick_ns, self._picture_ns = (
            [m.t_ns for m in row] for row in (self.truths, self.ticks, self._pictures)
        )
        first_ns = self.truths[0].t_ns
        begun = [t.t_ns for t in self.ticks if t.line.get("phase") != "hold"]
        self.start_ns = max(first_ns, begun[0] - LEAD_NS) if begun else first_ns
        ended_ns = self.ticks[-1].t_ns + TAIL_NS if self.ticks else self.truths[-1].t_ns
        self.end_ns = max(min(self.truths[-1].t_ns, ended_ns), self.start_ns + 1)

    @property
    def has_pictures(self) -> bool:
        """Whether the drone's own were recorded."""
        return bool(self._pictures)

    @property
    def missing_s(self) -> float:
        """By how much the record of how it truly was ends before the flight."""
        last_ns = self.ticks[-1].t_ns if self.ticks else self.truths[-1].t_ns
        return max(0.0, (last_ns - self.truths[-1].t_ns) / 1e9)

    def times_ns(self, rate_hz: float) -> list[int]:
        """When the film's pictures are."""
        period_ns = round(1e9 / rate_hz)
        return list(range(self.start_ns, self.end_ns + 1, period_ns))

    def at(self, t_ns: int) -> Instant:
        """What was there to see."""
        number = bisect_right(self._picture_ns, t_ns) - 1
        picture = self._pictures[number] if number >= 0 else None
        tick = bisect_right(self._tick_ns, t_ns) - 1
        return Instant(
            t_ns,
            self.truths[max(0, bisect_right(self._truth_ns, t_ns) - 1)],
            picture,
            None if picture is None else self._by_capture.get(picture.t_ns),
            self.ticks[tick] if tick >= 0 else None,
            None if picture is None else self._known_at(t_ns, picture.t_ns),
        )

    def _known_at(self, t_ns: int, t_capture_ns: int) -> Pose | None:
        number = bisect_right(self._known_ns, t_ns) - 1
        world_from_body = self._poses.at(t_capture_ns)
        if number < 0 or world_from_body is None:
            return None
        world_from_target = self._known[number].world_from_target
        assert world_from_target is not None
        world_from_camera = world_from_body @ self.facts.body_from_camera
        return world_from_camera.inverse() @ world_from_target

    def snapshot(self, t_ns: int) -> Snapshot:
        """Where everything truly was, between two looks as if on a straight way."""
        after = bisect_right(self._truth_ns, t_ns)
        before = self.truths[max(0, after - 1)]
        then = self.truths[min(after, len(self.truths) - 1)]
        p, q = (np.array(m.line["qpos"], dtype=np.float64) for m in (before, then))
        span_ns = then.t_ns - before.t_ns
        share = min(1.0, max(0.0, (t_ns - before.t_ns) / span_ns)) if span_ns > 0 else 0.0
        lamps = frozenset(map(str, before.line.get("lamps_out", ())))
        return Snapshot(int(before.line["t_simulated_ns"]), _between(p, q, share), lamps)


def load_reel(run: Path) -> tuple[Reel, int]:
    """The flight in a run's folder, and how many lines of it could not be read.

    Raises:
        FilmError: it is none of a simulator's.
        OutputError: no run is there.
    """
    folder = RunFolder(run)
    facts = folder.facts()
    if facts is None:
        raise FilmError(f"{run} is no flight: there is no flight.json in it")
    return Reel(facts, folder.grown()), folder.unread


def _is_place(line: Line) -> bool:
    """Whether there are a drone's coordinates: place, attitude, arm."""
    qpos = line.get("qpos")
    return (
        isinstance(qpos, list)
        and len(qpos) == COORDINATES
        and all(isinstance(v, int | float) for v in qpos)
    )


def _between(p: np.ndarray, q: np.ndarray, share: float) -> np.ndarray:
    """Coordinates between two; the drone's quaternion, from the fourth on, stays one."""
    mixed = (1.0 - share) * p + share * q
    mixed[3:7] /= np.linalg.norm(mixed[3:7])
    return np.asarray(mixed)
