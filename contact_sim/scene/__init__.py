"""What stands in the world: its geometry, its light, and where the target and the drone are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from contact_sim.chance import MAX_SEED
from contact_sim.errors import WorldError
from drone_client.cbf.vector import ZERO, Vec3

if TYPE_CHECKING:
    import mujoco
    import numpy as np
    from numpy.typing import NDArray

    from contact_sim.scene.textures import Paint
    from rgbd_wire.geometry import Array, Pose

WORLDS = ("tunnel", "refinery")
BOARDS = ("clean", "scratched", "glossy")
"""States of the print: fresh, worn by years of work, under a film that mirrors lamps."""

SEEN_GROUP = 0
"""Geoms that are seen, by cameras and lidars; the drone's own belong to it too."""
TOUCHED_GROUP = 3
"""Geoms that are only touched: plain shapes that stand in for a rough surface, never drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """A lamp that a camera can look into."""

    name: str
    """Of its light in the model."""
    position_world: Array  # (3,) [m]
    strength: float
    """Glare at 1 m, as a share of what makes the picture white."""


@dataclass(frozen=True, slots=True, eq=False)
class Sun:
    """The sun, which a camera can look into where nothing stands before it."""

    direction_world: Array  # (3,)
    """Unit vector from the ground to the sun."""
    strength: float
    """Glare, as a share of what makes the picture white."""


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """What the cameras' models must know of a world's light besides the rendered picture."""

    level: float
    """What a rendered white comes to on the sensor in its longest exposure without gain; over one
    the exposure is shortened, far below one the picture is lifted, noise and all."""
    haze_per_m: float
    """Extinction of dust or mist: light falls to exp(-haze z) over z metres [1/m]."""
    haze_rgb: tuple[float, float, float]
    """What endless haze looks like, as a rendered colour in [0, 1]."""
    dust: float
    """Grains that are lit well enough to be seen in one picture, on average."""
    projector: float
    """How well the depth camera's infrared pattern shows on things at 1 m, in [0, 1]: the sun
    drowns it."""
    over: float = 1.0
    """How much more light than it wants the automatic exposure lets in: dark things rule it."""
    lamps: tuple[Lamp, ...] = ()
    sun: Sun | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A world without a drone, and what must be known to fly in it."""

    bare: mujoco.MjSpec
    """The world without its textures: all that can be touched, and all that a lidar sees."""
    name: str
    seed: int
    world_from_target: Pose
    """Of the board; its front is the plane x = 0."""
    world_from_body: Pose
    """Where the drone hovers at the start: 2 to 3.5 m before the board, nothing in between. Its
    heading may be off by so much that the board is not in view."""
    floor_m: float
    """Height of the floor in ``world`` where it is highest near the way of the drone."""
    ceiling_m: float | None
    """Height of the ceiling where it is lowest near the way of the drone; None: open sky."""
    lamps: tuple[str, ...]
    """Names of the model's lights that may go out."""
    light: Light
    facts: Mapping[str, Any]
    """What was drawn by chance, for the log."""
    paints: Mapping[str, Paint] = field(default_factory=dict)
    """What paints the textures of materials, by name."""
    wind_world: Vec3 = ZERO
    """Its mean [m/s], where it blows to; gusts are the simulation's."""

    @cached_property
    def spec(self) -> mujoco.MjSpec:
        """The world with its textures, painted when it is first asked for."""
        # it needs this module's types
        from contact_sim.scene.textures import put_on

        spec = self.bare.copy()
        for name, paint in self.paints.items():
            put_on(spec, name, paint())
        return spec


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """All that a picture depends on: where everything is, and which lamps are out."""

    t_ns: int
    """Simulated time."""
    qpos: NDArray[np.float64]  # (nq,)
    lamps_out: frozenset[str] = frozenset()


def build_scene(world: str, seed: int, board: str = "clean") -> Scene:
    """The world of a seed; the same one every time.

    Args:
        world: one of ``WORLDS``.
        seed: draws its size, slope, clutter, lamps, sun, the board's place and the start.
        board: one of ``BOARDS``.

    Raises:
        WorldError: there is no such world, board or seed.
    """
    # they need this module's types
    from contact_sim.scene.refinery import build_refinery
    from contact_sim.scene.tunnel import build_tunnel

    builders = {"tunnel": build_tunnel, "refinery": build_refinery}
    if world not in builders:
        raise WorldError(f"no world {world!r}; there are: {', '.join(WORLDS)}")
    if board not in BOARDS:
        raise WorldError(f"no board {board!r}; there are: {', '.join(BOARDS)}")
    if not 0 <= seed <= MAX_SEED:
        raise WorldError(f"a seed is a whole number from 0 to {MAX_SEED}, not {seed}")
    return builders[world](seed, board)
