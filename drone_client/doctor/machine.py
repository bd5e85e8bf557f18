"""The machine on board: clock, disk, cores, priority, network buffers."""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drone_client.doctor.finding import Check, Finding, judged, unchecked
from drone_client.promptness import may_be_first

AREA = "machine"
MIN_FREE_BYTES = 500_000_000
"""About an hour of ledger and ticks, and the picture of the run."""
BUFFER_BYTES = 1_000_000
"""A whole frame and its parity wait there, at most."""


SLOW_WRITE_MS = 250.0
"""No line is lost by it, for minutes of them wait in memory; but what waits when the power goes is,
and a disk that takes longer is worn out, full, or shared with something that writes a lot."""


@dataclass(frozen=True, slots=True)
class MachineFacts:
    """What was measured; None: this system does not tell."""

    clock_step_ns: int
    """Smallest step seen of the monotonic clock."""
    write_ms: float | None
    """Longest of some small writes that were forced to the disk."""
    free_bytes: int | None
    cores: int
    governors: tuple[str, ...]
    """Of the cores' clock frequency, each once."""
    first_in_line: bool
    """Real-time priority may be had."""
    rmem_max: int | None
    wmem_max: int | None
    """Largest socket buffers [bytes]."""


def collect_machine(out: Path) -> MachineFacts:
    """Measure; a few milliseconds and a few small writes below the folder of the ledger."""
    steps = []
    for _ in range(50):
        start = now = time.monotonic_ns()
        while now == start:
            now = time.monotonic_ns()
        steps.append(now - start)
    folder = next(p for p in (out.absolute(), *out.absolute().parents) if p.is_dir())
    return MachineFacts(
        clock_step_ns=min(steps),
        write_ms=_write_ms(folder),
        free_bytes=_free_bytes(folder),
        cores=os.cpu_count() or 1,
        governors=_governors(),
        first_in_line=may_be_first(),
        rmem_max=_number(Path("/proc/sys/net/core/rmem_max")),
        wmem_max=_number(Path("/proc/sys/net/core/wmem_max")),
    )


def judge_machine(facts: MachineFacts, uses_tunnel: bool) -> Sequence[Check]:
    """All checks of the machine."""
    f = facts
    fine = f.clock_step_ns <= 100_000
    checks = [
        judged(
            AREA,
            "clock",
            Finding.OK if fine else Finding.FAULT,
            f"monotonic clock steps by {f.clock_step_ns} ns",
            "a clock of 0.1 ms or finer is needed: every age and delay is measured with it",
        ),
        judged(
            AREA,
            "cores",
            Finding.OK if f.cores >= 2 else Finding.WARNING,
            f"{f.cores} core{'s' * (f.cores != 1)}",
            "coding pictures and control share one core: give the client two",
        ),
        judged(
            AREA,
            "priority",
            Finding.OK if f.first_in_line else Finding.WARNING,
            "the control loop gets real-time priority"
            if f.first_in_line
            else "no real-time priority for the control loop",
            "allow it (CAP_SYS_NICE, or rtprio 10 in /etc/security/limits.conf): ticks are more "
            "punctual under load (scripts/bench tick)",
        ),
    ]
    if f.governors:
        saving = "powersave" in f.governors
        checks.append(
            judged(
                AREA,
                "cpu frequency",
                Finding.WARNING if saving else Finding.OK,
                f"governor {', '.join(f.governors)}",
                "set the governor to performance for the flight",
            )
        )
    return [*checks, *_disk(f), *_buffers(f, uses_tunnel)]


def _disk(f: MachineFacts) -> list[Check]:
    if f.free_bytes is None or f.write_ms is None:
        return [
            judged(
                AREA,
                "disk",
                Finding.FAULT,
                "the folder of --out cannot be written",
                "give another --out: without a ledger nobody can tell what happened",
            )
        ]
    enough = f.free_bytes >= MIN_FREE_BYTES
    slow = f.write_ms > SLOW_WRITE_MS
    return [
        judged(
            AREA,
            "disk",
            Finding.OK if enough else Finding.FAULT,
            f"{f.free_bytes / 1e9:.1f} GB free",
            f"make room for the ledger: at least {MIN_FREE_BYTES / 1e9:g} GB",
        ),
        judged(
            AREA,
            "disk speed",
            Finding.WARNING if slow else Finding.OK,
            f"a forced write of 1 kB takes up to {f.write_ms:.0f} ms",
            f"over {SLOW_WRITE_MS:g} ms: another disk or card, or end what writes beside us; the "
            "newest lines of the ledger are lost when the power goes",
        ),
    ]


def _buffers(f: MachineFacts, uses_tunnel: bool) -> list[Check]:
    if f.rmem_max is None or f.wmem_max is None:
        return [unchecked(AREA, "socket buffers", "this system does not tell their limits")]
    least = min(f.rmem_max, f.wmem_max)
    small = least < BUFFER_BYTES
    finding = Finding.OK if not small else Finding.WARNING
    return [
        judged(
            AREA,
            "socket buffers",
            finding if uses_tunnel else Finding.OK,
            f"limits: receive {f.rmem_max} B, send {f.wmem_max} B",
            f"the UDP tunnel wants {BUFFER_BYTES} B: sysctl -w net.core.rmem_max={BUFFER_BYTES} "
            f"net.core.wmem_max={BUFFER_BYTES}",
        )
    ]


def _write_ms(folder: Path) -> float | None:
    path = folder / f".doctor-{os.getpid()}"
    longest = 0.0
    try:
        with path.open("wb") as file:
            for _ in range(5):
                start = time.monotonic()
                file.write(b"x" * 1000)
                file.flush()
                os.fsync(file.fileno())
                longest = max(longest, time.monotonic() - start)
        path.unlink()
    except OSError:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        return None
    return longest * 1e3


def _free_bytes(folder: Path) -> int | None:
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def _governors() -> tuple[str, ...]:
    found = set()
    for folder in Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq"):
        try:
            if "pstate" in (folder / "scaling_driver").read_text():
                continue  # there "powersave" is the usual one, and quick
            found.add((folder / "scaling_governor").read_text().strip())
        except OSError:
            continue
    return tuple(sorted(found))


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None
