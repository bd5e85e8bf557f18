"""A RealSense D4xx camera: raw depth and colour, stamped by the camera itself.

Depth is neither aligned to colour nor filtered: what the sensor measured goes out, with the
transform between the two. Stamps are the hardware's, mapped to the drone's clock here
(``clock_map``) and not by the SDK, whose global time is neither monotonic nor bounded.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from drone_client.errors import SourceError
from drone_client.newest import Newest
from drone_client.source import Capture
from drone_client.source.assembly import Assembler, Assembling
from drone_client.source.realsense_camera import camera_of_profiles
from drone_client.source.realsense_sdk import load_sdk
from drone_client.source.realsense_setup import (
    RealsenseSettings,
    find_mode,
    set_depth_options,
    set_where_known,
)
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.clock import Clock

MAX_EXPOSURE_US: Final = 200_000
"""Longer ones are no exposures but garbage in the metadata."""
_RETRY_S: Final = 0.5


def play_file(path: Path, settings: RealsenseSettings, clock: Clock) -> RealsenseSource:
    """A recording of the RealSense SDK (.bag, .db3), played by the SDK as if it happened now.

    Raises:
        SourceError: the SDK is not installed.
    """

    def find() -> Any:
        try:
            return load_sdk().context().load_device(str(path))
        except RuntimeError as error:
            raise SourceError(f"{path}: not to be played by the RealSense SDK: {error}") from None

    return RealsenseSource(settings, clock, find, ends=True)


def _fitting(camera: RgbdCamera, told: RgbdCamera) -> RgbdCamera:
    """A user's camera in place of the told one, whose pictures have the same sizes."""
    for name in ("color", "depth"):
        own, device = getattr(camera, name), getattr(told, name)
        if (own.width, own.height) != (device.width, device.height):
            raise SourceError(
                f"the camera file is of {name} pictures of {own.width}x{own.height}, "
                f"the camera gives {device.width}x{device.height}"
            )
    return camera


class RealsenseSource:
    """A D4xx as a ``LiveSource``; captures are taken by one thread.

    Raises:
        SourceError: the SDK is not installed.
    """

    def __init__(
        self,
        settings: RealsenseSettings,
        clock: Clock,
        find: Callable[[], Any] | None = None,
        *,
        ends: bool = False,
    ) -> None:
        """Nothing is opened yet.

        Args:
            settings: what is asked for.
            clock: the drone's.
            find: gives the device, an ``rs.device``; without it the one that is plugged in.
            ends: a silence is the end, and nothing is opened anew: a file that is played.
        """
        self._sdk = load_sdk()
        self._settings = settings
        self._clock = clock
        self._find = self._plugged_in if find is None else find
        self._ends = ends
        self._camera: RgbdCamera | None = None
        self._told: RgbdCamera | None = None
        """By the first device that was opened."""
        self._sensors: list[Any] = []
        self._lock = threading.Lock()
        """Of assembler, counts and last numbers: the SDK calls from a thread per sensor."""
        self._how = Assembling.of_rate(settings.rate_hz, settings.pair_tolerance_ns)
        self._assembler = Assembler(self._how, settings.serial or "realsense")
        self._counts: Counter[str] = Counter()
        self._last_numbers: dict[Any, int] = {}
        self._last_color_ns = 0
        self._newest: Newest[Capture] = Newest()
        self._failure: SourceError | None = None
        self._stopping = threading.Event()
        self._watchman = threading.Thread(target=self._watch, name="realsense", daemon=True)

    @property
    def camera(self) -> RgbdCamera:
        """Intrinsics, extrinsics and depth unit as the camera tells them.

        Raises:
            SourceError: it was not started.
        """
        if self._camera is None:
            raise SourceError("the camera was not started")
        return self._camera

    def start(self) -> None:
        """Open the camera and let it run.

        Raises:
            SourceError: no camera, several and none named, or it cannot do what was asked for.
        """
        self._open()
        self._watchman.start()

    def captures(self, timeout_s: float) -> Iterator[Capture | None]:
        """The newest capture as it comes, None after each time-out; ends after ``stop``.

        Raises:
            SourceError: the camera went away and did not come back.
        """
        while not self._stopping.is_set():
            capture = self._newest.take(timeout_s)
            if capture is None and self._failure is not None:
                raise self._failure
            if capture is not None or not self._stopping.is_set():
                yield capture

    def counts(self) -> dict[str, int]:
        """What became of the camera's pictures."""
        with self._lock:
            return {**self._counts, **self._assembler.counts()}

    def stop(self) -> None:
        """Stop and close the camera."""
        self._stopping.set()
        self._newest.close()
        if self._watchman.is_alive():
            self._watchman.join()
        self._close()

    def _plugged_in(self) -> Any:
        serial = self._settings.serial
        found = {d.get_info(self._sdk.camera_info.serial_number): d for d in self._devices()}
        if not found:
            raise SourceError(
                "no RealSense camera found: is it plugged into a USB 3 port, and may you use it "
                "(udev rules of librealsense)?"
            )
        if serial is None and len(found) > 1:
            raise SourceError(
                f"{len(found)} RealSense cameras: name one as realsense:SERIAL, of "
                + ", ".join(sorted(found))
            )
        if serial is not None and serial not in found:
            raise SourceError(f"no RealSense camera {serial}; there is {', '.join(sorted(found))}")
        return found[serial] if serial is not None else next(iter(found.values()))

    def _devices(self) -> list[Any]:
        try:
            return list(self._sdk.context().query_devices())
        except RuntimeError as error:
            raise SourceError(f"RealSense cameras cannot be listed: {error}") from None

    def _open(self) -> None:
        """Find the camera, set it up and let it run."""
        device = self._find()
        try:
            self._set_up(device)
        except RuntimeError as error:
            self._close()
            raise SourceError(f"the RealSense camera cannot be opened: {error}") from None
        except SourceError:
            self._close()
            raise

    def _set_up(self, device: Any) -> None:
        rs, settings = self._sdk, self._settings
        sensors = list(device.query_sensors())
        rate_hz = settings.rate_hz
        color = find_mode(sensors, rs.stream.color, rs.format.rgb8, settings.color_size_px, rate_hz)
        depth = find_mode(sensors, rs.stream.depth, rs.format.z16, settings.depth_size_px, rate_hz)
        depth_sensor = depth[0]
        for sensor in sensors:
            set_where_known(sensor, rs.option.global_time_enabled, 0)
            # In the dark it would halve the rate instead of raising the gain
            set_where_known(sensor, rs.option.auto_exposure_priority, 0)
        set_depth_options(rs, depth_sensor, settings)
        baseline_mm = 0.0
        if depth_sensor.supports(rs.option.stereo_baseline):
            baseline_mm = abs(depth_sensor.get_option(rs.option.stereo_baseline))
        told = camera_of_profiles(
            rs,
            color[1],
            depth[1],
            float(depth_sensor.get_option(rs.option.depth_units)),
            baseline_mm / 1e3,
        )
        if self._told is not None and told.to_json() != self._told.to_json():
            raise SourceError("another camera was plugged in: its calibration is not the first's")
        self._told = told
        self._camera = told if settings.camera is None else _fitting(settings.camera, told)
        with self._lock:
            self._last_color_ns = self._clock.now_ns()
            self._last_numbers.clear()
        # Colour and depth may be of one sensor (D405) or of two
        if color[0] is depth_sensor:
            self._run(depth_sensor, [color[1], depth[1]])
        else:
            self._run(depth_sensor, [depth[1]])
            self._run(color[0], [color[1]])

    def _run(self, sensor: Any, profiles: list[Any]) -> None:
        sensor.open(profiles)
        self._sensors.append(sensor)
        sensor.start(self._on_frame)

    def _on_frame(self, frame: Any) -> None:
        """A picture, in a thread of the SDK's."""
        t_arrival_ns = self._clock.now_ns()
        try:
            stream = frame.get_profile().stream_type()
            stamp_us = round(frame.get_timestamp() * 1000)
            since_middle_ns = 1000 * self._since_middle_us(frame, stream)
            number = frame.get_frame_number()
            picture = np.array(frame.get_data())  # a copy: the SDK has but few buffers
        except (RuntimeError, ValueError, TypeError):
            with self._lock:
                self._counts["unreadable"] += 1
            return
        with self._lock:
            self._count(stream, number)
            when = stamp_us, since_middle_ns, t_arrival_ns
            if stream == self._sdk.stream.color:
                self._last_color_ns = t_arrival_ns
                settled = self._assembler.color(*when, picture)
            else:
                settled = self._assembler.depth(*when, picture)
            for capture in settled:
                self._put(capture)

    def _since_middle_us(self, frame: Any, stream: Any) -> int:
        """From the middle of the exposure to the frame's stamp, as far as metadata tell it."""
        of = self._sdk.frame_metadata_value
        if frame.supports_frame_metadata(of.sensor_timestamp) and frame.supports_frame_metadata(
            of.frame_timestamp
        ):
            middle_us = frame.get_frame_metadata(of.sensor_timestamp)
            since_us = frame.get_frame_metadata(of.frame_timestamp) - middle_us
        elif stream == self._sdk.stream.depth and frame.supports_frame_metadata(
            of.actual_exposure  # colour's has another unit on some models
        ):
            since_us = frame.get_frame_metadata(of.actual_exposure) // 2
        else:
            return 0
        return int(since_us) if 0 <= since_us <= MAX_EXPOSURE_US // 2 else 0

    def _count(self, stream: Any, number: int) -> None:
        name = "color" if stream == self._sdk.stream.color else "depth"
        self._counts[f"{name}_frames"] += 1
        last = self._last_numbers.get(stream)
        if last is not None and number > last + 1:
            self._counts[f"{name}_dropped"] += number - last - 1
        self._last_numbers[stream] = number

    def _put(self, capture: Capture) -> None:
        if self._newest.put(capture) is not None:
            self._counts["displaced"] += 1

    def _watch(self) -> None:
        """Open the camera anew when it falls silent; give up after a while."""
        silence_ns = round(self._settings.silence_s * 1e9)
        while not self._stopping.wait(self._settings.silence_s / 4):
            with self._lock:
                quiet_ns = self._clock.now_ns() - self._last_color_ns
            if quiet_ns > silence_ns and not self._came_back():
                return

    def _came_back(self) -> bool:
        self._close()
        if self._ends:
            self._stopping.set()
            self._newest.close()
            return False
        give_up_ns = self._clock.now_ns() + round(self._settings.reconnect_s * 1e9)
        while True:
            try:
                self._open()
            except SourceError as error:
                reason = error
            else:
                with self._lock:
                    self._counts["reconnects"] += 1
                return True
            if self._clock.now_ns() > give_up_ns:
                self._failure = SourceError(
                    f"the camera fell silent and did not come back within "
                    f"{self._settings.reconnect_s:g} s: check cable and power ({reason})"
                )
                self._newest.close()
                return False
            if self._stopping.wait(min(_RETRY_S, self._settings.reconnect_s / 4)):
                return False

    def _close(self) -> None:
        sensors, self._sensors = self._sensors, []
        for sensor in sensors:  # without the lock: it waits for a callback that runs
            for end in (sensor.stop, sensor.close):
                try:
                    end()
                except RuntimeError:
                    continue  # it is unplugged, or never ran
        with self._lock:
            for capture in self._assembler.restart():
                self._put(capture)
