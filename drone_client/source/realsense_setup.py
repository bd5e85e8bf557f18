"""How a RealSense camera is set up: modes, options, presets; and what is said if it cannot be."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from drone_client.errors import SourceError
from rgbd_wire.camera import RgbdCamera

MAX_LISTED_MODES: Final = 12


@dataclass(frozen=True, slots=True)
class RealsenseSettings:
    """What the camera is asked for; None: as the camera has it."""

    serial: str | None = None
    """Needed where there are several."""
    color_size_px: tuple[int, int] = (640, 480)
    depth_size_px: tuple[int, int] = (640, 480)
    rate_hz: int = 30
    pair_tolerance_ns: int | None = None
    """None: 45 % of a period."""
    emitter: bool | None = True
    """The infrared pattern: walls without texture have no depth without it."""
    laser_power_mw: float | None = None
    preset: str | None = None
    """Of the depth sensor by its name, such as "High Accuracy"."""
    camera: RgbdCamera | None = None
    """Stands in for what the camera says of itself."""
    silence_s: float = 1.0
    """No colour picture for so long: the camera is taken for gone."""
    reconnect_s: float = 10.0
    """It is looked for so long."""


def find_mode(
    sensors: Iterable[Any], stream: Any, pixel: Any, size_px: tuple[int, int], rate_hz: int
) -> tuple[Any, Any]:
    """Sensor and profile that give pictures of a kind, size and rate.

    Raises:
        SourceError: there is none; with those that there are.
    """
    offered: list[str] = []
    for sensor in sensors:
        for profile in sensor.get_stream_profiles():
            if profile.stream_type() != stream or profile.format() != pixel:
                continue
            video = profile.as_video_stream_profile()
            size = (video.width(), video.height())
            if size == size_px and video.fps() == rate_hz:
                return sensor, video
            offered.append(f"{size[0]}x{size[1]} at {video.fps()} Hz")
    kinds = list(dict.fromkeys(offered))
    have = ", ".join(kinds[:MAX_LISTED_MODES]) or "none at all"
    more = f" and {len(kinds) - MAX_LISTED_MODES} more" * (len(kinds) > MAX_LISTED_MODES)
    raise SourceError(
        f"the camera gives no {stream.name} pictures of {size_px[0]}x{size_px[1]} at "
        f"{rate_hz} Hz; it has {have}{more}. Few modes are a sign of USB 2"
    )


def set_where_known(sensor: Any, option: Any, value: float) -> bool:
    """Set an option where the sensor has it."""
    if not sensor.supports(option) or sensor.is_option_read_only(option):
        return False
    sensor.set_option(option, value)
    return True


def set_depth_options(sdk: Any, sensor: Any, settings: RealsenseSettings) -> None:
    """Preset, emitter and laser of the depth sensor.

    Raises:
        SourceError: a preset or a power that it does not have; with those that it has.
    """
    option = sdk.option
    if settings.preset is not None:  # first: it sets the laser too
        _set_preset(sensor, option.visual_preset, settings.preset)
    if settings.emitter is not None:
        set_where_known(sensor, option.emitter_enabled, float(settings.emitter))
    if settings.laser_power_mw is not None:
        _must_set(sensor, option.laser_power, settings.laser_power_mw, "laser power")


def _must_set(sensor: Any, option: Any, value: float, what: str) -> None:
    if not sensor.supports(option):
        raise SourceError(f"the camera has no {what} to set")
    allowed = sensor.get_option_range(option)
    if not allowed.min <= value <= allowed.max:
        raise SourceError(f"{what} {value:g}: the camera takes {allowed.min:g} to {allowed.max:g}")
    set_where_known(sensor, option, value)


def _set_preset(sensor: Any, option: Any, name: str) -> None:
    if not sensor.supports(option):
        raise SourceError("the camera has no presets")
    allowed = sensor.get_option_range(option)
    known = {
        str(sensor.get_option_value_description(option, value)).lower(): value
        for value in range(int(allowed.min), int(allowed.max) + 1)
        if sensor.get_option_value_description(option, value) is not None
    }
    if name.lower() not in known:
        raise SourceError(f"no preset {name!r}; the camera has {', '.join(known)}")
    set_where_known(sensor, option, known[name.lower()])
