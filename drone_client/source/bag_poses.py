"""Where the camera was, by a bag's odometry, poses or transforms, with the airframe's help."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import reduce
from itertools import pairwise
from operator import matmul
from typing import Any, Final

from drone_client.airframe import Airframe
from drone_client.errors import SourceError
from drone_client.pose_buffer import PoseBuffer
from drone_client.source.bag_camera import static_transforms
from drone_client.source.bag_file import BagFile
from drone_client.source.bag_topics import listed
from drone_client.source.ros_transforms import TransformTree, frame_name, pose_of, stamp_ns
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Pose

TF: Final = "/tf"
TF_PREFIX: Final = "tf:"
MAX_POSES: Final = 1_000_000
"""An hour at 200 Hz, and 0.5 GB."""
_POSE_OF: Final[dict[str, Callable[[Any], Any]]] = {
    "nav_msgs/msg/Odometry": lambda m: m.pose.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: m.pose.pose,
    "geometry_msgs/msg/PoseStamped": lambda m: m.pose,
}


def read_poses(file: BagFile, topic: str, airframe: Airframe | None) -> PoseBuffer:
    """``world_from_camera`` over the headers' times.

    Args:
        file: the bag.
        topic: of the body's pose (Odometry, PoseStamped, PoseWithCovarianceStamped), or
            ``tf:WORLD:BODY``, two frames of /tf and /tf_static.
        airframe: where the camera sits on the body.

    Raises:
        SourceError: no such topic or frames, another type, no airframe, or no pose at all.
    """
    if airframe is None:
        raise SourceError(
            f"{topic} tells where the body is: --airframe must say where the camera sits on it"
        )
    if topic.startswith(TF_PREFIX):
        poses = _of_transforms(file, topic)
    else:
        info = file.topics.get(topic)
        if info is None or info.kind not in _POSE_OF:
            known = [t for t, i in file.topics.items() if i.kind in _POSE_OF]
            raise SourceError(
                f"no poses at {topic}; the bag has poses at {listed(known)}; or name two frames "
                f"of its transforms as {TF_PREFIX}WORLD:BODY"
            )
        poses = _of_topic(file, topic, _POSE_OF[info.kind])
    buffer = PoseBuffer(MAX_POSES)
    for t_ns, world_from_body in poses:
        if len(buffer) == MAX_POSES:
            file.notes.append(f"{topic}: only the first {MAX_POSES} poses were taken")
            break
        buffer.add(t_ns, world_from_body @ airframe.body_from_camera)
    if not len(buffer):
        raise SourceError(f"{topic}: not one pose that can be read")
    return buffer


def _of_topic(
    file: BagFile, topic: str, pose_in: Callable[[Any], Any]
) -> Iterator[tuple[int, Pose]]:
    bad = 0
    for raw in file.messages([topic]):
        try:
            message = file.decode(raw)
            pose = pose_in(message)
            yield stamp_ns(message.header), pose_of(pose.position, pose.orientation)
        except (ValueError, GeometryError):
            bad += 1
    if bad:
        file.notes.append(f"{topic}: {bad} messages are no poses")


def _of_transforms(file: BagFile, text: str) -> Iterator[tuple[int, Pose]]:
    """Poses of one frame in another, at the stamps of the link between them that moves most."""
    parts = text.removeprefix(TF_PREFIX).split(":")
    if len(parts) != 2 or not all(parts):
        raise SourceError(f"{text!r} names no two frames; such as {TF_PREFIX}odom:base_link")
    world, body = frame_name(parts[0]), frame_name(parts[1])
    tree = static_transforms(file)
    moving = _moving(file, tree)
    path = tree.path(world, body)
    if path is None:
        raise SourceError(
            f"no transforms from {world!r} to {body!r}; there are {listed(tree.frames)}"
        )
    links = [link for link in pairwise(path) if link in moving]
    if not links:
        raise SourceError(f"{world!r} and {body!r} do not move against each other in {TF}")
    buffers = {link: PoseBuffer(len(moving[link])) for link in links}
    for link, buffer in buffers.items():
        for t_ns, pose in moving[link]:
            buffer.add(t_ns, pose)
    for t_ns, _ in moving[max(links, key=lambda link: len(moving[link]))]:
        now = {link: buffer.at(t_ns) for link, buffer in buffers.items()}
        known = {link: pose for link, pose in now.items() if pose is not None}
        if len(known) == len(links):
            steps = [known.get(link) or tree.between(*link) for link in pairwise(path)]
            yield t_ns, reduce(matmul, steps)


def _moving(file: BagFile, tree: TransformTree) -> dict[tuple[str, str], list[tuple[int, Pose]]]:
    """What /tf tells of each two neighbours, both ways round; the tree learns who they are."""
    moving: dict[tuple[str, str], list[tuple[int, Pose]]] = defaultdict(list)
    room = MAX_POSES
    for raw in file.messages([TF]):
        try:
            transforms = file.decode(raw).transforms
        except ValueError:
            continue
        room -= len(transforms)
        if room < 0:
            file.notes.append(f"{TF}: only the first {MAX_POSES} transforms were taken")
            break
        for t in transforms:
            parent, child = frame_name(t.header.frame_id), frame_name(t.child_frame_id)
            try:
                pose = pose_of(t.transform.translation, t.transform.rotation)
            except GeometryError:
                continue
            tree.add(parent, child, pose)
            moving[parent, child].append((stamp_ns(t.header), pose))
            moving[child, parent].append((stamp_ns(t.header), pose.inverse()))
    return moving
