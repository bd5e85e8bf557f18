"""How long a drone is without a worker: killed, hung, drained; two real workers, a real drone.

    scripts/bench handover [--repeats 5] [--transport zenoh|udp|both] [--write FILE]

For each fault: from the signal to the worker in use until the first result of the other one is
accepted; what the drone noticed when; and the control ticks in between that had no fresh target.
Everything runs on this machine's cores at once, three processes with torch in two of them, so the
service time of a frame is part of every figure and is printed beside it.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.two_workers import Flying, Pair

FAULTS = {"killed": signal.SIGKILL, "hung": signal.SIGSTOP, "drained": signal.SIGTERM}
GOALS = {
    "killed": "100 ms",
    "hung": "max(300 ms, 3 missed replies)",
    "drained": "no tick without a fresh target",
}
BEFORE, AFTER = 30, 10
"""Accepted results before the fault and after it."""


def measure(fault: str, transport: str, options: list[str]) -> dict[str, Any]:
    """One flight with one fault."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with Pair(folder, transport) as pair:
            flying = Flying(folder, pair, options)
            try:
                before = flying.wait_for_accepted(BEFORE)
                other = next(n for n in pair.services if n != before)
                fault_ns = time.monotonic_ns()  # one machine, one clock: the drone's as well
                pair.services[before].process.send_signal(FAULTS[fault])
                flying.wait_for_accepted(AFTER, other)
                run = flying.land()
            finally:
                flying.close()
    accepted = run.accepted()
    first = next(f for f in accepted if f["worker"] == other and f["t4_ns"] > fault_ns)
    last_before = max(f["t4_ns"] for f in accepted if f["t4_ns"] < first["t4_ns"])
    changed = [
        e["t_ns"]
        for e in run.events
        if e["event"] == "worker" and e["now"] == other and e["t_ns"] > fault_ns
    ]
    around = [t for t in run.ticks if fault_ns <= t["t_ns"] <= first["t4_ns"]]
    misses = [e for e in run.events if e["event"] == "ack_missed" and e["t_ns"] > fault_ns]
    return {
        "noticed_ms": (changed[0] - fault_ns) / 1e6,
        "first_result_ms": (first["t4_ns"] - fault_ns) / 1e6,
        "gap_ms": (first["t4_ns"] - last_before) / 1e6,
        "service_ms": first["service_ms"],
        "acks_missed": len([e for e in misses if e["t_ns"] <= first["t4_ns"]]),
        "ticks": len(around),
        "stale_ticks": sum(t.get("freshness") != "fresh" for t in around),
    }


def spread(values: list[float]) -> str:
    """Median and range."""
    low, middle, high = np.percentile(values, [0, 50, 100])
    return f"{middle:.0f} ({low:.0f}-{high:.0f})"


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one line for each transport and fault."""
    lines = [
        "| transport | worker is | noticed [ms] | first result of the other [ms] "
        "| of it service [ms] | ticks without a fresh target | goal |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for transport in dict.fromkeys(r["transport"] for r in rows):
        for fault in FAULTS:
            mine = [r for r in rows if (r["transport"], r["fault"]) == (transport, fault)]
            if not mine:
                continue
            columns = (
                spread([r[key] for r in mine])
                for key in ("noticed_ms", "first_result_ms", "service_ms", "stale_ticks")
            )
            lines.append(f"| {transport} | {fault} | {' | '.join(columns)} | {GOALS[fault]} |")
    return "\n".join(lines)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--transport", choices=["zenoh", "udp", "both"], default="both")
    parser.add_argument("--fault", choices=[*FAULTS, "all"], default="all")
    parser.add_argument("--json", action="store_true", help="print all runs as JSON")
    parser.add_argument("--write", type=Path, help="write the table to a file, too")
    args, options = parser.parse_known_args()
    transports = ["zenoh", "udp"] if args.transport == "both" else [args.transport]
    rows = []
    for transport in transports:
        for fault in FAULTS if args.fault == "all" else [args.fault]:
            for number in range(args.repeats):
                print(f"{transport}, {fault}: {number + 1} of {args.repeats}", file=sys.stderr)
                rows.append(
                    {"transport": transport, "fault": fault, **measure(fault, transport, options)}
                )
    text = json.dumps(rows, indent=2) if args.json else table(rows)
    print(text)
    if args.write:
        command = " ".join(["scripts/bench handover", *sys.argv[1:]])
        args.write.write_text(
            "# Hand-over\n\nMedian and range of "
            f"{args.repeats} flights each; made by `{command}`.\n\n{table(rows)}\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
