"""The picture of a run: it is drawn from any ledger, and what matters can be seen in it."""

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from drone_client import plot
from drone_client.ledger import Fate
from drone_client.plot import plot_run

MS = 1_000_000
GOLD = (np.array(to_rgb("gold")) * 0.25 + 0.75) * 255  # shaded at a quarter over white


def frame_line(i, fate="answered", **more):
    """A ledger line, 50 ms after the one before."""
    line = {"fate": fate, "t_capture_ns": i * 50 * MS, "encoding": None}
    if fate == "answered":
        line |= {"verdict": "accepted", "network_delay_ms": 20.0, "age_ms": 60.0}
        line |= {"t1_ns": i * 50 * MS, "bytes": 60_000}
        line |= {"encoding": {"rung": "full", "goodput_mbps": None if i == 0 else 40.0}}
    return line | more


def tick_line(i, freshness="fresh", **more):
    """A tick, 20 ms after the one before."""
    return {
        "t_ns": i * 20 * MS,
        "h_m": 1.0 - i / 100,
        "h_robust_m": 0.9 - i / 100,
        "freshness": freshness,
        "tip_target_m": [2 - i / 50, 0.1, 0.0],
        "command_mps": [0.2, 0.0, 0.0],
        "yaw_rate_radps": 0.01,
    } | more


def drawn(path, frames, ticks, events=()) -> np.ndarray:
    """The picture as it can be read again."""
    plot_run(path, frames, ticks, events, tau_max_ms=250, age_max_ms=300)
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    assert picture is not None
    return picture


def share(picture: np.ndarray, rgb, tolerance: float = 6) -> float:
    """Share of the pixels that have a colour."""
    return float((np.abs(picture - np.asarray(rgb, float)).max(axis=2) <= tolerance).mean())


def test_a_run_gives_a_picture_with_its_curves_and_its_stale_stretches(tmp_path):
    """Blue, orange and green curves on white, and gold behind the ticks that had to hold."""
    phases = ["fresh"] * 20 + ["hold"] * 20 + ["retreat"] * 10
    picture = drawn(
        tmp_path / "run.png",
        [frame_line(i) for i in range(20)],
        [tick_line(i, phase) for i, phase in enumerate(phases)],
    )
    assert min(picture.shape[:2]) > 800
    assert 0.5 < share(picture, (255, 255, 255)) < 0.99
    for name in ("tab:blue", "tab:orange", "tab:green"):
        assert share(picture, np.array(to_rgb(name)) * 255) > 1e-4
    assert share(picture, GOLD) > 0.01


def test_a_full_disk_leaves_no_half_of_a_picture(tmp_path):
    """It is told, and an empty picture would look like a run without a curve."""
    (tmp_path / ".run.part.png").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left on device"):
        drawn(tmp_path / "run.png", [frame_line(0)], [tick_line(0)])
    assert list(tmp_path.iterdir()) == []


def test_lines_without_numbers_are_drawn_around(tmp_path):
    """Refused times, ticks without a target, frames that nobody answered; nothing is shaded."""
    frames = [
        frame_line(0, verdict="impossible_time", network_delay_ms=None),
        frame_line(1, verdict="never_sent", network_delay_ms=None, age_ms=None),
        *(frame_line(2 + i, fate) for i, fate in enumerate(("no_reply", "no_worker"))),
        frame_line(4, "superseded_on_board"),
        frame_line(5, "interrupted"),
        frame_line(6, verdict="too_old", age_ms=900.0),
        frame_line(7, verdict="not_looked_at"),
    ]
    ticks = [
        {"t_ns": 0, "command_mps": [0, 0, 0], "yaw_rate_radps": 0},
        tick_line(1, h_m=None, h_robust_m=None),
    ]
    picture = drawn(tmp_path / "run.png", frames, ticks)
    for name in ("tab:purple", "tab:red", "tab:brown", "tab:pink"):
        assert share(picture, np.array(to_rgb(name)) * 255) > 1e-5
    assert share(picture, GOLD) < 1e-3


@pytest.mark.parametrize("fate", [f for f in Fate if f is not Fate.ANSWERED])
def test_every_fate_is_drawn_in_a_colour_of_its_own(tmp_path, fate):
    """A fate that is new and was forgotten here fails this test."""
    color = plot._FATE_COLORS[fate.value]
    assert list(plot._FATE_COLORS.values()).count(color) == 1
    assert color != "black"
    rgb = np.array(to_rgb(color)) * 255
    frames, ticks = [frame_line(i) for i in range(20)], [tick_line(i) for i in range(20)]
    without = share(drawn(tmp_path / "a.png", frames, ticks), rgb)
    frames += [frame_line(20 + i, fate.value) for i in range(5)]
    assert share(drawn(tmp_path / "b.png", frames, ticks), rgb) > without


def test_no_legend_covers_a_panel(tmp_path, monkeypatch):
    """Each stands to the right of its axes and of its second scale, and inside the picture."""
    figures = []
    monkeypatch.setattr(
        "matplotlib.figure.Figure.savefig", lambda self, *_, **__: figures.append(self)
    )
    frames = [frame_line(i) for i in range(20)] + [frame_line(20, "too_old_on_board")]
    plot_run(tmp_path / "run.png", frames, [tick_line(i) for i in range(20)], [], 250, 300)
    (figure,) = figures
    figure.canvas.draw()
    boxes = [a.get_legend().get_window_extent() for a in figure.axes if a.get_legend()]
    assert len(boxes) == 5
    for box in boxes:
        assert box.x1 <= figure.bbox.x1
        assert not any(box.overlaps(axes.get_window_extent()) for axes in figure.axes)


def test_an_empty_run_has_a_picture_too(tmp_path):
    """Interrupted before the first frame."""
    assert drawn(tmp_path / "run.png", [], []).size


def test_a_hand_over_is_marked(tmp_path):
    """Purple where the drone went to another worker, and no purple for its first choice."""
    purple = np.array(to_rgb("tab:purple")) * 255
    first = {"event": "worker", "before": None, "now": "w1", "t_ns": 0}
    change = {"event": "worker", "before": "w1", "now": "w2", "t_ns": 400 * MS}
    frames, ticks = [frame_line(i) for i in range(20)], [tick_line(i) for i in range(50)]
    without = share(drawn(tmp_path / "a.png", frames, ticks, [first]), purple)
    marked = share(drawn(tmp_path / "b.png", frames, ticks, [first, change]), purple)
    assert marked > without


def test_what_was_flown_on_own_eyes_is_shaded(tmp_path):
    """Light cyan behind a bridge, and nowhere else."""
    cyan = (np.array(to_rgb("tab:cyan")) * 0.2 + 0.8) * 255
    frames = [frame_line(i) for i in range(20)]

    def picture(source: str) -> np.ndarray:
        ticks = [tick_line(i, target_source=source if 10 <= i < 40 else "edge") for i in range(50)]
        return drawn(tmp_path / f"{source}.png", frames, ticks)

    assert share(picture("onboard"), cyan) > 0.01
    assert share(picture("edge"), cyan) < 1e-4
