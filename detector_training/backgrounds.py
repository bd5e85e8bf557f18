"""Real photographs that scenes are rendered into: found in packages, split by file.

Nothing is downloaded. Photographs come from the wheels of scikit-image and scikit-learn, from the
Debian packages in ``DEBIAN_SOURCES`` where these are installed (or unpacked with ``dpkg -x``), and
from folders of the user's. Without any of them the procedural rooms alone are used.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.errors import BackgroundsError

SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".webp"})
MAX_FILES = 20_000
MAX_FILE_BYTES = 64 * 1024 * 1024
MIN_FILE_BYTES = 8_192
"""Smaller files are icons."""
MAX_SIDE_PX = 1100
"""Photographs are kept at most this large in memory; a scene is 640x480."""


class Split(StrEnum):
    """Which pictures a background may appear in."""

    TRAIN = "train"
    VAL = "val"
    """To choose thresholds and settings by."""
    TEST = "test"
    """To measure on, and for nothing else."""


class Kind(StrEnum):
    """What a background picture is good for."""

    PHOTO = "photo"
    """A view: whatever stands behind and beside the target."""
    TEXTURE = "texture"
    """A surface seen head-on: walls, floors, boards."""


@dataclass(frozen=True, slots=True)
class Background:
    """One picture file and where it came from."""

    path: Path
    kind: Kind
    source: str
    """Package or folder."""

    @property
    def key(self) -> str:
        """What near-identical files share: sizes of one wallpaper, both views of a stereo pair."""
        parts = self.path.parts
        if "contents" in parts:
            return parts[parts.index("contents") - 1].lower()
        stem = re.sub(r"([-_ ]?(left|right|[lr]|\d+))+$", "", self.path.stem.lower())
        return stem or self.path.stem.lower()

    @property
    def split(self) -> Split:
        """By a hash of the key: the same on every machine, whatever else is installed."""
        digest = hashlib.sha256(self.key.encode()).digest()
        if digest[0] < 24:
            return Split.TEST
        return Split.VAL if digest[0] < 44 else Split.TRAIN


@dataclass(frozen=True, slots=True)
class Source:
    """A package with photographs whose licence allows training on them."""

    package: str
    licence: str
    kind: Kind
    folders: tuple[str, ...]
    """Below the package root."""
    only: str = r"\.(jpe?g|png|webp)$"
    """What a path must match ..."""
    never: str = r"$^"
    """... and must not."""


# Maps of normals, gloss and the like that lie beside the colour textures of games.
_NO_COLOUR = (
    r"(_n|_nm|_s|_z|_d|_add|normal|norm\d?|gloss|mask|local|height|spec|[a-z0-9]\d+[nsz])\."
)

_LOMIRI_20 = r"/(Fossa|Infinite-Sea|Kleiber|Painting-Colors)_by_[^/]+\.jpg$"

DEBIAN_SOURCES = (
    Source(
        "gnome-backgrounds",
        "CC-BY-SA-3.0, CC-BY-SA-2.0, CC-BY-2.0, GPL-2+",
        Kind.PHOTO,
        ("usr/share/backgrounds/gnome",),
    ),
    Source(
        "mate-backgrounds",
        "GPL-2+, CC-BY-SA-4.0",
        Kind.PHOTO,
        ("usr/share/backgrounds/mate",),
    ),
    Source(
        "plasma-workspace-wallpapers",
        "GPL-2+",
        Kind.PHOTO,
        ("usr/share/wallpapers",),
        never=r"/screenshot\.",
    ),
    Source(
        "ukui-wallpapers",
        "CC-BY-SA-3.0",
        Kind.PHOTO,
        ("usr/share/backgrounds",),
        only=r"backgrounds/(2004default|calla|city|desert|firstgeneration|fluent-color|goldfish"
        r"|focal-ubuntukylin|rhythm|rollpaper|string|the-mouse)\.(jpg|png)$",
    ),
    Source(
        "lomiri-wallpapers-16.04",
        "CC-BY-4.0, CC-BY-SA-3.0, CC-BY-SA-4.0, CC0",
        Kind.PHOTO,
        ("usr/share/backgrounds",),
        only=r"backgrounds/[^/]+_by_[^/]+\.jpg$",
        never=_LOMIRI_20,
    ),
    Source(
        "lomiri-wallpapers-20.04",
        "CC-BY-4.0, CC-BY-SA-3.0, CC-BY-SA-4.0, CC0",
        Kind.PHOTO,
        ("usr/share/backgrounds",),
        only=_LOMIRI_20,
    ),
    Source(
        "opencv-doc",
        "BSD-3-Clause, Apache-2.0",
        Kind.PHOTO,
        ("usr/share/doc/opencv-doc/examples",),
        only=r"\.jpe?g$",
        never=r"/(left|right)\d*\.jpg|ellipses|logo",
    ),
    Source(
        "supertuxkart-data",
        "CC-BY-SA-3.0, CC-BY-3.0, CC0, GPL-3+",
        Kind.TEXTURE,
        ("usr/share/games/supertuxkart/data/textures", "usr/share/games/supertuxkart/data/tracks"),
        only=r"\.jpe?g$",
        never=_NO_COLOUR,
    ),
    Source(
        "redeclipse-data",
        "CC-BY-3.0, CC-BY-SA-3.0, CC0",
        Kind.TEXTURE,
        tuple(
            f"usr/share/games/redeclipse/data/{author}"
            for author in ("john", "nobiax", "philipk", "torley", "trak", "ulukai", "wicked")
        ),
        only=r"\.(jpe?g|png)$",
        never=_NO_COLOUR,
    ),
)

_SKIMAGE_PHOTOS = (
    "astronaut.png",
    "brick.png",
    "camera.png",
    "chelsea.png",
    "coffee.png",
    "grass.png",
    "gravel.png",
    "motorcycle_left.png",
    "motorcycle_right.png",
    "rocket.jpg",
)
_SKIMAGE_TEXTURES = frozenset({"brick.png", "grass.png", "gravel.png"})


def find_backgrounds(
    folders: Sequence[Path] = (), package_root: Path = Path("/")
) -> tuple[Background, ...]:
    """All usable background pictures, sorted by path.

    Args:
        folders: folders of the user's, searched with their sub-folders.
        package_root: where Debian packages lie; another one after ``dpkg -x PACKAGE.deb ROOT``.

    Raises:
        BackgroundsError: a folder of the user's is missing or holds no picture.
    """
    found = [*_from_wheels()]
    for source in DEBIAN_SOURCES:
        found.extend(_from_debian(source, package_root))
    for folder in folders:
        if not folder.is_dir():
            raise BackgroundsError(f"--backgrounds {folder}: no such folder; give one of pictures")
        mine = [
            Background(p, Kind.PHOTO, str(folder))
            for p in _files(folder)
            if p.suffix.lower() in SUFFIXES
        ]
        if not mine:
            kinds = ", ".join(sorted(SUFFIXES))
            raise BackgroundsError(f"--backgrounds {folder}: no picture in it ({kinds})")
        found.extend(mine)
    unique = {b.path: b for b in found}
    return tuple(unique[p] for p in sorted(unique))


def licence_of(source: str) -> str:
    """Licence of the pictures of a package, or who has to say it."""
    known = {s.package: s.licence for s in DEBIAN_SOURCES}
    known |= {
        "scikit-image": "BSD-3-Clause and public domain, see skimage/data/README.txt",
        "scikit-learn": "CC-BY-2.0, see sklearn/datasets/images/README.txt",
    }
    return known.get(source, "the user's own")


def advice(found: Sequence[Background]) -> str | None:
    """One line on what to install when few photographs were found; None when there are enough."""
    if sum(b.kind is Kind.PHOTO for b in found) >= 40:
        return None
    packages = " ".join(s.package for s in DEBIAN_SOURCES)
    return (
        f"only {len(found)} background pictures found, the rest is procedural; for real ones: "
        f"apt-get install {packages}   (or give --backgrounds DIR)"
    )


def of_split(found: Iterable[Background], split: Split) -> tuple[Background, ...]:
    """Those whose file belongs to ``split``; no file is in both."""
    return tuple(b for b in found if b.split is split)


@lru_cache(maxsize=800)
def load_rgb(path: Path) -> NDArray[np.uint8] | None:
    """The picture (H, W, 3) RGB, at most ``MAX_SIDE_PX`` on a side; None when it is no photograph.

    Drawings with a handful of colours, icons, and maps of normals are turned down here, since only
    their content tells.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None or min(image.shape[:2]) < 200:
        return None
    shrink = MAX_SIDE_PX / max(image.shape[:2])
    if shrink < 1:
        size = (round(image.shape[1] * shrink), round(image.shape[0] * shrink))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    rgb = np.ascontiguousarray(image[:, :, ::-1])
    return rgb if _is_photo_like(rgb) else None


def _is_photo_like(rgb: NDArray[np.uint8]) -> bool:
    small = np.asarray(cv2.resize(rgb, (64, 64), interpolation=cv2.INTER_AREA)).reshape(-1, 3)
    mean, spread = small.mean(0), small.std(0).max()
    is_normal_map = mean[2] > 200 and abs(mean[0] - 128) < 20 and abs(mean[1] - 128) < 20
    colours = len(np.unique(small // 4, axis=0))
    return bool(not is_normal_map and spread > 4 and mean.max() > 12 and colours > 40)


def _files(folder: Path) -> Iterator[Path]:
    count = 0
    for path in sorted(folder.rglob("*")):
        if count >= MAX_FILES:
            return
        if path.is_symlink() or not path.is_file():
            continue
        if MIN_FILE_BYTES <= path.stat().st_size <= MAX_FILE_BYTES:
            count += 1
            yield path


def _from_debian(source: Source, root: Path) -> Iterator[Background]:
    only, never = re.compile(source.only, re.I), re.compile(source.never, re.I)
    for folder in source.folders:
        for path in _files(root / folder):
            name = path.as_posix()
            if only.search(name) and not never.search(name):
                yield Background(path, source.kind, source.package)


def _from_wheels() -> Iterator[Background]:
    if folder := _package_folder("skimage"):
        for name in _SKIMAGE_PHOTOS:
            if (path := folder / "data" / name).is_file():
                kind = Kind.TEXTURE if name in _SKIMAGE_TEXTURES else Kind.PHOTO
                yield Background(path, kind, "scikit-image")
    if folder := _package_folder("sklearn"):
        for path in sorted((folder / "datasets" / "images").glob("*.jpg")):
            yield Background(path, Kind.PHOTO, "scikit-learn")


def _package_folder(name: str) -> Path | None:
    spec = find_spec(name)
    return Path(spec.origin).parent if spec and spec.origin else None
