"""From a perfect picture to the colour camera's: exposure, lens, flare, dust, noise, eight bits.

Rendered levels are roots of light, as a camera's own levels nearly are (gamma 2): squared, they add
up as light does; and the noise of light, the root of it, is the same in all levels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contact_sim.scene import Lamp, Light
from contact_sim.sensing.renderer import View
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Array, Pose

Floats = NDArray[np.float32]

_LIGHT_OF_LEVEL = np.square(np.arange(256, dtype=np.float32) / 255)
_COARSE = 4
"""What is smooth (haze, glare, vignetting) is worked out on every fourth pixel."""
_TILE = 1024


@dataclass(frozen=True, slots=True)
class ColorSettings:
    """What the sensor and its lens are like."""

    longest_exposure_s: float = 0.008
    """Longer ones would smear; from there on gain has to do."""
    max_gain: float = 16.0
    wanted_light: float = 0.16
    """Mean of the picture that the exposure aims at."""
    settling_s: float = 0.25
    """Time constant of the automatic exposure."""
    full_well: float = 4000.0
    """Electrons of a white pixel without gain."""
    read_noise: float = 0.0012
    """Share of white, without gain."""
    soft_px: float = 0.6
    """Sigma of the lens and of demosaicing."""
    vignette: float = 0.22
    """How much darker the corners are, about."""
    veil: float = 0.012
    """Light of a lamp of 1 at 1 m that spreads over the whole picture in the longest exposure."""


@dataclass(frozen=True, slots=True)
class Exposure:
    """How a picture was taken."""

    exposure_s: float
    gain: float


class ColorCamera:
    """The model of one colour camera; what it gives depends on its arguments alone."""

    def __init__(
        self,
        intrinsics: CameraIntrinsics,
        rng: np.random.Generator,
        settings: ColorSettings | None = None,
    ) -> None:
        self.settings = settings or ColorSettings()
        self._size = intrinsics.width, intrinsics.height
        x = np.linspace(-1, 1, -(-intrinsics.width // _COARSE), dtype=np.float32)
        y = np.linspace(-1, 1, -(-intrinsics.height // _COARSE), dtype=np.float32)
        corner = np.float32(self.settings.vignette / 2)
        fall = 1 / (1 + corner / 2 * (x[None, :] ** 2 + y[:, None] ** 2)) ** 2
        self._vignette: Floats = fall.astype(np.float32)
        self._grain = _grain(rng, (intrinsics.height + _TILE // 4, intrinsics.width + _TILE // 4))

    def metered(
        self, view: View, light: Light, before: Exposure | None = None, elapsed_s: float = 0.0
    ) -> Exposure:
        """The exposure that suits a picture, or what it has come to on the way there.

        Args:
            view: what is seen.
            light: of the world.
            before: the last exposure; None: the first picture, which has had time.
            elapsed_s: since then.
        """
        s = self.settings
        seen = _LIGHT_OF_LEVEL[view.color[::8, ::8, 1]]
        mean = light.level * float(0.5 * seen.mean() + 0.5 * seen[15:-15, 20:-20].mean())
        wanted = light.over * s.wanted_light / max(mean, 1e-6)
        if before is not None:
            old = before.exposure_s / s.longest_exposure_s * before.gain
            wanted = old * (wanted / old) ** (1 - math.exp(-elapsed_s / s.settling_s))
        return Exposure(
            s.longest_exposure_s * float(np.clip(wanted, 1e-3, 1.0)),
            float(np.clip(wanted, 1.0, s.max_gain)),
        )

    def expose(
        self,
        view: View,
        light: Light,
        exposure: Exposure,
        rng: np.random.Generator,
        swept_px: tuple[float, float] = (0.0, 0.0),
        lamps_out: frozenset[str] = frozenset(),
    ) -> NDArray[np.uint8]:
        """The picture (H, W, 3) RGB that the camera gives.

        Args:
            view: what a perfect camera sees.
            light: of the world.
            exposure: how long, and with how much gain.
            rng: draws grain and dust.
            swept_px: how far the picture moved while the shutter was open, right and down.
            lamps_out: names of lamps that do not shine.
        """
        s = self.settings
        image: Floats = cv2.LUT(view.color, _LIGHT_OF_LEVEL)
        image = cv2.GaussianBlur(image, (0, 0), s.soft_px)
        if math.hypot(*swept_px) > 0.7:
            image = cv2.filter2D(image, -1, motion_kernel(*swept_px))
        lift = light.level * exposure.gain * exposure.exposure_s / s.longest_exposure_s
        share, added = self._air(view, light, rng, lift, lamps_out)
        share = cv2.resize(share * np.float32(lift), self._size)
        image = cv2.multiply(image, cv2.merge([share, share, share]))
        image = cv2.add(image, cv2.resize(added, self._size))
        image = image + np.float32(s.read_noise * exposure.gain) * self._window(rng)
        image = cv2.sqrt(cv2.max(image, 0.0))
        shot = 255 * 0.5 * math.sqrt(exposure.gain / s.full_well)
        image = cv2.addWeighted(image, 255.0, self._window(rng), shot, 0.5)
        return np.asarray(np.clip(image, 0, 255, out=image).astype(np.uint8))

    def _air(
        self,
        view: View,
        light: Light,
        rng: np.random.Generator,
        lift: float,
        lamps_out: frozenset[str],
    ) -> tuple[Floats, Floats]:
        """On the coarse raster: what share of the light comes through, and what is added to it."""
        depth = view.depth_m[_COARSE // 2 :: _COARSE, _COARSE // 2 :: _COARSE]
        through = np.exp(np.float32(-light.haze_per_m) * np.minimum(depth, np.float32(200.0)))
        haze = np.square(np.asarray(light.haze_rgb, np.float32))
        # haze and dust are lit as what stands in them: where no lamp shines they are not seen
        lift_of_air = lift * _lit(light, lamps_out)
        hanging = (1 - through)[..., None] * haze * np.float32(lift_of_air)
        glow = self._dust(light, rng, lift_of_air)
        for direction, strength in _glares(view, light, lamps_out):
            glow = glow + self._glare(view.intrinsics, direction, strength * lift)
        added = hanging + glow[..., None] * np.array([1.0, 0.96, 0.88], np.float32)
        return (
            np.asarray(through * self._vignette, dtype=np.float32),
            np.asarray(added * self._vignette[..., None], dtype=np.float32),
        )

    def _dust(self, light: Light, rng: np.random.Generator, lift: float) -> Floats:
        """Grains that drift through the light close to the lens, out of focus."""
        layer = np.zeros(self._vignette.shape, np.float32)
        for _ in range(int(rng.poisson(light.dust))):
            x, y = rng.uniform((0, 0), layer.shape[::-1])
            radius = 0.5 * 2.0 ** rng.exponential(0.7)
            bright = float(min(0.05 * lift, 0.12) / max(radius, 1.0) * rng.uniform(0.3, 1.5))
            place = (int(x * 16), int(y * 16))
            cv2.circle(layer, place, int(radius * 16), bright, -1, shift=4)
        return np.asarray(cv2.GaussianBlur(layer, (0, 0), 0.8), dtype=np.float32)

    def _glare(self, i: CameraIntrinsics, direction: Array, strength: float) -> Floats:
        """What a lens makes of a lamp: a core, a veil over all, ghosts across the middle."""
        u = (i.fx * direction[0] / direction[2] + i.cx) / _COARSE
        v = (i.fy * direction[1] / direction[2] + i.cy) / _COARSE
        rows, columns = self._vignette.shape
        y, x = np.ogrid[0:rows, 0:columns]
        r2 = ((x - u) ** 2 + (y - v) ** 2).astype(np.float32)
        veil = self.settings.veil * strength
        glow = 25 * veil / (1 + r2 / 12) + veil / (1 + r2 / (0.25 * columns) ** 2)
        middle = columns / 2, rows / 2
        for at, size, share in ((-0.6, 0.05, 0.5), (0.35, 0.03, 0.8), (-1.3, 0.09, 0.25)):
            gx, gy = (m + at * (p - m) for m, p in zip(middle, (u, v), strict=True))
            edge = size * columns - np.sqrt((x - gx) ** 2 + (y - gy) ** 2)
            glow += share * veil * np.clip(edge, 0, 1)
        return np.asarray(glow, dtype=np.float32)

    def _window(self, rng: np.random.Generator) -> Floats:
        """Grain (H, W, 3) from any place of the tile: new chance for every pixel takes too long."""
        width, height = self._size
        rows, columns = self._grain.shape[:2]
        y = int(rng.integers(0, rows - height + 1))
        x = int(rng.integers(0, columns - width + 1))
        return self._grain[y : y + height, x : x + width]


def swept_px(
    world_from_first: Pose, world_from_last: Pose, intrinsics: CameraIntrinsics, depth_m: float
) -> tuple[float, float]:
    """How far what is in the middle of a picture moves in it between two poses of the camera."""
    point = world_from_first @ np.array([0.0, 0.0, depth_m])
    x, y, z = world_from_last.inverse() @ point
    if z < 0.05:
        return 0.0, 0.0
    return float(intrinsics.fx * x / z), float(intrinsics.fy * y / z)


def motion_kernel(right_px: float, down_px: float, longest_px: float = 24.0) -> Floats:
    """A filter (n, n) that smears along a straight line, to both sides of the middle alike."""
    shorten = min(1.0, longest_px / max(math.hypot(right_px, down_px), 1e-9))
    right_px, down_px = right_px * shorten, down_px * shorten
    half = math.ceil(max(abs(right_px), abs(down_px)) / 2) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for t in np.linspace(-0.5, 0.5, 8 * half + 1):
        x, y = half + t * right_px, half + t * down_px
        x0, y0 = int(x), int(y)
        fx, fy = x - x0, y - y0
        kernel[y0, x0] += (1 - fx) * (1 - fy)
        kernel[y0, x0 + 1] += fx * (1 - fy)
        kernel[y0 + 1, x0] += (1 - fx) * fy
        kernel[y0 + 1, x0 + 1] += fx * fy
    return np.asarray(kernel / kernel.sum())


def _grain(rng: np.random.Generator, shape: tuple[int, int]) -> Floats:
    """Noise (h, w, 3) of deviation 1; demosaicing makes a part of it blotchy."""
    fine = rng.standard_normal((*shape, 3), dtype=np.float32)
    mixed = 0.75 * fine + 0.9 * cv2.GaussianBlur(fine, (0, 0), 0.9)
    return np.asarray(mixed / mixed.std(), dtype=np.float32)


def _glares(view: View, light: Light, lamps_out: frozenset[str]) -> list[tuple[Array, float]]:
    """Directions (3,) in the camera of the lamps and the sun that it can see, and their glare."""
    camera_from_world = view.world_from_camera.inverse()
    seen = []
    for lamp in light.lamps:
        if lamp.name in lamps_out:
            continue
        place = camera_from_world @ lamp.position_world
        away = float(np.linalg.norm(place))
        if _in_view(place, view, place[2] - 0.3):
            seen.append((place / away, _of_lamp(lamp, away)))
    if light.sun is not None:
        direction = camera_from_world.rotation @ light.sun.direction_world
        if _in_view(direction, view, np.inf):
            seen.append((direction, light.sun.strength))
    return seen


def _lit(light: Light, lamps_out: frozenset[str]) -> float:
    """Share of the lamps that shine; all of the light where there are none but the sun."""
    if not light.lamps:
        return 1.0
    return sum(lamp.name not in lamps_out for lamp in light.lamps) / len(light.lamps)


def _of_lamp(lamp: Lamp, away_m: float) -> float:
    return lamp.strength / max(away_m, 0.5) ** 2


def _in_view(direction: Array, view: View, depth_m: float) -> bool:
    """It lies in the picture or a little beside, and nothing before it, as far as can be seen."""
    i = view.intrinsics
    if direction[2] < 0.1 * float(np.linalg.norm(direction)):
        return False
    u = i.fx * direction[0] / direction[2] + i.cx
    v = i.fy * direction[1] / direction[2] + i.cy
    if not (-0.2 * i.width < u < 1.2 * i.width and -0.2 * i.height < v < 1.2 * i.height):
        return False
    column, row = (
        round(float(np.clip(u, 0, i.width - 1))),
        round(float(np.clip(v, 0, i.height - 1))),
    )
    return bool(view.depth_m[row, column] >= depth_m)
