"""Shapes with texture coordinates, as triangles: what MuJoCo's own shapes do not have."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_sim.scene import SEEN_GROUP
from rgbd_wire.geometry import Array, Pose


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Triangles that are seen from outside, where their corners go round anticlockwise."""

    points: Array  # (N, 3) [m]
    normals: Array  # (N, 3)
    texture: Array  # (N, 2)
    """Right and down, in widths of the texture."""
    faces: NDArray[np.int64]  # (M, 3)


def grid(points: Array, texture: Array) -> Shape:
    """A sheet (m, n, 3) that is seen from where its rows run down and its columns right."""
    m, n = points.shape[:2]
    down = np.gradient(points, axis=0)
    right = np.gradient(points, axis=1)
    normals = np.cross(down, right)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    index = np.arange(m * n).reshape(m, n)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    faces = np.concatenate([np.column_stack([a, c, b]), np.column_stack([b, c, d])])
    return Shape(points.reshape(-1, 3), normals.reshape(-1, 3), texture.reshape(-1, 2), faces)


def panel(corner: Array, right: Array, down: Array, tile_m: float, cells: int = 1) -> Shape:
    """A flat rectangle from its upper left corner (3,) along two edges (3,) [m]."""
    along = np.linspace(0, 1, cells + 1)
    points = corner + along[None, :, None] * right + along[:, None, None] * down
    u = np.linalg.norm(right) / tile_m * along[None, :] + 0 * along[:, None]
    v = np.linalg.norm(down) / tile_m * along[:, None] + 0 * along[None, :]
    return grid(points, np.stack([u, v], -1))


def block(center: ArrayLike, size: ArrayLike, tile_m: float) -> Shape:
    """An upright box of a centre (3,) and three edges (3,) [m], along x, y and z."""
    x, y, z = np.diag(np.asarray(size, float))
    c = np.asarray(center, float)
    sides = []
    for out, right, up in ((x, y, z), (-x, -y, z), (y, -x, z), (-y, x, z), (z, y, -x), (-z, y, x)):
        sides.append(panel(c + (out - right + up) / 2, right, -up, tile_m))
    return joined(sides)


def rod(start: ArrayLike, end: ArrayLike, radius_m: float, tile_m: float, sides: int = 14) -> Shape:
    """A closed cylinder between the centres (3,) of its two ends."""
    first, last = np.asarray(start, float), np.asarray(end, float)
    length = float(np.linalg.norm(last - first))
    axis = (last - first) / length
    aside = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside)
    up = np.cross(axis, aside)
    turn = np.linspace(0, 2 * np.pi, sides + 1)
    ring = radius_m * (np.cos(turn)[:, None] * aside + np.sin(turn)[:, None] * up)
    # long ones are cut, for lamps light the corners of triangles and nothing between them
    along = np.linspace(0, 1, max(2, min(12, int(length / 0.5) + 2)))
    points = first + along[:, None, None] * (last - first) + ring
    around = max(1, round(2 * np.pi * radius_m / tile_m)) * turn / (2 * np.pi)
    lengths = along * length / tile_m
    texture = np.stack(np.broadcast_arrays(around[None, :], lengths[:, None]), -1)
    mantle = grid(points, texture)
    radial = np.broadcast_to(ring / radius_m, points.shape).reshape(-1, 3)
    mantle = Shape(mantle.points, radial, mantle.texture, mantle.faces[:, ::-1])
    disc = np.column_stack([np.cos(turn), np.sin(turn)])[:-1] * radius_m / tile_m
    fan = np.arange(1, sides - 1)
    cap = np.column_stack([0 * fan, fan, fan + 1])
    far = Shape(last + ring[:-1], np.tile(axis, (sides, 1)), disc, cap)
    near = Shape(first + ring[:-1], np.tile(-axis, (sides, 1)), disc, cap[:, ::-1])
    return joined([mantle, far, near])


def joined(shapes: Iterable[Shape]) -> Shape:
    """Several as one, which is drawn at once."""
    parts = tuple(shapes)
    starts = np.cumsum([0, *(len(p.points) for p in parts[:-1])])
    return Shape(
        np.concatenate([p.points for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.texture for p in parts]),
        np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)]),
    )


def seen_from(point: Array, shape: Shape) -> Shape:
    """The shape, turned inside out where it must be for most of it to be seen from a point (3,)."""
    corners = shape.points[shape.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if float(((point - corners[:, 0]) * across).sum()) >= 0:
        return shape
    return Shape(shape.points, -shape.normals, shape.texture, shape.faces[:, ::-1])


def moved(shape: Shape, place: Pose) -> Shape:
    """The shape turned and carried to a place."""
    return Shape(place @ shape.points, shape.normals @ place.rotation.T, shape.texture, shape.faces)


def add_shape(spec: mujoco.MjSpec, name: str, shape: Shape, material: str, **geom: object) -> None:
    """Put a shape into the world, to be seen and not to be touched."""
    faces = shape.faces.astype(np.int32).ravel()
    spec.add_mesh(
        name=name,
        uservert=shape.points.ravel(),
        usernormal=shape.normals.ravel(),
        usertexcoord=shape.texture.ravel(),
        userface=faces,
        userfacenormal=faces,
        userfacetexcoord=faces,
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=material,
        contype=0,
        conaffinity=0,
        group=SEEN_GROUP,
        **geom,
    )
