"""Truth of a recording, where somebody knows it.

A JSON list, one entry a frame: ``{"t": s, "camera_from_target": 4x4, "visible": share}``; other
fields may stand beside these.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drone_client.errors import SourceError
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Pose

MAX_TRUTH_BYTES = 64 * 1024 * 1024


@dataclass(frozen=True, slots=True, eq=False)
class TruthEntry:
    """Where the target really was in one frame."""

    camera_from_target: Pose
    visible: float
    """Share of the target inside the picture."""


def load_truth(path: Path, captures: int) -> tuple[TruthEntry, ...]:
    """Read the truth of a recording of so many captures; entry i belongs to capture i.

    Raises:
        SourceError: with the path and the entry at fault.
    """
    try:
        if path.stat().st_size > MAX_TRUTH_BYTES:
            raise SourceError(f"truth file {path}: over {MAX_TRUTH_BYTES} bytes")
        raw = json.loads(path.read_bytes())
    except OSError as error:
        raise SourceError(f"truth file {path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise SourceError(f"truth file {path}: not JSON: {error}") from None
    if not isinstance(raw, list):
        raise SourceError(f"truth file {path}: must be a list of frames")
    if len(raw) != captures:
        raise SourceError(
            f"truth file {path}: {len(raw)} frames, but the recording has {captures}: not its truth"
        )
    entries = []
    for number, entry in enumerate(raw):
        try:
            matrix = np.asarray(entry["camera_from_target"], dtype=np.float64)
            entries.append(TruthEntry(Pose.from_matrix(matrix), float(entry["visible"])))
        except (KeyError, TypeError):
            raise SourceError(
                f"truth file {path}: frame {number}: must hold camera_from_target, a 4x4 matrix, "
                "and visible, a share"
            ) from None
        except (ValueError, GeometryError) as error:
            raise SourceError(f"truth file {path}: frame {number}: {error}") from None
    return tuple(entries)


def position_error_m(estimate: Pose, truth: Pose) -> float:
    """Distance between two places of the target [m]."""
    return float(np.linalg.norm(estimate.translation - truth.translation))


def normal_error_rad(estimate: Pose, truth: Pose) -> float:
    """Angle between two normals of the target (its x axis) [rad]."""
    cosine = float(estimate.rotation[:, 0] @ truth.rotation[:, 0])
    return float(np.arccos(min(1.0, max(-1.0, cosine))))
