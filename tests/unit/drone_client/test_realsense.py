"""A RealSense through the real SDK: what it says of itself, its stamps, and when it goes away."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from itertools import chain, repeat

import numpy as np
import pytest

from drone_client.errors import SourceError
from drone_client.source import realsense_sdk
from drone_client.source.realsense import RealsenseSource, play_file
from drone_client.source.realsense_camera import camera_of_profiles, intrinsics_of
from drone_client.source.realsense_setup import RealsenseSettings
from rgbd_wire.clock import ManualClock, MonotonicClock
from target_pose.lens import project
from tests.unit.drone_client.builders import MS, SECOND, eventually
from tests.unit.drone_client.realsense_rig import (
    BASELINE_MM,
    COLOR_SIZE,
    DEPTH_SIZE,
    ROTATION,
    TRANSLATION_M,
    Rig,
    sdk,
    sdk_recording,
)

SETTINGS = RealsenseSettings(color_size_px=COLOR_SIZE, depth_size_px=DEPTH_SIZE, silence_s=60)
WAY_NS = 5 * MS


@pytest.fixture
def rig() -> Rig:
    """A camera in the SDK."""
    return Rig()


class Running:
    """A source that runs on a rig, with a clock that the test moves."""

    def __init__(self, rig: Rig, settings: RealsenseSettings = SETTINGS) -> None:
        self.rig = rig
        self.clock = ManualClock(1000 * SECOND)
        self.source = RealsenseSource(settings, self.clock, lambda: rig.device)

    def __enter__(self) -> Running:
        self.source.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.source.stop()

    def newest(self):
        """What waits in the slot."""
        return next(self.source.captures(0))


def test_the_camera_is_what_the_device_says(rig):
    """Sizes, focal lengths, centres, lens model and its five numbers, depth unit and lattice."""
    with Running(rig) as running:
        camera = running.source.camera
    want = rig.color_profile.get_intrinsics()
    color = camera.color
    assert (color.width, color.height) == COLOR_SIZE
    assert (color.fx, color.fy, color.cx, color.cy) == (want.fx, want.fy, want.ppx, want.ppy)
    assert color.model == "brown_conrady"  # the name says another one: see the next tests
    np.testing.assert_allclose(color.coefficients, want.coeffs)
    assert (camera.depth.width, camera.depth.height) == DEPTH_SIZE
    assert camera.depth.model == "none"  # five zeros are no lens
    assert camera.depth_scale_m == pytest.approx(0.001)
    assert camera.depth_lattice_m == pytest.approx(45.0 * BASELINE_MM / 1e3 * 32)


def test_the_extrinsics_take_a_depth_point_to_colour(rig):
    """As the SDK's own function does, and not the other way round."""
    camera = camera_of_profiles(rig.rs, rig.color_profile, rig.depth_profile, 0.001, 0.0)
    assert camera.depth_lattice_m == 0
    p_depth = [0.3, -0.2, 1.7]
    extrinsics = rig.depth_profile.get_extrinsics_to(rig.color_profile)
    want = rig.rs.rs2_transform_point_to_point(extrinsics, p_depth)
    np.testing.assert_allclose(camera.color_from_depth @ np.array(p_depth), want, atol=1e-6)
    np.testing.assert_allclose(want, ROTATION.apply(p_depth) + TRANSLATION_M, atol=1e-6)


D455 = (-0.0565, 0.0682, 0.0004, 0.0007, -0.0218)


@pytest.mark.parametrize("model", ["brown_conrady", "inverse_brown_conrady"])
def test_a_point_is_seen_where_the_sdk_sees_it(model):
    """All over the picture, whatever the SDK calls a D455's numbers; both ways."""
    rs = sdk()
    theirs = rs.intrinsics()
    theirs.width, theirs.height, theirs.fx, theirs.fy = 640, 480, 385.0, 384.0
    theirs.ppx, theirs.ppy, theirs.coeffs = 318.0, 242.0, list(D455)
    theirs.model = getattr(rs.distortion, model)
    ours = intrinsics_of(rs, theirs, "colour")
    for u in np.linspace(0, 639, 14):
        for v in np.linspace(0, 479, 11):
            ray = np.array(rs.rs2_deproject_pixel_to_point(theirs, [u, v], 1.0))
            np.testing.assert_allclose(project(ray[None], ours)[0], (u, v), atol=0.02)


@pytest.mark.parametrize(
    ("model", "coefficients", "ours"),
    [
        ("none", (0.0,) * 5, "none"),
        ("brown_conrady", D455, "brown_conrady"),
        ("inverse_brown_conrady", D455, "brown_conrady"),
        ("modified_brown_conrady", D455, "brown_conrady"),
        ("modified_brown_conrady", (0.5, 0.2, 0.05, 0.05, 0.3), None),
        ("kannala_brandt4", (0.1, 0, 0, 0, 0), None),
        ("kannala_brandt4", (0.0,) * 5, None),
    ],
)
def test_lens_models(model, coefficients, ours):
    """Those that the SDK projects as OpenCV does; others are refused, by how far they are off."""
    rig = Rig(model=model, coefficients=coefficients)
    if ours is None:
        with pytest.raises(SourceError, match=rf"lens model {model} is not .* \d+\.\d px off"):
            camera_of_profiles(rig.rs, rig.color_profile, rig.depth_profile, 0.001, 0.0)
    else:
        camera = camera_of_profiles(rig.rs, rig.color_profile, rig.depth_profile, 0.001, 0.0)
        assert camera.color.model == ours


def test_pictures_come_as_they_are_and_pair_by_stamp(rig):
    """Red first, 16 bits of depth; numbers differ, stamps agree."""
    with Running(rig) as running:
        rig.color(7, 500.0)
        assert running.newest() is None
        rig.depth(3, 504.0)
        capture = running.newest()
        counts = running.source.counts()
    assert (capture.color_rgb == (7, 100, 200)).all()
    assert capture.color_rgb.shape == (COLOR_SIZE[1], COLOR_SIZE[0], 3)
    assert capture.depth_units.dtype == np.uint16
    assert (capture.depth_units == 1003).all()
    assert counts["paired"] == 1


def test_the_time_is_the_middle_of_the_exposure_on_the_drones_clock(rig):
    """From the sensor's own middle; the camera's clock runs 50 ppm fast and starts anywhere."""
    zero_ns = 777 * SECOND
    with Running(rig) as running:
        start_ns = running.clock.now_ns()
        for number in range(60):
            middle_ns = round((running.clock.now_ns() - start_ns) * (1 + 50e-6)) + zero_ns
            stamp_us = middle_ns // 1000 + 4000  # read out after half the exposure of 8 ms
            stamps = {"frame_timestamp": stamp_us, "sensor_timestamp": stamp_us - 4000}
            rig.metadata(rig.color_sensor, **stamps)
            rig.metadata(rig.depth_sensor, **stamps)
            true_ns = running.clock.now_ns()
            running.clock.advance(4 * MS + WAY_NS + (number % 3) * MS)
            rig.color(number, stamp_us / 1e3)
            rig.depth(number, stamp_us / 1e3)
            capture = running.newest()
            error_ns = capture.t_source_ns - true_ns
            assert capture.t_source_ns <= running.clock.now_ns() - 4 * MS
            # As soon as two of the quick ones were seen: the way, and nothing else
            if number >= 3:
                assert WAY_NS - 2000 <= error_ns <= WAY_NS + 0.5 * MS
            running.clock.advance(20 * MS)
        assert running.source.counts()["odd_stamps"] == 0


def test_without_the_middle_depths_exposure_stands_in(rig):
    """Half of it, if it is one."""
    with Running(rig) as running:
        rig.metadata(rig.depth_sensor, actual_exposure=8000)
        running.clock.advance(WAY_NS)
        rig.color(0, 1000.0)
        rig.depth(0, 1004.0 + 13.0)  # 17 ms later by the stamp, 13 by the middle
        assert running.newest().depth_units is not None
        rig.metadata(rig.depth_sensor, actual_exposure=10_000_000)
        running.clock.advance(33 * MS)
        rig.color(1, 1033.0)
        rig.depth(1, 1033.0)
        assert running.newest().depth_units is not None


def test_the_sdks_own_time_is_off_and_the_emitter_on(rig):
    """Options are set before the camera runs."""
    option = rig.rs.option
    with Running(rig, replace(SETTINGS, laser_power_mw=210)):
        assert rig.color_sensor.get_option(option.global_time_enabled) == 0
        assert rig.depth_sensor.get_option(option.global_time_enabled) == 0
        assert rig.depth_sensor.get_option(option.emitter_enabled) == 1
        assert rig.depth_sensor.get_option(option.laser_power) == 210


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"laser_power_mw": 400}, "laser power 400: the camera takes 0 to 360"),
        ({"preset": "High Accuracy"}, "the camera has no presets"),
        ({"rate_hz": 90}, "no color pictures of 64x48 at 90 Hz; it has 64x48 at 30 Hz"),
        ({"depth_size_px": (1280, 720)}, "no depth pictures of 1280x720 at 30 Hz; it has 48x32"),
    ],
)
def test_what_the_camera_cannot_do_is_told_with_what_it_can(rig, change, says):
    """Before anything runs, and the camera is free again."""
    source = RealsenseSource(replace(SETTINGS, **change), ManualClock(), lambda: rig.device)
    with pytest.raises(SourceError, match=says):
        source.start()
    source.stop()
    with Running(rig):
        pass


def test_presets_go_by_their_names(rig):
    """The SDK names a software sensor's values by nothing: then there is none of that name."""
    rig.add_option(rig.depth_sensor, rig.rs.option.visual_preset, 0, 5, 1)
    source = RealsenseSource(
        replace(SETTINGS, preset="High Accuracy"), ManualClock(), lambda: rig.device
    )
    with pytest.raises(SourceError, match="no preset 'High Accuracy'; the camera has"):
        source.start()


def test_the_newest_capture_wins(rig):
    """A caller that is slow gets the last one; the others are counted."""
    with Running(rig) as running:
        for number in range(5):
            running.clock.advance(33 * MS)
            rig.color(number, 33.0 * number)
            rig.depth(number, 33.0 * number)
        assert (running.newest().color_rgb[..., 0] == 4).all()
        assert running.newest() is None
        counts = running.source.counts()
    assert counts["displaced"] == 4
    assert (counts["color_frames"], counts["depth_frames"]) == (5, 5)


def test_frames_that_the_camera_dropped_are_counted(rig):
    """By their numbers, each stream by its own; what remains still pairs."""
    with Running(rig) as running:
        for number in (0, 1, 4, 5):
            running.clock.advance(33 * MS)
            rig.color(number, 33.0 * number)
            if number != 1:
                rig.depth(number + 50, 33.0 * number)
        counts = running.source.counts()
    assert counts["color_dropped"] == 2
    assert counts["depth_dropped"] == 3
    assert counts["paired"] == 3


def test_without_depth_the_colours_still_come(rig):
    """A bit later, and without."""
    with Running(rig) as running:
        got = []
        for number in range(10):
            running.clock.advance(33 * MS)
            rig.color(number, 33.0 * number)
            capture = running.newest()
            got += [] if capture is None else [capture]
    assert [int(c.color_rgb[0, 0, 0]) for c in got] == list(range(len(got)))
    assert len(got) >= 7
    assert all(c.depth_units is None for c in got)


def test_a_caller_waits_and_looks_up_in_between(rig):
    """None at the time-out, a capture when there is one, and an end after stop."""
    with Running(rig) as running:
        captures = running.source.captures(0.01)
        assert next(captures) is None
        pushed = threading.Thread(target=lambda: (rig.color(0, 0.0), rig.depth(0, 0.0)))
        pushed.start()
        pushed.join()
        assert next(c for c in captures if c is not None).depth_units is not None
        running.source.stop()
        assert list(captures) == []


def test_a_camera_that_comes_back_goes_on():
    """It falls silent, is opened anew with another zero of its clock, and nothing is mixed up."""
    first, second = Rig(), Rig()
    plugged = [first.device]  # until it has given a picture: a busy machine opens it anew before
    source = RealsenseSource(
        replace(SETTINGS, silence_s=0.04), MonotonicClock(), lambda: plugged[-1]
    )
    taken = []

    def fed(rig: Rig, zero_ms: float) -> bool:
        """Both pictures of one moment; on a slow machine the camera may be silent in between."""
        stamp_ms = MonotonicClock().now_ns() / 1e6 + zero_ms
        rig.color(0, stamp_ms)
        rig.depth(0, stamp_ms)
        taken.append(next(source.captures(0)))
        return taken[-1] is not None and taken[-1].depth_units is not None

    source.start()
    try:
        assert eventually(lambda: fed(first, 5_000_000.0))
        plugged.append(second.device)
        assert eventually(lambda: source.counts().get("reconnects", 0) > 0)
        assert eventually(lambda: fed(second, -3_000.0))
        assert abs(MonotonicClock().now_ns() - taken[-1].t_source_ns) < 5 * SECOND
        assert source.counts()["clock_jumps"] == 0
    finally:
        source.stop()


def test_a_camera_that_stays_away_is_said_plainly(rig):
    """After a bounded search, with what the last try said."""
    devices = iter([rig.device])

    def find():
        device = next(devices, None)
        if device is None:
            raise SourceError("no RealSense camera found")
        return device

    settings = replace(SETTINGS, silence_s=0.04, reconnect_s=0.1)
    source = RealsenseSource(settings, MonotonicClock(), find)
    source.start()
    with pytest.raises(SourceError, match=r"did not come back within 0\.1 s: check cable.*found\)"):
        list(source.captures(5))
    source.stop()


def test_another_camera_is_not_taken_for_the_first():
    """Its lenses are others."""
    first, other = Rig(), Rig(coefficients=(0.1, 0, 0, 0, 0))
    devices = chain([first.device], repeat(other.device))
    settings = replace(SETTINGS, silence_s=0.04, reconnect_s=0.02)
    source = RealsenseSource(settings, MonotonicClock(), lambda: next(devices))
    source.start()
    with pytest.raises(SourceError, match="another camera was plugged in"):
        list(source.captures(5))
    source.stop()


def test_the_sdks_own_threads_deliver_and_stop(tmp_path):
    """A file of the SDK, played by the SDK: calls from its threads, an end, and a clean stop."""
    path = sdk_recording(tmp_path / "sdk.db3")
    source = play_file(path, replace(SETTINGS, silence_s=0.3), MonotonicClock())
    source.start()
    camera = source.camera
    got = [c for c in source.captures(0.05) if c is not None]
    source.stop()
    assert camera.color.model == "brown_conrady"
    np.testing.assert_allclose(camera.color_from_depth.translation, TRANSLATION_M, atol=1e-6)
    assert 1 <= len(got) <= 20
    numbers = [int(c.color_rgb[0, 0, 0]) for c in got]
    assert numbers == sorted(set(numbers))
    for number, c in zip(numbers, got, strict=True):
        assert c.depth_units is None or int(c.depth_units[0, 0]) == 1000 + number
    counts = source.counts()
    assert counts["paired"] >= 10
    assert counts["odd_stamps"] == 0


def test_a_file_that_the_sdk_cannot_play_is_told(tmp_path):
    """In one line."""
    (tmp_path / "no.db3").write_bytes(b"nonsense")
    for name in ("no.db3", "missing.bag"):
        source = play_file(tmp_path / name, SETTINGS, MonotonicClock())
        with pytest.raises(SourceError, match=f"{name}: not to be played by the RealSense SDK"):
            source.start()
        source.stop()


def test_a_camera_file_stands_in_for_what_the_camera_says(rig):
    """If it is of the same pictures."""
    told = camera_of_profiles(rig.rs, rig.color_profile, rig.depth_profile, 0.001, 0.0)
    own = replace(told, color=replace(told.color, fx=61.0, fy=61.0))
    with Running(rig, replace(SETTINGS, camera=own)) as running:
        assert running.source.camera is own
    wide = replace(told, color=replace(told.color, width=128))
    source = RealsenseSource(replace(SETTINGS, camera=wide), ManualClock(), lambda: rig.device)
    with pytest.raises(SourceError, match="file is of color pictures of 128x48, the camera gives"):
        source.start()
    source.stop()


def test_without_a_camera_the_user_is_told():
    """Nothing is plugged in here; whatever the reason, it is one line."""
    source = RealsenseSource(RealsenseSettings(serial="no such"), ManualClock())
    with pytest.raises(SourceError, match="no RealSense camera|cannot be listed"):
        source.start()
    with pytest.raises(SourceError, match="was not started"):
        _ = source.camera
    source.stop()


def test_a_missing_sdk_is_one_line(monkeypatch):
    """Python's own way to say that a package is not there."""
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(SourceError, match=r"install aerial-contact\[realsense\]"):
        realsense_sdk.load_sdk()


def test_a_missing_libusb_is_one_line(monkeypatch):
    """Neither the system's nor the package's."""
    monkeypatch.setitem(sys.modules, "libusb_package", None)
    with pytest.raises(SourceError, match=r"pip install libusb-package, or .* libusb-1\.0-0"):
        realsense_sdk._preload_libusb()
