"""Who touches whom: which part of the drone, with which force, and how fast it came."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import mujoco
import numpy as np

from contact_sim.errors import VehicleError
from contact_sim.vehicle.body import Motion

TIP = "drone/tip"
BOARD = "board"
KEPT_IMPACTS = 1000
KEPT_FORCES = 100
APART_NS = 20_000_000
"""Two parts that have been apart for less than this never were: a stiff touch rattles."""


class Touch(NamedTuple):
    """A part of the drone on something, in one physics step."""

    part: str
    """Geom of the drone."""
    other: str
    """What it is on; ``geom N`` where the world's geom has no name."""
    force_n: float
    """Along the normal, never negative."""


class Impact(NamedTuple):
    """The beginning of a touch."""

    t_ns: int
    part: str
    other: str
    speed_mps: float
    """Closing speed along the surface's normal, in the step before."""


class Contacts:
    """Looks at the contacts of every physics step, and remembers what matters of a flight.

    Raises:
        VehicleError: there is no drone in the model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.touches: tuple[Touch, ...] = ()
        """Of the last step."""
        self.impacts: list[Impact] = []
        """Of the flight, in order; the first thousand."""
        self.fastest_mps: dict[tuple[str, str], float] = {}
        """By part and what it met: the fastest impact, also of those that are not kept."""
        self.worst_force_n: dict[str, float] = {}
        """By part; of all that it touched at once."""
        self._tip_forces: deque[tuple[int, float]] = deque(maxlen=KEPT_FORCES)
        self._model = model
        self._names = [
            mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, i) or f"geom {i}"
            for i in range(model.ngeom)
        ]
        drone = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "drone")
        if drone < 0:
            raise VehicleError("the model has no body 'drone'; add_drone makes it")
        roots = model.body_rootid[model.geom_bodyid]
        self._own: list[bool] = (roots == drone).tolist()
        self._touched_ns: dict[tuple[int, int], int] = {}
        self._newest_ns = -1
        self._wrench = np.zeros(6)

    @property
    def tip_force_n(self) -> float:
        """Of all that the tip touches, in the last step."""
        return sum(touch.force_n for touch in self.touches if touch.part == TIP)

    @property
    def worst_impact_mps(self) -> dict[str, float]:
        """By part; zero of one that was only ever left."""
        worst: dict[str, float] = {}
        for (part, _), speed_mps in self.fastest_mps.items():
            worst[part] = max(speed_mps, worst.get(part, 0.0))
        return worst

    def since(self, t_ns: int) -> tuple[tuple[str, str], ...]:
        """Which part was on what in any step that began at a time or later."""
        if self._newest_ns < t_ns:
            return ()
        return tuple(
            (self._names[part], self._names[other])
            for (part, other), last_ns in self._touched_ns.items()
            if last_ns >= t_ns
        )

    def worst_tip_force_since(self, t_ns: int) -> float:
        """The tip's worst force [N] in the steps that began at a time or later; of 200 ms."""
        return max((force_n for at_ns, force_n in self._tip_forces if at_ns >= t_ns), default=0.0)

    def look(self, data: mujoco.MjData, t_ns: int, before: Motion) -> None:
        """Take the contacts of a step that was just made.

        Args:
            data: after the step; its contacts are those that acted in it.
            t_ns: begin of the step.
            before: how the drone moved when it began.
        """
        if data.ncon == 0:
            self.touches = ()
            return
        touches: list[Touch] = []
        forces: dict[str, float] = {}
        for i in range(data.ncon):
            contact = data.contact[i]
            first, second = int(contact.geom1), int(contact.geom2)
            if self._own[first] == self._own[second]:
                continue
            part, other = (first, second) if self._own[first] else (second, first)
            mujoco.mj_contactForce(self._model, data, i, self._wrench)
            force_n = max(0.0, float(self._wrench[0]))
            name = self._names[part]
            touches.append(Touch(name, self._names[other], force_n))
            forces[name] = forces.get(name, 0.0) + force_n
            last_ns = self._touched_ns.get((part, other))
            self._touched_ns[part, other] = self._newest_ns = t_ns
            if last_ns is None or t_ns - last_ns > APART_NS:
                self._hit(contact, part, other, t_ns, before)
        self.touches = tuple(touches)
        for name, force_n in forces.items():
            self.worst_force_n[name] = max(force_n, self.worst_force_n.get(name, 0.0))
        if TIP in forces:
            self._tip_forces.append((t_ns, forces[TIP]))

    def _hit(
        self, contact: mujoco.MjContact, part: int, other: int, t_ns: int, before: Motion
    ) -> None:
        name = self._names[part]
        # The normal points from the first geom to the second.
        sign = 1.0 if int(contact.geom1) == part else -1.0
        x, y, z = contact.pos.tolist()
        velocity = before.point_velocity((x, y, z), on_arm=name == TIP)
        normal = contact.frame[:3].tolist()
        speed = sign * sum(v * n for v, n in zip(velocity, normal, strict=True))
        pair = name, self._names[other]
        if len(self.impacts) < KEPT_IMPACTS:
            self.impacts.append(Impact(t_ns, *pair, speed))
        self.fastest_mps[pair] = max(speed, self.fastest_mps.get(pair, -math.inf))
