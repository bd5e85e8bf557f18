"""Recordings for long flights: the shipped one, several times over."""

from __future__ import annotations

from pathlib import Path

RECORDING = Path(__file__).parents[1] / "examples/recordings/rendered-approach"
REPEATS = 60
"""The shipped recording is short; it is laid end to end, for longer than a loaded machine needs to
start a service again. Ctrl-C ends the flight when enough has been seen."""


def long_recording(folder: Path) -> Path:
    """The shipped recording, several times over, forth and back."""
    folder.mkdir()
    (folder / "camera.json").write_bytes((RECORDING / "camera.json").read_bytes())
    lists: dict[str, list[str]] = {"rgb.txt": [], "depth.txt": [], "groundtruth.txt": []}
    for name, lines in lists.items():
        rows = [
            line.split(maxsplit=1)
            for line in (RECORDING / name).read_text().splitlines()
            if not line.startswith("#")
        ]
        start, end = float(rows[0][0]), float(rows[-1][0])
        period = end - start + 0.1
        for repeat in range(REPEATS):
            for t, rest in rows if repeat % 2 == 0 else reversed(rows):
                along = float(t) - start if repeat % 2 == 0 else end - float(t)
                lines.append(f"{1000 + repeat * period + along:.6f} {rest}")
        (folder / name).write_text("\n".join(lines) + "\n")
    for name in ("rgb", "depth"):
        (folder / name).symlink_to(RECORDING / name)
    return folder


def close_recording(folder: Path, last: int = 25) -> Path:
    """The last frames of the shipped recording, in which the target is in view, forth and back."""
    long_recording(folder)
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        shipped = [x for x in (RECORDING / name).read_text().splitlines() if x[0] != "#"][-last:]
        rows = [x.split(maxsplit=1) for x in shipped]
        stamps = [float(t) for t, _ in rows]
        period = stamps[-1] - stamps[0] + 0.1
        lines = []
        for repeat in range(REPEATS):
            there = repeat % 2 == 0
            for t, (_, rest) in zip(stamps, rows if there else reversed(rows), strict=True):
                lines.append(f"{1000 + repeat * period + t - stamps[0]:.6f} {rest}")
        (folder / name).write_text("\n".join(lines) + "\n")
    return folder
