"""Which topics of a bag are the colour and the depth pictures."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from drone_client.errors import SourceError

IMAGE: Final = "sensor_msgs/msg/Image"
COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO: Final = "sensor_msgs/msg/CameraInfo"
MAX_LISTED: Final = 12
_COLOR_WORDS: Final = ("color", "colour", "rgb")
_OTHER_EYES: Final = re.compile(r"infra|(^|[/_])ir([/_0-9]|$)|mask|label|segment|debug|fisheye")


@dataclass(frozen=True, slots=True)
class BagTopics:
    """The picture topics of a bag, and where their cameras are told."""

    color: str
    depth: str | None

    @property
    def color_info(self) -> str:
        """Topic of the colour camera's CameraInfo."""
        return info_topic(self.color)

    @property
    def depth_info(self) -> str | None:
        """Topic of the depth camera's CameraInfo."""
        return None if self.depth is None else info_topic(self.depth)


def choose_topics(
    types: Mapping[str, str], color: str | None = None, depth: str | None = None
) -> BagTopics:
    """The topics that were named, and for the others the only ones that can be meant.

    Args:
        types: message type of each topic of the bag.
        color: named by the user.
        depth: named by the user; "" for none.

    Raises:
        SourceError: there is no such topic, none at all, or several that could be meant; with
            their names.
    """
    pictures = [t for t, kind in types.items() if kind in (IMAGE, COMPRESSED)]
    depths = [t for t in pictures if "depth" in t.lower()]
    colors = [t for t in pictures if t not in depths and not _OTHER_EYES.search(t.lower())]
    named = [t for t in colors if any(word in t.lower() for word in _COLOR_WORDS)]
    if color is None:
        color = _only(named or colors, types, "colour", "--color-topic")
        if color is None:
            raise SourceError(f"no colour pictures in the bag; it holds {listed(types)}")
    if depth is None:
        # Raw depth is what we want; aligned depth is that, resampled
        raw = [t for t in depths if "aligned" not in t.lower()]
        depth = _only(raw or depths, types, "depth", "--depth-topic")
    for topic in (color, depth):
        if topic and topic not in pictures:
            raise SourceError(f"no pictures at {topic}; the bag has pictures at {listed(pictures)}")
    return BagTopics(color, depth or None)


def base_topic(topic: str) -> str:
    """The picture topic without its transport: /camera/depth/image/compressedDepth and such."""
    return re.sub(r"/(compressed|compressedDepth|theora|zstd)$", "", topic)


def info_topic(topic: str) -> str:
    """Where ROS puts the CameraInfo of a picture topic: beside it."""
    return base_topic(topic).rpartition("/")[0] + "/camera_info"


def is_rectified(topic: str) -> bool:
    """By ROS's naming: image_rect, image_rect_color, image_rect_raw."""
    return "rect" in base_topic(topic).rpartition("/")[2]


def listed(topics: Iterable[str]) -> str:
    """Some names, for a message."""
    names = sorted(topics)
    more = f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else ""
    return (", ".join(names[:MAX_LISTED]) or "nothing") + more


def _only(candidates: list[str], types: Mapping[str, str], kind: str, option: str) -> str | None:
    """The only one, of several transports of one picture the raw one; None: there is none."""
    bases = {base_topic(t) for t in candidates}
    if len(bases) > 1:
        raise SourceError(
            f"several topics could be {kind}: {listed(candidates)}; name one with {option}"
        )
    raw = [t for t in candidates if types[t] == IMAGE]
    return next(iter(sorted(raw) or sorted(candidates)), None)
