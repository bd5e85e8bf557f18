"""Parameters by name, over a line that loses some and an autopilot that does not know others."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot.parameter_reader import BATCH, ParameterReader
from rgbd_wire.clock import MonotonicClock


def test_names_that_are_never_answered_keep_nobody_else_from_being_asked() -> None:
    """More of them than are asked for at once, and before the others."""
    asked: list[str] = []

    def ask(name: str) -> None:
        asked.append(name)
        if name.startswith("KNOWN") and asked.count(name) > 1:  # the first answer is lost
            reader.heard(
                mav.MAVLink_param_value_message(
                    name.encode(), 0.25, mav.MAV_PARAM_TYPE_REAL32, 3, 0
                )
            )

    reader = ParameterReader(MonotonicClock(), ask, bytewise=True)
    silent = [f"SILENT_{i}" for i in range(BATCH + 1)]
    values = reader.read([*silent, "KNOWN_1", "KNOWN_2"], 2.0)
    assert values == {"KNOWN_1": 0.25, "KNOWN_2": 0.25}
    assert set(asked) == {*silent, "KNOWN_1", "KNOWN_2"}
