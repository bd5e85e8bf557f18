"""From light to a picture file: lens, exposure, sensor noise, white balance, JPEG."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.image import LinearImage, luminance, srgb_from_linear
from detector_training.scenes.recipe import Plan


def motion_kernel(length_px: float, angle_rad: float, curve: float = 0.0) -> NDArray[np.float32]:
    """Kernel of a camera that moved ``length_px`` while the shutter was open."""
    n = max(3, int(np.ceil(length_px)) | 1)
    t = np.linspace(-0.5, 0.5, 8 * n)
    x = t * length_px * np.cos(angle_rad) - curve * length_px * (t**2 - 1 / 12)
    y = t * length_px * np.sin(angle_rad) + curve * length_px * (t**2 - 1 / 12)
    half = n // 2 + 1
    edges = np.arange(-half - 0.5, half + 1)
    kernel, _, _ = np.histogram2d(y, x, bins=(edges, edges))
    kernel = cv2.GaussianBlur(kernel.astype(np.float32), (0, 0), 0.5)
    return np.asarray(kernel / kernel.sum())


def disc_kernel(radius_px: float) -> NDArray[np.float32]:
    """Kernel of a lens out of focus: a uniform disc with a filtered edge."""
    half = int(np.ceil(radius_px)) + 1
    c = np.arange(-half, half + 1, dtype=np.float32)
    kernel = np.clip(radius_px + 0.5 - np.hypot(c[:, None], c[None, :]), 0, 1)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def blurred(image: LinearImage, kernel: NDArray[np.float32]) -> LinearImage:
    """Filtered, with the border repeated."""
    return np.asarray(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REPLICATE))


def random_optics(
    rng: np.random.Generator,
    image: LinearImage,
    readable_px: float,
    plan: Plan,
    conditions: list[str],
) -> LinearImage:
    """Lens softness always; defocus and motion blur at times; named in ``conditions``.

    ``readable_px`` is the size of what must stay readable: a target smeared beyond recognition
    would teach the net to see targets everywhere.
    """
    probability, share = plan.motion
    if rng.random() < probability:
        longest = float(np.clip(share * readable_px, 2.5, 16))
        length = float(np.exp(rng.uniform(np.log(2), np.log(longest))))
        image = blurred(image, motion_kernel(length, rng.uniform(0, np.pi), rng.normal(0, 0.3)))
        if length > max(0.12 * readable_px, 2.2):
            conditions.append("blur")
    probability, share = plan.defocus
    if rng.random() < probability:
        widest = float(np.clip(share * readable_px, 1.2, 4.5))
        radius = rng.uniform(1.0, widest)
        image = blurred(image, disc_kernel(radius))
        if radius > max(0.04 * readable_px, 1.1):
            conditions.append("blur")
    soft = rng.uniform(*plan.soft_px)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), soft))


def random_exposure(
    rng: np.random.Generator, image: LinearImage, plan: Plan, conditions: list[str]
) -> LinearImage:
    """A metering of the whole picture that is right, too dark or too bright."""
    metered = 0.18 / max(float(luminance(image[::8, ::8]).mean()), 1e-4)
    stops = rng.normal(0.0, plan.stops)
    kind = rng.random()
    if kind < plan.dark:
        stops = rng.uniform(*plan.dark_stops)
        conditions.append("low_light")
    elif kind < plan.dark + plan.bright:
        stops = rng.uniform(1.3, 2.8)
        conditions.append("over_exposed")
    return np.asarray(image * np.float32(min(metered, 30.0) * 2.0**stops))


def vignette(rng: np.random.Generator, image: LinearImage) -> LinearImage:
    """Darker corners, cos^4 and more."""
    h, w = image.shape[:2]
    y, x = np.mgrid[-1 : 1 : complex(h), -1 : 1 : complex(w)].astype(np.float32)
    return np.asarray(image / (1 + rng.uniform(0, 0.35) * (x * x + y * y)[..., None]) ** 2)


def add_noise(
    rng: np.random.Generator, image: LinearImage, full_well: float, read: float, grain: float
) -> LinearImage:
    """Shot noise of ``full_well`` electrons at 1.0, read noise, and some of it as blotches.

    Demosaicing and denoising correlate what the sensor gives, hence the blotches (``grain`` is
    their share).
    """
    fine = rng.standard_normal(image.shape, dtype=np.float32)
    if grain > 0:
        soft: LinearImage = cv2.GaussianBlur(fine, (0, 0), 0.9) * np.float32(3.2)
        fine = np.asarray(np.float32(1 - grain) * fine + np.float32(grain) * soft)
    sigma = np.sqrt(np.clip(image, 0, None) / full_well + read * read)
    return np.asarray(image + sigma * fine, dtype=np.float32)


def develop(
    rng: np.random.Generator, image: LinearImage, plan: Plan, conditions: list[str]
) -> NDArray[np.uint8]:
    """White balance, noise, tone curve, sharpening: 8-bit RGB (H, W, 3)."""
    warmth = rng.normal(0, 0.12)
    balance = np.exp([warmth, rng.normal(0, 0.04), -warmth]).astype(np.float32)
    dark = "low_light" in conditions
    full_well = float(np.exp(rng.uniform(*np.log(plan.full_well))))
    full_well /= plan.dark_noise if dark else 1.0
    read = float(np.exp(rng.uniform(np.log(0.0005), np.log(0.01))))
    noisy = add_noise(rng, image * balance, full_well, read, rng.uniform(0, 0.8))
    if full_well < 800:
        conditions.append("noise")
    if dark and rng.random() < 0.6:  # the camera lifts a dark picture, noise and all
        noisy = noisy * np.float32(rng.uniform(2.0, 8.0))
    rgb = srgb_from_linear(noisy).astype(np.float32)
    contrast, pivot = rng.uniform(0.75, 1.25), rng.uniform(90, 150)
    rgb = (rgb - pivot) * contrast + pivot + rng.uniform(-12, 12)
    grey = rgb.mean(-1, keepdims=True)
    rgb = grey + (rgb - grey) * rng.uniform(0.5, 1.3)
    if rng.random() < 0.5:
        soft = np.asarray(cv2.GaussianBlur(rgb, (0, 0), rng.uniform(0.8, 1.6)))
        rgb = rgb + rng.uniform(0.2, 1.2) * (rgb - soft)
    return np.asarray(np.clip(np.rint(rgb), 0, 255).astype(np.uint8))


def jpeg(rgb: NDArray[np.uint8], quality: int) -> bytes:
    """The picture as JPEG."""
    parameters = [cv2.IMWRITE_JPEG_QUALITY, quality]
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(rgb[:, :, ::-1]), parameters)
    return bytes(data)
