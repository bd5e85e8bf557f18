"""Which source a user means: a folder, a bag, a camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from drone_client.airframe import Airframe
from drone_client.errors import SourceError
from drone_client.source import LiveSource, Recording
from drone_client.source.replay import open_recording
from rgbd_wire.camera import load_camera
from rgbd_wire.clock import Clock

if TYPE_CHECKING:
    from drone_client.source.bag import BagOptions
    from drone_client.source.bag_file import BagFile
    from drone_client.source.realsense_setup import RealsenseSettings

REALSENSE: Final = "realsense"
SDK_FILES: Final = (".bag", ".db3")
KNOWN: Final = (
    "a folder in TUM RGB-D layout (rgb.txt), a ROS 2 bag (folder or .db3), an .mcap, "
    "a ROS 1 .bag, or realsense[:SERIAL]"
)


def is_live(text: str) -> bool:
    """Whether it names a camera and not a recording; a folder of that name is ./realsense."""
    return text == REALSENSE or text.startswith(f"{REALSENSE}:")


def open_source(
    text: str,
    clock: Clock,
    camera: Path | None = None,
    airframe: Airframe | None = None,
    options: BagOptions | None = None,
    settings: RealsenseSettings | None = None,
) -> Recording | LiveSource:
    """Whatever a user names; raises as ``open_recorded`` and ``open_live``."""
    if is_live(text):
        return open_live(text, clock, settings, camera)
    return open_recorded(text, camera, airframe, options)


def open_recorded(
    text: str,
    camera: Path | None = None,
    airframe: Airframe | None = None,
    options: BagOptions | None = None,
) -> Recording:
    """A recording on disk.

    Args:
        text: a path.
        camera: camera JSON; None: that of the folder, or what the bag says.
        airframe: where the camera sits; needed for a pose from a bag.
        options: topics of a bag.

    Raises:
        SourceError: no such thing, none that is known, or one that cannot be read.
        CameraFileError: the camera file is missing or wrong.
    """
    if is_live(text):
        raise SourceError(
            f"{text} is a camera, no recording: fly with it, or record it with drone-client record"
        )
    path = Path(text)
    if not path.exists():
        raise SourceError(f"{text}: no such file or folder; a source is {KNOWN}")
    if path.is_dir() and (path / "rgb.txt").exists():
        return open_recording(path, camera)
    try:
        file = _bag_file(path)
        if file is None:
            if path.is_dir() and camera is not None:
                return open_recording(path, camera)  # which says what is missing
            raise SourceError(f"{text}: nothing in it that is known; a source is {KNOWN}")
        from drone_client.source.bag import BagSource

        told = None if camera is None else load_camera(camera)
        return BagSource(file, text, told, airframe, options)
    except ModuleNotFoundError as error:
        raise SourceError(
            f"{text} is a bag, and package {error.name} is missing: install aerial-contact[bags]"
        ) from None


def open_live(
    text: str,
    clock: Clock,
    settings: RealsenseSettings | None = None,
    camera: Path | None = None,
) -> LiveSource:
    """A camera, which is not started yet.

    Args:
        text: ``realsense``, ``realsense:SERIAL`` where there are several, or ``realsense:FILE``, a
            recording of the RealSense SDK that it plays as if it happened now.
        clock: the drone's.
        settings: what it is asked for; a serial in ``text`` goes before theirs.
        camera: camera JSON that stands in for what the camera says of itself.

    Raises:
        SourceError: no camera that is known, or its SDK is not installed.
        CameraFileError: the camera file is missing or wrong.
    """
    from drone_client.source.realsense import RealsenseSource, play_file
    from drone_client.source.realsense_setup import RealsenseSettings

    kind, _, which = text.partition(":")
    if kind != REALSENSE:
        raise SourceError(f"{text}: no camera that is known; try realsense or realsense:SERIAL")
    asked = RealsenseSettings() if settings is None else settings
    if camera is not None:
        asked = replace(asked, camera=load_camera(camera))
    if Path(which).suffix in SDK_FILES:
        return play_file(Path(which), asked, clock)
    return RealsenseSource(replace(asked, serial=which or asked.serial), clock)


def _bag_file(path: Path) -> BagFile | None:
    """The opened container; None: it is no bag."""
    mcaps = sorted(path.glob("*.mcap")) if path.is_dir() else [path] * (path.suffix == ".mcap")
    if mcaps:
        from drone_client.source.mcap import McapFile

        return McapFile(mcaps)
    if path.suffix in (".db3", ".bag") if path.is_file() else _is_bag_folder(path):
        from drone_client.source.rosbag import RosbagFile

        return RosbagFile(path)
    return None


def _is_bag_folder(path: Path) -> bool:
    return (path / "metadata.yaml").exists() or any(path.glob("*.db3"))
