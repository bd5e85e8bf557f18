"""A flight in lockstep as the arrays that figures draw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from contact_sim.chance import stream
from contact_sim.flight.outcome import Witness
from contact_sim.lockstep.eyes import Eyes, ModelEyes
from contact_sim.lockstep.flight import Flown, LockstepFlight, LockstepSettings
from contact_sim.scene import Scene
from contact_sim.sensing import d455
from contact_sim.simulation import Simulation
from drone_client.cbf import Funnel
from drone_client.mission import Phase
from drone_client.reception import Reception
from link_emulator.profiles import profile
from rgbd_wire.geometry import Array

NEAR_M = 0.1
"""Nearer to the board than this, the force is written down at every turn."""


class Push(NamedTuple):
    """The arm at a moment near the board."""

    t_s: float
    force_n: float
    """Of the tip, in the last physics step."""
    arm_m: float
    """By how much it is pressed in."""


class CloseWitness(Witness):
    """Also writes down the force, 250 times a second, while the tip is near the board."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene.world_from_target)
        self.pushes: list[Push] = []
        self._board_from_world = scene.world_from_target.inverse()

    def look(self, simulation: Simulation) -> None:
        """Take the moment."""
        super().look(simulation)
        truth = simulation.truth
        if (self._board_from_world @ truth.tip_world)[0] < NEAR_M:
            self.pushes.append(Push(truth.t_ns / 1e9, truth.tip_force_n, truth.arm_m))


@dataclass(frozen=True, eq=False)
class Run:
    """A flight that is over. Positions are of the unloaded tip in the frame ``target``."""

    label: str
    world: str
    seed: int
    flown: Flown
    funnel: Funnel
    receptions: tuple[Reception, ...]
    pushes: tuple[Push, ...]
    target_from_world: Array  # (3, 3)
    """Rotation, of the truth."""

    @cached_property
    def t_s(self) -> Array:
        """(n,) of the truth."""
        return np.array([row.t_ns / 1e9 for row in self.flown.rows])

    @cached_property
    def tip(self) -> Array:
        """(n, 3) where the tip truly was."""
        return np.array([row.tip_target for row in self.flown.rows])

    @cached_property
    def h(self) -> Array:
        """(n,) the barrier where the tip truly was."""
        return np.array([self.funnel.h(row.tip_target) for row in self.flown.rows])

    @cached_property
    def yaw_error_rad(self) -> Array:
        """(n,)."""
        return np.array([row.yaw_error_rad for row in self.flown.rows])

    @cached_property
    def velocity_target(self) -> Array:
        """(n, 3) of the body's origin, as it truly flew."""
        world = np.array([row.velocity_world for row in self.flown.rows])
        return np.asarray(world @ self.target_from_world.T)

    @cached_property
    def tick_t_s(self) -> Array:
        """(m,) of the control ticks."""
        return np.array([tick.t_ns / 1e9 for tick in self.flown.ticks])

    @cached_property
    def command_target(self) -> Array:
        """(m, 3) commanded velocity of the body."""
        world = np.array([tick.decision.command.velocity_world for tick in self.flown.ticks])
        return np.asarray(world @ self.target_from_world.T)

    @cached_property
    def yaw_rate_radps(self) -> Array:
        """(m,) commanded."""
        return np.array([tick.decision.command.yaw_rate_radps for tick in self.flown.ticks])

    @cached_property
    def h_certain(self) -> Array:
        """(m,) the barrier that the filter was certain of; NaN where it was not asked."""
        safe = [tick.decision.safe for tick in self.flown.ticks]
        return np.array([np.nan if s is None else s.h_robust for s in safe])

    @cached_property
    def phases(self) -> list[tuple[float, Phase]]:
        """When each phase of the mission began."""
        starts: list[tuple[float, Phase]] = []
        for tick in self.flown.ticks:
            mission = tick.decision.mission
            if mission is not None and (not starts or starts[-1][1] is not mission.phase):
                starts.append((tick.t_ns / 1e9, mission.phase))
        return starts

    def began(self, phase: Phase) -> float | None:
        """When it went into a phase first [s]; None: never."""
        return next((t_s for t_s, p in self.phases if p is phase), None)

    @property
    def attempt_s(self) -> float:
        """When the approach began that came to contact; the start where none did."""
        contact_s = self.began(Phase.CONTACT)
        starts = [t_s for t_s, p in self.phases if p is Phase.APPROACH]
        before = [t_s for t_s in starts if contact_s is not None and t_s <= contact_s]
        return before[-1] if before else 0.0

    @property
    def touch_s(self) -> float | None:
        """When the tip first pressed on something in that approach; None: never."""
        pressed = (p.t_s for p in self.pushes if p.force_n > 0.0 and p.t_s >= self.attempt_s)
        return next(pressed, None)

    @property
    def touch_attempt(self) -> int | None:
        """Which attempt touched the board first; None: none did."""
        touched_ns = self.flown.outcome.touched_ns
        if touched_ns is None:
            return None
        missions = [tick.decision.mission for tick in self.flown.ticks if tick.t_ns <= touched_ns]
        return next((m.attempts for m in reversed(missions) if m is not None), 0)

    @property
    def contact_end_s(self) -> float:
        """When it went back from contact; the end of the flight where it did not."""
        contact_s = self.began(Phase.CONTACT)
        ends = [t_s for t_s, _ in self.phases if contact_s is not None and t_s > contact_s]
        return ends[0] if ends else float(self.t_s[-1])


def fly(
    label: str,
    scene: Scene,
    seed: int,
    link: str = "wifi",
    eyes: Eyes | None = None,
    settings: LockstepSettings | None = None,
    before_tick: Callable[[LockstepFlight], None] = lambda flight: None,
) -> Run:
    """Fly one to its end.

    Args:
        label: what the figures call it.
        scene: the world.
        seed: of chance in flight.
        link: name of a link profile.
        eyes: who looks; None: the model of a localiser.
        settings: of all parts.
        before_tick: as in ``LockstepFlight.fly``.
    """
    looking = eyes or ModelEyes(d455().color, stream(seed, "eyes"))
    flight = LockstepFlight(scene, seed, profile(link), lambda _: looking, d455(), settings)
    witness = flight.witness = CloseWitness(scene)
    flown = flight.fly(before_tick)
    return Run(
        label,
        scene.name,
        seed,
        flown,
        flight.settings.parts.control.filter.funnel,
        tuple(flight.receptions),
        tuple(witness.pushes),
        scene.world_from_target.rotation.T,
    )
