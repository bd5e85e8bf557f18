"""What ``train`` shows while it runs, and how it is asked to stop."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from detector_training.training.loop import Progress

LINE_EVERY_S = 30.0
"""How often a line is printed where there is no terminal for a bar."""


@contextmanager
def stop_when_asked() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or SIGTERM came: the step is finished and saved; a second one acts at once."""
    asked = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    before = {s: signal.signal(s, note) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def progress(console: Console) -> Iterator[Callable[[Progress], None]]:
    """A live bar on a terminal, else a line now and then; each score has a line of its own."""

    def note(p: Progress) -> None:
        if p.val is not None:
            console.print(
                f"{p.images} pictures seen: AP50-95 {p.val.ap50_95:.3f}  recall {p.val.recall:.3f}"
                f"  false {p.val.false_per_picture:.4f} a picture",
                soft_wrap=True,
                highlight=False,
            )

    if not console.is_terminal:
        last = time.monotonic()

        def line(p: Progress) -> None:
            nonlocal last
            note(p)
            if (now := time.monotonic()) - last >= LINE_EVERY_S:
                last = now
                console.print(
                    f"{p.share:6.1%}  step {p.step}  pictures {p.images}  loss {p.loss:.3f}"
                )

        yield line
        return
    text = TextColumn("step {task.fields[step]}  loss {task.fields[loss]:.3f}")
    with Bar(BarColumn(), text, TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task("", total=1.0, step=0, loss=float("nan"))

        def move(p: Progress) -> None:
            bar.update(task, completed=p.share, step=p.step, loss=p.loss)
            note(p)

        yield move
