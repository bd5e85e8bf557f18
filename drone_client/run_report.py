"""The end of a run: everything taken down, and what it came to written beside the ledger."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from drone_client.errors import OutputError
from drone_client.flight import Flight
from drone_client.ledger import Ledger
from drone_client.link import Link
from drone_client.link.choose import link_summary
from drone_client.plot import plot_run
from drone_client.run_files import (
    EVENTS_NAME,
    LEDGER_NAME,
    ONBOARD_NAME,
    PLOT_NAME,
    SUMMARY_NAME,
    TICKS_NAME,
    check_earlier,
)
from drone_client.settings import ClientSettings
from drone_client.summary import read_lines, summarise
from drone_client.truth import TruthEntry
from drone_client.viewing.whole_file import write_whole


def check_folder(folder: Path, *, overwrite: bool) -> None:
    """See, before anything is started, whether a run may be written there; touches nothing.

    Raises:
        OutputError: it may not, or holds an earlier run that ``overwrite`` does not let go.
    """
    try:
        check_earlier(folder, overwrite=overwrite)
        there = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    except OSError as error:
        raise OutputError(f"folder {folder}: {error.strerror}") from None
    if not there.is_dir():
        raise OutputError(f"folder {folder}: {there} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise OutputError(f"folder {folder}: {there} cannot be written")


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Write ``summary.json``; a disk that does not take it is told under ``unwritten``."""
    try:
        text = json.dumps(summary, indent=2) + "\n"
        write_whole(folder / SUMMARY_NAME, text.encode())
    except OSError as error:
        summary["unwritten"].append(f"{folder / SUMMARY_NAME}: {error.strerror}")


def take_down(flight: Flight, link: Link) -> dict[str, Any]:
    """Stop a flight; returns what its link and workers were like until then."""
    at_end = {
        "standings": flight.uplink.standings(),
        "same_name_workers": flight.uplink.same_name_workers,
        "link": link_summary(link),  # before it is closed, and knows nobody any more
    }
    flight.stop()
    return at_end


def report(
    folder: Path,
    settings: ClientSettings,
    flight: Flight,
    ledger: Ledger,
    about: dict[str, Any],
    *,
    truth: tuple[TruthEntry, ...] = (),
    plot: bool = True,
) -> dict[str, Any]:
    """The summary of a run that was taken down; written with its plot, as far as the disk lets.

    What could not be written is told under ``unwritten``.

    Args:
        folder: Of the ledger.
        settings: The run's.
        flight: Its counts.
        ledger: Closed.
        about: What stands in the summary beside that.
        truth: Per capture; empty where nobody knows.
        plot: Draw the run.
    """
    frames, ticks, events = (
        read_lines(folder / name) for name in (LEDGER_NAME, TICKS_NAME, EVENTS_NAME)
    )
    looks = read_lines(folder / ONBOARD_NAME) if settings.onboard_fallback else None
    summary = {
        "drone": settings.name,
        "connect": settings.connect,
        "tau_max_ms": settings.tau_max_ms,
        "age_max_ms": settings.age_max_ms,
        **summarise(frames, ticks, events, truth, looks),
        "rejected_messages": {r.value: n for r, n in flight.receiver.rejects.items()},
        "foreign_messages": flight.receiver.foreign,
        "late_results": flight.tally.late_results,
        "control_errors": flight.tally.control_errors,
        "receive_errors": flight.tally.receive_errors,
        "lost_ledger_lines": ledger.lost_lines,
        "unwritten": [],
        **about,
    }
    if flight.own_eyes is not None:
        summary["onboard"]["taken_back"] = flight.own_eyes.contradicted
    write_summary(folder, summary)
    if plot:
        try:
            path = folder / PLOT_NAME
            plot_run(path, frames, ticks, events, settings.tau_max_ms, settings.age_max_ms)
        except OSError as error:
            summary["unwritten"].append(f"{folder / PLOT_NAME}: {error.strerror}")
    return summary
