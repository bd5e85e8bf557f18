"""Rays into a world: what they meet first, and how far away."""

from __future__ import annotations

import math

import mujoco
import numpy as np


class Rays:
    """Of a world that is compiled once."""

    def __init__(self, spec):
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)

    def ray(self, start, direction, group=None):
        """How far it is to whatever is seen or touched, or to one of these, and its name."""
        chosen = None if group is None else (np.arange(6) == group).astype(np.uint8)
        hit = np.zeros(1, np.int32)
        ahead = np.asarray(direction, float) / np.linalg.norm(direction)
        far = mujoco.mj_ray(
            self.model, self.data, np.asarray(start, float), ahead, chosen, 1, -1, hit
        )
        return (math.inf, "") if far < 0 else (far, self.model.geom(int(hit[0])).name)
