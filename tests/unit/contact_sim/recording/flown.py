"""A run's folder as a simulated flight leaves it, without a service: flown straight to the wall."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from contact_sim.recording.truth import TruthWriter
from contact_sim.simulation import STEP_NS
from drone_client.cbf import Funnel
from drone_client.run_files import FACTS_NAME
from drone_client.settings import load_settings
from drone_client.viewing.facts import facts_of
from rgbd_wire.messages import pose_numbers
from tests.unit.contact_sim.flights import AIRFRAME, BOARD, RIG, simulation
from tests.unit.drone_client.view_builders import write_lines

START_NS = 7_000_000_000_000
"""Of the flight on the drone's clock."""
MS = 1_000_000
PICTURE_STEPS, TICK_STEPS, TURN_STEPS = 50, 10, 2
DELAY_NS = 80 * MS
REFUSED_FROM_NS = 600 * MS
"""From here on the answers come too late, in this flight."""


def fly(folder: Path, seconds: float = 1.0) -> Path:
    """Fly, and write all that a real run writes."""
    folder.mkdir(parents=True, exist_ok=True)
    sim = simulation()
    facts = facts_of(load_settings(), AIRFRAME, Funnel(), RIG)
    (folder / FACTS_NAME).write_text(json.dumps(facts.to_json()), encoding="utf-8")
    (folder / "pictures").mkdir(exist_ok=True)
    truth = TruthWriter(folder)
    truth.begin()
    frames: list[dict] = []
    ticks: list[dict] = []
    poses: list[dict] = []
    sim.set_velocity((0.4, 0.0, 0.0), 0.0)
    for step in range(0, round(seconds * 1e9 / STEP_NS), TURN_STEPS):
        now_ns = START_NS + sim.t_ns
        body = sim.truth.world_from_body
        seen = (body @ AIRFRAME.body_from_camera).inverse() @ BOARD
        if step % TICK_STEPS == 0:
            tip = BOARD.inverse() @ (body @ AIRFRAME.body_from_tip.translation)
            ticks.append(_tick(now_ns, tip.tolist()))
            poses.append({"t_ns": now_ns, "world_from_body": list(pose_numbers(body))})
        if step % PICTURE_STEPS == 0:
            picture = np.full((48, 64, 3), 128, dtype=np.uint8)
            cv2.imwrite(str(folder / "pictures" / f"{now_ns}.jpg"), picture)
            frames.append(_frame(len(frames), now_ns, list(pose_numbers(seen))))
        sim.step(TURN_STEPS)
        truth.look(sim, START_NS + sim.t_ns)
    truth.close()
    for name, lines in (("ledger", frames), ("ticks", ticks), ("poses", poses)):
        write_lines(folder / f"{name}.jsonl", lines)
    said = {
        "t_ns": START_NS + 100 * MS,
        "event": "phase",
        "before": "align",
        "after": "approach",
        "reason": "aligned",
        "sentence": "square before the board",
    }
    write_lines(folder / "events.jsonl", [said])
    return folder


def _tick(now_ns: int, tip: list[float]) -> dict:
    return {
        "t_ns": now_ns,
        "known": "target",
        "phase": "align" if now_ns < START_NS + 100 * MS else "approach",
        "tip_target_m": tip,
        "h_m": tip[0],
        "h_robust_m": tip[0] - 0.2,
        "target_age_ms": 90.0,
        "status": "inactive",
    }


def _frame(number: int, t_ns: int, seen: list[float]) -> dict:
    late = t_ns >= START_NS + REFUSED_FROM_NS
    return {
        "sequence": number,
        "fate": "answered",
        "worker": "w",
        "t_capture_ns": t_ns,
        "t1_ns": t_ns + 5 * MS,
        "t4_ns": t_ns + DELAY_NS,
        "network_delay_ms": 400.0 if late else 40.0,
        "age_ms": 80.0,
        "verdict": "network_delay" if late else "accepted",
        "outcome": "target",
        "camera_from_target": seen,
        "world_from_target": list(pose_numbers(BOARD)),
    }
