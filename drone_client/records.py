"""What the ledger says of a reception and of a control tick, as plain JSON values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from drone_client.clock_offset import Echo, OffsetEstimate, one_way
from drone_client.control import Decision
from drone_client.onboard import Look, LookVerdict
from drone_client.reception import Reception
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Result, pose_numbers, unpack_covariance


def reception_record(r: Reception) -> dict[str, Any]:
    """Stamps, times, verdict, outcome and pose of an answered frame."""
    result, target = r.result, r.result.target
    record: dict[str, Any] = {
        "worker": result.worker,
        "t1_ns": result.t1_ns,
        "t2_ns": result.t2_ns,
        "t3_ns": result.t3_ns,
        "t4_ns": r.t4_ns,
        "worker_boot_id": result.worker_boot_id,
        "network_delay_ms": _ms(r.judgement.network_delay_ns),
        "age_ms": _ms(r.judgement.age_ns),
        "service_ms": _ms(result.t3_ns - result.t2_ns),
        "stages_ms": {name: _ms(t_ns) for name, t_ns in result.stages_ns.items()},
        "verdict": r.judgement.verdict.value,
        "outcome": result.outcome.value,
        "reason": result.reason or None,
        "update": None if r.update is None else r.update.value,
    }
    if target is not None:
        variances = np.diag(unpack_covariance(target.covariance))
        record |= {
            "method": target.method,
            "ambiguous": target.ambiguous,
            "score": round(target.score, 4),
            "camera_from_target": list(target.camera_from_target),
            "world_from_target": _pose(r.world_from_target),
            "sigma_mm": [round(math.sqrt(max(0.0, v)) * 1e3, 3) for v in variances[:3]],
            "sigma_deg": [round(math.degrees(math.sqrt(max(0.0, v))), 4) for v in variances[3:]],
            "boxes": {b.level: [b.x0, b.y0, b.x1, b.y1, b.score] for b in target.boxes},
        }
    return record


def decision_record(decision: Decision) -> dict[str, Any]:
    """What a control tick knew, what the mission and the filter said, and the command."""
    record: dict[str, Any] = {
        "known": decision.known.value,
        "target_age_ms": _ms(decision.age_ns),
        "command_mps": [round(v, 6) for v in decision.command.velocity_world.tolist()],
        "yaw_rate_radps": round(decision.command.yaw_rate_radps, 6),
    }
    if decision.source is not None:
        record |= {
            "target_source": decision.source.value,
            "unconfirmed_ms": _ms(decision.unconfirmed_ns),
        }
    if (mission := decision.mission) is not None:
        record |= {"phase": mission.phase.value, "reason": mission.reason.value}
        if (transition := mission.transition) is not None:
            record["transition"] = {
                "before": transition.before.value,
                "sentence": transition.sentence,
            }
    if (safe := decision.safe) is not None:
        record |= {
            "tip_target_m": None
            if decision.tip_target is None
            else [round(v, 6) for v in decision.tip_target],
            "h_m": _finite(safe.h),
            "h_robust_m": _finite(safe.h_robust),
            "delta_m": _finite(safe.delta_m),
            "freshness": safe.freshness.value,
            "status": safe.status.value,
        }
    return record


def look_record(verdict: LookVerdict, look: Look | None) -> dict[str, Any]:
    """What became of a frame on board, and what was measured in it."""
    record: dict[str, Any] = {"verdict": verdict.value}
    if look is None:
        return record
    record |= {
        "detail": look.detail or None,
        "distance2": None if look.distance2 is None else _finite(look.distance2),
        "shades_share": None if look.shades_share is None else _finite(look.shades_share),
    }
    if (found := look.localisation) is not None:
        record |= {
            "method": found.method.value,
            "camera_from_target": list(pose_numbers(found.camera_from_target)),
        }
    if (estimate := look.estimate) is not None:
        variances = np.diag(estimate.covariance)
        record |= {
            "source": estimate.source.value,
            "world_from_target": _pose(estimate.world_from_target),
            "sigma_mm": [_root(v, 1e3) for v in variances[:3]],
            "sigma_deg": [_root(v, math.degrees(1)) for v in variances[3:]],
            "unconfirmed_ms": _ms(estimate.unconfirmed_ns(estimate.t_capture_ns)),
        }
    return record


def _root(variance: float, unit: float) -> float:
    return round(math.sqrt(max(0.0, variance)) * unit, 4)


def one_way_record(result: Result, t4_ns: int, estimate: OffsetEstimate | None) -> dict[str, Any]:
    """d1 and d2 apart, and within what they are known: for people, never for the gate."""
    if estimate is None:
        return {"d1_ms": None, "d2_ms": None, "one_way_bound_ms": None}
    echo = Echo(result.t1_ns, result.t2_ns, result.t3_ns, t4_ns, result.worker_boot_id)
    d1_ns, d2_ns, bound_ns = one_way(echo, estimate)
    return {"d1_ms": _ms(d1_ns), "d2_ms": _ms(d2_ns), "one_way_bound_ms": _ms(bound_ns)}


def _ms(t_ns: int | None) -> float | None:
    return None if t_ns is None else t_ns / 1e6


def _finite(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None


def _pose(pose: Pose | None) -> list[float] | None:
    return None if pose is None else list(pose_numbers(pose))
