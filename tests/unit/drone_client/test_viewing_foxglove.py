"""A flight as MCAP, read back with another library than the one that wrote it."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from rich.console import Console

from drone_client.errors import OutputError
from drone_client.viewing.command import write_mcap
from tests.unit.drone_client.view_builders import (
    FRAMES,
    LATE,
    POSES,
    RIG,
    START_NS,
    TICKS,
    WORLD_FROM_TARGET,
    body_at,
    camera_from_target,
    capture_ns,
    facts,
    write_lines,
    write_run,
)

QUIET = Console(quiet=True)


def read(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Each topic's messages with their log times, decoded by the schemas in the file."""
    topics: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    classes: dict[int, Any] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            if schema.encoding == "protobuf":
                if schema.id not in classes:
                    pool = descriptor_pool.DescriptorPool()
                    files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
                    for proto in files.file:
                        pool.Add(proto)
                    descriptor = pool.FindMessageTypeByName(schema.name)
                    classes[schema.id] = message_factory.GetMessageClass(descriptor)
                value = classes[schema.id].FromString(message.data)
            else:
                value = json.loads(message.data)
            topics[channel.topic].append((message.log_time, value))
    return topics


def write(run: Path, path: Path, *, overwrite: bool = False) -> dict[str, list[tuple[int, Any]]]:
    write_mcap(run, path, overwrite=overwrite, console=QUIET)
    return read(path)


@pytest.fixture(scope="module")
def topics(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[int, Any]]]:
    folder = tmp_path_factory.mktemp("run")
    return write(write_run(folder), folder / "flight.mcap")


def transforms(topics: dict, child: str) -> list[tuple[int, Any]]:
    return [
        (t_ns, transform)
        for t_ns, message in topics["/tf"]
        for transform in message.transforms
        if transform.child_frame_id == child
    ]


def test_every_kind_of_moment_has_its_topic(topics: dict):
    """All of them, at the drone's own time."""
    counts = {topic: len(messages) for topic, messages in topics.items()}
    assert counts["/camera/image"] == FRAMES
    assert counts["/drone"] == POSES
    assert counts["/control"] == TICKS
    assert counts["/frames"] == FRAMES + 1
    assert counts["/target"] == FRAMES - 1
    assert counts["/log"] == 3
    assert {"/tf", "/scene", "/camera/calibration", "/camera/found"} <= counts.keys()
    assert min(t_ns for messages in topics.values() for t_ns, _ in messages) == START_NS


def test_the_tree_of_frames_places_drone_camera_and_target(topics: dict):
    """World to drone as flown, drone to camera as built, world to target as accepted."""
    t_ns, drone = transforms(topics, "drone")[10]
    assert drone.parent_frame_id == "world"
    expected = body_at(t_ns).translation
    actual = (drone.translation.x, drone.translation.y, drone.translation.z)
    np.testing.assert_allclose(actual, expected, atol=1e-6)
    assert drone.timestamp.seconds * 10**9 + drone.timestamp.nanos == t_ns
    _, camera = transforms(topics, "camera")[0]
    q = facts().body_from_camera.q_wxyz
    assert camera.parent_frame_id == "drone"
    turned = (camera.rotation.w, camera.rotation.x, camera.rotation.y, camera.rotation.z)
    np.testing.assert_allclose(turned, q, atol=1e-9)
    _, target = transforms(topics, "target")[0]
    place = (target.translation.x, target.translation.y, target.translation.z)
    np.testing.assert_allclose(place, WORLD_FROM_TARGET.translation, atol=1e-9)


def test_a_picture_is_the_cameras_own(topics: dict):
    """The JPEG as it was recorded, with the calibration to project by."""
    t_ns, image = topics["/camera/image"][2]
    assert (t_ns, image.frame_id, image.format) == (capture_ns(2), "camera", "jpeg")
    assert image.data[:2] == b"\xff\xd8"
    _, calibration = topics["/camera/calibration"][0]
    assert (calibration.width, calibration.height) == (RIG.color.width, RIG.color.height)
    np.testing.assert_allclose(
        np.reshape(calibration.K, (3, 3)), RIG.color.image_from_camera, atol=1e-12
    )


def test_what_was_found_lies_over_its_own_picture(topics: dict):
    """Stamped as the picture, in its pixels, green or red; none where nothing was found."""
    by_stamp = {
        m.timestamp.seconds * 10**9 + m.timestamp.nanos: m for _, m in topics["/camera/found"]
    }
    assert sorted(by_stamp) == [capture_ns(i) for i in range(FRAMES + 1)]
    good, late, none = (by_stamp[capture_ns(i)] for i in (0, LATE, FRAMES))
    center = RIG.color.image_from_camera @ camera_from_target(0).translation
    corners = np.array([(p.x, p.y) for p in good.points[0].points])[:4]
    np.testing.assert_allclose(corners.mean(axis=0), center[:2] / center[2], atol=0.5)
    assert good.points[0].outline_color.g > good.points[0].outline_color.r
    assert late.points[0].outline_color.r > late.points[0].outline_color.g
    assert len(none.points) == 0
    assert (good.texts[0].text, none.texts[0].text) == ("accepted, 80 ms old", "no reply")


def test_numbers_are_there_to_be_plotted(topics: dict):
    """The barrier, the tip and the delay as fields of JSON."""
    _, tick = topics["/control"][20]
    assert (tick["h_m"], tick["tip_target_x_m"]) == pytest.approx((0.8, 2.2))
    assert (tick["phase"], tick["command_x_mps"]) == ("approach", 0.5)
    delays = [frame.get("network_delay_ms") for _, frame in topics["/frames"]]
    assert sorted(d for d in delays if d is not None) == [20, 21, 22, 24, 25, 26, 27, 300]


def test_the_log_has_levels(topics: dict):
    """What a person has to worry about is a warning: level 3, as Foxglove counts."""
    assert [message.level for _, message in topics["/log"]] == [2, 2, 3]


def test_the_scene_hangs_on_its_frames(topics: dict):
    """Drone, board and funnel move with the tree of frames; the way does not."""
    frames = {e.id: e.frame_id for _, update in topics["/scene"] for e in update.entities}
    assert frames["drone"] == "drone"
    assert "way" not in frames or frames["way"] == "world"


def test_a_replay_shows_what_it_has(tmp_path: Path):
    """Without poses and pictures: the target, and the camera where it saw it."""
    topics = write(write_run(tmp_path / "run", known=False), tmp_path / "replay.mcap")
    assert topics.keys() == {"/control", "/frames", "/log", "/target", "/tf"}
    _, camera = transforms(topics, "camera")[0]
    expected = WORLD_FROM_TARGET @ camera_from_target(0).inverse()
    place = (camera.translation.x, camera.translation.y, camera.translation.z)
    np.testing.assert_allclose(place, expected.translation, atol=1e-9)


def test_the_truth_of_a_simulator_has_frames_of_its_own(tmp_path: Path):
    """Beside what the drone believed, and the force to plot."""
    run = write_run(tmp_path / "run")
    lines = [
        {
            "t_ns": START_NS + i,
            "world_from_body": [0.1 * i, 0, 1, 1, 0, 0, 0],
            "world_from_target": [3, 0, 1, 0, 0, 0, 1],
            "tip_force_n": 2.5,
            "arm_m": 0.008,
            "drift_m": 0.01,
        }
        for i in range(3)
    ]
    write_lines(run / "truth.jsonl", lines)
    topics = write(run, tmp_path / "true.mcap")
    assert [m["tip_force_n"] for _, m in topics["/truth"]] == [2.5] * 3
    assert transforms(topics, "true drone")[2][1].translation.x == pytest.approx(0.2)
    assert len(transforms(topics, "true target")) == 3


def test_a_file_that_is_there_stays(tmp_path: Path):
    """Unless it may go."""
    run, path = write_run(tmp_path / "run"), tmp_path / "flight.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(OutputError, match="is there already"):
        write(run, path)
    assert path.read_bytes() == b"precious"
    assert write(run, path, overwrite=True)


FULL = """
import resource, signal, sys
from pathlib import Path
from rich.console import Console
from drone_client.errors import OutputError
from drone_client.viewing import command
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
try:
    getattr(command, sys.argv[1])(
        Path(sys.argv[2]), Path(sys.argv[3]), overwrite=False, console=Console(quiet=True)
    )
except OutputError as error:
    print(error)
    sys.exit(7)
"""


@pytest.mark.parametrize("writer", ["write_mcap", "write_rerun"])
def test_a_disk_that_is_full_is_told(tmp_path: Path, writer: str):
    """In one sentence with the file's name, whichever library meets it; nothing is left of it."""
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[1] == resource.RLIM_INFINITY
    run, path = write_run(tmp_path / "run"), tmp_path / "flight.out"
    done = subprocess.run(
        [sys.executable, "-c", FULL, writer, str(run), str(path)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 7, done.stderr
    assert done.stdout == f"{path} is not whole: File too large\n"
    assert done.stderr == ""
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
