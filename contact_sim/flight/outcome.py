"""What a flight truly came to, whatever the client believes of it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from contact_sim.contacts import BOARD, TIP
from contact_sim.simulation import Simulation
from drone_client.cbf import Funnel
from drone_client.cbf.vector import Vec3, moved
from rgbd_wire.geometry import Array, Pose, vec3

MOUTH_M: Final = Funnel().r_c_m
"""Radius of the usual funnel's mouth."""
TRACK_NS: Final = 20_000_000
RISEN_NS: Final = 200_000_000
"""A drone that has touched nothing for so long flies; what it stood on before is no collision."""
MAX_TRACK: Final = 100_000
"""Rows of the track: over half an hour."""


@dataclass(frozen=True, slots=True)
class Row:
    """The truth at a moment."""

    t_ns: int
    """Simulated time."""
    tip_target: tuple[float, float, float]
    """The unloaded tip in the board's frame [m]: x is the distance from its plane."""
    body_world: tuple[float, float, float]
    yaw_error_rad: float
    """Heading of the arm against the board's normal."""
    velocity_world: tuple[float, float, float]
    arm_m: float
    """By how much the arm is pressed in."""
    tip_force_n: float
    drift_m: float
    """Of the estimate against the truth, where it is."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """A flight in numbers; ``None`` where there was no touch."""

    touched: bool
    """The tip touched the board."""
    offset_m: float | None
    """Where it touched first, from the centre of the print."""
    touch_target_m: tuple[float, float] | None
    """The same, left and up."""
    touched_ns: int | None
    """When: simulated time."""
    closing_mps: float | None
    """Worst speed of the tip along the normal, as it met the board."""
    peak_force_n: float
    """Of the tip, in one physics step."""
    press_force_n: float | None
    """Median while it touched."""
    pressed_s: float
    outside_m: float
    """Deepest that the arm was pressed in while its tip touched anything outside the mouth."""
    collisions: tuple[str, ...]
    """What else touched what: ``part on thing``."""
    nearest_m: float
    """Of the tip's way, from the board's plane."""
    end_m: float
    """Distance of the tip from the board's plane at the end."""
    flown_s: float
    drift_m: float
    """Of the odometry at the end."""

    @property
    def safe(self) -> bool:
        """Nothing but the tip has touched anything, and not beside the mouth."""
        return not self.collisions and self.outside_m == 0.0

    def as_json(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)


class Witness:
    """Looks 50 times a second, and at every turn in which something touches; keeps what matters.

    What touched between two looks counts, also where it is off again at the second.
    """

    def __init__(self, world_from_target: Pose, mouth_m: float = MOUTH_M) -> None:
        """Nothing is seen yet.

        Args:
            world_from_target: of the board as it truly hangs.
            mouth_m: radius of the flown funnel's mouth; contact is allowed inside it.
        """
        self._mouth_m = mouth_m
        self.rows: list[Row] = []
        self._target_from_world = world_from_target.inverse()
        self._touch: Array | None = None
        self._touched_ns: int | None = None
        self._forces: list[float] = []
        self._outside_m = 0.0
        self._collisions: dict[str, None] = {}
        self._stands_ns: int | None = 0
        """When it was last seen to stand where it starts; None: it has risen."""
        self._nearest_m = math.inf
        self._touching_turns = 0
        self._looked_ns = 0
        self._last: Row | None = None
        """Also when the track is full."""

    def look(self, simulation: Simulation) -> None:
        """Take the moment, if it is one: a free flight looks the same for 20 ms."""
        due = self._last is None or simulation.t_ns - self._last.t_ns >= TRACK_NS
        met = simulation.contacts.since(self._looked_ns)
        self._looked_ns = simulation.t_ns
        if not (due or met):
            return
        truth = simulation.truth
        target_from_body = self._target_from_world @ truth.world_from_body
        forward = target_from_body.rotation[:, 0]
        tip_target = self._target_from_world @ truth.tip_world
        # Where the tip would be if the arm had not given way
        x, y, z = moved(vec3(tip_target), vec3(forward), truth.arm_m)
        self._nearest_m = min(self._nearest_m, x)
        beside_m = math.hypot(float(tip_target[1]), float(tip_target[2]))
        if beside_m > self._mouth_m and any(part == TIP for part, _ in met):
            self._outside_m = max(self._outside_m, truth.arm_m)
        flies = not self._stands(simulation.t_ns, touches=bool(met))
        for part, other in met if flies else ():
            if (part, other) != (TIP, BOARD):
                self._collisions.setdefault(f"{part} on {other}")
        if self._touch is None and (TIP, BOARD) in met:
            self._touch, self._touched_ns = tip_target, simulation.t_ns
        if truth.tip_force_n > 0.0:
            self._forces.append(truth.tip_force_n)
            self._touching_turns += 1
        if due:
            self._add_row(simulation, (x, y, z), vec3(forward))

    def _stands(self, t_ns: int, *, touches: bool) -> bool:
        """Whether the drone has not risen yet from where it was put."""
        if self._stands_ns is None:
            return False
        if touches:
            self._stands_ns = t_ns
        elif t_ns - self._stands_ns >= RISEN_NS:
            self._stands_ns = None
        return self._stands_ns is not None

    def _add_row(self, simulation: Simulation, tip_target: Vec3, forward_target: Vec3) -> None:
        truth = simulation.truth
        px, py, pz = truth.world_from_body.translation.tolist()
        vx, vy, vz = truth.velocity_world.tolist()
        self._last = Row(
            truth.t_ns,
            tip_target,
            (px, py, pz),
            math.atan2(forward_target[1], -forward_target[0]),
            (vx, vy, vz),
            truth.arm_m,
            truth.tip_force_n,
            simulation.drift_m,
        )
        if len(self.rows) < MAX_TRACK:
            self.rows.append(self._last)

    def outcome(self, simulation: Simulation, turn_s: float) -> Outcome:
        """What it came to.

        Args:
            simulation: at its end.
            turn_s: time between two looks.
        """
        contacts = simulation.contacts
        touch = self._touch
        last = self._last
        return Outcome(
            touched=touch is not None,
            offset_m=None if touch is None else math.hypot(touch[1], touch[2]),
            touch_target_m=None if touch is None else (float(touch[1]), float(touch[2])),
            touched_ns=self._touched_ns,
            closing_mps=contacts.fastest_mps.get((TIP, BOARD)),
            peak_force_n=contacts.worst_force_n.get(TIP, 0.0),
            press_force_n=float(np.median(self._forces)) if self._forces else None,
            pressed_s=self._touching_turns * turn_s,
            outside_m=self._outside_m,
            collisions=tuple(self._collisions),
            nearest_m=self._nearest_m,
            end_m=math.nan if last is None else last.tip_target[0],
            flown_s=simulation.t_ns / 1e9,
            drift_m=math.nan if last is None else last.drift_m,
        )
