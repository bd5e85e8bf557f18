"""What a simulated flight truly came to, as people read it beside what the client believes."""

from __future__ import annotations

from typing import Any

from drone_client.summary_table import print_rows


def print_truth(summary: dict[str, Any]) -> None:
    """Print the table of it; nothing for a real flight, of which nobody knows."""
    if (simulated := summary.get("simulated")) is None:
        return
    print_rows(truth_rows(simulated), "truth")


def truth_rows(simulated: dict[str, Any]) -> dict[str, str]:
    """Text of each row by its name, of what a simulator reports."""
    rows = {"touch": "none"}
    if simulated["touched"]:
        rows["touch"] = (
            f"{1e3 * simulated['offset_m']:.0f} mm from the centre of the print"
            + _number(", closing at {:.0f} mm/s", simulated["closing_mps"], 1e3)
        )
    rows |= {
        "force": (
            f"at most {simulated['peak_force_n']:.1f} N"
            + _number(", median {:.1f} N", simulated["press_force_n"])
            + f", pressed {simulated['pressed_s']:.1f} s"
        ),
        "else touched": ", ".join(simulated["collisions"]) or "nothing",
        "beside the mouth": (
            f"pushed {1e3 * simulated['outside_m']:.1f} mm" if simulated["outside_m"] else "never"
        ),
        "drift": _number("{:.0f} mm at the end", simulated["drift_m"], 1e3) or "unknown",
    }
    if simulated["slipped_s"]:
        rows["slipped"] = f"{simulated['slipped_s']:.1f} s that the world fell behind the clock"
    if simulated["error"]:
        rows["ERROR"] = simulated["error"]
    return rows


def unsafe(summary: dict[str, Any]) -> str | None:
    """What a simulated flight did that none may do, in a sentence; None: nothing."""
    simulated = summary.get("simulated")
    if simulated is None or simulated["safe"]:
        return None
    what = list(simulated["collisions"])
    if simulated["outside_m"]:
        what.append(f"pushed {1e3 * simulated['outside_m']:.1f} mm beside the mouth")
    return f"not safe, whatever the client believes: {', '.join(what)}"


def _number(form: str, value: float | None, scale: float = 1.0) -> str:
    """Empty: there is none, or it is no number."""
    return "" if value is None or value != value else form.format(scale * value)
