"""Bags of ROS 1 and 2, SQLite and MCAP, whole and damaged, as sources."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from rosbags.rosbag2 import StoragePlugin

from drone_client.airframe import Airframe
from drone_client.errors import SourceError
from drone_client.source import bag as bag_module
from drone_client.source.bag import BagOptions
from drone_client.source.choose import open_recorded
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.bag_builders import (
    COLOR,
    DEPTH,
    ROS1,
    T0_NS,
    Messages,
    camera_messages,
    color_of,
    compressed_depth,
    depth_of,
    pictures,
    png,
    write_mcap,
    write_ros1,
    write_ros2,
)
from tests.unit.drone_client.builders import CAMERA, HEIGHT, MS, SECOND, WIDTH, pose, rotation_of

M = Messages()


def as_db3(path, messages):
    return write_ros2(path / "rec", messages, M)


def as_db3_file(path, messages):
    return next(write_ros2(path / "rec", messages, M).glob("*.db3"))


def as_mcap_folder(path, messages):
    return write_ros2(path / "rec", messages, M, StoragePlugin.MCAP)


def as_mcap(path, messages):
    return write_mcap(path / "rec.mcap", messages, M)


def as_lz4(path, messages):
    return write_mcap(path / "rec.mcap", messages, M, compression=CompressionType.LZ4)


def as_plain_mcap(path, messages):
    """Neither chunks nor index, as a simple logger writes it."""
    return write_mcap(
        path / "rec.mcap",
        messages,
        M,
        use_chunking=False,
        index_types=IndexType.NONE,
        use_statistics=False,
        use_summary_offsets=False,
        repeat_channels=False,
        repeat_schemas=False,
    )


CONTAINERS = [as_db3, as_db3_file, as_mcap_folder, as_mcap, as_lz4, as_plain_mcap]


def whole(count: int = 3):
    """Cameras and pictures."""
    return camera_messages(M) + pictures(M, count)


def check(source, count: int = 3) -> None:
    """Pictures, times by the headers, and the rig, as they were written."""
    assert len(source) == count
    captures = list(source.captures())
    assert [c.t_source_ns for c in captures] == [T0_NS + n * SECOND // 30 for n in range(count)]
    for n, capture in enumerate(captures):
        np.testing.assert_array_equal(capture.color_rgb, color_of(n))
        np.testing.assert_array_equal(capture.depth_units, depth_of(n))
        assert capture.depth_units.dtype == np.uint16
    camera = source.camera
    assert (camera.color.fx, camera.color.fy, camera.color.cx) == (20.0, 21.0, 7.5)
    assert camera.color.model == "brown_conrady"
    assert camera.color.coefficients == (0.1, 0.2, 0.0, 0.0, 0.3)
    assert camera.depth.fx == 28.0  # rectified pictures go by P
    assert camera.depth.model == "none"
    assert camera.depth_scale_m == 0.001
    np.testing.assert_allclose(camera.color_from_depth.translation, (-0.059, 0.001, 0.002))
    np.testing.assert_allclose(rotation_of(camera.color_from_depth).as_rotvec(), (0, 0.01, 0))
    assert source.notes == ()


@pytest.mark.parametrize("write", CONTAINERS)
def test_every_container_gives_the_same(tmp_path, write):
    """Pictures by the headers' stamps; the times of receipt lie an hour off."""
    check(open_recorded(str(write(tmp_path, whole()))))


def test_a_bag_of_ros_1_gives_the_same(tmp_path):
    """Whose CameraInfo writes K, D and P large."""
    m = Messages(ROS1)
    path = write_ros1(tmp_path / "rec.bag", camera_messages(m) + pictures(m), m)
    check(open_recorded(str(path)))


def test_some_captures_are_spread_evenly(tmp_path):
    """The others are not decoded."""
    source = open_recorded(str(as_mcap(tmp_path, whole(9))))
    assert [int(c.color_rgb[0, 0, 2]) for c in source.some_captures(3)] == [0, 3, 6]
    assert len(list(source.captures())) == 9


def test_a_big_file_is_streamed(tmp_path, monkeypatch):
    """What is held at once does not grow with the file: pictures wait for their partner alone."""
    source = open_recorded(str(as_mcap(tmp_path, whole(60))))
    held, most = 0, 0
    decode = source._file.decode

    class Counted:
        """Counts the messages that are alive."""

        def __init__(self, message):
            self.__dict__.update({k: getattr(message, k) for k in message.__dataclass_fields__})
            nonlocal held, most
            held += 1
            most = max(most, held)

        def __del__(self):
            nonlocal held
            held -= 1

    monkeypatch.setattr(source._file, "decode", lambda raw: Counted(decode(raw)))
    assert sum(1 for _ in source.captures()) == 60
    assert most < 12


ENCODINGS = [
    ("rgb8", color_of(1), color_of(1)),
    ("bgr8", color_of(1)[..., ::-1], color_of(1)),
    ("8UC3", color_of(1)[..., ::-1], color_of(1)),
    ("rgba8", np.dstack([color_of(1), np.zeros((HEIGHT, WIDTH), np.uint8)]), color_of(1)),
    ("bgra8", np.dstack([color_of(1)[..., ::-1], color_of(1)[..., :1]]), color_of(1)),
    ("mono8", color_of(1)[..., 0], np.full((HEIGHT, WIDTH, 3), 200, np.uint8)),
]


@pytest.mark.parametrize(("encoding", "sent", "want"), ENCODINGS, ids=[e[0] for e in ENCODINGS])
@pytest.mark.parametrize("padding", [0, 5])
def test_colour_encodings(tmp_path, encoding, sent, want, padding):
    """Red ends up first; rows may be padded."""
    messages = [*camera_messages(M), (COLOR, M.image(T0_NS, sent, encoding, padding))]
    (capture,) = open_recorded(str(as_mcap(tmp_path, messages))).captures()
    np.testing.assert_array_equal(capture.color_rgb, want)
    assert capture.depth_units is None


METRES = np.full((HEIGHT, WIDTH), 1.2345, np.float32)
METRES[0, :8] = (np.nan, np.inf, -np.inf, -1.0, 0.0, 40.0, 1e-5, 1e30)


@pytest.mark.parametrize("big", [False, True])
def test_depth_in_metres_becomes_half_millimetres(tmp_path, big):
    """Rounded; what is no depth, or too far, is 0."""
    messages = [
        *camera_messages(M),
        (COLOR, M.image(T0_NS, color_of(0), "rgb8")),
        (DEPTH, M.image(T0_NS, METRES, "32FC1", 4, big)),
    ]
    source = open_recorded(str(as_mcap(tmp_path, messages)))
    (capture,) = source.captures()
    assert source.camera.depth_scale_m == 0.0005
    assert (capture.depth_units[1:] == 2469).all()
    assert (capture.depth_units[0, :8] == 0).all()


def test_depth_of_a_big_endian_machine(tmp_path):
    """Its millimetres are ours."""
    messages = [
        *camera_messages(M),
        (COLOR, M.image(T0_NS, color_of(0), "rgb8")),
        (DEPTH, M.image(T0_NS, depth_of(7), "16UC1", 0, big=True)),
    ]
    (capture,) = open_recorded(str(as_mcap(tmp_path, messages))).captures()
    np.testing.assert_array_equal(capture.depth_units, depth_of(7))


INVERSE_A, INVERSE_B = 500.0, -100.0
INVERSE = np.rint(INVERSE_A / np.full((HEIGHT, WIDTH), 1.25) + INVERSE_B).astype(np.uint16)


@pytest.mark.parametrize(
    ("data", "form", "want", "scale_m"),
    [
        (compressed_depth(depth_of(3)), "16UC1; compressedDepth png", 1003, 0.001),
        (compressed_depth(depth_of(3)), "16UC1; compressedDepth", 1003, 0.001),
        (png(depth_of(3)), "16UC1; png compressed", 1003, 0.001),
        (compressed_depth(INVERSE, INVERSE_A, INVERSE_B), "32FC1; compressedDepth", 2500, 0.0005),
    ],
)
def test_compressed_pictures(tmp_path, data, form, want, scale_m):
    """JPEG or PNG for colour, compressedDepth or PNG for depth, floats by their inverse."""
    color, depth = COLOR + "/compressed", DEPTH + "/compressedDepth"
    messages = [
        *camera_messages(M),
        (color, M.compressed(T0_NS, png(color_of(1)[..., ::-1]), "bgr8; png compressed bgr8")),
        (depth, M.compressed(T0_NS, data, form)),
    ]
    source = open_recorded(str(as_mcap(tmp_path, messages)))
    (capture,) = source.captures()
    np.testing.assert_array_equal(capture.color_rgb, color_of(1))
    assert (capture.depth_units == want).all()
    assert source.camera.depth_scale_m == scale_m


def bad_image(t_ns=T0_NS - 100 * MS, **changes):
    """A picture that says something else than it is."""
    message = M.image(t_ns, color_of(0), "rgb8")
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("message", "says"),
    [
        (bad_image(encoding="yuv422_yuy2"), "colour encoding 'yuv422_yuy2'; known: rgb8, bgr8"),
        (bad_image(height=4000), "576 bytes in rows of 48 are not 16x4000"),
        (bad_image(step=47), "in rows of 47 are not 16x12"),
        (bad_image(step=0), "in rows of 0 are not 16x12"),
        (bad_image(width=0), "0x12 is no size of a picture"),
        (bad_image(width=2**31), "is no size of a picture"),
        (bad_image(width=4096, height=4096), "4096x4096 is over"),
        (bad_image(width=8), "a picture of 8x12, the camera has 16x12"),
        (bad_image(encoding="\x1b[2J"), r"colour encoding '\x1b[2j'"),
    ],
)
def test_a_picture_that_cannot_be_is_left_out_with_a_reason(tmp_path, message, says):
    """The others are read; where there is no other, the bag is refused with that reason."""
    good = whole(1)
    alone = [*camera_messages(M), (COLOR, message)]
    with pytest.raises(SourceError) as caught:
        open_recorded(str(write_mcap(tmp_path / "alone.mcap", alone, M)))
    assert "not one colour picture can be read" in str(caught.value)
    assert says in str(caught.value)
    source = open_recorded(str(as_mcap(tmp_path, [good[0], (COLOR, message), *good[1:]])))
    assert len(list(source.captures())) == 1
    assert any(says in note for note in source.notes)


@pytest.mark.parametrize(
    ("message", "says"),
    [
        (M.image(T0_NS, color_of(0)[..., 0], "mono8"), "depth encoding 'mono8'; known: 16uc1"),
        (M.compressed(T0_NS, b"x" * 40, "16UC1; compressedDepth png"), "cannot be decoded"),
        (M.compressed(T0_NS, b"", "16UC1; compressedDepth png"), "cannot be decoded"),
        (M.compressed(T0_NS, b"", "16UC1; compressedDepth rvl"), "compressed by rvl; known: png"),
        (M.compressed(T0_NS, png(color_of(0)), "jpeg"), "colours hold no metres"),
        (M.compressed(T0_NS, png(depth_of(0)), "32FC1; png"), "float depth in a plain picture"),
    ],
)
def test_depth_that_cannot_be_read_leaves_the_colour(tmp_path, message, says):
    """With a reason."""
    messages = [
        *camera_messages(M),
        (COLOR, M.image(T0_NS, color_of(0), "rgb8")),
        (DEPTH, message),
    ]
    source = open_recorded(str(as_mcap(tmp_path, messages)))
    (capture,) = source.captures()
    assert capture.depth_units is None
    assert any(says in note for note in source.notes)


def test_pairs_go_by_time_and_what_has_none_is_told(tmp_path):
    """A depth picture is missing, another one lies 25 ms off."""
    messages = [*camera_messages(M)]
    for n, depth_ms in enumerate((5, None, 25)):
        t_ns = T0_NS + n * 100 * MS
        messages.append((COLOR, M.image(t_ns, color_of(n), "rgb8")))
        if depth_ms is not None:
            messages.append((DEPTH, M.image(t_ns + depth_ms * MS, depth_of(n), "16UC1")))
    source = open_recorded(str(as_mcap(tmp_path, messages)))
    assert [c.depth_units is not None for c in source.captures()] == [True, False, False]
    assert set(source.notes) == {"2 x colour: no partner", "1 x depth: no partner"} or set(
        source.notes
    ) == {"2 x colour: no partner", "1 x depth: too old"}


def refusal(tmp_path, messages, **options) -> str:
    """The line with which a bag is refused."""
    with pytest.raises(SourceError) as caught:
        open_recorded(str(as_mcap(tmp_path, messages)), options=BagOptions(**options))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_missing_is_told(tmp_path):
    """Pictures, cameras, the way between them; and what to do."""
    cameras, shots = camera_messages(M), pictures(M)
    says = refusal(tmp_path, cameras)
    assert "no colour pictures in the bag; it holds /camera/color/camera_info" in says
    says = refusal(tmp_path, cameras[1:] + shots)
    assert "no CameraInfo at /camera/color/camera_info: give the camera file with --camera" in says
    says = refusal(tmp_path, [cameras[0], *cameras[2:], *shots])
    assert "no CameraInfo at /camera/depth/camera_info" in says
    says = refusal(tmp_path, cameras[:3] + shots)
    assert "/tf_static does not say where 'camera_depth_optical_frame' is" in says


def test_a_camera_file_stands_in_for_what_the_bag_does_not_say(tmp_path):
    """And goes before what it says."""
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(CAMERA.to_json()))
    source = open_recorded(str(as_mcap(tmp_path, pictures(M))), path)
    assert source.camera.to_json() == CAMERA.to_json()
    assert len(list(source.captures())) == 3


@pytest.mark.parametrize(
    ("info", "says"),
    [
        ({"model": "equidistant", "d": (0.1, 0, 0, 0)}, "lens model 'equidistant' is not supp"),
        ({"model": "rational_polynomial", "d": (0.1,) * 8}, "with 8 coefficients is not supported"),
        ({"focal": 0.0}, "it is not calibrated: fx is 0"),
        ({"width": 0}, "an image side is 1 to"),
    ],
)
def test_a_lens_that_we_do_not_have_is_refused(tmp_path, info, says):
    """With what to do."""
    messages = camera_messages(M)
    messages[0] = (messages[0][0], M.info("x", **info))
    got = refusal(tmp_path, messages + pictures(M))
    assert says in got
    assert got.endswith("or give the camera file with --camera")


def test_a_rational_lens_with_five_numbers_is_a_plumb_bob(tmp_path):
    """The others being zero."""
    messages = camera_messages(M)
    d = (0.1, 0.2, 0.001, 0.002, 0.3, 0, 0, 0)
    messages[0] = (
        messages[0][0],
        M.info("camera_color_optical_frame", 20.0, "rational_polynomial", d),
    )
    camera = open_recorded(str(as_mcap(tmp_path, messages + pictures(M)))).camera
    assert camera.color.coefficients == d[:5]


def test_aligned_depth_needs_no_transform(tmp_path):
    """Both in one frame, with one CameraInfo each."""
    depth = "/camera/aligned_depth_to_color/image_raw"
    messages = [
        ("/camera/color/camera_info", M.info("optical")),
        ("/camera/aligned_depth_to_color/camera_info", M.info("/optical")),
        *pictures(M, depth=depth),
    ]
    source = open_recorded(str(as_mcap(tmp_path, messages)))
    assert source.camera.aligned
    assert all(c.depth_units is not None for c in source.captures())


def test_raw_depth_goes_before_aligned_and_infrared_is_no_colour(tmp_path):
    """What a RealSense node publishes all at once."""
    more = [
        (topic, M.image(T0_NS, color_of(99)[..., 0], "mono8"))
        for topic in ("/camera/infra1/image_rect_raw", "/camera/aligned_depth_to_color/image_raw")
    ]
    source = open_recorded(str(as_mcap(tmp_path, [*more, *whole()])))
    assert source.camera.depth.fx == 28.0
    assert len(list(source.captures())) == 3


def test_several_candidates_are_listed_and_one_can_be_named(tmp_path):
    """With the option that names one."""
    messages = [*whole(), ("/other/color/image_raw", M.image(T0_NS, color_of(0), "rgb8"))]
    says = refusal(tmp_path, messages)
    assert "several topics could be colour: /camera/color/image_raw, /other/color/image_r" in says
    assert "--color-topic" in says
    assert "no pictures at /nope; the bag has pictures at" in refusal(
        tmp_path, messages, color_topic="/nope"
    )
    options = BagOptions(color_topic=COLOR, depth_topic="")
    source = open_recorded(str(tmp_path / "rec.mcap"), options=options)
    assert all(c.depth_units is None for c in source.captures())


AIRFRAME = Airframe()


@pytest.mark.parametrize("kind", ["odometry", "pose_stamped"])
def test_odometry_gives_the_cameras_pose(tmp_path, kind):
    """The body's, taken on to the camera, and interpolated at the pictures' stamps."""
    make = getattr(M, kind)
    path = [("/odom", make(T0_NS + n * 100 * MS, (n, 2 * n, 3), (0, 0, 0.1 * n))) for n in (0, 1)]
    messages = [*whole(), *path]
    source = open_recorded(
        str(as_mcap(tmp_path, messages)), airframe=AIRFRAME, options=BagOptions(pose_topic="/odom")
    )
    want = pose((0.5, 1.0, 3), (0, 0, 0.05)) @ AIRFRAME.body_from_camera
    got = source.world_from_camera(T0_NS + 50 * MS)
    # the camera's own place is interpolated on a chord: 0.12 m of arm, 0.1 rad
    np.testing.assert_allclose(got.translation, want.translation, atol=2e-4)
    assert (rotation_of(got) * rotation_of(want).inv()).magnitude() < 1e-6
    assert source.world_from_camera(T0_NS + SECOND) is None
    assert open_recorded(str(tmp_path / "rec.mcap")).world_from_camera(T0_NS) is None


def test_transforms_give_the_cameras_pose(tmp_path):
    """Two moving links at different rates and a fixed one, against their product."""
    messages = [*whole(), ("/tf_static", M.transform(0, "base_link", "imu", (0, 0, 0.1)))]
    for n in range(11):
        t_ns = T0_NS + n * 10 * MS
        messages.append(("/tf", M.transform(t_ns, "odom", "imu", (n, 0, 0), (0, 0, 0.1 * n))))
        if n % 5 == 0:
            messages.append(("/tf", M.transform(t_ns, "map", "odom", (0, n, 0))))
    source = open_recorded(
        str(as_mcap(tmp_path, messages)),
        airframe=AIRFRAME,
        options=BagOptions(pose_topic="tf:/map:base_link"),
    )
    imu_from_base = pose((0, 0, 0.1)).inverse()
    want = pose((0, 3, 0)) @ pose((3, 0, 0), (0, 0, 0.3)) @ imu_from_base
    want = want @ AIRFRAME.body_from_camera
    got = source.world_from_camera(T0_NS + 30 * MS)
    np.testing.assert_allclose(got.matrix, want.matrix, atol=1e-9)


@pytest.mark.parametrize(
    ("topic", "airframe", "says"),
    [
        ("/odom", None, "--airframe must say where the camera sits"),
        ("/nope", AIRFRAME, "no poses at /nope; the bag has poses at /odom"),
        (COLOR, AIRFRAME, "no poses at /camera/color/image_raw"),
        ("tf:a", AIRFRAME, "'tf:a' names no two frames; such as tf:odom:base_link"),
        ("tf:map:mars", AIRFRAME, "no transforms from 'map' to 'mars'; there are"),
        (
            "tf:camera_link:camera_color_optical_frame",
            AIRFRAME,
            "do not move against each other in /tf",
        ),
    ],
)
def test_poses_that_are_not_there_are_told(tmp_path, topic, airframe, says):
    """With those that are."""
    messages = [*whole(), ("/odom", M.odometry(T0_NS, (0, 0, 0)))]
    with pytest.raises(SourceError, match=says):
        open_recorded(
            str(as_mcap(tmp_path, messages)),
            airframe=airframe,
            options=BagOptions(pose_topic=topic),
        )


def test_poses_that_are_none_are_left_out(tmp_path):
    """A quaternion of zeros, as a node sends before it knows."""
    zero = M.odometry(T0_NS, (0, 0, 0))
    zero.pose.pose.orientation.w = 0.0
    good = M.odometry(T0_NS + 10 * MS, (1, 0, 0))
    messages = [*whole(), ("/odom", zero), ("/odom", good)]
    path, options = as_mcap(tmp_path, messages), BagOptions(pose_topic="/odom")
    source = open_recorded(str(path), airframe=AIRFRAME, options=options)
    assert source.world_from_camera(T0_NS + 10 * MS) is not None
    assert "/odom: 1 messages are no poses" in source.notes
    path = as_mcap(tmp_path, messages[:-1])
    with pytest.raises(SourceError, match="/odom: not one pose that can be read"):
        open_recorded(str(path), airframe=AIRFRAME, options=options)


def test_an_mcap_without_its_end_is_read_as_far_as_it_goes(tmp_path):
    """A recorder that lost power: whole chunks, and no index."""
    path = write_mcap(tmp_path / "rec.mcap", whole(20), M, finish=False, chunk_bytes=2000)
    source = open_recorded(str(path))
    got = list(source.captures())
    assert 10 < len(got) <= len(source) <= 20
    for n, capture in enumerate(got):
        np.testing.assert_array_equal(capture.color_rgb, color_of(n))
    assert any("damaged or cut off after" in note for note in source.notes)


def read_as_far_as_it_goes(path):
    """The captures of a damaged bag, and the reasons why there are no more."""
    try:
        source = open_recorded(str(path))
        captures = list(source.captures())
    except SourceError as error:
        return [], [str(error)]
    return captures, source.notes


@pytest.mark.parametrize("write", [as_mcap, as_lz4, as_plain_mcap, as_db3_file])
def test_a_file_cut_anywhere_gives_pictures_or_a_reason(tmp_path, write):
    """And never anything but a SourceError."""
    data = (path := write(tmp_path, whole(12))).read_bytes()
    counts = []
    for size in range(0, len(data), max(1, len(data) // 40)):
        path.write_bytes(data[:size])
        captures, reasons = read_as_far_as_it_goes(path)
        assert len(captures) == 12 or reasons
        counts.append(len(captures))
    if write is not as_db3_file:  # SQLite keeps its tree in pages anywhere in the file
        assert counts == sorted(counts)
        assert max(counts) >= 8


@pytest.mark.parametrize("write", [as_mcap, as_lz4, as_plain_mcap, as_db3_file])
@pytest.mark.parametrize("seed", range(8))
def test_bytes_that_flipped_end_in_pictures_or_a_reason(tmp_path, write, seed):
    """Damage in the middle: no exception, no picture of another size."""
    rng = np.random.default_rng(seed)
    data = bytearray((path := write(tmp_path, whole(6))).read_bytes())
    for at in rng.integers(0, len(data), 1 + seed % 8):
        data[at] ^= int(rng.integers(1, 256))
    path.write_bytes(data)
    captures, _ = read_as_far_as_it_goes(path)
    assert all(c.color_rgb.shape == (HEIGHT, WIDTH, 3) for c in captures)


def test_a_bag_folder_without_its_metadata_is_read_by_its_files(tmp_path):
    """A recorder that crashed never wrote metadata.yaml."""
    folder = as_db3(tmp_path, whole())
    os.remove(folder / "metadata.yaml")
    source = open_recorded(str(folder))
    assert len(list(source.captures())) == 3
    assert any("each file is read by itself" in note for note in source.notes)


def test_messages_of_an_unknown_encoding_are_not_ours(tmp_path):
    """An MCAP of another robot's middleware."""
    path = write_mcap(tmp_path / "rec.mcap", whole(), M, encoding="protobuf")
    with pytest.raises(SourceError, match="holds no message of ROS 2"):
        open_recorded(str(path))


def test_a_bomb_is_not_unpacked(tmp_path, monkeypatch):
    """A chunk that says it is larger than any."""
    from drone_client.source import mcap

    path = as_mcap(tmp_path, whole())
    monkeypatch.setattr(mcap, "MAX_RECORD_BYTES", 3000)
    with pytest.raises(SourceError, match="a chunk of .* bytes|exceeds limit|damaged or cut off"):
        open_recorded(str(path))


def test_reasons_are_bounded(tmp_path, monkeypatch):
    """A bag with nothing but different nonsense does not fill the screen."""
    monkeypatch.setattr(bag_module, "MAX_REASONS", 3)
    odd = [(COLOR, bad_image(T0_NS + (n + 1) * SECOND, encoding=f"odd{n}")) for n in range(9)]
    good = whole(1)
    source = open_recorded(str(as_mcap(tmp_path, [*good, *odd])))
    list(source.captures())
    assert len(source.notes) <= 3 + 1 + 2  # and what found no partner, of two streams
    assert any(note.endswith("other reasons") for note in source.notes)


def test_the_airframe_of_the_tests_is_no_identity():
    """Otherwise the tests of poses would show nothing."""
    assert np.abs(AIRFRAME.body_from_camera.matrix - Pose.identity().matrix).max() > 0.1
