"""How many threads this process may run at full speed: its affinity and its CPU quota."""

from __future__ import annotations

import math
import os
from pathlib import Path

CGROUP_ROOT = Path("/sys/fs/cgroup")


def available_cpus(cgroup_root: Path = CGROUP_ROOT) -> int:
    """Whole CPUs that the scheduler and the container's quota leave us, at least one.

    More threads than that are throttled together at the end of each period: the tail suffers.
    """
    affinity = len(os.sched_getaffinity(0))
    quota = cpu_quota(cgroup_root)
    return affinity if quota is None else max(1, min(affinity, math.ceil(quota)))


def cpu_quota(cgroup_root: Path) -> float | None:
    """CPUs granted by cgroup v2 (``cpu.max``) or v1 (``cpu.cfs_quota_us``); None: no limit."""
    if (line := _read(cgroup_root / "cpu.max")) is not None:
        fields = line.split()
    else:
        fields = [
            _read(cgroup_root / "cpu" / name) or ""
            for name in ("cpu.cfs_quota_us", "cpu.cfs_period_us")
        ]
    if len(fields) != 2 or not all(f.isascii() and f.isdigit() for f in fields):
        return None  # "max", v1's -1, or no cgroup at all
    quota, period = map(int, fields)
    return quota / period if quota > 0 and period > 0 else None


def wait_asleep() -> None:
    """Let OpenMP's threads sleep while they wait; of use only before torch is loaded.

    As it comes it spins, and a thread that spins holds the core that the others need: on 2 cores
    shared with another job a picture took 330-870 ms, asleep 34 ms. What the user set stays.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def _read(path: Path) -> str | None:
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return None
