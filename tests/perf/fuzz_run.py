"""Run a fuzzer on several processes, watch it, and say what came of it.

Work comes in blocks; a block is all made from ``SEED-NUMBER``, so one that fails is repeated with
``--block``. A process writes what it has thrown into shared memory; one that throws nothing for
long hangs, also if it does so inside a library where no signal is looked at.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from typing import Any, Protocol

HANG_S = 20.0
"""Of processor time without anything thrown: a busy machine is no hang."""
STUCK_S = 120.0
"""Of any time: it waits for what never comes."""
MAX_GROWTH_BYTES = 48 * 1024 * 1024
"""Of each process after its first blocks: two sessions full of pieces of messages, and what the
allocator keeps."""
WARM_SHARE = 0.1
NICENESS = 10


class Block(Protocol):
    """A stretch of fuzzing that is repeatable."""

    outcomes: Counter[str]
    thrown: int

    def throw(self) -> int:
        """Throw some; how many. Whatever it raises is a find."""

    def close(self) -> None:
        """It is over; ``outcomes`` is complete."""


@dataclass
class Report:
    """What one process did, or all of them."""

    outcomes: Counter[str] = field(default_factory=Counter)
    thrown: int = 0
    slowest_s: float = 0.0
    """Processor time of the slowest batch."""
    growth_bytes: int = 0
    peak_bytes: int = 0
    find: str = ""

    def add(self, other: Report) -> None:
        """The reports of several processes in one."""
        self.outcomes += other.outcomes
        self.thrown += other.thrown
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.growth_bytes = max(self.growth_bytes, other.growth_bytes)
        self.peak_bytes = max(self.peak_bytes, other.peak_bytes)
        self.find += other.find


@dataclass(frozen=True)
class Plan:
    """What is to be done.

    Args:
        make: a block from its seed.
        block: how many it throws.
        count: of all processes together.
        seed: of all blocks.
        processes: how many.
    """

    make: Callable[[str], Block]
    block: int
    count: int
    seed: int = 0
    processes: int = 1


def run_block(plan: Plan, number: int, report: Report, note: Callable[[int], None]) -> bool:
    """One block; False: it made a find, which is in the report."""
    block = None
    try:
        block = plan.make(f"{plan.seed}-{number}")
        while block.thrown < plan.block:
            began_s = time.process_time()
            note(block.throw())
            report.slowest_s = max(report.slowest_s, time.process_time() - began_s)
        return True
    except BaseException as error:  # a panic of a library in Rust is no Exception
        report.find = f"block {number} of seed {plan.seed}\n{traceback.format_exc()}"
        if isinstance(error, KeyboardInterrupt):
            report.find = "interrupted"
        return False
    finally:
        if block is not None:
            block.close()
            report.outcomes += block.outcomes
            report.thrown += block.thrown


def run(plan: Plan, unit: str) -> Report:
    """All blocks, on ``processes``; progress to stderr."""
    context = multiprocessing.get_context("spawn")
    counts = context.Array("q", plan.processes, lock=False)
    blocks = context.Array("q", plan.processes, lock=False)
    results: SimpleQueue[Report] = context.SimpleQueue()
    last = -(-plan.count // plan.block)
    children = [
        context.Process(
            target=_child,
            args=(plan, range(i, last, plan.processes), counts, blocks, i, results),
        )
        for i in range(plan.processes)
    ]
    for child in children:
        child.start()
    total, done = Report(), 0
    began_s = time.monotonic()
    moved = [(0, began_s, 0.0)] * plan.processes
    while done < plan.processes and not total.find:
        while not results.empty():
            total.add(results.get())
            done += 1
        now_s = time.monotonic()
        for i, child in enumerate(children):
            _, since_s, spent_s = moved[i]
            if counts[i] != moved[i][0] or not child.is_alive():
                moved[i] = (counts[i], now_s, processor_s(child.pid))
            elif now_s - since_s > STUCK_S or processor_s(child.pid) - spent_s > HANG_S:
                total.find = f"a hang in block {blocks[i]} of seed {plan.seed}"
            if child.exitcode not in (None, 0) and results.empty():
                where = f"block {blocks[i]} of seed {plan.seed}"
                total.find = f"died with {child.exitcode} in {where}"
        thrown = sum(counts)
        rate_hz = thrown / (now_s - began_s)
        sys.stderr.write(f"\r{thrown}/{plan.count} {unit}, {rate_hz:.0f} a second ")
        sys.stderr.flush()
        time.sleep(0.5)
    sys.stderr.write("\n")
    for child in children:
        child.kill() if total.find else None
        child.join()
    return total


def print_report(report: Report, took_s: float, unit: str) -> None:
    """A line for each outcome, and a summary."""
    for name, number in report.outcomes.most_common():
        print(f"{number:12d}  {name}")
    if report.find:
        print(report.find)
    print(
        f"{report.thrown} {unit} in {took_s:.0f} s, {report.thrown / took_s:.0f} a second; slowest "
        f"batch {report.slowest_s * 1e3:.0f} ms of processor time; each process at most "
        f"{report.peak_bytes / 2**20:.0f} MiB, {report.growth_bytes / 2**20:.1f} MiB more than "
        f"after its first tenth (bound {MAX_GROWTH_BYTES / 2**20:.0f}); "
        f"{'A FIND' if report.find else 'no crash, no hang'}"
    )


def processor_s(pid: int | None) -> float:
    """Processor time that a process has spent; 0: it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_bytes() -> int:
    """Memory of this process that is in use."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize()


def _child(plan: Plan, numbers: range, counts: Any, blocks: Any, slot: int, results: Any) -> None:
    os.nice(NICENESS)
    report, warm_bytes = Report(), 0

    def note(thrown: int) -> None:
        counts[slot] += thrown

    for done, number in enumerate(numbers, start=1):
        blocks[slot] = number
        if not run_block(plan, number, report, note):
            break
        if not warm_bytes and done >= len(numbers) * WARM_SHARE:
            warm_bytes = resident_bytes()
    report.growth_bytes = max(0, resident_bytes() - warm_bytes) if warm_bytes else 0
    report.peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    if report.growth_bytes > MAX_GROWTH_BYTES and not report.find:
        report.find = f"{report.growth_bytes} bytes more memory"
    results.put(report)
