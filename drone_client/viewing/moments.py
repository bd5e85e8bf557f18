"""What happened in a flight, a value for each moment, from the lines of a run's files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from drone_client.gate import Verdict
from drone_client.run_files import EVENTS_NAME, LEDGER_NAME, POSES_NAME, TICKS_NAME, TRUTH_NAME
from rgbd_wire.geometry import Array, Pose
from rgbd_wire.messages import pose_of

Line: TypeAlias = dict[str, Any]


class Level(StrEnum):
    """How much a sentence matters."""

    INFO = "info"
    WARNING = "warning"


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """Where the drone believed to be."""

    t_ns: int
    """When that held; like all times here on the drone's clock."""
    world_from_body: Pose
    velocity_world: Array | None  # (3,) [m/s]


@dataclass(frozen=True, slots=True, eq=False)
class Pictured:
    """The camera took a picture."""

    t_ns: int
    """Middle of the exposure."""
    path: Path
    """A JPEG file."""


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """The fate of a frame became known."""

    t_ns: int
    t_capture_ns: int
    verdict: str
    """The gate's; of a frame that nobody answered, its fate."""
    camera_from_target: Pose | None
    world_from_target: Pose | None
    """As composed with the drone's pose at the exposure; None: no target, or it knew none."""
    line: Line
    """Of the ledger."""

    @property
    def accepted(self) -> bool:
        """The gate let it through."""
        return self.verdict == Verdict.ACCEPTED.value


@dataclass(frozen=True, slots=True, eq=False)
class Ticked:
    """The control loop decided."""

    t_ns: int
    line: Line


@dataclass(frozen=True, slots=True, eq=False)
class Said:
    """Something happened to the run."""

    t_ns: int
    sentence: str
    level: Level


@dataclass(frozen=True, slots=True, eq=False)
class Truly:
    """How it really was, which only a simulator knows."""

    t_ns: int
    world_from_body: Pose
    world_from_target: Pose
    tip_force_n: float
    arm_m: float
    """By how much the arm is pressed in."""
    line: Line


Moment: TypeAlias = Moved | Pictured | Settled | Ticked | Said | Truly

WARNINGS: Final = frozenset(
    {"ack_timeout", "camera_lost", "control_stuck", "not_taken", "odometry_jumped", "suspect"}
    | {"refused_result", "vio_jumped"}
)
_SILENT: Final = frozenset({"copy", "late_result", "waits_for_other_copy"})
"""Events by the dozen that nobody reads."""


def moved(line: Line) -> Moved:
    """Of a line of ``poses.jsonl``."""
    velocity = line.get("velocity_mps")
    return Moved(
        int(line["t_ns"]),
        pose_of(line["world_from_body"]),
        None if velocity is None else np.array(velocity, dtype=np.float64).reshape(3),
    )


def settled(line: Line) -> Settled:
    """Of a line of ``ledger.jsonl``."""
    t_capture_ns = int(line["t_capture_ns"])
    t_ns = line.get("t4_ns") or line.get("t1_ns") or t_capture_ns
    return Settled(
        int(t_ns),
        t_capture_ns,
        str(line.get("verdict") or line["fate"]),
        _maybe(line.get("camera_from_target")),
        _maybe(line.get("world_from_target")),
        line,
    )


def ticked(line: Line) -> Ticked:
    """Of a line of ``ticks.jsonl``."""
    return Ticked(int(line["t_ns"]), line)


def said(line: Line) -> Said | None:
    """Of a line of ``events.jsonl``; None: nothing for people."""
    event = str(line["event"])
    if event in _SILENT:
        return None
    level = Level.WARNING if event in WARNINGS else Level.INFO
    return Said(int(line["t_ns"]), _sentence(event, line), level)


def truly(line: Line) -> Truly:
    """Of a line of ``truth.jsonl``."""
    return Truly(
        int(line["t_ns"]),
        pose_of(line["world_from_body"]),
        pose_of(line["world_from_target"]),
        float(line["tip_force_n"]),
        float(line["arm_m"]),
        line,
    )


READERS: Final[dict[str, Callable[[Line], Moment | None]]] = {
    POSES_NAME: moved,
    LEDGER_NAME: settled,
    TICKS_NAME: ticked,
    EVENTS_NAME: said,
    TRUTH_NAME: truly,
}
"""How the lines of each file are read."""


def _maybe(numbers: Any) -> Pose | None:
    return None if numbers is None else pose_of(numbers)


def _sentence(event: str, line: Line) -> str:
    match event:
        case "phase":
            return f"{line['before']} -> {line['after']}: {line['sentence']}"
        case "worker":
            why = f" ({line['why']})" if line.get("why") else ""
            return f"frames go to {line['now'] or 'nobody'}{why}"
        case _:
            told = {k: v for k, v in line.items() if k not in ("t_ns", "event", "standings")}
            named = ", ".join(f"{key} {_short(value)}" for key, value in told.items())
            return f"{event.replace('_', ' ')}" + (f": {named}" if named else "")


def _short(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
