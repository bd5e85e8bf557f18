"""A bag of ROS messages as a source: pictures by their own stamps, the camera by CameraInfo.

Times are those of the messages' headers. When a message was received says when a network was
done with it, and in a bag that was recorded elsewhere not even that.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drone_client.airframe import Airframe
from drone_client.errors import SourceError
from drone_client.pose_buffer import PoseBuffer
from drone_client.source import Capture, stride
from drone_client.source.bag_camera import camera_of_bag
from drone_client.source.bag_file import BagFile, RawMessage
from drone_client.source.bag_poses import read_poses
from drone_client.source.bag_topics import choose_topics
from drone_client.source.pairing import Pair, Pairer
from drone_client.source.ros_images import PictureError, color_rgb, depth_units
from drone_client.source.ros_transforms import stamp_ns
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.geometry import Pose

MAX_PAIR_DISTANCE_NS: Final = 20_000_000
"""As for recordings in the TUM layout."""
MAX_REASONS: Final = 20
SDK_MARK: Final = "/device_0/info"


@dataclass(frozen=True, slots=True)
class BagOptions:
    """What a user says about a bag; None: it is found out."""

    color_topic: str | None = None
    depth_topic: str | None = None
    """"" for none."""
    pose_topic: str | None = None
    """Odometry or pose of the body, or ``tf:PARENT:CHILD``; None: the pose is not known."""


class BagSource:
    """The pictures of a bag, one at a time, as an ``RgbdSource``.

    Raises:
        SourceError: no or several possible topics, no camera, or not one picture that can be read.
    """

    def __init__(
        self,
        file: BagFile,
        name: str,
        camera: RgbdCamera | None = None,
        airframe: Airframe | None = None,
        options: BagOptions | None = None,
    ) -> None:
        """Find topics, camera and poses, and look at the first picture.

        Args:
            file: the opened bag.
            name: of the bag, for messages.
            camera: stands in for CameraInfo and /tf_static.
            airframe: where the camera sits on the body; needed with ``options.pose_topic``.
            options: topics.
        """
        options = BagOptions() if options is None else options
        if SDK_MARK in file.topics:
            raise SourceError(
                f"bag {name}: of the RealSense SDK, whose headers hold no stamps of the camera; "
                f"turn it into a recording: drone-client record OUT --source realsense:{name}"
            )
        self._file = file
        try:
            self._topics = choose_topics(
                {topic: info.kind for topic, info in file.topics.items()},
                options.color_topic,
                options.depth_topic,
            )
            self._count = file.topics[self._topics.color].count
            self.camera = camera_of_bag(file, self._topics) if camera is None else camera
            self._poses = PoseBuffer()
            if options.pose_topic is not None:
                self._poses = read_poses(file, options.pose_topic, airframe)
        except SourceError as error:
            raise SourceError("; ".join((f"bag {name}: {error}", *file.notes))) from None
        self._bad: Counter[str] = Counter()
        if next(self.captures(), None) is None:
            said = "; ".join(self.notes) or f"no message at {self._topics.color}"
            raise SourceError(f"bag {name}: not one colour picture can be read: {said}")

    @property
    def notes(self) -> tuple[str, ...]:
        """What could not be read while it was last played, and why."""
        bad = (f"{number} x {reason}" for reason, number in self._bad.most_common())
        return (*self._file.notes, *bad)

    def __len__(self) -> int:
        """Colour messages; what cannot be read of them is left out of the captures."""
        return self._count

    def captures(self) -> Iterator[Capture]:
        """The captures, oldest first; those that cannot be read are left out, and noted."""
        self._bad.clear()
        return self._loaded(self._pairs())

    def some_captures(self, at_most: int) -> Iterator[Capture]:
        """So many of the captures, spread evenly; the others are not even decoded."""
        self._bad.clear()
        step = stride(self._count, at_most)
        return self._loaded(islice(self._pairs(), 0, None, step))

    def world_from_camera(self, t_source_ns: int) -> Pose | None:
        """Interpolated pose of the colour camera; None outside what the bag tells."""
        return self._poses.at(t_source_ns)

    def _pairs(self) -> Iterator[Pair[Any, Any]]:
        """Messages, paired by their headers' stamps."""
        pairer: Pairer[Any, Any] = Pairer(MAX_PAIR_DISTANCE_NS)
        color, depth = self._topics.color, self._topics.depth
        for raw in self._file.messages([t for t in (color, depth) if t is not None]):
            message = self._decoded(raw)
            if message is None:
                continue
            add = pairer.add_color if raw.topic == color else pairer.add_depth
            yield from add(stamp_ns(message.header), message)
        yield from pairer.flush()
        for stream, counter in (
            ("colour", pairer.unpaired_color),
            ("depth", pairer.unpaired_depth),
        ):
            for reason, number in counter.items():
                if depth is not None:
                    self._bad[f"{stream}: {reason.value}"] += number

    def _decoded(self, raw: RawMessage) -> Any:
        try:
            return self._file.decode(raw)
        except ValueError as error:
            self._note(f"{raw.topic}: {error}")
            return None

    def _loaded(self, pairs: Iterator[Pair[Any, Any]]) -> Iterator[Capture]:
        for pair in pairs:
            try:
                color = color_rgb(pair.color)
                self._check_size(color, self.camera.color.width, self.camera.color.height)
            except PictureError as error:
                self._note(f"{self._topics.color}: {error}")
                continue
            seconds, ns = divmod(pair.t_color_ns, 1_000_000_000)
            depth = None if pair.depth is None else self._depth(pair.depth)
            yield Capture(pair.t_color_ns, color, depth, f"{seconds}.{ns:09d}")

    def _depth(self, message: Any) -> NDArray[np.uint16] | None:
        try:
            depth = depth_units(message, self.camera.depth_scale_m)
            self._check_size(depth, self.camera.depth.width, self.camera.depth.height)
        except PictureError as error:
            self._note(f"{self._topics.depth}: {error}")
            return None
        return depth

    def _check_size(self, picture: NDArray[Any], width: int, height: int) -> None:
        if picture.shape[:2] != (height, width):
            raise PictureError(
                f"a picture of {picture.shape[1]}x{picture.shape[0]}, the camera has "
                f"{width}x{height}"
            )

    def _note(self, reason: str) -> None:
        known = reason in self._bad or len(self._bad) < MAX_REASONS
        self._bad[reason if known else "other reasons"] += 1
