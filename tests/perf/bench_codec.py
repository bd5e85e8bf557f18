"""Time and bytes of the picture codecs, as ratios to PNG level 1 in the same run.

Depth also as a slow link gets it: around a target at full resolution, elsewhere every second or
fourth row and column, nothing past 6 m. That is compared with PNG of the whole picture, and what
was sent has to come back without loss.

``python tests/perf/bench_codec.py [FOLDER]`` - FOLDER holds ``depth/*.png`` (16 bit) and, if there,
``rgb/*.png``; without it only the synthetic pictures are measured. CPU time of one thread, and the
codecs take turns on each picture, so that a busy machine slows them alike.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drone_client.region_of_interest import depth_region
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.color import decode_color, encode_color
from rgbd_wire.depth import (
    ALL_OF_IT,
    CodedDepth,
    DepthPlan,
    Step,
    decode_depth,
    encode_depth,
)
from rgbd_wire.geometry import Pose

D455_LATTICE_M = 380.0 * 0.095 * 32
SCALE_M = 0.001
SIZE = (480, 640)
RANGE_MAX_M = 6.0
RIG = RgbdCamera(
    *(CameraIntrinsics(SIZE[1], SIZE[0], 380.0, 380.0, 319.5, 239.5),) * 2,
    SCALE_M,
    Pose.identity(),
    D455_LATTICE_M,
)


@dataclass(frozen=True, slots=True)
class Codec:
    """A pair of functions; ``decode`` takes what ``encode`` gives."""

    name: str
    encode: Callable[[NDArray[Any]], Any]
    decode: Callable[[Any], Any]
    weigh: Callable[[Any], int]
    expected: Callable[[NDArray[Any]], NDArray[Any]] | None
    """What has to come back of a picture, to the last bit; None: the codec is lossy."""


def all_of_it(picture: NDArray[Any]) -> NDArray[Any]:
    """Nothing is left out."""
    return picture


def png() -> Codec:
    """The reference."""
    return Codec(
        "PNG level 1",
        lambda picture: cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1],
        lambda data: cv2.imdecode(data, cv2.IMREAD_UNCHANGED),
        len,
        all_of_it,
    )


def depth_codec(name: str, lattice_m: float, plan: DepthPlan = ALL_OF_IT) -> Codec:
    """Our depth codec, told of a lattice or not, and what to leave out."""

    def encode(depth: NDArray[np.uint16]) -> tuple[CodedDepth, int, int]:
        return encode_depth(depth, lattice_m, SCALE_M, plan), depth.shape[1], depth.shape[0]

    def decode(coded: tuple[CodedDepth, int, int]) -> NDArray[np.uint16]:
        return decode_depth(*coded, lattice_m, SCALE_M)

    def weigh(coded: tuple[CodedDepth, int, int]) -> int:
        return coded[0].size_bytes

    return Codec(name, encode, decode, weigh, lambda picture: planned(picture, plan))


def planned(depth: NDArray[np.uint16], plan: DepthPlan) -> NDArray[np.uint16]:
    """What a plan says of a picture, told apart from the codec."""
    sent = np.zeros(depth.shape, bool)
    sent[:: plan.step, :: plan.step] = True
    if plan.region is not None:
        x0, y0, x1, y1 = plan.region
        sent[y0:y1, x0:x1] = True
    if plan.range_max_m is not None:
        sent &= depth <= plan.range_max_m / SCALE_M
    return np.where(sent, depth, np.uint16(0))


def around_target(step: Step, distance_m: float) -> DepthPlan:
    """What a lean rung of the rate controller sends of a target seen 0.1 s ago, straight ahead."""
    target = Pose(np.array([0.0, 0.0, distance_m]), np.array([1.0, 0.0, 0.0, 0.0]))
    region = depth_region(target, Pose.identity(), 100_000_000, RIG)
    return DepthPlan(step, region, RANGE_MAX_M)


def color_codec(quality: int) -> Codec:
    """Our colour codec."""
    return Codec(
        f"JPEG q{quality}",
        lambda c: (encode_color(c, quality), c.shape[1], c.shape[0]),
        lambda coded: decode_color(*coded),
        lambda coded: len(coded[0]),
        None,
    )


def synthetic_depth(seed: int, *, on_lattice: bool) -> NDArray[np.uint16]:
    """A room as a stereo camera sees it: walls, boxes, disparity noise, holes, edge shadows."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    inverse_m = 1 / rng.uniform(2.5, 4) + 4e-4 * (u - 320) * rng.uniform(-1, 1)
    inverse_m = np.maximum(inverse_m, (v - 240) / 380 / 1.2)  # the floor
    for _ in range(12):
        x, y = rng.integers(0, SIZE[1]), rng.integers(0, SIZE[0])
        w, h = rng.integers(20, 160, 2)
        box = inverse_m[y : y + h, x : x + w]
        np.maximum(box, 1 / rng.uniform(1, 3.5), out=box)
    noise = cv2.GaussianBlur(rng.normal(0, 1, SIZE), (0, 0), 1.2)
    disparity = np.rint(D455_LATTICE_M * inverse_m + 2.0 / noise.std() * noise)
    depth_m = D455_LATTICE_M / np.maximum(disparity, 1)
    if not on_lattice:
        depth_m *= 1.003
    holes = cv2.GaussianBlur(rng.normal(0, 1, SIZE), (0, 0), 6)
    shadow = np.abs(np.diff(inverse_m, axis=1, prepend=0)) > 0.02
    depth_m[(holes > np.quantile(holes, 0.85)) | shadow] = 0
    return np.asarray(np.rint(depth_m / SCALE_M).clip(0, 65535), np.uint16)


def synthetic_color(seed: int) -> NDArray[np.uint8]:
    """Shaded boxes with sensor noise, RGB."""
    rng = np.random.default_rng(seed)
    picture = np.full((*SIZE, 3), 120.0)
    for _ in range(60):
        x, y = rng.integers(0, SIZE[1]), rng.integers(0, SIZE[0])
        w, h = rng.integers(10, 200, 2)
        picture[y : y + h, x : x + w] = rng.uniform(20, 235, 3)
    picture = cv2.GaussianBlur(picture, (0, 0), 1.0) + rng.normal(0, 2, picture.shape)
    return np.asarray(picture.clip(0, 255), np.uint8)


def recorded(folder: Path, count: int) -> tuple[list[NDArray[Any]], list[NDArray[Any]]]:
    """Up to ``count`` depth and colour pictures of a folder, evenly spread."""

    def spread(name: str, flags: int) -> list[NDArray[Any]]:
        paths = sorted((folder / name).glob("*.png")) or sorted((folder / name).glob("*.jpg"))
        step = max(1, len(paths) // count)
        pictures = [cv2.imread(str(path), flags) for path in paths[::step][:count]]
        return [picture for picture in pictures if picture is not None]

    depth = [d for d in spread("depth", cv2.IMREAD_UNCHANGED) if d.dtype == np.uint16]
    color = [c[..., ::-1].copy() for c in spread("rgb", cv2.IMREAD_COLOR)]
    if not depth:
        raise SystemExit(f"{folder}: no 16-bit pictures in {folder / 'depth'}")
    return depth, color


def timed_ms(work: Callable[[Any], Any], argument: Any) -> tuple[float, Any]:
    """CPU time of one call, of all threads, and what it gave."""
    start_ns = time.process_time_ns()
    result = work(argument)
    return 1e-6 * (time.process_time_ns() - start_ns), result


def measure(pictures: list[NDArray[Any]], codecs: list[Codec], repeats: int) -> NDArray[np.float64]:
    """Encode [ms], decode [ms] and bytes: (codec, picture, 3), best of ``repeats`` for times."""
    figures = np.full((len(codecs), len(pictures), 3), np.inf)
    for k, picture in enumerate(pictures):
        for _ in range(repeats):
            for i, codec in enumerate(codecs):
                encode_ms, coded = timed_ms(codec.encode, picture)
                decode_ms, decoded = timed_ms(codec.decode, coded)
                expected = decoded if codec.expected is None else codec.expected(picture)
                if not np.array_equal(decoded, expected):
                    raise SystemExit(f"{codec.name} is not lossless")
                figures[i, k] = np.minimum(
                    figures[i, k], (encode_ms, decode_ms, codec.weigh(coded))
                )
    return figures


def report(title: str, figures: NDArray[np.float64], codecs: list[Codec]) -> None:
    """One row per codec: median (10th to 90th percentile) and the median ratio to the first."""
    print(f"\n{title}, {figures.shape[1]} pictures")
    print(f"{'':20}{'encode ms':>24}{'ratio':>7}{'decode ms':>24}{'ratio':>7}", end="")
    print(f"{'kB':>24}{'ratio':>7}")
    scale = np.array([1.0, 1.0, 1e-3])
    for i, codec in enumerate(codecs):
        print(f"{codec.name:20}", end="")
        low, mid, high = np.quantile(figures[i] * scale, (0.1, 0.5, 0.9), axis=0)
        ratios = np.median(figures[i] / figures[0], axis=0)
        for column in range(3):
            spread = f"{mid[column]:.2f} ({low[column]:.2f}-{high[column]:.2f})"
            print(f"{spread:>24}{ratios[column]:7.2f}", end="")
        print()


def main() -> None:
    """Measure the synthetic pictures, and a folder's if one is given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--pictures", type=int, default=40)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    depth_codecs = [
        png(),
        depth_codec("JXL plain", 0.0),
        depth_codec("JXL ranks", D455_LATTICE_M),
        *(
            depth_codec(
                f"target {distance_m:.0f} m, 1/{step}",
                D455_LATTICE_M,
                around_target(step, distance_m),
            )
            for step in (2, 4)
            for distance_m in (3.0, 2.0, 1.0)
        ),
        depth_codec("no target, 1/2", D455_LATTICE_M, DepthPlan(2, None, RANGE_MAX_M)),
        depth_codec("no target, 1/4", D455_LATTICE_M, DepthPlan(4, None, RANGE_MAX_M)),
    ]
    color_codecs = [png(), *(color_codec(quality) for quality in (80, 65, 45, 25))]
    seeds = range(options.pictures)
    runs: list[tuple[str, list[NDArray[Any]], list[Codec]]] = [
        (
            "synthetic depth on the lattice",
            [synthetic_depth(s, on_lattice=True) for s in seeds],
            depth_codecs,
        ),
        (
            "synthetic depth off the lattice",
            [synthetic_depth(s, on_lattice=False) for s in seeds],
            depth_codecs,
        ),
        ("synthetic colour", [synthetic_color(s) for s in seeds], color_codecs),
    ]
    if options.folder is not None:
        depth, color = recorded(options.folder, options.pictures)
        runs.append((f"depth of {options.folder.name}", depth, depth_codecs))
        if color:
            runs.append((f"colour of {options.folder.name}", color, color_codecs))
    for number, (title, pictures, codecs) in enumerate(runs, 1):
        sys.stderr.write(f"{number}/{len(runs)} {title}\n")
        report(title, measure(pictures, codecs, options.repeats), codecs)


if __name__ == "__main__":
    main()
