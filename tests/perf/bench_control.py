"""Measure the safety filter: against solvers, on bad input, and in very many simulated approaches.

    scripts/bench control --quick
    scripts/bench control --kept run.jsonl --write docs/results/control.md

A full run takes some 20 minutes on two cores. With --kept a run that was broken off goes on where
it was. With --write the picture goes to figures/ beside the page.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from tests.perf import bench_control_plot as pictures
from tests.perf.bench_control_page import page, summarise
from tests.perf.bench_control_speed import agreement, speed
from tests.perf.bench_control_states import ask
from tests.perf.bench_control_trials import chunks, fingerprint, run

PICTURE = "control-stall.png"


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal; nothing elsewhere."""
    columns = (TextColumn("{task.description:24}"), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    with Progress(
        *columns, TimeRemainingColumn(), console=console, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All parts.

    Raises:
        ValueError: the kept flights are of other sources.
    """
    share = 0.002 if options.quick else options.share
    result: dict[str, Any] = {"share": share, "sources": fingerprint()}
    wanted = chunks(share)
    with progress("approaches", sum(chunk.flights for chunk in wanted)) as done:
        flown = 0

        def step(more: int) -> None:
            nonlocal flown
            flown += more
            done(flown)

        result["trials"] = summarise(run(wanted, options.jobs, options.kept, step))
    count = max(800, round(1_000_000 * share))
    with progress("states", count) as done:
        answers = ask(count, seed=2026, step=done)
    result["states"] = {
        "count": answers.states.total(),
        "kinds": dict(answers.states),
        "statuses": {str(status): n for status, n in answers.statuses.items()},
        "wrong": dict(answers.wrong),
    }
    result["agreement"] = agreement(max(20, round(10_000 * share)))
    rounds = 2 if options.quick else 10
    with progress("speed", rounds) as done:
        result["speed"] = speed(rounds, max(0.02, share), done)
    flights = pictures.flights(1 if options.quick else 6)
    result["variants"] = pictures.outcome(flights)
    if options.write:
        pictures.draw(flights, options.write.parent / "figures" / PICTURE)
    return result


def _share(text: str) -> float:
    share = float(text)
    if not 0.0 < share <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not in (0, 1]")
    return share


def _jobs(text: str) -> int:
    jobs = int(text)
    if not 1 <= jobs <= 256:
        raise argparse.ArgumentTypeError(f"{text} is not in [1, 256]")
    return jobs


def main() -> int:
    """Measure, print, and write what was asked for; 1 where a safety figure is missed."""
    parser = argparse.ArgumentParser(
        prog="scripts/bench control",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--share", type=_share, default=1.0, help="of a full run, in (0, 1]")
    parser.add_argument("--quick", action="store_true", help="a few of everything: some seconds")
    jobs = min(2, os.cpu_count() or 1)
    parser.add_argument("--jobs", type=_jobs, default=jobs, help="processes that fly")
    parser.add_argument("--kept", type=Path, help="keep flights here, and go on from them")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--write", type=Path, help="write the page to this Markdown file, too")
    options = parser.parse_args()
    try:
        result = measure(options)
    except (OSError, ValueError) as error:
        print(f"scripts/bench control: {error}", file=sys.stderr)
        return 2
    text, safe = page(result, f"scripts/bench {shlex.join(['control', *sys.argv[1:]])}", PICTURE)
    if options.write:
        options.write.parent.mkdir(parents=True, exist_ok=True)
        part = options.write.with_name(f".{options.write.name}.part")
        part.write_text(text, encoding="utf-8")
        os.replace(part, options.write)
    print(json.dumps(result, indent=2) if options.json else text)
    return 0 if safe else 1


if __name__ == "__main__":
    sys.exit(main())
