"""What stands behind the target: a crop of a photograph, a furnished room, or one wall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.backgrounds import Background, Kind, load_rgb
from detector_training.scenes.image import LinearImage, linear_from_srgb
from detector_training.scenes.room import random_room, random_view, render
from detector_training.scenes.surfaces import Surface, random_surface
from rgbd_wire.camera import CameraIntrinsics

SURFACE_PX = 384


@dataclass(frozen=True, slots=True)
class Library:
    """The background pictures that a split may use."""

    photos: tuple[Background, ...]
    textures: tuple[Background, ...]

    @classmethod
    def of(cls, backgrounds: Sequence[Background]) -> Library:
        """Sorted by what they are good for."""
        return cls(
            tuple(b for b in backgrounds if b.kind is Kind.PHOTO),
            tuple(b for b in backgrounds if b.kind is Kind.TEXTURE),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Backdrop:
    """What is seen behind everything else."""

    image: LinearImage  # (H, W, 3)
    depth_m: NDArray[np.float32] | None  # (H, W)
    """Along the optical axis, of a room; nobody knows that of a picture."""
    flat: bool
    """Whether it is one wall, seen head-on."""


def random_backdrop(
    rng: np.random.Generator, library: Library, camera: CameraIntrinsics
) -> Backdrop:
    """A backdrop of the camera's size, in linear light."""
    depth: NDArray[np.float32] | None = None
    kind = rng.choice(["photo", "room", "wall"], p=[0.45, 0.4, 0.15])
    flat = kind == "wall"
    if kind == "photo" and library.photos:
        image = _photo(rng, library.photos, camera.width, camera.height)
    elif flat:
        side = max(camera.width, camera.height)
        wall = np.asarray(cv2.resize(random_wall(rng, library), (side, side)))
        image = np.ascontiguousarray(wall[: camera.height, : camera.width])
    else:
        surfaces = tuple(random_wall(rng, library) for _ in range(int(rng.integers(3, 8))))
        room = random_room(rng, surfaces)
        image, _, hits = render(room, camera, random_view(rng, room))
        depth = hits.depth_m
    if rng.random() < 0.08:
        grey = image.mean(-1, keepdims=True)
        image = np.repeat(grey, 3, axis=-1)
    return Backdrop(image, depth, bool(flat))


def random_wall(rng: np.random.Generator, library: Library) -> Surface:
    """One surface: procedural, a photographed texture, or a picture hung flat."""
    pick = rng.random()
    if pick < 0.35 and library.textures:
        return random_patch(rng, library.textures, SURFACE_PX, SURFACE_PX)
    if pick < 0.45 and library.photos:
        return random_patch(rng, library.photos, SURFACE_PX, SURFACE_PX)
    return random_surface(rng, SURFACE_PX)


def random_patch(
    rng: np.random.Generator, pictures: Sequence[Background], width: int, height: int
) -> LinearImage:
    """A crop of any of the pictures; a procedural surface when none of a few can be read."""
    for _ in range(8 if pictures else 0):
        rgb = load_rgb(pictures[int(rng.integers(len(pictures)))].path)
        if rgb is None:
            continue
        h, w = rgb.shape[:2]
        scale = min(h / height, w / width) * rng.uniform(0.35, 1.0)
        ch, cw = max(8, int(height * scale)), max(8, int(width * scale))
        y, x = int(rng.integers(0, h - ch + 1)), int(rng.integers(0, w - cw + 1))
        crop = rgb[y : y + ch, x : x + cw]
        if rng.random() < 0.5:
            crop = crop[:, ::-1]
        shrinks = cw > width
        how = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
        return linear_from_srgb(
            np.ascontiguousarray(cv2.resize(crop, (width, height), interpolation=how))
        )
    surface = random_surface(rng, SURFACE_PX)
    return np.asarray(cv2.resize(surface, (width, height), interpolation=cv2.INTER_LINEAR))


def _photo(
    rng: np.random.Generator, photos: Sequence[Background], width: int, height: int
) -> LinearImage:
    image = random_patch(rng, photos, width, height)
    gain = np.exp(rng.normal(0, 0.15, 3)).astype(np.float32)
    return np.asarray(image * gain)
