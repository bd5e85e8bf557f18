"""A camera inside the real RealSense SDK: its software device, fed with frames of our making."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drone_client.errors import SourceError
from drone_client.source.realsense_sdk import load_sdk

COLOR_SIZE, DEPTH_SIZE = (64, 48), (48, 32)
ROTATION = Rotation.from_rotvec((0.01, -0.02, 0.03))
TRANSLATION_M = (-0.059, 0.001, 0.0003)
BASELINE_MM = 95.0


def sdk():
    """The real SDK; without it the test is skipped, with the reason that a user would read."""
    try:
        return load_sdk()
    except SourceError as error:
        pytest.skip(str(error))


class Rig:
    """A software device with a depth and a colour sensor, and what they are fed."""

    def __init__(
        self,
        serial: str = "0123",
        rate_hz: int = 30,
        model: str = "inverse_brown_conrady",
        coefficients: tuple[float, ...] = (-0.055, 0.066, -0.0005, 0.0003, -0.021),
    ) -> None:
        self.rs = rs = sdk()
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.serial_number, serial)
        self.depth_sensor = self.device.add_sensor("Stereo Module")
        self.color_sensor = self.device.add_sensor("RGB Camera")
        color = self._stream(rs.stream.color, rs.format.rgb8, 3, COLOR_SIZE, rate_hz)
        color.intrinsics = self._intrinsics(COLOR_SIZE, 60.0, model, coefficients)
        depth = self._stream(rs.stream.depth, rs.format.z16, 2, DEPTH_SIZE, rate_hz)
        depth.intrinsics = self._intrinsics(DEPTH_SIZE, 45.0, "brown_conrady", (0.0,) * 5)
        self.color_profile = self.color_sensor.add_video_stream(color).as_video_stream_profile()
        self.depth_profile = self.depth_sensor.add_video_stream(depth).as_video_stream_profile()
        extrinsics = rs.extrinsics()
        extrinsics.rotation = ROTATION.as_matrix().ravel(order="F").tolist()
        extrinsics.translation = list(TRANSLATION_M)
        self.depth_profile.register_extrinsics_to(self.color_profile, extrinsics)
        self.depth_sensor.add_read_only_option(rs.option.depth_units, 0.001)
        self.depth_sensor.add_read_only_option(rs.option.stereo_baseline, BASELINE_MM)
        for sensor in (self.depth_sensor, self.color_sensor):
            self.add_option(sensor, rs.option.global_time_enabled, 0, 1, 1)
        self.add_option(self.depth_sensor, rs.option.emitter_enabled, 0, 2, 0)
        self.add_option(self.depth_sensor, rs.option.laser_power, 0, 360, 150)

    def _stream(self, kind, pixel, bytes_per_pixel, size, rate_hz):
        stream = self.rs.video_stream()
        stream.type, stream.fmt, stream.bpp = kind, pixel, bytes_per_pixel
        stream.index, stream.uid, stream.fps = 0, int(kind), rate_hz
        stream.width, stream.height = size
        return stream

    def _intrinsics(self, size, focal_px, model, coefficients):
        intrinsics = self.rs.intrinsics()
        intrinsics.width, intrinsics.height = size
        intrinsics.fx, intrinsics.fy = focal_px, focal_px + 0.5
        intrinsics.ppx, intrinsics.ppy = size[0] / 2 - 0.75, size[1] / 2 + 0.25
        intrinsics.model = getattr(self.rs.distortion, model)
        intrinsics.coeffs = list(coefficients)
        return intrinsics

    def add_option(self, sensor, option, least, most, default) -> None:
        """An option that can be set."""
        allowed = self.rs.option_range()
        allowed.min, allowed.max, allowed.step, allowed.default = least, most, 1, default
        sensor.add_option(option, allowed, True)

    def metadata(self, sensor, **values: int) -> None:
        """Of the next frames."""
        for name, value in values.items():
            sensor.set_metadata(getattr(self.rs.frame_metadata_value, name), value)

    def color(self, number: int, stamp_ms: float) -> None:
        """A colour picture whose channels are its number and two constants."""
        picture = np.empty((COLOR_SIZE[1], COLOR_SIZE[0], 3), np.uint8)
        picture[:] = (number, 100, 200)
        self._push(self.color_sensor, self.color_profile, picture, 3, number, stamp_ms)

    def depth(self, number: int, stamp_ms: float) -> None:
        """A depth picture whose units are 1000 and its number."""
        picture = np.full((DEPTH_SIZE[1], DEPTH_SIZE[0]), 1000 + number, np.uint16)
        self._push(self.depth_sensor, self.depth_profile, picture, 2, number, stamp_ms)

    def _push(self, sensor, profile, picture, bytes_per_pixel, number, stamp_ms) -> None:
        frame = self.rs.software_video_frame()
        frame.pixels = np.ascontiguousarray(picture).view(np.uint8).reshape(picture.shape[0], -1)
        frame.bpp, frame.stride = bytes_per_pixel, picture.shape[1] * bytes_per_pixel
        frame.frame_number, frame.timestamp = number, stamp_ms
        frame.domain = self.rs.timestamp_domain.hardware_clock
        frame.profile = profile
        sensor.on_video_frame(frame)


def sdk_recording(path: Path, count: int = 20) -> Path:
    """A file written by the SDK's own recorder, of so many pairs."""
    rig = Rig()
    recorder = rig.rs.recorder(str(path), rig.device)
    sensors = recorder.query_sensors()
    for sensor in sensors:
        sensor.open([sensor.get_stream_profiles()[0]])
        sensor.start(lambda frame: None)
    pace = threading.Event()
    for number in range(count):
        stamp_us = 33_333 * number + 5_000
        for sensor in (rig.color_sensor, rig.depth_sensor):
            rig.metadata(sensor, frame_timestamp=stamp_us, sensor_timestamp=stamp_us - 5_000)
        rig.color(number, stamp_us / 1e3)
        rig.depth(number, stamp_us / 1e3)
        pace.wait(0.005)  # it is played at the pace at which it came
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    return path
