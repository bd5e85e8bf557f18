"""What must be known of a drone to draw its flight: ``flight.json`` in the run's folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from drone_client.airframe import Airframe
from drone_client.cbf import Funnel
from drone_client.cbf.vector import Vec3
from drone_client.errors import OutputError
from drone_client.settings import ClientSettings
from rgbd_wire.camera import RgbdCamera, camera_from_json
from rgbd_wire.errors import WireError
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import pose_numbers, pose_of
from target_pose.target import load_target

MAX_FACTS_BYTES: Final = 1_000_000


class Propeller(NamedTuple):
    """A disc, level in the body."""

    center_body: Vec3
    radius_m: float


@dataclass(frozen=True, slots=True, eq=False)
class FlightFacts:
    """What holds for the whole of a flight."""

    drone: str
    camera: RgbdCamera
    body_from_camera: Pose
    body_from_tip: Pose
    propellers: tuple[Propeller, ...]
    board_side_m: float
    discs_m: tuple[float, ...]
    """Diameters on the board."""
    funnel: Funnel
    tau_max_ms: float
    age_max_ms: float

    def to_json(self) -> dict[str, Any]:
        """For ``flight.json``."""
        return {
            "drone": self.drone,
            "camera": self.camera.to_json(),
            "body_from_camera": list(pose_numbers(self.body_from_camera)),
            "body_from_tip": list(pose_numbers(self.body_from_tip)),
            "propellers": [[list(p.center_body), p.radius_m] for p in self.propellers],
            "board_side_m": self.board_side_m,
            "discs_m": list(self.discs_m),
            "funnel": {"a": self.funnel.a, "e_m": self.funnel.e_m, "r_c_m": self.funnel.r_c_m},
            "tau_max_ms": self.tau_max_ms,
            "age_max_ms": self.age_max_ms,
        }


def facts_of(
    settings: ClientSettings, airframe: Airframe, funnel: Funnel, camera: RgbdCamera
) -> FlightFacts:
    """The facts of a flight that begins; the camera tells of itself last."""
    target = load_target(settings.onboard_target)
    parts = dict.fromkeys(part for plane in airframe.keep_outs for part in plane.parts)
    return FlightFacts(
        settings.name,
        camera,
        airframe.body_from_camera,
        airframe.body_from_tip,
        tuple(Propeller(p.center_body, p.radius_m) for p in parts if p.axis_body is not None),
        target.board_side_m,
        tuple(disc.diameter_m for disc in target.discs),
        funnel,
        settings.tau_max_ms,
        settings.age_max_ms,
    )


def load_facts(path: Path) -> FlightFacts | None:
    """Read ``flight.json``; None: there is none, as beside a replay.

    Raises:
        OutputError: it is not what was written there.
    """
    try:
        with path.open("rb") as file:
            text = file.read(MAX_FACTS_BYTES + 1)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise OutputError(f"{path}: {error.strerror}") from None
    if len(text) > MAX_FACTS_BYTES:
        raise OutputError(f"{path}: over {MAX_FACTS_BYTES} bytes, which no flight.json has")
    try:
        return _facts(json.loads(text))
    except (WireError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise OutputError(f"{path} is no flight.json of a run: {error!r:.200}") from None


def _facts(raw: dict[str, Any]) -> FlightFacts:
    funnel = raw["funnel"]
    return FlightFacts(
        str(raw["drone"]),
        camera_from_json(json.dumps(raw["camera"])),
        pose_of(raw["body_from_camera"]),
        pose_of(raw["body_from_tip"]),
        tuple(
            Propeller((float(x), float(y), float(z)), float(r))
            for (x, y, z), r in raw["propellers"]
        ),
        float(raw["board_side_m"]),
        tuple(float(d) for d in raw["discs_m"]),
        Funnel(float(funnel["a"]), float(funnel["e_m"]), float(funnel["r_c_m"])),
        float(raw["tau_max_ms"]),
        float(raw["age_max_ms"]),
    )
