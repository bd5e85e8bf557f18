"""Throw hostile input at everything that reads from the network: scripts/fuzz.

datagrams   both ends of the UDP tunnel, without a key and with one
messages    FRAME, RESULT, ACK, PROBE, STATUS: checked, unpacked, decompressed
atheris     both, guided by what the input reaches
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence

from tests.perf import fuzz_run
from tests.perf.fuzz_tunnel import BLOCK as DATAGRAMS
from tests.perf.fuzz_tunnel import TunnelBlock
from tests.perf.fuzz_wire import BLOCK as MESSAGES
from tests.perf.fuzz_wire import MessageBlock


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what was asked for; 1 if something was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("datagrams", "messages", "atheris"))
    parser.add_argument("--count", type=int, default=100_000, help="of inputs (not atheris)")
    parser.add_argument("--seconds", type=int, default=60, help="of each target (atheris)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--block", type=int, help="repeat this one alone, on this process")
    args = parser.parse_args(arguments)
    if args.what == "atheris":
        return _guided(args.seconds, args.seed)
    make, size = (TunnelBlock, DATAGRAMS) if args.what == "datagrams" else (MessageBlock, MESSAGES)
    plan = fuzz_run.Plan(make, size, args.count, args.seed, args.processes)
    began_s = time.monotonic()
    if args.block is None:
        report = fuzz_run.run(plan, args.what)
    else:
        report = fuzz_run.Report()
        fuzz_run.run_block(plan, args.block, report, lambda thrown: None)
    fuzz_run.print_report(report, time.monotonic() - began_s, args.what)
    return 1 if report.find else 0


def _guided(seconds: int, seed: int) -> int:
    """Each target in a process of its own: atheris ends the one in which it runs."""
    codes = []
    for target in ("tunnel", "messages"):
        command = [sys.executable, "-m", "tests.perf.fuzz_atheris", target]
        codes.append(subprocess.run([*command, str(seconds), str(seed)], check=False).returncode)
    return max(map(abs, codes))


if __name__ == "__main__":
    sys.exit(main())
