"""A mission: search, align, approach, touch, retreat; and what ends it (docs/mission.md).

``begin`` makes a mission, ``step`` takes it one tick on; the parts stand alone for tests.
"""

from __future__ import annotations

from drone_client.mission.arm import Arm
from drone_client.mission.contact import ContactSettings
from drone_client.mission.machine import begin, step
from drone_client.mission.phase import Order, Phase, Reason
from drone_client.mission.settings import MissionSettings
from drone_client.mission.state import (
    Intent,
    MissionState,
    Observation,
    Seen,
    Senses,
    Told,
    Transition,
)

__all__ = [
    "Arm",
    "ContactSettings",
    "Intent",
    "MissionSettings",
    "MissionState",
    "Observation",
    "Order",
    "Phase",
    "Reason",
    "Seen",
    "Senses",
    "Told",
    "Transition",
    "begin",
    "step",
]
