"""Surfaces of a tunnel and a refinery, made of noise: seamless when laid side by side.

Most flights are not looked at by anybody: what a surface draws by chance it draws at once, so that
the world is the same with it and without, and is painted only when a picture is to be made.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import TypeAlias

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

Texture = NDArray[np.uint8]  # (H, W, 3)
"""RGB; levels are roots of albedo, as in all rendered pictures."""
Paint: TypeAlias = Callable[[], Texture]
"""Paints a surface whose chances are drawn; the same one every time."""
TILE_PX = 512


def cloud(rng: np.random.Generator, n: int, fade: float = 1.6) -> NDArray[np.float32]:
    """Noise (n, n) of mean 0 and deviation 1 that repeats without a seam.

    Args:
        rng: where chance comes from.
        n: side in texels.
        fade: how fast finer waves grow weaker; 1 is rough, 2 smooth.
    """
    waves = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :]) * n
    waves[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((n, n))) * waves**-fade
    noise = np.fft.irfft2(spectrum, s=(n, n))
    return np.asarray(noise / noise.std(), dtype=np.float32)


def noise_later(rng: np.random.Generator, fade: float = 1.6) -> Callable[[], NDArray[np.float32]]:
    """A tile's cloud that is worked out when it is asked for; its chances are drawn now."""
    chance = copy.deepcopy(rng)
    rng.standard_normal((TILE_PX, TILE_PX))  # what comes after must not depend on who asks
    return lambda: cloud(copy.deepcopy(chance), TILE_PX, fade)


def rock(rng: np.random.Generator) -> Paint:
    """Rough rock or sprayed concrete: bumps with a light side, cracks, and runs of water."""
    bumps, cracks, runs = noise_later(rng, 1.35), noise_later(rng, 1.7), _runs_later(rng)
    shade, tint = rng.uniform(0.13, 0.26), _tint(rng, 0.07)

    def paint() -> Texture:
        relief = bumps()
        light = np.roll(relief, 2, axis=0) - relief
        crack = np.clip(0.06 - np.abs(cracks()), 0, 1) / 0.06
        wet = np.clip(runs() - 0.6, 0, 1)
        albedo = shade * np.exp(0.18 * relief + 1.1 * light)
        return _painted(albedo * (1 - 0.55 * crack) * (1 - 0.4 * wet), tint)

    return paint


def concrete(rng: np.random.Generator) -> Paint:
    """Cast concrete: stains, pores, and the seams of the boards it was cast between."""
    shade, stains, holes = rng.uniform(0.26, 0.42), noise_later(rng, 1.5), noise_later(rng, 0.5)
    runs, tint = _runs_later(rng), _tint(rng, 0.03)

    def paint() -> Texture:
        albedo = shade * np.exp(0.12 * stains())
        pores = holes() > 2.9
        albedo[pores] *= 0.5
        for row in range(0, TILE_PX, TILE_PX // 2):
            albedo[row : row + 3] *= 0.7
        return _painted(albedo * (1 - 0.3 * np.clip(runs(), 0, 1)), tint)

    return paint


def gravel(rng: np.random.Generator) -> Paint:
    """A floor of gravel and mud."""
    stones, shade, mud = noise_later(rng, 0.7), rng.uniform(0.08, 0.2), noise_later(rng, 1.8)
    tint = _tint(rng, 0.06)
    return lambda: _painted(shade * np.exp(0.4 * stones() + 0.25 * mud()), tint)


def painted_steel(rng: np.random.Generator, colour: tuple[float, float, float]) -> Paint:
    """Paint of an albedo in RGB, with rust that comes through and runs down."""
    tones, spots, least = noise_later(rng, 1.6), noise_later(rng, 1.4), rng.uniform(1.0, 2.2)
    runs, grain = _runs_later(rng), noise_later(rng, 0.9)

    def paint() -> Texture:
        tone = np.exp(0.05 * tones())[..., None] * np.asarray(colour)
        rust = np.clip(spots() - least, 0, 1)
        rust = np.clip(rust + 0.5 * np.clip(runs() - 1.2, 0, 1), 0, 1)[..., None]
        rusty = np.array([0.22, 0.09, 0.04]) * np.exp(0.3 * grain())[..., None]
        return _levels(tone + rust * (rusty - tone))

    return paint


def cladding(rng: np.random.Generator) -> Paint:
    """Ribbed sheet metal: an insulated tank's or a hall's skin, with rows of rivets."""
    shade, stains, runs = rng.uniform(0.3, 0.5), noise_later(rng, 1.7), _runs_later(rng)
    tint = _tint(rng, 0.03)

    def paint() -> Texture:
        across = np.arange(TILE_PX) / TILE_PX
        ribs = 1 + 0.16 * np.tanh(4 * np.sin(2 * np.pi * 8 * across))[None, :]
        albedo = shade * ribs * np.exp(0.07 * stains())
        for row in (4, TILE_PX // 2):
            albedo[row : row + 4] *= 0.6
            albedo[row + 8 : row + 12, 16::32] *= 0.5
        albedo *= 1 - 0.35 * np.clip(runs() - 0.4, 0, 1)
        return _painted(albedo, tint)

    return paint


def grating(rng: np.random.Generator) -> Paint:
    """A walkway of bars over a dark pit."""
    shade, stains, tint = rng.uniform(0.2, 0.35), noise_later(rng, 1.3), _tint(rng, 0.02)

    def paint() -> Texture:
        at = np.arange(TILE_PX)
        bars = (at % 32 < 7)[:, None] | (at % 128 < 9)[None, :]
        return _painted(np.where(bars, shade * np.exp(0.15 * stains()), 0.02), tint)

    return paint


def dial(rng: np.random.Generator) -> Paint:
    """The face of a pressure gauge: round and black on white, but no target."""
    shown = rng.uniform(0.75, 2.25) * np.pi

    def paint() -> Texture:
        n = 256
        face = np.full((n, n), 0.03, np.float32)
        middle = (n // 2, n // 2)
        cv2.circle(face, middle, int(0.42 * n), 0.75, -1, cv2.LINE_AA)
        for angle in np.linspace(0.75 * np.pi, 2.25 * np.pi, 11):
            towards = np.array([np.cos(angle), np.sin(angle)])
            ends = (n / 2 + np.outer((0.31, 0.38), n * towards)).astype(int)
            cv2.line(face, tuple(ends[0].tolist()), tuple(ends[1].tolist()), 0.04, 3, cv2.LINE_AA)
        tip = (n / 2 + 0.34 * n * np.array([np.cos(shown), np.sin(shown)])).astype(int)
        cv2.line(face, middle, tuple(tip.tolist()), 0.04, 5, cv2.LINE_AA)
        cv2.circle(face, middle, int(0.05 * n), 0.05, -1, cv2.LINE_AA)
        return _painted(face, np.ones(3))

    return paint


def sign(rng: np.random.Generator) -> Paint:
    """A warning sign: a black and yellow frame, and lines of text that nobody can read."""
    n = 256
    ends = {row: int(rng.uniform(0.5, 0.85) * n) for row in range(60, n - 50, 30)}

    def paint() -> Texture:
        at = np.add.outer(np.arange(n), np.arange(n)) // 24 % 2
        yellow, black = np.array([0.62, 0.42, 0.02]), np.array([0.03, 0.03, 0.03])
        picture = np.where(at[..., None] == 1, yellow, black)
        picture[28:-28, 28:-28] = (0.7, 0.7, 0.66)
        for row, end in ends.items():
            picture[row : row + 12, 50:end] = black
        return _levels(picture)

    return paint


def add_bare_material(
    spec: mujoco.MjSpec, name: str, specular: float = 0.0, shine: float = 0.3
) -> None:
    """Give a material to the world; ``put_on`` gives it its texture."""
    spec.add_material(name=name, specular=specular, shininess=shine)


def put_on(spec: mujoco.MjSpec, name: str, texture: Texture) -> None:
    """Give a material of the world its texture, under the same name."""
    height, width = texture.shape[:2]
    picture = spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=width,
        height=height,
        nchannel=3,
    )
    picture.data = texture.tobytes()  # as an argument it would go byte by byte
    spec.material(name).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def add_material(
    spec: mujoco.MjSpec, name: str, texture: Texture, specular: float = 0.0, shine: float = 0.3
) -> str:
    """Give a material of that texture to the world; returns its name."""
    add_bare_material(spec, name, specular, shine)
    put_on(spec, name, texture)
    return name


def _runs_later(rng: np.random.Generator) -> Callable[[], NDArray[np.float32]]:
    """Where water ran down, a tile, about normal."""
    noise = noise_later(rng, 0.8)

    def runs() -> NDArray[np.float32]:
        spectrum = np.fft.rfft(noise(), axis=0) * _smear(TILE_PX)[:, None]
        smeared = np.fft.irfft(spectrum, n=TILE_PX, axis=0)
        return np.asarray(smeared / smeared.std(), dtype=np.float32)

    return runs


def _smear(n: int) -> NDArray[np.float64]:
    return np.asarray(1 / (1 + (np.arange(n // 2 + 1) / 2.5) ** 2))


def _tint(rng: np.random.Generator, spread: float) -> NDArray[np.float64]:
    """A slight colour (3,), rather warm than cold."""
    warmth = rng.normal(0.5 * spread, spread)
    return np.exp([warmth, 0.2 * warmth, -warmth])


def _painted(albedo: NDArray[np.floating], tint: NDArray[np.float64]) -> Texture:
    return _levels(albedo[..., None] * tint)


def _levels(albedo: NDArray[np.floating]) -> Texture:
    return np.asarray(np.rint(255 * np.sqrt(np.clip(albedo, 0.0, 1.0))).astype(np.uint8))
