"""What stands about in a world: seen as triangles, touched as boxes and cylinders."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from contact_sim.scene import TOUCHED_GROUP, shapes
from contact_sim.scene.shapes import Shape, add_shape, joined, moved
from contact_sim.scene.textures import add_bare_material
from rgbd_wire.geometry import Array, Pose

_UPRIGHT = np.eye(3)


class Parts:
    """Shapes by material, each drawn at once, and what can be touched, in a frame of a builder's.

    What is touched is named after its material, with a number: a collision says with what it was.
    """

    def __init__(self, spec: mujoco.MjSpec, world_from_here: Pose) -> None:
        """Begin in a world; what is touched is there at once, what is seen after ``draw``."""
        self.by_look: dict[str, list[Shape]] = {}
        self._spec = spec
        self._world_from_here = world_from_here
        self._touched = 0

    def add(self, look: str, *seen: Shape) -> None:
        """What is seen and cannot be touched."""
        self.by_look.setdefault(look, []).extend(seen)

    def block(self, look: str, center: ArrayLike, size: ArrayLike, tile_m: float) -> None:
        """An upright box of a centre (3,) and three edges (3,) [m]."""
        self.add(look, shapes.block(center, size, tile_m))
        self.solid_box(look, center, size)

    def rod(
        self,
        look: str,
        start: ArrayLike,
        end: ArrayLike,
        radius_m: float,
        tile_m: float,
        sides: int = 14,
    ) -> None:
        """A cylinder between the centres (3,) of its two ends [m]."""
        self.add(look, shapes.rod(start, end, radius_m, tile_m, sides))
        self.solid_rod(look, start, end, radius_m)

    def solid_box(
        self, look: str, center: ArrayLike, size: ArrayLike, rotation: Array = _UPRIGHT
    ) -> None:
        """A box that is touched and not drawn, turned by ``rotation`` (3, 3)."""
        place = self._world_from_here @ Pose.from_rotation(rotation, np.asarray(center, float))
        self._solid(
            look,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=np.asarray(size, float) / 2,
            pos=place.translation,
            quat=place.q_wxyz,
        )

    def solid_rod(self, look: str, start: ArrayLike, end: ArrayLike, radius_m: float) -> None:
        """A cylinder that is touched and not drawn."""
        ends = (self._world_from_here @ np.asarray(p, float) for p in (start, end))
        self._solid(
            look,
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=(radius_m, 0.0, 0.0),
            fromto=np.concatenate(tuple(ends)),
        )

    def draw(self, shining: frozenset[str] = frozenset()) -> None:
        """Give the world what is seen, with bare materials; those that shine are named."""
        for look, seen in self.by_look.items():
            specular, shine = (0.35, 0.4) if look in shining else (0.0, 0.3)
            add_bare_material(self._spec, look, specular, shine)
            add_shape(self._spec, look, moved(joined(seen), self._world_from_here), look)

    def _solid(self, look: str, **geom: Any) -> None:
        self._touched += 1
        self._spec.worldbody.add_geom(name=f"{look} {self._touched}", group=TOUCHED_GROUP, **geom)
