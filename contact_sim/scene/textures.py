"""Surfaces of a tunnel and a refinery, made of noise: seamless when laid side by side."""

from __future__ import annotations

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

Texture = NDArray[np.uint8]  # (H, W, 3)
"""RGB; levels are roots of albedo, as in all rendered pictures."""
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


def rock(rng: np.random.Generator) -> Texture:
    """Rough rock or sprayed concrete: bumps with a light side, cracks, and runs of water."""
    relief = cloud(rng, TILE_PX, 1.35)
    light = np.roll(relief, 2, axis=0) - relief
    crack = np.clip(0.06 - np.abs(cloud(rng, TILE_PX, 1.7)), 0, 1) / 0.06
    wet = np.clip(_runs(rng, TILE_PX) - 0.6, 0, 1)
    albedo = rng.uniform(0.13, 0.26) * np.exp(0.18 * relief + 1.1 * light)
    return _painted(albedo * (1 - 0.55 * crack) * (1 - 0.4 * wet), _tint(rng, 0.07))


def concrete(rng: np.random.Generator) -> Texture:
    """Cast concrete: stains, pores, and the seams of the boards it was cast between."""
    albedo = rng.uniform(0.26, 0.42) * np.exp(0.12 * cloud(rng, TILE_PX, 1.5))
    pores = cloud(rng, TILE_PX, 0.5) > 2.9
    albedo[pores] *= 0.5
    for row in range(0, TILE_PX, TILE_PX // 2):
        albedo[row : row + 3] *= 0.7
    return _painted(albedo * (1 - 0.3 * np.clip(_runs(rng, TILE_PX), 0, 1)), _tint(rng, 0.03))


def gravel(rng: np.random.Generator) -> Texture:
    """A floor of gravel and mud."""
    stones = cloud(rng, TILE_PX, 0.7)
    albedo = rng.uniform(0.08, 0.2) * np.exp(0.4 * stones + 0.25 * cloud(rng, TILE_PX, 1.8))
    return _painted(albedo, _tint(rng, 0.06))


def painted_steel(rng: np.random.Generator, colour: tuple[float, float, float]) -> Texture:
    """Paint of an albedo in RGB, with rust that comes through and runs down."""
    tone = np.exp(0.05 * cloud(rng, TILE_PX, 1.6))[..., None] * np.asarray(colour)
    rust = np.clip(cloud(rng, TILE_PX, 1.4) - rng.uniform(1.0, 2.2), 0, 1)
    rust = np.clip(rust + 0.5 * np.clip(_runs(rng, TILE_PX) - 1.2, 0, 1), 0, 1)[..., None]
    rusty = np.array([0.22, 0.09, 0.04]) * np.exp(0.3 * cloud(rng, TILE_PX, 0.9))[..., None]
    return _levels(tone + rust * (rusty - tone))


def cladding(rng: np.random.Generator) -> Texture:
    """Ribbed sheet metal: an insulated tank's or a hall's skin, with rows of rivets."""
    across = np.arange(TILE_PX) / TILE_PX
    ribs = 1 + 0.16 * np.tanh(4 * np.sin(2 * np.pi * 8 * across))[None, :]
    albedo = rng.uniform(0.3, 0.5) * ribs * np.exp(0.07 * cloud(rng, TILE_PX, 1.7))
    for row in (4, TILE_PX // 2):
        albedo[row : row + 4] *= 0.6
        albedo[row + 8 : row + 12, 16::32] *= 0.5
    albedo *= 1 - 0.35 * np.clip(_runs(rng, TILE_PX) - 0.4, 0, 1)
    return _painted(albedo, _tint(rng, 0.03))


def grating(rng: np.random.Generator) -> Texture:
    """A walkway of bars over a dark pit."""
    at = np.arange(TILE_PX)
    bars = (at % 32 < 7)[:, None] | (at % 128 < 9)[None, :]
    steel = rng.uniform(0.2, 0.35) * np.exp(0.15 * cloud(rng, TILE_PX, 1.3))
    return _painted(np.where(bars, steel, 0.02), _tint(rng, 0.02))


def dial(rng: np.random.Generator) -> Texture:
    """The face of a pressure gauge: round and black on white, but no target."""
    n = 256
    face = np.full((n, n), 0.03, np.float32)
    middle = (n // 2, n // 2)
    cv2.circle(face, middle, int(0.42 * n), 0.75, -1, cv2.LINE_AA)
    for angle in np.linspace(0.75 * np.pi, 2.25 * np.pi, 11):
        towards = np.array([np.cos(angle), np.sin(angle)])
        ends = (n / 2 + np.outer((0.31, 0.38), n * towards)).astype(int)
        cv2.line(face, tuple(ends[0].tolist()), tuple(ends[1].tolist()), 0.04, 3, cv2.LINE_AA)
    shown = rng.uniform(0.75, 2.25) * np.pi
    tip = (n / 2 + 0.34 * n * np.array([np.cos(shown), np.sin(shown)])).astype(int)
    cv2.line(face, middle, tuple(tip.tolist()), 0.04, 5, cv2.LINE_AA)
    cv2.circle(face, middle, int(0.05 * n), 0.05, -1, cv2.LINE_AA)
    return _painted(face, np.ones(3))


def sign(rng: np.random.Generator) -> Texture:
    """A warning sign: a black and yellow frame, and lines of text that nobody can read."""
    n = 256
    at = np.add.outer(np.arange(n), np.arange(n)) // 24 % 2
    yellow, black = np.array([0.62, 0.42, 0.02]), np.array([0.03, 0.03, 0.03])
    picture = np.where(at[..., None] == 1, yellow, black)
    picture[28:-28, 28:-28] = (0.7, 0.7, 0.66)
    for row in range(60, n - 50, 30):
        end = int(rng.uniform(0.5, 0.85) * n)
        picture[row : row + 12, 50:end] = black
    return _levels(picture)


def add_material(
    spec: mujoco.MjSpec, name: str, texture: Texture, specular: float = 0.0, shine: float = 0.3
) -> str:
    """Give a material of that texture to the world; returns its name."""
    height, width = texture.shape[:2]
    picture = spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=width,
        height=height,
        nchannel=3,
    )
    picture.data = texture.tobytes()  # as an argument it would go byte by byte
    material = spec.add_material(name=name, specular=specular, shininess=shine)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return name


def _runs(rng: np.random.Generator, n: int) -> NDArray[np.float32]:
    """Where water ran down, (n, n), about normal."""
    noise = cloud(rng, n, 0.8)
    smeared = np.fft.irfft(np.fft.rfft(noise, axis=0) * _smear(n)[:, None], n=n, axis=0)
    return np.asarray(smeared / smeared.std(), dtype=np.float32)


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
