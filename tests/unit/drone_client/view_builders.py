"""A short flight in a run's folder, as recorder, ledger and simulator write it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from drone_client.airframe import Airframe
from drone_client.cbf import Funnel
from drone_client.run_files import FACTS_NAME
from drone_client.settings import load_settings
from drone_client.viewing.facts import FlightFacts, facts_of
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import pose_numbers
from tests.unit.drone_client.builders import pose

EYE = CameraIntrinsics(160, 120, 96.0, 96.0, 79.5, 59.5)
RIG = RgbdCamera(EYE, EYE, 0.001, Pose.identity())
WORLD_FROM_TARGET = pose((3.0, 0.0, 1.5), (0.0, 0.0, np.pi))
START_NS = 5_000_000_000_000
"""On the drone's clock, which began long before."""
MS = 1_000_000
FRAMES, TICKS, POSES, TRUTHS = 8, 50, 30, 30
LATE = 3
"""The frame whose answer came too late."""


def facts() -> FlightFacts:
    return facts_of(load_settings(), Airframe(), Funnel(), RIG)


def body_at(t_ns: int) -> Pose:
    """It flies straight to the board at 0.5 m/s."""
    return pose((0.5 * (t_ns - START_NS) / 1e9, 0.1, 1.5))


def capture_ns(i: int) -> int:
    return START_NS + 20 * MS + i * 100 * MS


def camera_from_target(i: int) -> Pose:
    world_from_camera = body_at(capture_ns(i)) @ Airframe().body_from_camera
    return world_from_camera.inverse() @ WORLD_FROM_TARGET


def write_lines(path: Path, lines: list[dict]) -> None:
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")


def ledger_lines() -> list[dict]:
    lines: list[dict] = []
    for i in range(FRAMES):
        t_ns = capture_ns(i)
        late = i == LATE
        lines.append(
            {
                "sequence": i,
                "name": str(i),
                "fate": "answered",
                "worker": "w",
                "bytes": 40_000 + i,
                "encoding": None,
                "t_capture_ns": t_ns,
                "t1_ns": t_ns + 5 * MS,
                "t4_ns": t_ns + 80 * MS,
                "network_delay_ms": 300.0 if late else 20.0 + i,
                "age_ms": 80.0,
                "service_ms": 30.0,
                "verdict": "network_delay" if late else "accepted",
                "outcome": "target",
                "method": "fused",
                "camera_from_target": list(pose_numbers(camera_from_target(i))),
                "world_from_target": list(pose_numbers(WORLD_FROM_TARGET)),
                "d1_ms": 10.0,
                "d2_ms": 10.0,
            }
        )
    lines.append(
        {
            "sequence": FRAMES,
            "name": str(FRAMES),
            "fate": "no_reply",
            "worker": "w",
            "bytes": 40_000,
            "encoding": None,
            "t_capture_ns": capture_ns(FRAMES),
            "t1_ns": capture_ns(FRAMES) + 5 * MS,
        }
    )
    return lines


def tick_lines() -> list[dict]:
    lines: list[dict] = []
    for i in range(TICKS):
        lines.append(
            {
                "t_ns": START_NS + i * 20 * MS,
                "late_us": 10,
                "known": "target",
                "target_age_ms": 60.0,
                "command_mps": [0.5, 0.0, 0.0],
                "yaw_rate_radps": 0.0,
                "phase": "hold" if i < 5 else "approach",
                "tip_target_m": [2.4 - 0.01 * i, 0.0, 0.0],
                "h_m": 1.0 - 0.01 * i,
                "h_robust_m": 0.8 - 0.01 * i,
                "delta_m": 0.02,
                "freshness": "fresh",
                "status": "inactive",
            }
        )
    return lines


def event_lines() -> list[dict]:
    return [
        {"t_ns": START_NS, "event": "workers", "live": ["w"]},
        {
            "t_ns": START_NS + 100 * MS,
            "event": "phase",
            "before": "hold",
            "after": "approach",
            "reason": "aligned",
            "sentence": "square before the board",
        },
        {"t_ns": START_NS + 200 * MS, "event": "late_result", "verdict": "too_old", "sequence": 1},
        {"t_ns": START_NS + 300 * MS, "event": "suspect", "worker": "w", "why": "silent"},
    ]


def write_run(folder: Path, *, pictures: bool = True, known: bool = True) -> Path:
    """All files of a flight; without ``known`` those of a replay."""
    folder.mkdir(parents=True, exist_ok=True)
    write_lines(folder / "ledger.jsonl", ledger_lines())
    write_lines(folder / "ticks.jsonl", tick_lines())
    write_lines(folder / "events.jsonl", event_lines())
    if not known:
        return folder
    (folder / FACTS_NAME).write_text(json.dumps(facts().to_json()), encoding="utf-8")
    stamps = [START_NS + round(i * 33.3 * MS) for i in range(POSES)]
    poses = [
        {
            "t_ns": t_ns,
            "world_from_body": list(pose_numbers(body_at(t_ns))),
            "velocity_mps": [0.5, 0.0, 0.0],
            "mode": "OFFBOARD",
            "obeying": True,
            "resets": 0,
        }
        for t_ns in stamps
    ]
    write_lines(folder / "poses.jsonl", poses)
    if pictures:
        (folder / "pictures").mkdir(exist_ok=True)
        for i in range(FRAMES):
            cv2.imwrite(str(folder / "pictures" / f"{capture_ns(i)}.jpg"), photo(i))
    return folder


def photo(i: int) -> np.ndarray:
    """What the camera took, (120, 160, 3) BGR: grey, each another."""
    return np.full((120, 160, 3), 60 + 10 * i, dtype=np.uint8)
