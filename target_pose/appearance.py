"""How a board looks in the picture, and how that changes with its pose, its light and the blur.

The edges of a small or blurred target run into one another, so that no edge lies where the print's
does. The picture of the whole board has no such trouble: it is a sum of blurred discs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.geometry import rotation_from_vector
from target_pose.circle_edges import PrintedCircle
from target_pose.vectors import cross, unit

Array: TypeAlias = NDArray[np.float64]
Focal: TypeAlias = tuple[float, float]
"""Focal lengths across and down, in pixels of the raster."""

SOFT_EDGE_PX = 0.6
"""Blur that edges are drawn with; the rest is added by a filter. Less would alias on the raster."""
LEAST_BLUR_PX = 0.35
"""Of a perfect lens: the pixel's own width has 0.29."""
NEAREST_M = 0.05
SRGB_TONE = 1 / 2.2
"""What sRGB's curve (IEC 61966-2-1) comes to but for the darkest tones."""
LEAST_TONE, MOST_TONE = 0.25, 1.3

CENTER, TURN = slice(0, 3), slice(3, 6)
SIZE, MARGIN, BLUR, STRETCH_X, STRETCH_XY = range(6, 11)
BLACK, WHITE, WALL, WALL_X, WALL_Y, SHADE_X, SHADE_Y = range(11, 18)
VEIL = slice(18, 23)
TONE, PEDESTAL = 23, 24
PARAMETERS = 25


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A board's pose, its light and the camera's blur."""

    center: Array  # (3,) [m], camera frame
    normal: Array  # (3,), towards the camera
    up: Array  # (3,), along the board
    size: float = 0.0
    """Relative error of print size over focal length."""
    margin_m: float = 0.0
    """By how much the board is cut larger than it should be, on each side."""
    blur_px2: float = 0.5
    """Variance of the point spread function, pixel included ..."""
    stretch_px2: tuple[float, float] = (0.0, 0.0)
    """... and by how much it is not round: (xx - yy) / 2 and xy, to first order."""
    black: float = 0.0
    """Linear light, like the following; a picture's 255 is 1."""
    white: float = 1.0
    wall: tuple[float, float, float] = (0.5, 0.0, 0.0)
    """In the middle of the patch, and its slopes to the patch's borders."""
    shade: tuple[float, float] = (0.0, 0.0)
    """Relative slopes of the light on the board."""
    veil: tuple[float, ...] = (0.0,) * 5
    """What a cover mirrors onto the board: x, y, xx, xy, yy from the patch's middle."""
    tone: float = SRGB_TONE
    """Exponent of the tone curve, from light to code; stands for ink and glare, too, which move
    small edges alike."""
    pedestal: float = 0.0
    """Code value of no light at all: contrast and brightness as the camera was set."""

    def moved(self, step: Array) -> Look:
        """The look after a step (25,) in all parameters."""
        turn = rotation_from_vector(np.asarray(step[TURN]))
        normal = turn @ self.normal
        up = turn @ self.up
        at = step.tolist()
        least = LEAST_BLUR_PX**2
        return replace(
            self,
            center=self.center + step[CENTER],
            normal=unit(normal),
            up=unit(up - normal * float(up @ normal)),
            size=self.size + at[SIZE],
            margin_m=self.margin_m + at[MARGIN],
            blur_px2=max(self.blur_px2 + at[BLUR], 0.5 * self.blur_px2, least),
            stretch_px2=(
                self.stretch_px2[0] + at[STRETCH_X],
                self.stretch_px2[1] + at[STRETCH_XY],
            ),
            black=self.black + at[BLACK],
            white=self.white + at[WHITE],
            wall=(self.wall[0] + at[WALL], self.wall[1] + at[WALL_X], self.wall[2] + at[WALL_Y]),
            shade=(self.shade[0] + at[SHADE_X], self.shade[1] + at[SHADE_Y]),
            veil=tuple(v + d for v, d in zip(self.veil, at[VEIL], strict=True)),
            pedestal=self.pedestal + at[PEDESTAL],
            tone=min(max(self.tone + at[TONE], LEAST_TONE), MOST_TONE),
        )


class Board(NamedTuple):
    """What is printed."""

    half_side_m: float
    circles: tuple[PrintedCircle, ...]
    white: bool
    """Shade of the board itself."""


class Raster(NamedTuple):
    """The pixels of a patch."""

    rays: Array  # (N, 3), z = 1
    x: Array  # (N,), from -1 to 1 across the patch
    y: Array  # (N,)
    shape: tuple[int, int]


class Predicted(NamedTuple):
    """A patch as a look predicts it."""

    light: Array  # (N,), linear
    derivative: Array  # (N, 25)
    """Zero by tone and pedestal, which are between light and code."""
    radius_m: Array  # (N,)
    """Distance from the board's centre."""


def predict(raster: Raster, focal_px: Focal, board: Board, look: Look) -> Predicted | None:
    """The patch in linear light, and its derivative but for the coding; None: not in front.

    Each printed edge is a soft step over the distance to its circle, to first order in pixels; the
    blur's derivative is half the second derivative in space (the heat equation).
    """
    plane = _on_board(raster.rays, look)
    if plane is None:
        return None
    soft_px = min(math.sqrt(look.blur_px2), SOFT_EDGE_PX)
    printed = _print(plane, focal_px, board, look, soft_px)
    rim = _rim(plane, focal_px, board, look, soft_px)
    fields = _fields(raster, look, printed, rim)
    blurred = _blurred(fields, raster.shape, look.blur_px2 - soft_px**2)
    derivative = np.asarray(blurred[:, :PARAMETERS], dtype=np.float64)
    light = np.asarray(blurred[:, PARAMETERS], dtype=np.float64)
    # so far by the axes right, up and normal
    axes = np.stack([plane.right, look.up, look.normal])
    derivative[:, CENTER] = derivative[:, CENTER] @ axes
    derivative[:, TURN] = derivative[:, TURN] @ axes
    xx, yy, xy = _second_derivatives(light.reshape(raster.shape))
    derivative[:, BLUR] = 0.5 * (xx + yy)
    derivative[:, STRETCH_X] = 0.5 * (xx - yy)
    derivative[:, STRETCH_XY] = xy
    a, b = look.stretch_px2
    light = light + a * derivative[:, STRETCH_X] + b * derivative[:, STRETCH_XY]
    return Predicted(light, derivative, np.hypot(plane.a, plane.b))


def outside_px(raster: Raster, focal_px: Focal, board: Board, look: Look) -> Array | None:
    """Distance (N,) from the board's rim, negative on the board; None: not in front."""
    plane = _on_board(raster.rays, look)
    if plane is None:
        return None
    return _rim_distance(plane, focal_px, board, look).distance_px


class _OnBoard(NamedTuple):
    """Where the rays of the pixels meet the board's plane."""

    right: Array  # (3,), the axis to the viewer's right
    a: Array  # (N,) [m], to the right
    b: Array  # (N,) [m], upwards
    reach: Array  # (N,) [m], depth
    center: tuple[float, float, float]
    """Along right, up and normal [m]."""


def _on_board(rays: Array, look: Look) -> _OnBoard | None:
    right = cross(look.up, look.normal)
    center = (
        float(right @ look.center),
        float(look.up @ look.center),
        float(look.normal @ look.center),
    )
    along = rays @ look.normal
    if not (look.center[2] > NEAREST_M and center[2] < -1e-3 and along.max() < -1e-6):
        return None
    reach = center[2] / along
    return _OnBoard(
        right, rays @ right * reach - center[0], rays @ look.up * reach - center[1], reach, center
    )


def _px_per_m(
    plane: _OnBoard, look: Look, focal_px: Focal, out: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Pixels (N,) that a metre outwards takes, across an edge, and the lean (N,) of the rays."""
    oa, ob = out
    (rx, ry, _), (ux, uy, _), (nx, ny, _) = (
        v.tolist() for v in (plane.right, look.up, look.normal)
    )
    ca, cb, cn = plane.center
    lean = ((plane.a + ca) * oa + (plane.b + cb) * ob) / cn
    x = (oa * rx + ob * ux - lean * nx) / focal_px[0]
    y = (oa * ry + ob * uy - lean * ny) / focal_px[1]
    return 1 / np.maximum(plane.reach * np.sqrt(x * x + y * y), 1e-7), lean


class _Printed(NamedTuple):
    """The print, 0 for black and 1 for white (N,), and its derivatives."""

    shade: Array
    by_center: tuple[Array, Array, Array]
    """Along right, up and normal."""
    by_turn: tuple[Array, Array]
    """About right and up; none about the normal."""
    by_size: Array


def _print(plane: _OnBoard, focal_px: Focal, board: Board, look: Look, soft_px: float) -> _Printed:
    radius = np.maximum(np.sqrt(plane.a * plane.a + plane.b * plane.b), 1e-9)
    oa, ob = plane.a / radius, plane.b / radius
    px_per_m, lean = _px_per_m(plane, look, focal_px, (oa, ob))
    cn = plane.center[2]
    shade = np.full(len(radius), 1.0 if board.white else 0.0)
    weight, leaning, turning, by_size = (np.zeros(len(radius)) for _ in range(4))
    for circle in board.circles:
        r = circle.radius_m * (1 + look.size)
        dark = 1.0 if circle.dark_inside else -1.0
        # a soft step along the distance lies outside of where a soft disc's edge would
        bend = soft_px**2 / (2 * np.maximum(r * px_per_m, soft_px))
        cover, slope = _soft_step((radius - r) * px_per_m + bend, soft_px)
        shade -= dark * cover
        across = -dark * slope * px_per_m
        by_size -= circle.radius_m * across
        weight += across
        # by the lean at the edge, not at the pixel: else size and range would not cancel
        leaned = across * (lean + (r - radius) / cn)
        leaning += leaned
        turning += r * leaned
    return _Printed(
        shade,
        (-weight * oa, -weight * ob, leaning),
        (turning * ob, -turning * oa),
        by_size,
    )


class _Rim(NamedTuple):
    """How much of each pixel is board (N,), and the derivatives."""

    on: Array
    by_center: tuple[Array, Array, Array]
    by_turn: tuple[Array, Array, Array]
    by_margin: Array


class _RimDistance(NamedTuple):
    """From the side of the board that each pixel is nearest to."""

    distance_px: Array  # (N,)
    reach_m: Array  # (N,)
    """From the centre, across that side."""
    half_m: float
    out: tuple[Array, Array]
    """Across the side, to the right and upwards."""
    px_per_m: Array  # (N,)
    lean: Array  # (N,)


def _rim_distance(plane: _OnBoard, focal_px: Focal, board: Board, look: Look) -> _RimDistance:
    upright = np.abs(plane.b) > np.abs(plane.a)
    oa = np.where(upright, 0.0, np.sign(plane.a))
    ob = np.where(upright, np.sign(plane.b), 0.0)
    px_per_m, lean = _px_per_m(plane, look, focal_px, (oa, ob))
    reach = plane.a * oa + plane.b * ob
    half = board.half_side_m + look.margin_m
    return _RimDistance((reach - half) * px_per_m, reach, half, (oa, ob), px_per_m, lean)


def _rim(plane: _OnBoard, focal_px: Focal, board: Board, look: Look, soft_px: float) -> _Rim:
    rim = _rim_distance(plane, focal_px, board, look)
    (oa, ob), half = rim.out, rim.half_m
    on, slope = _soft_step(rim.distance_px, soft_px)
    across = slope * rim.px_per_m
    leaned = across * (rim.lean + (half - rim.reach_m) / plane.center[2])
    # the point of the rim that a pixel is nearest to
    upright = ob != 0
    ea, eb = np.where(upright, plane.a, half * oa), np.where(upright, half * ob, plane.b)
    return _Rim(
        on,
        (-across * oa, -across * ob, leaned),
        (leaned * eb, -leaned * ea, across * (oa * plane.b - ob * plane.a)),
        -across,
    )


def _fields(raster: Raster, look: Look, printed: _Printed, rim: _Rim) -> NDArray[np.float32]:
    """Light before the blur and its derivatives (N, 26), the pose's by right, up and normal."""
    shade = printed.shade
    contrast = look.white - look.black
    lit = 1 + look.shade[0] * raster.x + look.shade[1] * raster.y
    paint = look.black + contrast * shade
    x, y = raster.x, raster.y
    bends = (x, y, x * x, x * y, y * y)
    veil = sum((v * bend for v, bend in zip(look.veil, bends, strict=True)), np.zeros(len(x)))
    wall = look.wall[0] + look.wall[1] * raster.x + look.wall[2] * raster.y
    over_wall = paint * lit + veil - wall
    seen, off = rim.on * lit, 1 - rim.on
    edge = seen * contrast
    painted = rim.on * paint
    columns = [
        *(edge * p + over_wall * r for p, r in zip(printed.by_center, rim.by_center, strict=True)),
        *(edge * p + over_wall * r for p, r in zip(printed.by_turn, rim.by_turn[:2], strict=True)),
        over_wall * rim.by_turn[2],
        edge * printed.by_size,
        over_wall * rim.by_margin,
        *(np.zeros(len(shade)) for _ in (BLUR, STRETCH_X, STRETCH_XY)),
        seen * (1 - shade),
        seen * shade,
        off,
        off * raster.x,
        off * raster.y,
        painted * raster.x,
        painted * raster.y,
        *(rim.on * bend for bend in bends),
        np.zeros(len(shade)),
        np.zeros(len(shade)),
        rim.on * over_wall + wall,
    ]
    return np.stack(columns, axis=1, dtype=np.float32, casting="same_kind")


def _soft_step(distance: Array, sigma: float) -> tuple[Array, Array]:
    """1 inside and 0 outside of an edge that a Gaussian blurs (N,), and its derivative (N,).

    The error function after M. Abramowitz, I. Stegun, 1964, 7.1.26: good to 1.5e-7.
    """
    x = distance / (math.sqrt(2) * sigma)
    bell = np.exp(-x * x)
    t = 1 / (1 + 0.3275911 * np.abs(x))
    tail = t * (
        0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429)))
    )
    outer = 0.5 * tail * bell
    return np.where(x > 0, outer, 1 - outer), -bell / (math.sqrt(2 * math.pi) * sigma)


def _blurred(
    fields: NDArray[np.float32], shape: tuple[int, int], variance: float
) -> NDArray[np.float32]:
    """Fields (N, K) on a raster, after a round Gaussian."""
    if variance <= 1e-4:
        return fields
    half = max(2, math.ceil(3.5 * math.sqrt(variance)))
    taps = np.arange(-half, half + 1)
    kernel = np.exp(-0.5 * taps**2 / variance)
    kernel /= kernel.sum()
    image = fields.reshape(*shape, fields.shape[1])
    done = cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(done.reshape(fields.shape), dtype=np.float32)


def _second_derivatives(image: Array) -> tuple[Array, Array, Array]:
    """d2/dx2, d2/dy2 and d2/dxdy (N,) of a picture (H, W)."""
    e = np.pad(image, 1, mode="edge")
    middle = e[1:-1, 1:-1]
    xx = e[1:-1, 2:] - 2 * middle + e[1:-1, :-2]
    yy = e[2:, 1:-1] - 2 * middle + e[:-2, 1:-1]
    xy = 0.25 * (e[2:, 2:] - e[2:, :-2] - e[:-2, 2:] + e[:-2, :-2])
    return xx.ravel(), yy.ravel(), xy.ravel()
