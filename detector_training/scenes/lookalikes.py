"""Things that a careless net would take for the target: hard negatives as flat textures.

Each drawer fills a unit square (N, N) and gives premultiplied RGBA. None has the target's rings:
``rings_of_wrong_ratios`` draws until its ratios are far from the target's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import cloud_noise
from detector_training.scenes.printed import Paint, disc_coverage, radius_grid, random_paint
from target_pose.target import Target

Texture: TypeAlias = NDArray[np.float32]
Drawer: TypeAlias = Callable[[np.random.Generator, int, Target], Texture]

MIN_RATIO_STEPS = (0.3, 0.7)
"""How far, in logarithm, a look-alike's ratios of the second and of the further discs to the outer
one are from the target's, in at least one ring. The inner ones must differ more: from afar and
blurred, nobody could tell a slightly larger dot."""


def random_lookalike(rng: np.random.Generator, side_px: int, target: Target) -> Texture:
    """Any of them as a texture (N, N, 4), drawn as likely as its weight says."""
    names = list(DRAWERS)
    weights = np.array([DRAWERS[n][0] for n in names], dtype=float)
    name = names[int(rng.choice(len(names), p=weights / weights.sum()))]
    return DRAWERS[name][1](rng, side_px, target)


def _board(rng: np.random.Generator, n: int, paint: Paint) -> Texture:
    """White square, white disc, dark square, coloured square, or nothing."""
    kind = rng.choice(["white", "white", "round", "dark", "coloured", "none"])
    image = np.zeros((n, n, 4), dtype=np.float32)
    if kind == "none":
        return image
    colour = {"dark": paint.black, "coloured": rng.uniform(0.05, 0.8, 3).astype(np.float32)}.get(
        kind, paint.white
    )
    if kind == "round":
        alpha = disc_coverage(radius_grid(n, 1.0), 0.5, 1 / n)
    else:
        alpha = np.ones((n, n), dtype=np.float32)
    image[..., :3] = alpha[..., None] * colour
    image[..., 3] = alpha
    return image


def _lay(image: Texture, coverage: NDArray[np.float32], colour: NDArray[np.float32]) -> None:
    c = coverage[..., None]
    image[..., :3] += c * (colour - image[..., :3])
    image[..., 3] += coverage * (1 - image[..., 3])


def _disc(image: Texture, diameter: float, colour: NDArray[np.float32]) -> None:
    n = image.shape[0]
    _lay(image, disc_coverage(radius_grid(n, 1.0), diameter / 2, 1 / n), colour)


def _strokes(n: int, lines: list[tuple[float, float, float, float]], thick: float) -> Texture:
    """Coverage (N, N) of line segments in unit coordinates about the centre."""
    canvas = np.zeros((n, n), dtype=np.uint8)
    for ax, ay, bx, by in lines:
        a = (round((ax + 0.5) * n * 16), round((ay + 0.5) * n * 16))
        b = (round((bx + 0.5) * n * 16), round((by + 0.5) * n * 16))
        cv2.line(canvas, a, b, 255, max(1, round(thick * n)), cv2.LINE_AA, 4)
    return np.asarray(canvas.astype(np.float32) / 255)


def _true_diameters(target: Target) -> list[float]:
    return [d.diameter_m / target.board_side_m for d in target.discs]


def rings_of_wrong_ratios(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """The target with other diameters, or more rings, or fewer; dark on light."""
    paint = random_paint(rng)
    image = _board(rng, n, paint)
    truth = _true_diameters(target)
    while True:
        count = int(rng.choice([2, 3, 3, 3, 4, 5, 6, 7]))
        outer = rng.uniform(0.5, 0.98)
        if rng.random() < 0.4:  # an archer's target: equal steps
            diameters = [outer * (count - i) / count for i in range(count)]
        else:
            diameters = list(outer * np.sort(rng.uniform(0.08, 0.95, count - 1))[::-1])
            diameters.insert(0, outer)
        ratios = np.array(diameters) / outer
        if np.min(-np.diff(ratios)) >= 0.06 and is_far_from(ratios, np.array(truth) / truth[0]):
            break
    coloured = rng.random() < 0.35
    dark = rng.uniform(0.02, 0.5, 3).astype(np.float32) if coloured else paint.black
    for i, diameter in enumerate(diameters):
        _disc(image, float(diameter), dark if i % 2 == 0 else paint.white)
    return image


def is_far_from(ratios: NDArray[np.float64], true_ratios: NDArray[np.float64]) -> bool:
    """Whether rings of these diameters (as shares of the outermost) can be told from the target."""
    if len(ratios) != len(true_ratios):
        return True
    step = np.abs(np.log(ratios[1:] / true_ratios[1:]))
    second, further = MIN_RATIO_STEPS
    return bool((step[:1] > second).any() or (step[1:] > further).any())


def inverted(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """The target with black and white exchanged."""
    paint = random_paint(rng)
    swapped = Paint(paint.black, paint.white)
    image = np.zeros((n, n, 4), dtype=np.float32)
    if rng.random() < 0.6:
        image[..., :3], image[..., 3] = swapped.of(target.board_shade), 1.0
    for disc, diameter in zip(target.discs, _true_diameters(target), strict=True):
        _disc(image, diameter, swapped.of(disc.shade))
    return image


def ring_without_dot(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A dark ring around an empty light disc, a washer."""
    paint = random_paint(rng)
    image = _board(rng, n, paint)
    outer = rng.uniform(0.4, 0.95)
    _disc(image, outer, paint.black)
    _disc(image, outer * rng.uniform(0.25, 0.9), paint.white)
    return image


def plain_disc(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """One dark or light disc, on a board or not."""
    paint = random_paint(rng)
    image = _board(rng, n, paint)
    dark = rng.random() < 0.6
    _disc(image, rng.uniform(0.3, 0.95), paint.black if dark else paint.white)
    if rng.random() < 0.3:
        _disc(image, rng.uniform(0.03, 0.12), paint.white if dark else paint.black)
    return image


def thin_circles(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """Drawn circles, perhaps with a cross through them."""
    paint = random_paint(rng)
    image = _board(rng, n, paint)
    grid = radius_grid(n, 1.0)
    thick = rng.uniform(0.008, 0.04)
    for radius in rng.uniform(0.08, 0.46, int(rng.integers(1, 5))):
        ring = disc_coverage(grid, radius + thick / 2, 1 / n)
        ring -= disc_coverage(grid, radius - thick / 2, 1 / n)
        _lay(image, ring, paint.black)
    if rng.random() < 0.4:
        cross = [(-0.48, 0.0, 0.48, 0.0), (0.0, -0.48, 0.0, 0.48)]
        _lay(image, _strokes(n, cross, float(thick)), paint.black)
    return image


def wheel(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A tyre with a bright rim, a hub and spokes; or a fan."""
    image = np.zeros((n, n, 4), dtype=np.float32)
    tyre = rng.uniform(0.01, 0.08, 3).astype(np.float32)
    rim = np.float32(rng.uniform(0.2, 0.8)) * np.ones(3, dtype=np.float32)
    rim_size = rng.uniform(0.45, 0.78)
    _disc(image, 0.98, tyre)
    _disc(image, rim_size, rim)
    count, turn = int(rng.integers(3, 13)), rng.uniform(0, 2 * math.pi)
    angles = turn + np.arange(count) * 2 * math.pi / count
    r = rim_size * 0.47
    spokes = [(0.0, 0.0, r * math.cos(a), r * math.sin(a)) for a in angles]
    if rng.random() < 0.7:
        _disc(image, rim_size * rng.uniform(0.8, 0.95), tyre * 2)
        _lay(image, _strokes(n, spokes, rng.uniform(0.02, 0.07)), rim)
    else:
        _lay(image, _strokes(n, spokes, rng.uniform(0.01, 0.04)), tyre)
    _disc(image, rng.uniform(0.1, 0.25), rim * np.float32(rng.uniform(0.3, 1.2)))
    _disc(image, rng.uniform(0.03, 0.08), tyre)
    return image


def clock(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A dial with marks, hands and a frame, or a pressure gauge."""
    paint = random_paint(rng)
    image = np.zeros((n, n, 4), dtype=np.float32)
    _disc(image, 0.98, rng.uniform(0.02, 0.5, 3).astype(np.float32))
    _disc(image, rng.uniform(0.8, 0.93), paint.white)
    marks = []
    for a in np.arange(12) * math.pi / 6:
        c, s = math.cos(a), math.sin(a)
        marks.append((0.34 * c, 0.34 * s, 0.38 * c, 0.38 * s))
    _lay(image, _strokes(n, marks, rng.uniform(0.01, 0.03)), paint.black)
    hands = []
    for length in (0.2, 0.32):
        a = rng.uniform(0, 2 * math.pi)
        hands.append((0.0, 0.0, length * math.cos(a), length * math.sin(a)))
    _lay(image, _strokes(n, hands, rng.uniform(0.012, 0.03)), paint.black)
    _disc(image, rng.uniform(0.03, 0.1), paint.black)
    return image


def traffic_sign(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A coloured ring around white, with a bar, a number or nothing in it."""
    image = np.zeros((n, n, 4), dtype=np.float32)
    colour = np.array([[0.55, 0.02, 0.02], [0.02, 0.06, 0.4], [0.03, 0.03, 0.03]])[
        int(rng.integers(3))
    ].astype(np.float32)
    white = np.full(3, rng.uniform(0.6, 0.95), dtype=np.float32)
    _disc(image, 0.98, white)
    _disc(image, 0.94, colour)
    style = int(rng.integers(4))
    if style == 0:  # no entry
        _lay(image, _strokes(n, [(-0.3, 0.0, 0.3, 0.0)], 0.14), white)
        return image
    _disc(image, rng.uniform(0.55, 0.78), white)
    if style == 1:  # a prohibition
        _lay(image, _strokes(n, [(-0.3, -0.3, 0.3, 0.3)], 0.07), colour)
    if style == 2:
        canvas = np.zeros((n, n), dtype=np.uint8)
        text = str(rng.integers(2, 13) * 10)
        at = (round(n * 0.26), round(n * 0.6))
        cv2.putText(
            canvas, text, at, cv2.FONT_HERSHEY_DUPLEX, n / 90, 255, max(1, n // 40), cv2.LINE_AA
        )
        _lay(image, np.float32(1 / 255) * canvas, np.full(3, 0.03, dtype=np.float32))
    return image


def sphere(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A shaded ball with a highlight."""
    c = (np.arange(n, dtype=np.float32) + 0.5) / n * 2 - 1
    x, y = np.meshgrid(c, c)
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    light = rng.normal(0, 1, 3) + (0, 0, 1.2)
    light /= np.linalg.norm(light)
    shade = np.clip(x * light[0] + y * light[1] + z * light[2], 0, 1)
    half = light + (0, 0, 1)
    half /= np.linalg.norm(half)
    gloss = np.clip(x * half[0] + y * half[1] + z * half[2], 0, 1) ** rng.uniform(20, 200)
    colour = rng.uniform(0.01, 0.8) * rng.uniform(0.3, 1.0, 3)
    rgb = (0.08 + shade[..., None]) * colour + gloss[..., None] * rng.uniform(0, 0.8)
    alpha = disc_coverage(radius_grid(n, 1.0), 0.49, 1 / n)
    return np.dstack([rgb * alpha[..., None], alpha]).astype(np.float32)


def checkerboard(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """Squares of a calibration board, or of a square marker's code."""
    cells = int(rng.integers(3, 12))
    paint = random_paint(rng)
    if rng.random() < 0.5:
        i, j = np.indices((cells, cells))
        code = ((i + j) % 2).astype(np.float32)
    else:
        code = rng.integers(0, 2, (cells, cells)).astype(np.float32)
        code[[0, -1], :] = code[:, [0, -1]] = 0
    pattern = np.asarray(cv2.resize(code, (n, n), interpolation=cv2.INTER_NEAREST))[..., None]
    rgb = paint.black + pattern * (paint.white - paint.black)
    return np.dstack([rgb, np.ones((n, n), dtype=np.float32)])


def nested_squares(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """The corner mark of a matrix code, or the target's shades as squares."""
    paint = random_paint(rng)
    image = np.zeros((n, n, 4), dtype=np.float32)
    c = np.abs((np.arange(n, dtype=np.float32) + 0.5) / n - 0.5)
    far = np.maximum(c[:, None], c[None, :])
    sizes = [1.0, 0.78, 0.55, 0.34] if rng.random() < 0.6 else [1.0, *_true_diameters(target)]
    for i, size in enumerate(sizes):
        cover = np.clip((size / 2 - far) * n + 0.5, 0, 1).astype(np.float32)
        _lay(image, cover, paint.white if i % 2 == 0 else paint.black)
    return image


def paper(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A light sheet with blots, lines or text: the board without its discs."""
    paint = random_paint(rng)
    image = np.ones((n, n, 4), dtype=np.float32)
    image[..., :3] = paint.white
    for row in np.arange(rng.uniform(0.05, 0.2), 0.9, rng.uniform(0.05, 0.15)):
        end = rng.uniform(-0.1, 0.42)
        y = float(row) - 0.5
        thick = rng.uniform(0.005, 0.03)
        _lay(image, _strokes(n, [(-0.42, y, end, y)], thick), paint.black)
    if rng.random() < 0.4:
        blot = np.clip(cloud_noise(rng, n, n, 3) - 0.5, 0, 1).astype(np.float32)
        _lay(image, blot, rng.uniform(0.02, 0.5, 3).astype(np.float32))
    return image


def speaker(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A loudspeaker, a lens, a hole: dark rings that fade into each other."""
    paint = random_paint(rng)
    image = _board(rng, n, paint)
    outer, base = rng.uniform(0.5, 0.95), rng.uniform(0.02, 0.3)
    for size in sorted(rng.uniform(0.15, 1.0, int(rng.integers(2, 6))), reverse=True):
        grey = np.float32(base * rng.uniform(0.3, 1.7))
        _disc(image, outer * size, np.full(3, grey, dtype=np.float32))
    return image


def target_of_colour(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """Red, blue and gold rings on white, as archers and pressure gauges have them."""
    image = _board(rng, n, random_paint(rng))
    count = int(rng.integers(4, 8))
    for i in range(count):
        colour = rng.uniform(0.02, 0.9, 3).astype(np.float32)
        _disc(image, 0.96 * (count - i) / count, colour)
    return image


def manhole(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A cast-iron cover: a frame, a rim, and studs, bars or a grid in it."""
    image = np.zeros((n, n, 4), dtype=np.float32)
    iron = rng.uniform(0.02, 0.15) * (1 + 0.1 * rng.standard_normal(3)).astype(np.float32)
    bright = (iron * rng.uniform(1.6, 4.0)).astype(np.float32)
    _disc(image, 0.98, bright)
    _disc(image, rng.uniform(0.88, 0.95), iron)
    inner = rng.uniform(0.6, 0.82)
    if rng.random() < 0.6:
        _disc(image, inner, bright)
        _disc(image, inner * rng.uniform(0.9, 0.97), iron)
    reach, count = inner * 0.46, int(rng.integers(5, 14))
    steps = np.linspace(-reach, reach, count)
    if rng.random() < 0.5:
        thick = rng.uniform(0.3, 0.7) * float(steps[1] - steps[0])
        dots = [(x, y, x, y) for x in steps for y in steps if math.hypot(x, y) < reach]
        _lay(image, _strokes(n, dots, thick), bright)
    else:
        bars = [(-math.sqrt(reach**2 - y**2), y, math.sqrt(reach**2 - y**2), y) for y in steps]
        _lay(image, _strokes(n, bars, rng.uniform(0.01, 0.03)), bright)
    if rng.random() < 0.5:
        _disc(image, rng.uniform(0.06, 0.2), bright)
    return image


def record(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A black disc with grooves, a light label and a hole: a record, a reel, a grinding wheel."""
    image = np.zeros((n, n, 4), dtype=np.float32)
    black = np.float32(rng.uniform(0.01, 0.08)) * np.ones(3, dtype=np.float32)
    _disc(image, 0.98, black)
    grid = radius_grid(n, 1.0)
    waves = 1 + rng.uniform(0.1, 0.6) * np.sin(2 * math.pi * rng.uniform(15, 60) * grid)
    image[..., :3] *= waves[..., None].astype(np.float32)
    label = 0.98 * rng.uniform(0.2, 0.34)
    _disc(image, label, rng.uniform(0.1, 0.9, 3).astype(np.float32))
    _disc(image, label * rng.uniform(0.05, 0.2), black)
    return image


def patterned_sphere(rng: np.random.Generator, n: int, target: Target) -> Texture:
    """A shaded ball with bands or rings around an axis that points anywhere."""
    c = (np.arange(n, dtype=np.float32) + 0.5) / n * 2 - 1
    x, y = np.meshgrid(c, c)
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    # never towards the viewer: there its rings may well be the target's
    turn, lean = rng.uniform(0, 2 * math.pi), rng.uniform(math.radians(30), math.radians(100))
    axis = (math.sin(lean) * math.cos(turn), math.sin(lean) * math.sin(turn), math.cos(lean))
    angle = np.arccos(np.clip(x * axis[0] + y * axis[1] + z * axis[2], -1, 1))
    bands = np.sin(angle * rng.uniform(3, 9) + rng.uniform(0, 2 * math.pi)) > 0
    paint = random_paint(rng)
    rgb = np.where(bands[..., None], paint.white, paint.black) * (0.15 + 0.85 * z[..., None])
    alpha = disc_coverage(radius_grid(n, 1.0), 0.49, 1 / n)
    return np.dstack([rgb * alpha[..., None], alpha]).astype(np.float32)


DRAWERS: dict[str, tuple[float, Drawer]] = {
    "rings_of_wrong_ratios": (4.0, rings_of_wrong_ratios),
    "inverted": (2.5, inverted),
    "ring_without_dot": (1.5, ring_without_dot),
    "plain_disc": (1.5, plain_disc),
    "thin_circles": (1.0, thin_circles),
    "wheel": (1.0, wheel),
    "clock": (1.0, clock),
    "traffic_sign": (1.0, traffic_sign),
    "sphere": (0.5, sphere),
    "checkerboard": (0.7, checkerboard),
    "nested_squares": (0.8, nested_squares),
    "paper": (1.5, paper),
    "speaker": (1.0, speaker),
    "target_of_colour": (0.8, target_of_colour),
    "manhole": (0.8, manhole),
    "record": (0.6, record),
    "patterned_sphere": (0.8, patterned_sphere),
}
"""Weight and drawer by name."""
