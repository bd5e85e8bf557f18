"""The rig of a bag: two CameraInfo, and the way between their frames in /tf_static."""

from __future__ import annotations

from typing import Any

from drone_client.errors import SourceError
from drone_client.source.bag_file import BagFile
from drone_client.source.bag_topics import BagTopics, is_rectified
from drone_client.source.ros_camera import intrinsics_of_info
from drone_client.source.ros_images import MILLIMETRE_M, depth_scale_m
from drone_client.source.ros_transforms import TransformTree, frame_name
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Pose

TF_STATIC = "/tf_static"
_ASK = "give the camera file with --camera"


def camera_of_bag(file: BagFile, topics: BagTopics) -> RgbdCamera:
    """What the bag says of its cameras.

    Raises:
        SourceError: it says too little, or something that we do not have.
    """
    color_info = _first(file, topics.color_info)
    if color_info is None:
        raise SourceError(f"no CameraInfo at {topics.color_info}: {_ASK}")
    try:
        color = intrinsics_of_info(color_info, rectified=is_rectified(topics.color))
    except GeometryError as error:
        raise SourceError(f"{topics.color_info}: {error}; or {_ASK}") from None
    if topics.depth is None or topics.depth_info is None:
        return RgbdCamera(color, color, MILLIMETRE_M, Pose.identity())
    depth_info = _first(file, topics.depth_info)
    if depth_info is None:
        raise SourceError(f"no CameraInfo at {topics.depth_info}: {_ASK}")
    first_depth = _first(file, topics.depth)
    scale_m = MILLIMETRE_M if first_depth is None else depth_scale_m(first_depth)
    try:
        depth = intrinsics_of_info(depth_info, rectified=is_rectified(topics.depth))
        color_from_depth = _between(file, color_info.header.frame_id, depth_info.header.frame_id)
        return RgbdCamera(color, depth, scale_m, color_from_depth)
    except GeometryError as error:
        raise SourceError(f"{topics.depth_info}: {error}; or {_ASK}") from None


def static_transforms(file: BagFile) -> TransformTree:
    """All of /tf_static."""
    tree = TransformTree()
    for raw in file.messages([TF_STATIC]):
        try:
            tree.add_message(file.decode(raw))
        except ValueError as error:
            file.notes.append(f"{TF_STATIC}: {error}")
    return tree


def _between(file: BagFile, color_frame: str, depth_frame: str) -> Pose:
    """``color_from_depth``; the identity where both are of one frame."""
    color_frame, depth_frame = frame_name(color_frame), frame_name(depth_frame)
    if color_frame == depth_frame:
        return Pose.identity()
    found = static_transforms(file).find(color_frame, depth_frame)
    if found is None:
        raise SourceError(
            f"{TF_STATIC} does not say where {depth_frame!r} is in {color_frame!r}: {_ASK}"
        )
    return found


def _first(file: BagFile, topic: str) -> Any:
    """The first message of a topic that can be decoded; None: there is none."""
    for raw in file.messages([topic]):
        try:
            return file.decode(raw)
        except ValueError:
            continue
    return None
